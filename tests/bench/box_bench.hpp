#pragma once

#include <vector>

#include "tests/bench/bench_util.hpp"
#include "tests/bench/live_server.hpp"

namespace incise::bench {

struct BoxBench {
  LiveMotion motion;
  std::vector<int> boxed;  // how many viewers with a box, one run each
  double part = 0.5;       // of the body's size that a box has along each axis
  double rate_hz = 60;     // of the simulator
  int rounds = 1;
};

// A simulator moves the whole body while viewers with a box follow.
void bench_boxed(const BoxBench& bench, Report& report);

}  // namespace incise::bench
