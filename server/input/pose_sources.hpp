#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "server/core/cut/cut_config.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/core/stroke/stroke_builder.hpp"
#include "server/input/doorbell.hpp"
#include "server/input/spsc_queue.hpp"

namespace incise::input {

// A pose and when it reached this machine: CLOCK_MONOTONIC, ns.
struct TimedPose {
  core::Pose pose;
  std::int64_t arrival_ns = 0;
};

// What a source tells the loop.
struct InputEvent {
  enum class Kind : std::uint8_t {
    kOpened,     // the blade has a new owner: with its own clock, `blade`
    kPose,       // `pose`
    kEndStroke,  // the blade was released, or its owner vanished
  };
  Kind kind = Kind::kPose;
  TimedPose pose;  // of kOpened and kEndStroke: arrival_ns only
  core::Blade blade;
  std::uint32_t owner = 0;                  // of kOpened: the owner's number
  std::shared_ptr<const std::string> name;  // of kOpened: the owner's; one object for each owner
};

// What has become of a source's poses since the source was opened. Counts the poses that the loop has drained; where
// there is a journal, those that it has also written or lost.
struct SourceCounts {
  std::array<std::uint64_t, core::kPoseVerdicts> verdicts{};  // by PoseVerdict
  std::uint64_t drained = 0;                                  // their sum
  std::int64_t last_source_ns = 0;                            // source time of the last accepted pose
  // Accepted poses that were written: they survive a crash of this process.
  std::uint64_t recorded = 0;
  std::int64_t recorded_source_ns = 0;  // source time of the last of these

  std::uint64_t count(core::PoseVerdict verdict) const { return verdicts[static_cast<std::size_t>(verdict)]; }
};

class PoseSources;

// One open source: a blade and its owner's queue to the loop. Movable. The destructor closes the source: queued poses
// still count, then the stroke ends and the blade is free.
//
// Thread: one at a time (a strand will do).
class PoseSource {
 public:
  PoseSource(PoseSource&& other) noexcept
      : sources_(std::exchange(other.sources_, nullptr)), number_(other.number_), owner_(other.owner_) {}
  PoseSource& operator=(PoseSource&& other) noexcept;
  ~PoseSource();

  std::uint32_t number() const { return number_; }
  // Appends poses to the queue in order and returns how many fitted. If the queue is full the caller keeps the rest,
  // stops reading from its peer and tries again a frame or two later. No pose is ever dropped here.
  std::size_t enqueue(std::span<const TimedPose> poses);
  // Ends the running stroke after the poses queued so far. False if the queue is full: try again.
  bool end_stroke(std::int64_t arrival_ns);
  SourceCounts counts() const;

 private:
  friend class PoseSources;
  PoseSource(PoseSources* sources, std::uint32_t number, std::uint32_t owner)
      : sources_(sources), number_(number), owner_(owner) {}
  PoseSources* sources_;
  std::uint32_t number_, owner_;
};

// All sources of poses: up to core::kMaxSources blades at once, each with its own queue to the loop. A source has a name.
// A name that the configuration declares has its own number and blade; any other gets the lowest free number and the
// common blade.
//
// Thread: open() from any; drain() from the loop, which takes no lock and does not allocate.
class PoseSources {
 public:
  struct Declared {
    std::string name;
    core::Blade blade;
  };
  // `queue_capacity`: the most poses that one source's queue holds.
  explicit PoseSources(const core::Blade& blade, std::vector<Declared> declared = {},
                       std::size_t queue_capacity = 8192);
  ~PoseSources();
  PoseSources(const PoseSources&) = delete;
  PoseSources& operator=(const PoseSources&) = delete;

  // Opens a source with its owner's blade, or else the declared or common one. Nothing if the name is in use, no number is
  // free, or close() was called.
  std::optional<PoseSource> open(std::string_view name,
                                 const std::optional<core::Blade>& own_blade = std::nullopt);
  // Whether a source of that name is open.
  bool is_open(std::string_view name) const;
  // The same, but for one whose owner has closed it and whose last poses the loop has yet to take.
  bool is_held(std::string_view name) const;
  // From here on open() and enqueue() refuse. Call before the last drain.
  void close() { closed_.store(true, std::memory_order_release); }

