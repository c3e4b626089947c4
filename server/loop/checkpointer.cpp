#include "server/loop/checkpointer.hpp"

#include <pthread.h>
#include <sched.h>

#include <algorithm>
#include <exception>

#include "server/base/clock.hpp"
#include "server/base/thread_name.hpp"
#include "server/core/session/session_state.hpp"
#include "server/loop/checkpoint_file.hpp"

namespace incise::loop {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

// How long a disk that does not take a checkpoint is left alone.
constexpr std::chrono::seconds kRetry{5};
// The part of `replay_s` that is worth a checkpoint when nothing else is to be done.
constexpr double kAtRest = 0.25;
// A resume, which knows nothing of the loop's outcome, takes so many times as long for a step that is not checked here.
constexpr double kCheckedStep = 2;

}  // namespace

Checkpointer::Checkpointer(const Options& options, std::uint64_t session_id, int next_file,
                           std::function<std::unique_ptr<core::CutSession>()> first, Report report)
    : options_(options), report_(std::move(report)), session_id_(session_id), next_file_(next_file) {
  thread_ = std::thread([this, first = std::move(first)] { run(first); });
}

Checkpointer::~Checkpointer() {
  {
    const std::scoped_lock lock(mutex_);
    stop_ = true;
  }
  wake_.notify_one();
  thread_.join();
}

std::string Checkpointer::finish(milliseconds limit) {
  std::unique_lock lock(mutex_);
  accept_given();
  finish_ = true;
  wake_.notify_one();
  finished_.wait_for(lock, limit, [this] { return done_; });
  if (!done_) {
    return "in " + std::to_string(limit.count() / 1000) +
           " s the second session did not catch up; records that wait: " + std::to_string(waiting_.size());
  }
  if (!dirty_) return "";
  return failure_.empty() ? "there is no checkpoint after the last record" : failure_;
}

void Checkpointer::record(const JournalRecord& record) {
  Item item;
  item.record = record;
  given_.push_back(item);
  hand_over();
}

void Checkpointer::mark(std::uint64_t id, std::uint64_t offset, std::uint64_t records, bool wanted) {
  Item item;
  item.mark = true;
  item.wanted = wanted;
  item.id = id;
  item.offset = offset;
  item.records = records;
  given_.push_back(item);
  hand_over();
}

void Checkpointer::hand_over() {
  if (given_.empty()) return;
  {
    // The thread may have been preempted while it holds the mutex, for as long as the processors are busy: the journal
    // does not wait for it.
    const std::unique_lock lock(mutex_, std::try_to_lock);
    if (!lock) return;
    accept_given();
  }
  wake_.notify_one();
}

void Checkpointer::accept_given() {
  for (const Item& item : given_) {
    // A record dropped here matters until the next reset, before which nothing needs to be replayed.
    if (!item.mark && item.record.kind == JournalRecord::Kind::kReset) {
      waiting_.clear();
      overflow_ = false;
    }
    if (overflow_) continue;
    if (waiting_.size() >= options_.capacity) {
      waiting_.clear();
      overflow_ = true;
    } else {
      waiting_.push_back(item);
    }
  }
  given_.clear();
}

void Checkpointer::give_up(const std::string& why) {
  if (!session_) return;
  session_.reset();
  computed_.clear();
  history_.clear();
  tell_undoable();
  dirty_ = true;
  following_.store(false, std::memory_order_relaxed);
  report_(true, "no more checkpoints until the mesh is reset or the server restarted: " + why);
}

void Checkpointer::run(const std::function<std::unique_ptr<core::CutSession>()>& first) {
  name_thread("checkpoints");
  // Never preempts when it wakes up: the loop, the stream and the journal come first.
  const sched_param none{};
  pthread_setschedparam(pthread_self(), SCHED_BATCH, &none);
  session_ = first();
  began_s_ = thread_cpu_s() - options_.debt_s;
  dirty_ = options_.debt_s > 0;
  std::deque<Item> taken;
  while (wait_for_items(taken)) {
    for (Item& item : taken) {
      if (stop_) return;
      handle(item);
      item.record.positions.reset();  // there are few buffers for them
    }
    taken.clear();
  }
}

