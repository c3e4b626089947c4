#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "server/app/offline/recorded_motion.hpp"

namespace incise::app {

struct SourceNames {
  std::vector<std::string> names;  // the first few
  std::size_t others = 0;          // how many more there are
};

// The names that a capture has for its sources: of the holders whose poses are in its state, each once, in order. Where no note says who they were, those of the
// configuration.
std::map<std::uint32_t, SourceNames> source_names(const RecordedMotion& motion);

}  // namespace incise::app