  // Rung for the loop by whatever a source queues, and when one closes.
  Doorbell& doorbell() { return doorbell_; }
  // For the loop: calls handle(source, event) for each queued event, source by source in order of number, each source's in
  // order, until the queues are empty or handle() returns false (that event counts as handled). Events that arrive
  // meanwhile may wait for the next call.
  template <class Handle>
  void drain(Handle&& handle);
  // For the loop: counts its verdict on a pose.
  void count(std::uint32_t source, core::PoseVerdict verdict);
  // Shows a verdict to the source's owner. Called after count(), in the same order, from the loop's thread or the
  // journal's.
  void acknowledge(std::uint32_t source, core::PoseVerdict verdict, std::int64_t source_ns);
  // For the journal, before acknowledge(): an accepted pose of the owner with this number was written.
  void acknowledge_recorded(std::uint32_t source, std::uint32_t owner, std::int64_t source_ns);
  // How many events each source has queued so far, over all its owners: tells later which of its events came before
  // this call. From any thread.
  using Marks = std::array<std::uint64_t, core::kMaxSources>;
  Marks queued() const;
  // For the loop: how many of these it has taken.
  std::uint64_t taken(std::uint32_t source) const { return slots_[source]->queue.popped(); }
  // Queued events of all sources.
  std::size_t waiting() const;
  // Sources that are open.
  std::uint32_t open_count() const;
  // Name of a source's owner, or of its last one; empty if there was none.
  std::string name_of(std::uint32_t source) const;
  // Whether a source is open, and what has become of its owner's poses so far: accepted and rejected.
  struct Tally {
    bool open = false;
    std::uint64_t accepted = 0, rejected = 0;
  };
  Tally tally(std::uint32_t source) const;

 private:
  friend class PoseSource;
  enum class State : std::uint8_t { kFree, kOpen, kClosing };
  struct Slot {
    explicit Slot(std::size_t capacity) : queue(capacity) {}
    SpscQueue<InputEvent> queue;
    std::atomic<State> state{State::kFree};
    std::atomic<std::int64_t> closed_ns{0};
    // Verdicts on the poses of all owners so far: counted by the loop, acknowledged to the owners, and counted before the
    // present owner came. The owner's own are acknowledged - before.
    using Counts = std::array<std::atomic<std::uint64_t>, core::kPoseVerdicts>;
    Counts counted{}, acknowledged{}, before{};
    std::atomic<std::int64_t> last_source_ns{0};
    // For the owner whose poses were recorded last.
    std::atomic<std::uint64_t> recorded{0};
    std::atomic<std::int64_t> recorded_source_ns{0};
    std::atomic<std::uint32_t> recorded_owner{0};
    std::string name;          // guarded by mutex_
    std::uint32_t owners = 0;  // so far; guarded by mutex_
  };

  const core::Blade blade_;
  const std::vector<Declared> declared_;
  Doorbell doorbell_;
  std::atomic<bool> closed_{false};
  mutable std::mutex mutex_;  // for open(); the loop never locks it
  std::array<std::unique_ptr<Slot>, core::kMaxSources> slots_;
};

template <class Handle>
void PoseSources::drain(Handle&& handle) {
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    Slot& slot = *slots_[source];
    // Read before the queue: once it says kClosing, all that the owner queued is visible.
    const State state = slot.state.load(std::memory_order_acquire);
    if (state == State::kFree) continue;
    InputEvent event;
    for (std::size_t left = slot.queue.size(); left > 0 && slot.queue.pop(event); --left) {
      if (!handle(source, event)) return;
    }
    if (state == State::kClosing && slot.queue.size() == 0) {
      event = {
          InputEvent::Kind::kEndStroke, {{}, slot.closed_ns.load(std::memory_order_relaxed)}, {}, 0, nullptr};
      const bool go_on = handle(source, event);
      slot.state.store(State::kFree, std::memory_order_release);
      if (!go_on) return;
    }
  }
}

}  // namespace incise::input
