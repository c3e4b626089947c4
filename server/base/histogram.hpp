#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cstdint>

namespace incise {

// Counts of durations in buckets of constant relative width (the layout of HdrHistogram, G. Tene): exact
// below 32 ns, then 32 buckets an octave, so a quantile is right to 3 %. Up to 2^40 ns (18 minutes); longer
// ones count as that.
//
// Thread: record() from one; the rest from any, without a lock: a reader sees each count as it was at some
// moment.
class Histogram {
 public:
  void record(std::int64_t ns) {
    const std::uint64_t value = ns < 0 ? 0 : static_cast<std::uint64_t>(ns);
    bump(buckets_[index(value)], 1);
    bump(count_, 1);
    bump(sum_, value);
    if (value > max_.load(std::memory_order_relaxed)) max_.store(value, std::memory_order_relaxed);
  }

  std::uint64_t count() const { return count_.load(std::memory_order_relaxed); }
  std::uint64_t sum_ns() const { return sum_.load(std::memory_order_relaxed); }
  std::uint64_t max_ns() const { return max_.load(std::memory_order_relaxed); }
  // The duration that a part q (0 ... 1) of all did not exceed: the upper end of its bucket, at most
  // max_ns(); 0 where nothing is recorded.
  std::uint64_t quantile_ns(double q) const {
    std::uint64_t total = 0;
    for (const auto& bucket : buckets_) total += bucket.load(std::memory_order_relaxed);
    if (total == 0) return 0;
    const double wanted = q * static_cast<double>(total);
    std::uint64_t seen = 0;
    for (std::size_t i = 0; i < buckets_.size(); ++i) {
      seen += buckets_[i].load(std::memory_order_relaxed);
      if (seen > 0 && static_cast<double>(seen) >= wanted) return std::min(upper_end(i), max_ns());
    }
    return max_ns();
  }

 private:
  static constexpr int kSubBits = 5;
  static constexpr int kOctaves = 40;
  static constexpr std::size_t kBuckets = std::size_t{kOctaves - kSubBits + 1} << kSubBits;

  static std::size_t index(std::uint64_t value) {
    if (value < (1u << kSubBits)) return value;
    const auto octave = static_cast<int>(std::bit_width(value)) - 1;
    if (octave >= kOctaves) return kBuckets - 1;
    const std::uint64_t sub = (value >> (octave - kSubBits)) & ((1u << kSubBits) - 1);
    return (static_cast<std::size_t>(octave - kSubBits + 1) << kSubBits) + sub;
  }
  static std::uint64_t upper_end(std::size_t i) {
    const std::size_t octave = i >> kSubBits, sub = i & ((1u << kSubBits) - 1);
    if (octave == 0) return sub;
    return (((std::uint64_t{1} << kSubBits) + sub + 1) << (octave - 1)) - 1;
  }
  // One writer: a load and a store, not a locked addition.
  static void bump(std::atomic<std::uint64_t>& counter, std::uint64_t by) {
    counter.store(counter.load(std::memory_order_relaxed) + by, std::memory_order_relaxed);
  }

  std::array<std::atomic<std::uint64_t>, kBuckets> buckets_{};
  std::atomic<std::uint64_t> count_{0}, sum_{0}, max_{0};
};

}  // namespace incise