bool Checkpointer::wait_for_items(std::deque<Item>& taken) {
  const auto news = [this] { return stop_ || overflow_ || finish_ || !waiting_.empty(); };
  std::unique_lock lock(mutex_);
  for (;;) {
    behind_.store(waiting_.size(), std::memory_order_relaxed);
    if (!can_write_at_rest()) {
      wake_.wait(lock, news);
    } else if (!wake_.wait_until(lock, std::max(steady_clock::now() + options_.rest, next_try_), news)) {
      lock.unlock();
      write(*place_);
      lock.lock();
      continue;
    }
    if (stop_) return false;
    if (overflow_) {
      lock.unlock();
      give_up("the second session cannot keep up with the loop");
      lock.lock();
      wake_.wait(lock, [this] { return stop_ || finish_ || !overflow_; });
      if (!finish_) continue;
    }
    if (waiting_.empty()) break;  // finish_
    // A few at a time: the rest can still be dropped.
    for (int i = 0; i < 256 && !waiting_.empty(); ++i) {
      taken.push_back(waiting_.front());
      waiting_.pop_front();
    }
    return true;
  }
  lock.unlock();
  if (session_ && dirty_ && place_) write(*place_);
  lock.lock();
  done_ = true;
  finished_.notify_one();
  return false;
}

double Checkpointer::debt_s() const {
  return thread_cpu_s() - began_s_;
}

bool Checkpointer::can_write_at_rest() const {
  return session_ && dirty_ && place_ && (owed_ || debt_s() >= kAtRest * options_.replay_s);
}

void Checkpointer::handle(const Item& item) {
  using Kind = JournalRecord::Kind;
  const JournalRecord& record = item.record;
  if (!item.mark && record.kind == Kind::kReset) {
    session_ = options_.fresh();
    session_id_ = record.session;
    computed_.clear();
    history_.clear();
    tell_undoable();
    // A resume begins here at the latest, with the mesh as loaded.
    began_s_ = thread_cpu_s();
    owed_ = false;
    dirty_ = true;
    place_.reset();
    following_.store(true, std::memory_order_relaxed);
    return;
  }
  if (!item.mark && record.kind == Kind::kUndoWanted) {
    find_undone(record);
    return;
  }
  if (!session_) return;
  if (item.mark) {
    handle_mark(item);
    return;
  }
  place_.reset();
  dirty_ = true;
  if (record.kind == Kind::kCommit) {
    commit_to(record);
  } else if (record.kind == Kind::kGap) {
    give_up("the journal lost records before they were read");
  } else if (record.kind == Kind::kUndo) {
    go_back(record);
  } else {
    // What was cut before a blade has another owner is the last one's.
    if (record.kind == Kind::kOpened) session_->end_stroke(record.source);
    if (record.kind == Kind::kOpened || record.begins_stroke) commit_all();
    if (options_.undone) history_.note(record, *session_);
    apply(*session_, record);
  }
  if (record.kind != Kind::kPose || record.begins_stroke) tell_undoable();
}

void Checkpointer::handle_mark(const Item& mark) {
  commit_all();
  tell_undoable();
  owed_ = owed_ || mark.wanted;
  place_ = mark;
  const bool due = owed_ || debt_s() >= std::max(options_.replay_s, 5 * write_s_);
  if (due && steady_clock::now() >= next_try_) write(mark);
}

// All that came before is applied: the journal keeps the order.
void Checkpointer::find_undone(const JournalRecord& wanted) {
  if (!options_.undone) return;
  if (session_) commit_all();
  Undone undone;
  undone.request = wanted.request;
  const BeforeStroke* const last = session_ ? history_.last(wanted.name.get()) : nullptr;
  if (last) undone.session = history_.before(*last, session_->config());
  if (undone.session) {
    undone.before = *last;
    undone.blades = history_.cut_since(*last);
    const core::TetMesh& mesh = undone.session->mesh();
    for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
      if (!mesh.alive(t)) continue;
      for (int face = 0; face < 4; ++face)
        if ((mesh.cut_mask(t) >> face & 1) != 0) undone.cuts.push_back(core::half_face(t, face));
    }
  } else if (const BeforeStroke* const of_another = history_.last()) {
    undone.blades.push_back(of_another->name());
  }
  options_.undone(std::move(undone));
}

