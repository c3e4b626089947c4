#pragma once

#include <cstdint>

namespace incise::input::openigtlink {

// Source times of one tool's poses: the peer's clock where messages have a timestamp, else made from when they arrived.
//
// Messages that arrive together were not measured together: the network or the peer's buffer kept them. By their arrival the blade would
// have moved between them in microseconds, which is a jump. So poses without a timestamp are at least half of the peer's mean period
// apart, and the times of those that come at once run ahead of their arrival. They do so by at most half of the time that the peer takes
// to send as many, since the half makes up for that while poses come one by one. No pose waits, and equal arrivals give equal times.
class PoseClock {
 public:
  // Forgets the poses before, and a clock that was set back. What is known of the peer's period stays.
  void begin();
  // Of a pose with that timestamp (0: none) that arrives then. Increases for poses without a timestamp.
  std::int64_t time_of(std::int64_t stamp_ns, std::int64_t arrival_ns);
  // How often the peer's clock was set back by more than a second; times continue from where they were.
  std::uint64_t restarts() const { return restarts_; }

 private:
  std::int64_t time_without_stamp(std::int64_t arrival_ns);

  bool has_pose_ = false;
  std::int64_t arrival_ns_ = 0, source_ns_ = 0;  // of the last pose
  std::int64_t offset_ns_ = 0;                   // from the peer's clock to source time
  std::int64_t ahead_ns_ = 0;                    // the last source time of its arrival
  double period_ns_ = 10e6;                      // a tracker's, until the peer shows its own
  std::uint64_t restarts_ = 0;
};

}  // namespace incise::input::openigtlink
