#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "server/app/offline/recorded_motion.hpp"

namespace incise::app {

// The names that a capture has for its sources: those of their holders, as its notes have them, and of the configuration. Each once, in
// order, and only the first few of a source.
std::map<std::uint32_t, std::vector<std::string>> source_names(const RecordedMotion& motion);

}  // namespace incise::app
