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
#include "server/input/spsc_queue.hpp"

namespace incise::input {

// A pose and when it reached this machine: CLOCK_MONOTONIC, ns.
struct TimedPose {
  core::Pose pose;
  std::int64_t arrival_ns = 0;
};

// What a source says to the loop.
struct InputEvent {
  enum class Kind : std::uint8_t {
    kOpened,     // the blade has (another) owner: a clock of its own, `blade`
    kPose,       // `pose`
    kEndStroke,  // the blade was let go, or its owner vanished
  };
  Kind kind = Kind::kPose;
  TimedPose pose;  // of kOpened and kEndStroke: arrival_ns only
  core::Blade blade;
  std::uint32_t owner = 0;  // of kOpened: the owner's number
};

// What has become of a source's poses since the source was opened: of those that the loop has taken and, where there
// is a journal, that it has handed to the system or lost.
struct SourceCounts {
  std::array<std::uint64_t, core::kPoseVerdicts> verdicts{};  // by PoseVerdict
  std::uint64_t drained = 0;                                  // their sum
  std::int64_t last_source_ns = 0;                            // source time of the last accepted pose
  // Accepted ones that the system has: no crash of this process takes them.
  std::uint64_t recorded = 0;
  std::int64_t recorded_source_ns = 0;  // of the last of them

  std::uint64_t count(core::PoseVerdict verdict) const { return verdicts[static_cast<std::size_t>(verdict)]; }
};

class InputHub;

// One blade's owner. Moves; closes its source when destroyed: what was pushed still counts, then the stroke
// ends and the blade is free.
//
// Thread: one at a time (a strand will do).
class SourceHandle {
 public:
  SourceHandle(SourceHandle&& other) noexcept
      : hub_(std::exchange(other.hub_, nullptr)), number_(other.number_), owner_(other.owner_) {}
  SourceHandle& operator=(SourceHandle&& other) noexcept;
  ~SourceHandle();

  std::uint32_t number() const { return number_; }
  // Queues poses in order. Returns how many were taken: where that is not all the queue is full, and whoever
  // calls keeps the rest, reads no more from its peer, and tries again in a frame or two. No pose is ever
  // dropped here.
  std::size_t push(std::span<const TimedPose> poses);
  // Ends the running stroke after the poses pushed so far. False where the queue is full: try again.
  bool end_stroke(std::int64_t arrival_ns);
  // What has become of the poses.
  SourceCounts counts() const;

 private:
  friend class InputHub;
  SourceHandle(InputHub* hub, std::uint32_t number, std::uint32_t owner)
      : hub_(hub), number_(number), owner_(owner) {}
  InputHub* hub_;
  std::uint32_t number_, owner_;
};

// The pose sources, up to core::kMaxSources blades at once, each with a queue of its own to the loop. A
// source has a name; a name that the configuration declares has its own number and blade, any other takes the
// lowest free number and the blade of all.
//
// Thread: open_source() from any; drain() from the loop, which takes no lock and does not allocate.
class InputHub {
 public:
  struct Declared {
    std::string name;
    core::Blade blade;
  };
  // `queue_capacity`: poses that wait for each source at most.
  explicit InputHub(const core::Blade& blade, std::vector<Declared> declared = {},
                    std::size_t queue_capacity = 8192);
  ~InputHub();
  InputHub(const InputHub&) = delete;
  InputHub& operator=(const InputHub&) = delete;

  // Takes a blade, with the shape declared for it or its owner's. Nothing where the name is taken, no number is free, or the hub is closed.
  std::optional<SourceHandle> open_source(std::string_view name,
                                          const std::optional<core::Blade>& own_blade = std::nullopt);
  // Whether somebody holds the blade of that name.
  bool is_open(std::string_view name) const;
  // No source opens from here on and no push takes anything: before the last drain.
  void close() { closed_.store(true, std::memory_order_release); }

  // The loop's side: calls handle(source, event) for each event that waits, source by source in the order of
  // their numbers, each source's in order, until all are done or handle() returns false (the event then
  // counts as done). Events that arrive meanwhile may wait for the next call.
  template <class Handle>
  void drain(Handle&& handle);
  // The loop's: counts what it did with a pose.
  void count(std::uint32_t source, core::PoseVerdict verdict);
  // Then, in the same order, from the loop's thread or the journal's: the owner may know.
  void tell(std::uint32_t source, core::PoseVerdict verdict, std::int64_t source_ns);
  // The journal's, before tell(): the system has that accepted pose of the owner that opened the source with this number.
  void tell_recorded(std::uint32_t source, std::uint32_t owner, std::int64_t source_ns);
  // Events that wait, of all sources.
  std::size_t waiting() const;
  // Sources with an owner now.
  std::uint32_t open_sources() const;
  // Name of a source's owner, or of its last one; empty where there was none.
  std::string name_of(std::uint32_t source) const;

 private:
  friend class SourceHandle;
  enum class State : std::uint8_t { kFree, kOpen, kClosing };
  struct Slot {
    explicit Slot(std::size_t capacity) : queue(capacity) {}
    SpscQueue<InputEvent> queue;
    std::atomic<State> state{State::kFree};
    std::atomic<std::int64_t> closed_ns{0};
    // Of all owners so far. Who opens a source finds what the loop has counted of those before, and what is told beyond
    // that is of its own poses.
    using Counts = std::array<std::atomic<std::uint64_t>, core::kPoseVerdicts>;
    Counts counted{}, told{}, before{};
    std::atomic<std::int64_t> last_source_ns{0};
    // Of the owner whose poses were recorded last.
    std::atomic<std::uint64_t> recorded{0};
    std::atomic<std::int64_t> recorded_source_ns{0};
    std::atomic<std::uint32_t> recorded_owner{0};
    std::string name;          // guarded by mutex_
    std::uint32_t owners = 0;  // so far; guarded by mutex_
  };

  const core::Blade blade_;
  const std::vector<Declared> declared_;
  std::atomic<bool> closed_{false};
  mutable std::mutex mutex_;  // of those who open; the loop never takes it
  std::array<std::unique_ptr<Slot>, core::kMaxSources> slots_;
};

template <class Handle>
void InputHub::drain(Handle&& handle) {
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    Slot& slot = *slots_[source];
    // Read before the queue: once it says kClosing, all that the owner pushed is there to be seen.
    const State state = slot.state.load(std::memory_order_acquire);
    if (state == State::kFree) continue;
    InputEvent event;
    for (std::size_t left = slot.queue.size(); left > 0 && slot.queue.pop(event); --left) {
      if (!handle(source, event)) return;
    }
    if (state == State::kClosing && slot.queue.size() == 0) {
      event = {InputEvent::Kind::kEndStroke, {{}, slot.closed_ns.load(std::memory_order_relaxed)}, {}, 0};
      const bool go_on = handle(source, event);
      slot.state.store(State::kFree, std::memory_order_release);
      if (!go_on) return;
    }
  }
}

}  // namespace incise::input
