#include "server/input/openigtlink/pose_clock.hpp"

#include <algorithm>

namespace incise::input::openigtlink {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;
// Of the mean over the last poses. Longer than most bursts, and short enough to follow a peer that changes its rate.
constexpr double kPosesOfMean = 32;
// A longer interval is a pause, which says nothing about the period.
constexpr double kMaxPeriod_ns = 0.1e9;

}  // namespace

void PoseClock::begin() {
  has_pose_ = false;
  offset_ns_ = ahead_ns_ = 0;
}

std::int64_t PoseClock::time_of(std::int64_t stamp_ns, std::int64_t arrival_ns) {
  std::int64_t time_ns = 0;
  if (stamp_ns == 0) {
    time_ns = time_without_stamp(arrival_ns);
  } else {
    if (has_pose_ && stamp_ns + offset_ns_ < source_ns_ - kSecond_ns) {
      offset_ns_ = source_ns_ + std::max<std::int64_t>(arrival_ns - arrival_ns_, 1) - stamp_ns;
      ++restarts_;
    }
    time_ns = stamp_ns + offset_ns_;
    ahead_ns_ = 0;
  }
  has_pose_ = true;
  arrival_ns_ = arrival_ns;
  return source_ns_ = time_ns;
}

std::int64_t PoseClock::time_without_stamp(std::int64_t arrival_ns) {
  if (!has_pose_) return arrival_ns;
  const std::int64_t passed_ns = std::max<std::int64_t>(arrival_ns - arrival_ns_, 0);
  period_ns_ += (std::min(static_cast<double>(passed_ns), kMaxPeriod_ns) - period_ns_) / kPosesOfMean;
  const auto apart_ns = std::max<std::int64_t>(static_cast<std::int64_t>(period_ns_ / 2), 1);
  const std::int64_t step_ns = std::max(passed_ns - ahead_ns_, apart_ns);
  ahead_ns_ += step_ns - passed_ns;
  return source_ns_ + step_ns;
}

}  // namespace incise::input::openigtlink
