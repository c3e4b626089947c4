#pragma once

#include <cstddef>

#include "server/app/offline/cut_run.hpp"

namespace incise::app {

// Adds poses to a text motion whose poses lie further apart than a device's, so that forces follow it at the haptic rate: one a
// millisecond (fewer in motions of more than 1,000 s), the position on the line between two poses, the orientation by slerp (Shoemake 1985), and of
// the buttons those that are held at both ends. Not where the session sees a jump, and not in a capture, which has what a device sent.
// Returns how many it added.
std::size_t interpolate_to_force_rate(CutInput& input);

}  // namespace incise::app
