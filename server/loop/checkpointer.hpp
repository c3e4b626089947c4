#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "server/core/session/cut_session.hpp"
#include "server/loop/journal_record.hpp"
#include "server/loop/undo_history.hpp"

namespace incise::loop {

// Keeps restarts short. A second session repeats at its own pace what the loop's session did, from the
// records that the journal writes. It can be saved between any two records, in the middle of strokes, while the loop
// goes on. It computes each revision again and compares the hash, so that a journal that does not replay is noticed
// while the server still runs.
//
// It computes a revision when it meets its mark, which says what the loop found out about a simulation's step: which vertices had to give
// way. So it does not look at the tetrahedra again, which is half of a step's work. The hash still has to be the same.
//
// The journal marks more places for checkpoints than are used. The thread decides when it reaches a mark,
// however far behind the loop it is, whether to write one there. What counts is the debt: the computing that a resume from
// the newest checkpoint would have to repeat, in this run of the server or an earlier one. When nothing happens for a
// while, a smaller debt is enough, and at the end any.
//
// It also knows how to go back to the state before a stroke (UndoHistory), and prepares that off the loop: a record kUndoWanted asks for it, and one
// of kUndo says that the loop has gone there.
//
// It costs as much memory as the loop's session and as much computing, as a batch job (SCHED_BATCH), and up to kUndo_bytes for undoing.
//
// Thread: record() and mark() from the journal's; figures from any. Owns: the second session, its thread, the
// checkpoint files.
class Checkpointer {
 public:
  static constexpr std::size_t kUndo_bytes = 256u << 20;
  struct Options {
    std::string journal;  // the path that the checkpoints' names begin with
    // A checkpoint is written when the debt is this large; less often if writing one takes more than a fifth of that.
    double replay_s = 1;
    // What the resume at the start of this run had to compute, and has written no checkpoint of.
    double debt_s = 0;
    std::function<bool()> may_write;  // whether the files are still ours; empty: always
    // After so long without a record a quarter of `replay_s` is enough.
    std::chrono::milliseconds rest{2000};
    std::size_t capacity = 1u << 20;                           // records that may wait
    std::function<std::unique_ptr<core::CutSession>()> fresh;  // the session as loaded; on the thread
    // Given what a record kUndoWanted has asked for, without a session where nothing can be undone; on the thread. May be empty.
    std::function<void(Undone)> undone;
  };
  // Called on its thread, and from record(): a line for the log. `bad`: there will be no checkpoints for now.
  using Report = std::function<void(bool bad, const std::string& text)>;

  // `first`: gives the session as it is where the records begin; called on the thread. `next_file`: 0 or 1, not the one
  // that holds the newest checkpoint.
  Checkpointer(const Options& options, std::uint64_t session_id, int next_file,
               std::function<std::unique_ptr<core::CutSession>()> first, Report report);
  // Drops what waits.
  ~Checkpointer();
  // After the last record and mark: works off what waits, for at most `limit`, and saves the session as it is then. Returns
  // an empty text if a restart has nothing to compute again, else why it has.
  std::string finish(std::chrono::milliseconds limit);

  // The next record that the journal took from the loop, written or not. If more than `capacity` wait, the second
  // session stops following until the next reset.
  void record(const JournalRecord& record);
  // A checkpoint may be written here: `offset` and `records` of the journal's record that says so. `wanted`: one must be
  // written, here or at the next possible mark, because the journal has a gap that only a checkpoint behind it bridges.
  void mark(std::uint64_t id, std::uint64_t offset, std::uint64_t records, bool wanted);

  // Tries again to hand records to the thread when it was busy; the journal calls it now and then.
  void hand_over();

  std::uint64_t written() const { return written_.load(std::memory_order_relaxed); }
  std::uint64_t last_revision() const { return last_revision_.load(std::memory_order_relaxed); }
  // The offset in the journal of the newest checkpoint of this run, in bytes; 0: none yet.
  std::uint64_t last_offset() const { return last_offset_.load(std::memory_order_acquire); }
  // Records that wait.
  std::size_t behind() const { return behind_.load(std::memory_order_relaxed); }
  // Whether the run began with work that a resume would have to do again.
  bool in_debt() const { return options_.debt_s > 0; }
  // Strokes that can be undone.
  std::uint32_t undoable() const { return undoable_.load(std::memory_order_relaxed); }
  // Tetrahedra that it has looked at in a simulation's steps.
  std::uint64_t tets_checked() const { return tets_checked_.load(std::memory_order_relaxed); }
  bool following() const { return following_.load(std::memory_order_relaxed); }

 private:
  struct Item {
    JournalRecord record;
    bool mark = false, wanted = false;
    std::uint64_t id = 0, offset = 0, records = 0;
  };
  void run(const std::function<std::unique_ptr<core::CutSession>()>& first);
  // Waits for records and moves some of them to `taken`; meanwhile pays debt at rest. False at the end.
  bool wait_for_items(std::deque<Item>& taken);
  void accept_given();  // under mutex_
  double debt_s() const;
  bool can_write_at_rest() const;
  void handle(const Item& item);
  void handle_mark(const Item& mark);
  void find_undone(const JournalRecord& wanted);
  void go_back(const JournalRecord& undo);
  void give_up(const std::string& why);
  // Takes the session to where it has no work left, or one step on; false: it has none.
  void commit_all();
  bool commit_next(const std::vector<core::GaveWay>* known);
  void commit_to(const JournalRecord& commit);
  void compare(const JournalRecord& commit);
  void write(const Item& mark);
  void tell_undoable();

  const Options options_;
  const Report report_;
  std::mutex mutex_;
  std::condition_variable wake_, finished_;
  std::vector<Item> given_;        // the journal's: not handed over yet
  std::deque<Item> waiting_;       // under mutex_
  bool overflow_ = false;          // under mutex_
  bool finish_ = false;            // under mutex_: end once nothing waits
  bool done_ = false;              // under mutex_: it has
  std::atomic<bool> stop_{false};  // set under mutex_: end now
  std::atomic<bool> following_{true};
  std::atomic<std::uint64_t> written_{0}, last_revision_{0}, last_offset_{0};
  std::atomic<std::uint64_t> tets_checked_{0};
  std::atomic<std::size_t> behind_{0};
  std::atomic<std::uint32_t> undoable_{0};

  // The thread's.
  std::unique_ptr<core::CutSession> session_;  // null: it cannot follow
  std::uint64_t session_id_;
  int next_file_;
  std::string failure_;                             // of the last checkpoint; empty: none
  std::chrono::steady_clock::time_point next_try_;  // after a failure
  bool owed_ = false;                               // one must be written: the journal has a gap
  bool dirty_ = false;                              // something came after the last one
  std::optional<Item> place_;  // the last mark, where nothing came after it and it was not used
  double began_s_ = 0;         // of the thread's processor time: what came since is the debt
  double write_s_ = 0;         // what the last checkpoint took of it
  struct Computed {
    std::uint64_t revision, hash;
  };
  std::deque<Computed> computed_;  // whose marks have not come by
  UndoHistory history_{kUndo_bytes};
  core::Delta delta_;
  std::thread thread_;
};

}  // namespace incise::loop
