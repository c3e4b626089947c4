#include "server/loop/journal.hpp"

#include <sys/random.h>

#include <chrono>
#include <exception>

#include "server/loop/loop_stats.hpp"
#include "server/loop/realtime.hpp"

namespace incise::loop {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

// How often the thread looks for records. The queue holds a second of them at the least, so this bounds only
// how old a record is when it reaches the system.
constexpr milliseconds kPoll{5};
// How long a failing sink is left alone.
constexpr milliseconds kRetry{1000};
// Between two places where a checkpoint may be.
constexpr milliseconds kMarks{250};

JournalRecord gap_of(std::uint64_t lost) {
  JournalRecord record;
  record.kind = JournalRecord::Kind::kGap;
  record.lost = lost;
  return record;
}

}  // namespace

Journal::Journal(std::unique_ptr<JournalSink> sink, const Options& options, OnTrouble on_trouble,
                 std::unique_ptr<Checkpointer> checkpointer)
    : sink_(std::move(sink)),
      options_(options),
      on_trouble_(std::move(on_trouble)),
      checkpointer_(std::move(checkpointer)),
      queue_(options.capacity) {
  thread_ = std::thread([this] { run(); });
}

Journal::~Journal() {
  while (gap_ > 0 && !queue_.push(gap_of(gap_))) std::this_thread::sleep_for(kPoll);
  stop_.store(true, std::memory_order_release);
  thread_.join();
}

bool Journal::record(const JournalRecord& record) noexcept {
  if (gap_ > 0 && queue_.push(gap_of(gap_))) gap_ = 0;
  if (gap_ == 0 && queue_.push(record)) return true;
  ++gap_;
  bump(lost_unqueued_);
  return false;
}

bool Journal::write_waiting() {
  if (failing() && unflushed_ > 0)
    sink_->write(gap_of(unflushed_));  // what was lost when it failed, and since
  JournalRecord record;
  bool any = failing();
  while (queue_.pop(record)) {
    const std::uint64_t gap = record.kind == JournalRecord::Kind::kGap ? record.lost : 0;
    unflushed_ += gap > 0 ? gap : 1;
    unflushed_gaps_ += gap;
    if (checkpointer_) checkpointer_->record(record);  // whether or not the disk takes it
    unmarked_ = true;
    sink_->write(record);
    record.positions.reset();
    any = true;
  }
  if (!any) return false;
  sink_->flush();
  unflushed_ = unflushed_gaps_ = 0;
  return true;
}

// Before anything of this pass is written: a mark that the disk does not take is never told to the checkpointer.
void Journal::mark_checkpoint() {
  const auto now = steady_clock::now();
  if (!checkpointer_ || failing() || !(wanted_ || (unmarked_ && now - last_mark_ >= kMarks))) return;
  JournalRecord mark;
  mark.kind = JournalRecord::Kind::kCheckpoint;
  if (getrandom(&mark.checkpoint, sizeof mark.checkpoint, 0) != sizeof mark.checkpoint) return;
  const JournalSink::Position at = sink_->position();
  sink_->write(mark);
  sink_->flush();
  checkpointer_->mark(mark.checkpoint, at.bytes, at.records, wanted_);
  last_mark_ = now;
  wanted_ = unmarked_ = false;
}

void Journal::run() {
  if (options_.realtime_priority > 0) request_priority(options_.realtime_priority);
  auto last_sync = steady_clock::now(), last_try = last_sync;
  bool unsynced = false;
  for (;;) {
    const bool stopping = stop_.load(std::memory_order_acquire);
    if (failing() && !stopping && steady_clock::now() - last_try < kRetry) {
      std::this_thread::sleep_for(kPoll);
      continue;
    }
    try {
      last_try = steady_clock::now();
      mark_checkpoint();
      unsynced |= write_waiting();
      const bool due =
          options_.policy == SyncPolicy::kAlways ||
          (options_.policy == SyncPolicy::kGroup &&
           (stopping || steady_clock::now() - last_sync >= milliseconds(options_.sync_interval_ms)));
      if (unsynced && due) {
        sink_->sync();
        last_sync = steady_clock::now();
        unsynced = false;
      }
      if (failing()) {
        lost_unwritten_before_ = lost_unwritten_.load(std::memory_order_relaxed);
        failing_.store(false, std::memory_order_relaxed);
        wanted_ = true;
        on_trouble_("");
      }
      if (stopping) sink_->close();
    } catch (const std::exception& error) {
      lost_unwritten_.store(lost_unwritten_before_ + unflushed_ - unflushed_gaps_, std::memory_order_relaxed);
      if (!failing()) on_trouble_(error.what());
      failing_.store(true, std::memory_order_relaxed);
    }
    if (stopping) return;
    std::this_thread::sleep_for(kPoll);
  }
}

}  // namespace incise::loop
