#pragma once

#include <cstddef>
#include <cstdint>

namespace incise::core {

// Budgets are counted work, so that no clock decides anything. One unit is about the work on one
// tetrahedron: some 50 ns. server/loop measures what a unit costs on this machine.
struct WorkBudget {
  std::int64_t left = 0;

  static WorkBudget unlimited() { return {INT64_MAX}; }
  bool spent() const { return left <= 0; }
  void charge(std::int64_t units) { left -= units; }
};

// Units done and not charged to a budget yet.
class WorkMeter {
 public:
  WorkMeter& operator+=(std::int64_t units) {
    units_ += units;
    return *this;
  }
  // The same for operations of which `a_unit` make one unit.
  void add(std::size_t count, std::size_t a_unit) { units_ += static_cast<std::int64_t>(count / a_unit); }
  void charge(WorkBudget& budget) {
    budget.charge(units_);
    units_ = 0;
  }

 private:
  std::int64_t units_ = 0;
};

}  // namespace incise::core
