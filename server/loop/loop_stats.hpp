#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include "server/base/histogram.hpp"
#include "server/core/stroke/stroke_builder.hpp"

namespace incise::loop {

// A value of several words from one writer to any readers, without a lock: the writer's sequence number is
// odd while it writes, and a reader tries again if it was odd or has changed (the seqlock; Boehm 2012,
// "Can seqlocks get along with programming language memory models?"). Words are stored with release and
// loaded with acquire instead of his fences: a reader that sees a new word then also sees the odd number that was
// stored before it.
template <class T>
class Published {
  static_assert(std::is_trivially_copyable_v<T> && sizeof(T) % sizeof(std::uint64_t) == 0);

 public:
  Published() { store(T{}); }
  void store(const T& value) {
    std::uint64_t words[kWords];
    std::memcpy(words, &value, sizeof value);
    const std::uint64_t sequence = sequence_.load(std::memory_order_relaxed);
    sequence_.store(sequence + 1, std::memory_order_relaxed);
    for (std::size_t i = 0; i < kWords; ++i) words_[i].store(words[i], std::memory_order_release);
    sequence_.store(sequence + 2, std::memory_order_release);
  }
  T load() const {
    std::uint64_t words[kWords];
    for (;;) {
      const std::uint64_t before = sequence_.load(std::memory_order_acquire);
      for (std::size_t i = 0; i < kWords; ++i) words[i] = words_[i].load(std::memory_order_acquire);
      if (before % 2 == 0 && sequence_.load(std::memory_order_relaxed) == before) break;
    }
    T value;
    std::memcpy(&value, words, sizeof value);
    return value;
  }

 private:
  static constexpr std::size_t kWords = sizeof(T) / sizeof(std::uint64_t);
  std::atomic<std::uint64_t> sequence_{0};
  std::array<std::atomic<std::uint64_t>, kWords> words_{};
};

// Why a frame ended after the next one should have begun.
enum class LateCause : std::uint8_t { kWakeUp, kInput, kCut, kPublish };
inline constexpr int kLateCauses = 4;
const char* to_string(LateCause cause);

// Limits that a frame ran into; it completed nevertheless.
enum FrameFlag : std::uint64_t {
  kBudgetSpent =
      1,  // work is carried over: raise loop.budget_fraction, lower loop.rate_hz, or use a coarser mesh
  kInputCarried = 2,    // poses wait in their queues for the next frame
  kDeltasBlocked = 4,   // the stream does not read: cutting waits for it
  kJournalBlocked = 8,  // the disk does not keep up: the journal has a gap
};

// Where the loop is, as of the end of a frame.
struct LoopState {
  std::uint64_t revision = 0;
  std::uint64_t state_hash = 0;
  std::uint64_t live_tets = 0;
  std::uint64_t vertices = 0;  // slots
  std::uint64_t frames = 0;
  std::uint64_t skipped_frames = 0;    // whose time had passed before they could begin
  std::uint64_t backlog_events = 0;    // poses in the queues
  std::uint64_t backlog_batches = 0;   // to be cut, the one at work included
  std::uint64_t backlog_segments = 0;  // of these
  std::uint64_t backlog_ns = 0;        // work that these stand for, estimated
  std::uint64_t recovery_ns = 0;       // until they are done if nothing more comes, estimated
  std::uint64_t flags = 0;             // of the last frame: FrameFlag
  std::uint64_t cut_faces = 0;         // opened so far; a session that goes on begins with those of its body
  std::uint64_t strokes = 0;  // of all sources, begun since the start, those that were undone as well
  double cut_area_m2 = 0;     // of these, one side
  double ns_per_unit = 0;     // the cost model's
  std::uint64_t forces_cut_short = 0;  // whose edge was not searched to its end
};

// Where a blade was last; arrival_ns is 0 where there was no pose yet.
struct BladeNow {
  std::int64_t arrival_ns = 0;
  std::int64_t cutting = 0;  // 1: a stroke is under way
  // Since it has its present owner: strokes begun and faces opened that are neither undone nor gone with a reset.
  std::uint64_t strokes = 0, cut_faces = 0;
  core::BladeLine line;
  core::Vec3 force;  // on the hand, N
};
using BladesNow = std::array<BladeNow, core::kMaxSources>;

// What the loop tells about itself. Thread: written by the loop's, read by any.
struct LoopStats {
  Published<LoopState> state;
  Published<BladesNow> blades;  // by source

  Histogram wake_late;   // start of a frame after its deadline
  Histogram frame_work;  // start to end of a frame
  Histogram drain;       // stages of a frame that had something to do
  Histogram force;
  Histogram cut;
  Histogram publish;
  Histogram batch_cut;      // work on one batch or a part of it, over all its frames
  Histogram pose_to_force;  // arrival of a blade's newest pose until its force was there
  Histogram deform;         // work on one deformation, likewise
  Histogram pose_to_drain;  // arrival of a batch's last pose until the loop took it
  Histogram pose_to_cut;    // ... until the batch was committed

  std::array<std::atomic<std::uint64_t>, kLateCauses> late{};  // frames by LateCause
  std::array<std::atomic<std::uint64_t>, core::kPoseVerdicts> verdicts{};
  std::atomic<std::uint64_t> batches{0};
  std::atomic<std::uint64_t> deformations{0}, vertices_moved{0}, vertices_held{0};
  std::atomic<std::uint64_t> journal_lost{0};  // records that found the journal's queue full

  std::uint64_t late_frames() const {
    std::uint64_t sum = 0;
    for (const auto& n : late) sum += n.load(std::memory_order_relaxed);
    return sum;
  }
};

// Adds to a counter that one thread writes.
inline void bump(std::atomic<std::uint64_t>& counter, std::uint64_t by = 1) {
  counter.store(counter.load(std::memory_order_relaxed) + by, std::memory_order_relaxed);
}

}  // namespace incise::loop
