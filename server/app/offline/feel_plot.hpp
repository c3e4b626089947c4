#pragma once

#include <string>
#include <vector>

#include "server/app/offline/feel_run.hpp"

namespace incise::app {

// A figure of forces over time, as SVG: for one blade its magnitude and components, for several the magnitude of each;
// shaded where a blade is engaged and where one is inside, with a mark at each puncture. Self-contained, without scripts, at most
// four points a pixel, readable on light and dark pages. `names[s]` is the name of source s.
std::string force_plot(const std::vector<FeltPose>& poses, const std::vector<std::string>& names);

}  // namespace incise::app