void Checkpointer::go_back(const JournalRecord& undo) {
  BeforeStroke stroke;
  stroke.source = undo.source;
  stroke.t_ns = undo.pose.t_ns;
  stroke.arrival_ns = undo.posed_ns;
  auto session = history_.before(stroke, session_->config());
  if (!session) {
    give_up("the state before a stroke that was undone is no longer there");
    return;
  }
  session_ = std::move(session);
  history_.went_back(stroke);
  tell_undoable();
  session_id_ = undo.session;
  computed_.clear();
  owed_ = true;  // a resume would have to begin before the stroke
}

void Checkpointer::tell_undoable() {
  const std::size_t strokes = history_.last() ? history_.size() : 0;
  undoable_.store(static_cast<std::uint32_t>(strokes), std::memory_order_relaxed);
}

void Checkpointer::commit_all() {
  while (commit_next(nullptr)) {
  }
}

bool Checkpointer::commit_next(const std::vector<core::GaveWay>* known) {
  core::WorkBudget budget = core::WorkBudget::unlimited();
  if (session_->advance(budget, delta_, known) != core::CutSession::Progress::kCommitted) return false;
  computed_.push_back({delta_.revision, delta_.state_hash});
  history_.note(delta_);
  tets_checked_.store(session_->tets_checked(), std::memory_order_relaxed);
  return true;
}

void Checkpointer::commit_to(const JournalRecord& commit) {
  while (session_->revision() < commit.revision) {
    const bool is_next = commit.positions && session_->revision() + 1 == commit.revision;
    const std::vector<core::GaveWay>* const known = is_next ? commit.positions->outcome.get() : nullptr;
    const double before_s = known != nullptr ? thread_cpu_s() : 0;
    if (!commit_next(known)) break;
    if (known != nullptr) began_s_ -= (kCheckedStep - 1) * (thread_cpu_s() - before_s);
  }
  compare(commit);
}

void Checkpointer::compare(const JournalRecord& commit) {
  while (!computed_.empty() && computed_.front().revision < commit.revision) computed_.pop_front();
  if (computed_.empty() || computed_.front().revision != commit.revision) return;
  const bool same = computed_.front().hash == commit.state_hash;
  computed_.pop_front();
  if (!same) {
    give_up("revision " + std::to_string(commit.revision) +
            " has another hash when it is computed again; keep the capture: it shows a fault in the "
            "program or in this machine's memory");
  }
}

void Checkpointer::write(const Item& mark) {
  const double before = thread_cpu_s();
  Checkpoint checkpoint;
  checkpoint.id = mark.id;
  checkpoint.session = session_id_;
  checkpoint.offset = mark.offset;
  checkpoint.records = mark.records;
  checkpoint.revision = session_->revision();
  checkpoint.state_hash = session_->mesh().state_hash();
  checkpoint.state = core::save_session(*session_);
  try {
    if (options_.may_write && !options_.may_write())
      throw std::runtime_error("another instance may have the session");
    write_checkpoint(checkpoint_path(options_.journal, next_file_), checkpoint);
    next_file_ = (next_file_ + 1) % kCheckpointFiles;
    last_revision_.store(checkpoint.revision, std::memory_order_relaxed);
    last_offset_.store(checkpoint.offset, std::memory_order_release);
    written_.fetch_add(1, std::memory_order_relaxed);
    failure_.clear();
    owed_ = dirty_ = false;
    place_.reset();
    began_s_ = thread_cpu_s();
    write_s_ = began_s_ - before;
  } catch (const std::exception& error) {
    // The debt remains.
    if (failure_.empty()) report_(false, std::string("a checkpoint cannot be written: ") + error.what());
    failure_ = error.what();
    next_try_ = steady_clock::now() + kRetry;
    began_s_ += thread_cpu_s() - before;
  }
}

}  // namespace incise::loop
