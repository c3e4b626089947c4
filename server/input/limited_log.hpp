#pragma once

#include <spdlog/common.h>

#include <cstdint>
#include <string>

namespace incise::input {

// Log lines that a peer can cause: ten at once, then one every five seconds, which says how many were left out.
//
// Thread: one.
class LimitedLog {
 public:
  void write(spdlog::level::level_enum level, const std::string& line);

 private:
  double tokens_ = 10;
  std::int64_t last_ns_ = 0;
  std::uint64_t left_out_ = 0;
};

}  // namespace incise::input
