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

// Where a journal goes. Called from the journal's thread, sync() also from another one at the same time; whatever fails
// throws.
class JournalSink {
 public:
  virtual ~JournalSink() = default;
  virtual void write(const JournalRecord& record) = 0;
  // Hands what was written to the system. Where that fails, all that was written since the last flush is dropped.
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

// Writes what the loop drained, in its order, from a thread of its own, every few milliseconds; what was written
// outlives a crash of this process. Another thread makes it durable, for that may take as long as a disk likes. Neither
// keeps the loop waiting:
// where the queue is full, or the sink fails (disk full), records are lost; lost() counts them, and a kGap
// record says so at that place as soon as the sink takes it. What follows a gap can be replayed only from a
// checkpoint after it: the journal asks for one as soon as it can be written again.
//
// Thread: record() from the loop's; the rest from any. Owns: the sink, the checkpointer, its threads.
class Journal {
 public:
  struct Options {
    SyncPolicy policy = SyncPolicy::kGroup;
    std::int64_t sync_interval_ms = 100;
    std::size_t capacity = 1u << 16;  // records
    // SCHED_FIFO for its thread; 0: none. What a crash loses is what this thread has not come to; it needs little time.
    int realtime_priority = 0;
    // Records that the sink should have and did not take, before the first of this journal.
    std::uint64_t lost = 0;
  };
  // Called from the journal's thread when the sink begins to fail, with the reason, and with an empty text
  // when it works again.
  using OnTrouble = std::function<void(const std::string&)>;
  // Called from the journal's thread for each pose, in order, when the system has it (`recorded`), or when it is lost for
  // good: from then on its operator may be told that it was taken.
  using OnPose = std::function<void(const JournalRecord&, bool recorded)>;
  // `checkpointer` may be null: no checkpoints. So may `on_pose`.
  Journal(std::unique_ptr<JournalSink> sink, const Options& options, OnTrouble on_trouble,
          std::unique_ptr<Checkpointer> checkpointer = nullptr, OnPose on_pose = nullptr);
  // As close(), without the last checkpoint.
  ~Journal();
  // Writes what waits, flushes, ends the thread; then gives the checkpointer at most so long for a checkpoint of the end.
  // Empty, or why a restart will have more to compute. The loop must have stopped. Once.
  std::string close(std::chrono::milliseconds checkpoint_limit);

  // False where the record is lost.
  bool record(const JournalRecord& record) noexcept;

  std::uint64_t lost() const {
    return lost_unqueued_.load(std::memory_order_relaxed) + lost_unwritten_.load(std::memory_order_relaxed);
  }
  bool failing() const { return failing_.load(std::memory_order_relaxed); }
  // Why a restart would not have what is taken now: the sink fails, or there is a gap and no checkpoint after it yet.
  // Empty: it would.
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
  // Marks a place where a checkpoint may be, now and then and at the end (`last`), and one where it must be, after a gap.
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
  std::vector<JournalRecord> poses_;         // of the pass at hand, to be acknowledged
  std::uint64_t lost_unwritten_before_ = 0;  // the failure at hand
  bool unmarked_ = false, wanted_ = false;   // records since the last mark; a gap since the last one
  // In what is not flushed: a gap; a reset, which makes the gaps before it past.
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
