#include "server/loop/journal.hpp"

#include <sys/random.h>

#include <chrono>
#include <exception>
#include <stdexcept>
#include <utility>

#include "server/base/thread_name.hpp"
#include "server/loop/loop_stats.hpp"
#include "server/loop/realtime.hpp"

namespace incise::loop {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

// How often the thread looks for records. The queue holds at least a second's worth, so this only bounds
// how old a record is when it is written.
constexpr milliseconds kPoll{5};
// How long to wait before a failing sink is tried again.
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
                 std::unique_ptr<Checkpointer> checkpointer, OnPose on_pose)
    : sink_(std::move(sink)),
      options_(options),
      on_trouble_(std::move(on_trouble)),
      on_pose_(std::move(on_pose)),
      checkpointer_(std::move(checkpointer)),
      queue_(options.capacity),
      unflushed_(options.lost),
      unmarked_(checkpointer_ && checkpointer_->in_debt()),
      lost_unwritten_(options.lost),
      failing_(options.lost > 0) {
  if (failing()) set_trouble("the capture cannot be written");
  if (options_.policy != SyncPolicy::kNone) sync_thread_ = std::thread([this] { run_sync(); });
  thread_ = std::thread([this] { run(); });
}

Journal::~Journal() {
  end();
}

std::string Journal::close(milliseconds checkpoint_limit) {
  end();
  return checkpointer_ ? checkpointer_->finish(checkpoint_limit) : "";
}

void Journal::end() {
  if (!thread_.joinable()) return;
  while (gap_ > 0 && !queue_.push(gap_of(gap_))) std::this_thread::sleep_for(kPoll);
  stop_.store(true, std::memory_order_release);
  thread_.join();
}

std::string Journal::trouble() const {
  const std::scoped_lock lock(trouble_mutex_);
  return trouble_;
}

void Journal::set_trouble(const std::string& error) {
  if (gap_end_ && checkpointer_ && checkpointer_->last_offset() >= *gap_end_) gap_end_.reset();
  std::string trouble = error;
  if (error.empty() && gap_end_) {
    trouble = checkpointer_ && checkpointer_->following()
                  ? "records are missing in the capture, and the checkpoint after the gap is not written yet"
                  : "records are missing in the capture, and no restart can cross the gap until the mesh "
                    "is reset";
  }
  const std::scoped_lock lock(trouble_mutex_);
  trouble_ = trouble;
}

bool Journal::record(const JournalRecord& record) noexcept {
  if (gap_ > 0 && queue_.push(gap_of(gap_))) gap_ = 0;
  if (gap_ == 0 && queue_.push(record)) return true;
  ++gap_;
  bump(lost_unqueued_);
  return false;
}

bool Journal::want_undo(std::uint64_t request, std::shared_ptr<const std::string> name) noexcept {
  JournalRecord record;
  record.kind = JournalRecord::Kind::kUndoWanted;
  record.request = request;
  record.name = std::move(name);
  return gap_ == 0 && queue_.push(record);
}

bool Journal::write_waiting() {
  gap_waits_ = reset_waits_ = false;
  if (failing() && unflushed_ > 0) {
    sink_->write(gap_of(unflushed_));  // what was lost when it failed, and since
    gap_waits_ = true;
  }
  JournalRecord record;
  bool any = failing();
  while (queue_.pop(record)) {
    if (record.kind == JournalRecord::Kind::kUndoWanted) {
      if (checkpointer_) checkpointer_->record(record);
      continue;
    }
    const std::uint64_t gap = record.kind == JournalRecord::Kind::kGap ? record.lost : 0;
    unflushed_ += gap > 0 ? gap : 1;
    unflushed_gaps_ += gap;
    if (record.kind == JournalRecord::Kind::kReset) {
      gap_waits_ = false;
      reset_waits_ = true;
    }
    gap_waits_ = gap_waits_ || gap > 0;
    if (checkpointer_) checkpointer_->record(record);  // whether or not the disk takes it
    unmarked_ = true;
    if (on_pose_ && record.kind == JournalRecord::Kind::kPose) poses_.push_back(record);
    sink_->write(record);
    record.positions.reset();
    any = true;
  }
  if (!any) return false;
  sink_->flush();
  unflushed_ = unflushed_gaps_ = 0;
  if (reset_waits_) gap_end_.reset();
  if (gap_waits_) gap_end_ = sink_->position().bytes;
  return true;
}

void Journal::acknowledge_poses(bool recorded) {
  for (const JournalRecord& pose : poses_) on_pose_(pose, recorded);
  poses_.clear();
}

// Called before anything of this pass is written: the checkpointer never sees a mark that the disk did not take.
void Journal::mark_checkpoint(bool last) {
  const auto now = steady_clock::now();
  if (!checkpointer_ || failing() || !(wanted_ || (unmarked_ && (last || now - last_mark_ >= kMarks))))
    return;
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
  name_thread("journal");
  if (options_.realtime_priority > 0) request_priority(options_.realtime_priority);
  auto last_try = steady_clock::now();
  for (;;) {
    const bool stopping = stop_.load(std::memory_order_acquire);
    if (checkpointer_) checkpointer_->hand_over();
    if (failing() && !stopping && steady_clock::now() - last_try < kRetry) {
      std::this_thread::sleep_for(kPoll);
      continue;
    }
    try {
      last_try = steady_clock::now();
      mark_checkpoint(false);
      const bool wrote = write_waiting();
      acknowledge_poses(true);
      {
        const std::scoped_lock lock(sync_mutex_);
        unsynced_ = unsynced_ || wrote;
        if (!sync_error_.empty()) throw std::runtime_error(std::exchange(sync_error_, {}));
      }
      if (wrote) sync_wake_.notify_one();
      if (failing()) {
        lost_unwritten_before_ = lost_unwritten_.load(std::memory_order_relaxed);
        failing_.store(false, std::memory_order_relaxed);
        wanted_ = true;
        on_trouble_("");
      }
      if (stopping) {
        mark_checkpoint(true);
        end_sync();
        sink_->close();
      }
      set_trouble("");
    } catch (const std::exception& error) {
      lost_unwritten_.store(lost_unwritten_before_ + unflushed_ - unflushed_gaps_, std::memory_order_relaxed);
      acknowledge_poses(false);
      if (!failing()) on_trouble_(error.what());
      set_trouble(error.what());
      failing_.store(true, std::memory_order_relaxed);
    }
    if (stopping) {
      end_sync();
      return;
    }
    std::this_thread::sleep_for(kPoll);
  }
}

void Journal::run_sync() {
  name_thread("journal sync");
  if (options_.realtime_priority > 0) request_priority(options_.realtime_priority);
  auto next = steady_clock::now();
  std::unique_lock lock(sync_mutex_);
  for (;;) {
    sync_wake_.wait(lock, [this] { return unsynced_ || end_sync_; });
    if (options_.policy == SyncPolicy::kGroup)
      sync_wake_.wait_until(lock, next, [this] { return end_sync_; });
    if (!unsynced_) return;
    unsynced_ = false;
    next = steady_clock::now() + milliseconds(options_.sync_interval_ms);
    lock.unlock();
    std::string error;
    try {
      sink_->sync();
    } catch (const std::exception& failed) {
      error = failed.what();
    }
    lock.lock();
    if (!error.empty()) sync_error_ = error;
  }
}

void Journal::end_sync() {
  if (!sync_thread_.joinable()) return;
  {
    const std::scoped_lock lock(sync_mutex_);
    end_sync_ = true;
  }
  sync_wake_.notify_one();
  sync_thread_.join();
}

}  // namespace incise::loop
