#pragma once

#include <cstdint>

namespace incise::core {

// Counted work: what a budget is in, so that no clock decides anything. One unit is about the work on one
// tetrahedron: some 50 ns. server/loop knows what a unit costs on this machine.
struct WorkBudget {
  std::int64_t left = 0;

  static WorkBudget unlimited() { return {INT64_MAX}; }
  bool spent() const { return left <= 0; }
  void charge(std::int64_t units) { left -= units; }
};

}  // namespace incise::core
