#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "server/input/spsc_queue.hpp"
#include "server/loop/checkpointer.hpp"
#include "server/loop/journal_record.hpp"

namespace incise::loop {

// Where a journal goes. Called from the journal's thread, sync() also from another one at the same time; failures
// throw.
class JournalSink {
 public:
  virtual ~JournalSink() = default;
  virtual void write(const JournalRecord& record) = 0;
  // Passes what was written to the system. If that fails, everything written since the last flush is dropped.
  virtual void flush() = 0;
  // Returns when what was flushed survives a loss of power.
  virtual void sync() = 0;
  // The last call: nothing more will come, and nothing is missing since the last gap.
  virtual void close() = 0;
  // Up to where all was flushed: bytes, and the records in them.
  struct Position {
    std::uint64_t bytes = 0, records = 0;
  };
  virtual Position position() const { return {}; }
};

// When what was written must be on the disk.
enum class SyncPolicy : std::uint8_t {
  kNone,    // when the system pleases: survives a crash of incised, not of the machine
  kGroup,   // at most sync_interval_ms after it was drained
  kAlways,  // as soon as possible
};

// Writes what the loop drained, in its order, from its own thread, every few milliseconds; what is written
// survives a crash of this process. A second thread makes it durable, since a disk may take any time for that. The
// loop never waits for either:
// if the queue is full, or the sink fails (disk full), records are lost; lost() counts them, and a kGap
// record says so at that place as soon as the sink accepts it. What follows a gap can be replayed only from a
// checkpoint after it: the journal asks for one as soon as it can be written again.
//
// Thread: record() from the loop's; the rest from any. Owns: the sink, the checkpointer, its threads.
class Journal {
 public:
  struct Options {
    SyncPolicy policy = SyncPolicy::kGroup;
    std::int64_t sync_interval_ms = 100;
    std::size_t capacity = 1u << 16;  // records
    // SCHED_FIFO priority of its thread; 0: none. A crash loses what this thread has not written yet; it needs little time.
    int realtime_priority = 0;
    // Records that the sink failed to take before the first one of this journal.
    std::uint64_t lost = 0;
  };
  // Called from the journal's thread when the sink begins to fail, with the reason, and with an empty text
  // when it works again.
  using OnTrouble = std::function<void(const std::string&)>;
  // Called from the journal's thread for each pose, in order, when it is written (`recorded`) or lost for
  // good: only then may the operator be told that the server took it.
  using OnPose = std::function<void(const JournalRecord&, bool recorded)>;
  // `checkpointer` may be null: no checkpoints. So may `on_pose`.
  Journal(std::unique_ptr<JournalSink> sink, const Options& options, OnTrouble on_trouble,
          std::unique_ptr<Checkpointer> checkpointer = nullptr, OnPose on_pose = nullptr);
  // Like close(), but without a last checkpoint.
  ~Journal();
  // Writes what waits, flushes, ends the thread; then gives the checkpointer at most `checkpoint_limit` for a last checkpoint.
  // Returns an empty text, or why a restart will have more to compute. Call it once, when the loop has stopped.
  std::string close(std::chrono::milliseconds checkpoint_limit);

  // False: the record is lost.
  bool record(const JournalRecord& record) noexcept;
  // Asks the checkpointer to go back before the last stroke of the blade of that name, or of any (null), once it has all records so far. From
  // the loop's thread. False: no room, ask again.
  bool want_undo(std::uint64_t request, std::shared_ptr<const std::string> name) noexcept;

  std::uint64_t lost() const {
    return lost_unqueued_.load(std::memory_order_relaxed) + lost_unwritten_.load(std::memory_order_relaxed);
  }
  bool failing() const { return failing_.load(std::memory_order_relaxed); }
  // Why a restart would lack poses taken now: the sink fails, or there is a gap without a checkpoint after it.
  // Empty: it would have them.
  std::string trouble() const;
  // Records that wait.
  std::size_t waiting() const { return queue_.size(); }
  const Checkpointer* checkpointer() const { return checkpointer_.get(); }

 private:
  void run();
  // Writes and flushes what waits; whether there was anything.
  bool write_waiting();
  // Acknowledges the poses that were flushed, or lost.
  void acknowledge_poses(bool recorded);
  // Ends the thread, once all is written.
  void end();
  void set_trouble(const std::string& error);
  // Marks a place where a checkpoint may be, now and then and at the end (`last`); after a gap, one where it must be.
  void mark_checkpoint(bool last);
  void run_sync();
  void end_sync();

  const std::unique_ptr<JournalSink> sink_;
  const Options options_;
  const OnTrouble on_trouble_;
  const OnPose on_pose_;
  const std::unique_ptr<Checkpointer> checkpointer_;
  input::SpscQueue<JournalRecord> queue_;
  std::uint64_t gap_ = 0;  // the loop's: records lost since the last one that was queued
  // The thread's: records that the sink has not flushed, and of them those that lost_unqueued_ counts already.
  std::uint64_t unflushed_ = 0, unflushed_gaps_ = 0;
  std::vector<JournalRecord> poses_;         // of this pass, to be acknowledged
  std::uint64_t lost_unwritten_before_ = 0;  // this failure
  bool unmarked_ = false, wanted_ = false;   // records since the last mark; a gap since the last one
  // Not flushed yet: a gap; a reset, after which earlier gaps no longer matter.
  bool gap_waits_ = false, reset_waits_ = false;
  std::optional<std::uint64_t> gap_end_;  // behind the last gap, in bytes, until something leads across it
  std::chrono::steady_clock::time_point last_mark_{};
  std::atomic<std::uint64_t> lost_unqueued_{0}, lost_unwritten_{0};
  std::atomic<bool> failing_{false}, stop_{false};
  mutable std::mutex trouble_mutex_;
  std::string trouble_;
  // Between the two threads; held for a moment only.
  std::mutex sync_mutex_;
  std::condition_variable sync_wake_;
  bool unsynced_ = false, end_sync_ = false;
  std::string sync_error_;
  std::thread thread_, sync_thread_;
};

}  // namespace incise::loop
