#include "server/loop/checkpointer.hpp"

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstddef>
#include <filesystem>
#include <fstream>
#include <thread>

#include "server/core/session/session_state.hpp"
#include "server/loop/checkpoint_file.hpp"
#include "server/loop/frame_loop.hpp"
#include "tests/support/bodies.hpp"

namespace incise::loop {
namespace {

namespace fs = std::filesystem;
using Kind = JournalRecord::Kind;

core::CutConfig config() {
  core::CutConfig made;
  made.blade = tests::long_blade();
  return made;
}

// A folder of its own, a Checkpointer in it, and what it tells.
class CheckpointerTest : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  ~CheckpointerTest() override { fs::remove_all(folder_); }
  std::string journal() const { return (folder_ / "journal").string(); }
  // `rest`: by default longer than any test.
  std::unique_ptr<Checkpointer> make(double replay_s, std::size_t capacity = 1u << 20, double debt_s = 0,
                                     std::chrono::milliseconds rest = std::chrono::hours(1)) {
    Checkpointer::Options options;
    options.journal = journal();
    options.replay_s = replay_s;
    options.debt_s = debt_s;
    options.rest = rest;
    options.capacity = capacity;
    options.fresh = [this] { return std::make_unique<core::CutSession>(mesh_, config()); };
    auto first = [this, fresh = options.fresh] {
      while (held_) std::this_thread::yield();
      return fresh();
    };
    return std::make_unique<Checkpointer>(options, 7, 0, first, [this](bool bad, const std::string& text) {
      const std::scoped_lock lock(mutex_);
      told_ += (bad ? "bad: " : "note: ") + text + "\n";
    });
  }
  std::string told() {
    const std::scoped_lock lock(mutex_);
    return told_;
  }
  // The records of a stroke through the body with the marks that belong to it.
  std::vector<JournalRecord> stroke() {
    core::CutSession session(mesh_, config());
    std::vector<JournalRecord> records;
    core::Delta delta;
    auto budget = core::WorkBudget::unlimited();
    for (const core::Pose& pose : tests::sweep_through(300)) {
      JournalRecord record;
      record.pose = pose;
      records.push_back(record);
      session.push(0, pose);
      while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted)
        records.push_back(commit_record(delta));
    }
    return records;
  }
  // As the journal does: what the thread was too busy to take is offered again.
  static bool wait_for(Checkpointer& checkpointer, const std::function<bool()>& condition) {
    for (int i = 0; i < 4'000; ++i) {
      checkpointer.hand_over();
      if (condition()) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    return false;
  }

  const core::MeshData mesh_ = tests::cube(6);
  std::atomic<bool> held_{false};

 private:
  fs::path folder_ = fs::temp_directory_path() / ("incise_checkpoints_" + std::to_string(::getpid()));
  std::mutex mutex_;
  std::string told_;
};

// The files of two, one after the other, in turn; each leads on to what all records lead to.
TEST_F(CheckpointerTest, ACheckpointAndTheRecordsAfterItGiveWhatAllRecordsGive) {
  const auto records = stroke();
  core::CutSession whole(mesh_, config());
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  const auto apply = [&](core::CutSession& session, std::size_t from, std::size_t to) {
    for (std::size_t i = from; i < to; ++i) {
      if (records[i].kind == Kind::kPose) session.push(0, records[i].pose);
      while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
      }
    }
  };
  apply(whole, 0, records.size());
  ASSERT_GE(whole.revision(), 5u);
  const auto checkpointer = make(1000);
  const std::size_t marks[] = {40, 170, 250};
  std::size_t next = 0;
  for (std::size_t i = 0; i < records.size(); ++i) {
    if (next < 3 && i == marks[next]) {
      checkpointer->mark(100 + next, 1000 * next, i, true);
      ++next;
    }
    checkpointer->record(records[i]);
  }
  ASSERT_TRUE(
      wait_for(*checkpointer, [&] { return checkpointer->written() == 3 && checkpointer->behind() == 0; }));
  EXPECT_EQ(told(), "");
  for (const std::size_t n : {std::size_t{1}, std::size_t{2}}) {
    std::string error;
    const auto checkpoint = read_checkpoint(checkpoint_path(journal(), static_cast<int>(n % 2)), error);
    ASSERT_TRUE(checkpoint) << error;
    EXPECT_EQ(checkpoint->id, 100 + n);
    EXPECT_EQ(checkpoint->session, 7u);
    EXPECT_EQ(checkpoint->offset, 1000 * n);
    EXPECT_EQ(checkpoint->records, marks[n]);
    auto session = core::restore_session(checkpoint->state, config(), error);
    ASSERT_TRUE(session) << error;
    EXPECT_EQ(session->revision(), checkpoint->revision);
    EXPECT_EQ(session->mesh().state_hash(), checkpoint->state_hash);
    apply(*session, marks[n], records.size());
    EXPECT_EQ(session->revision(), whole.revision());
    EXPECT_EQ(session->mesh().state_hash(), whole.mesh().state_hash());
  }
}

// Of the places that are marked those are used that enough work lies before.
TEST_F(CheckpointerTest, AMarkIsUsedWhereWorkLiesBehindIt) {
  const auto never = make(1000);
  const auto often = make(1e-6);
  for (const auto& checkpointer : {never.get(), often.get()}) {
    std::uint64_t i = 0;
    for (const JournalRecord& record : stroke()) {
      if (++i % 50 == 0) checkpointer->mark(i, i, i, false);
      checkpointer->record(record);
    }
    JournalRecord last;
    last.kind = Kind::kCommit;
    checkpointer->record(last);
    EXPECT_TRUE(wait_for(*checkpointer, [&] { return checkpointer->behind() == 0; }));
  }
  EXPECT_TRUE(wait_for(*often, [&] { return often->written() >= 1; }));
  EXPECT_EQ(never->written(), 0u);
}

// The marks say what gave way in a simulation's steps. So no tetrahedron is checked again, and what is saved is the same as if each had
// been. A step whose mark has not come yet, at a place for a checkpoint, is computed like the loop's.
TEST_F(CheckpointerTest, StepsWhoseOutcomeIsKnownAreNotCheckedAgain) {
  core::CutSession session(mesh_, config());
  std::vector<JournalRecord> records;
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  const auto advance = [&] {
    while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted)
      records.push_back(commit_record(delta));
  };
  int i = 0, steps = 0;
  for (const core::Pose& pose : tests::sweep_through(300)) {
    JournalRecord record;
    record.pose = pose;
    records.push_back(record);
    session.push(0, pose);
    advance();
    if (++i % 10 != 0) continue;
    auto positions = std::make_shared<core::VertexPositions>();
    positions->revision = session.revision();
    for (core::VertexId v = 0; v < session.mesh().vertex_slots(); ++v) {
      const core::Vec3 p = session.mesh().rest_position(v);
      positions->positions.push_back(p + core::Vec3{0.03 * i / 300 * p.y, 0, 0});
    }
    record = {};
    record.kind = Kind::kDeform;
    record.positions = positions;
    records.push_back(record);
    session.deform(positions);
    positions->outcome = std::make_shared<std::vector<core::GaveWay>>();
    advance();
    ASSERT_EQ(records.back().kind, Kind::kCommit);
    *positions->outcome = session.gave_way();
    records.back().positions = positions;
    ++steps;
  }
  ASSERT_EQ(steps, 30);
  const auto last_step = std::find_if(records.rbegin(), records.rend(), [](const JournalRecord& record) {
    return record.kind == Kind::kDeform;
  });
  const auto marked = static_cast<std::size_t>(last_step.base() - records.begin());
  for (const bool between : {false, true}) {
    const std::uint64_t place = between ? marked : records.size();
    const auto checkpointer = make(1000);
    for (std::size_t k = 0; k < records.size(); ++k) {
      if (k == place) checkpointer->mark(1, 0, k, true);
      checkpointer->record(records[k]);
    }
    if (place == records.size()) checkpointer->mark(1, 0, place, true);
    ASSERT_TRUE(wait_for(*checkpointer, [&] { return checkpointer->written() == 1; }));
    EXPECT_EQ(checkpointer->finish(std::chrono::seconds(60)).empty(), !between);
    EXPECT_EQ(told(), "");
    EXPECT_EQ(checkpointer->tets_checked() > 0, between);
    std::string error;
    const auto checkpoint = read_checkpoint(checkpoint_path(journal(), 0), error);
    ASSERT_TRUE(checkpoint) << error;
    if (!between) {
      EXPECT_EQ(checkpoint->state, core::save_session(session));
      continue;
    }
    auto resumed = core::restore_session(checkpoint->state, config(), error);
    ASSERT_TRUE(resumed) << error;
    for (std::size_t k = marked; k < records.size(); ++k) {
      apply(*resumed, records[k]);
      while (resumed->advance(budget, delta) == core::CutSession::Progress::kCommitted) {
      }
    }
    EXPECT_EQ(core::save_session(*resumed), core::save_session(session));
  }
}

TEST_F(CheckpointerTest, AnotherHashIsToldAndEndsIt) {
  auto records = stroke();
  int marks = 0;
  for (JournalRecord& record : records) {
    if (record.kind == Kind::kCommit && ++marks == 3) record.state_hash ^= 1;
  }
  const auto checkpointer = make(1000);
  for (const JournalRecord& record : records) checkpointer->record(record);
  EXPECT_TRUE(wait_for(*checkpointer, [&] { return !checkpointer->following(); }));
  EXPECT_NE(told().find("revision 3 has another hash when it is computed again"), std::string::npos)
      << told();
  checkpointer->mark(1, 0, 0, true);
  checkpointer->record({});
  EXPECT_TRUE(wait_for(*checkpointer, [&] { return checkpointer->behind() == 0; }));
  EXPECT_EQ(checkpointer->written(), 0u);
}

// Records that never came leave a state that nobody knows, until the mesh is as loaded again.
TEST_F(CheckpointerTest, AfterLostRecordsAResetMakesItFollowAgain) {
  const auto records = stroke();
  const auto checkpointer = make(1000);
  JournalRecord gap;
  gap.kind = Kind::kGap;
  gap.lost = 5;
  for (std::size_t i = 0; i < 100; ++i) checkpointer->record(records[i]);
  checkpointer->record(gap);
  EXPECT_TRUE(wait_for(*checkpointer, [&] { return !checkpointer->following(); }));
  EXPECT_NE(told().find("no more checkpoints"), std::string::npos) << told();
  JournalRecord reset;
  reset.kind = Kind::kReset;
  reset.session = 8;
  checkpointer->record(reset);
  for (const JournalRecord& record : records) checkpointer->record(record);
  checkpointer->mark(5, 1, 2, true);
  EXPECT_TRUE(wait_for(*checkpointer, [&] { return checkpointer->written() == 1; }));
  EXPECT_TRUE(checkpointer->following());
  std::string error;
  const auto checkpoint = read_checkpoint(checkpoint_path(journal(), 0), error);
  ASSERT_TRUE(checkpoint) << error;
  EXPECT_EQ(checkpoint->session, 8u);
  EXPECT_GE(checkpoint->revision, 5u);
}

// Steps that were computed before a reset, and whose marks never came, are not compared with those after it.
TEST_F(CheckpointerTest, AResetForgetsWhatWasComputedBefore) {
  const auto records = stroke();
  const auto checkpointer = make(1000);
  for (core::Pose pose : tests::sweep_through(300, 1000, 0.3)) {
    JournalRecord record;
    record.pose = pose;
    checkpointer->record(record);
  }
  checkpointer->mark(4, 1, 1, true);
  EXPECT_TRUE(wait_for(*checkpointer, [&] { return checkpointer->written() == 1; }));
  JournalRecord reset;
  reset.kind = Kind::kReset;
  reset.session = 8;
  checkpointer->record(reset);
  for (const JournalRecord& record : records) checkpointer->record(record);
  checkpointer->mark(5, 1, 2, true);
  EXPECT_TRUE(
      wait_for(*checkpointer, [&] { return checkpointer->written() == 2 || !checkpointer->following(); }));
  EXPECT_TRUE(checkpointer->following()) << told();
}

// A disk that is full in the middle of it keeps no part, and what was there before.
TEST_F(CheckpointerTest, APartThatCouldNotBeWrittenIsRemoved) {
  Checkpoint checkpoint;
  checkpoint.id = 1;
  const std::string path = checkpoint_path(journal(), 0);
  write_checkpoint(path, checkpoint);
  checkpoint.id = 2;
  checkpoint.state.assign(1u << 20, std::byte{42});
  rlimit limit{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &limit), 0);
  const rlimit small{64u << 10, limit.rlim_max};
  const auto before = std::signal(SIGXFSZ, SIG_IGN);
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &small), 0);
  EXPECT_THROW(write_checkpoint(path, checkpoint), std::system_error);
  ::setrlimit(RLIMIT_FSIZE, &limit);
  std::signal(SIGXFSZ, before);
  EXPECT_FALSE(fs::exists(path + ".part"));
  std::string error;
  EXPECT_EQ(read_checkpoint(path, error)->id, 1u) << error;
}

TEST_F(CheckpointerTest, MoreThanMayWaitEndsItAsWell) {
  held_ = true;
  const auto checkpointer = make(1000, 50);
  const auto records = stroke();
  for (const JournalRecord& record : records) checkpointer->record(record);
  held_ = false;
  EXPECT_TRUE(wait_for(*checkpointer, [&] { return !checkpointer->following(); }));
  EXPECT_NE(told().find("cannot keep up"), std::string::npos) << told();
}

// What a resume has had to compute counts as if this run had done it.
TEST_F(CheckpointerTest, TheDebtOfEarlierRunsMakesACheckpointDue) {
  const auto due = make(500, 1u << 20, 500), not_yet = make(500, 1u << 20, 400);
  for (const auto& checkpointer : {due.get(), not_yet.get()}) {
    EXPECT_TRUE(checkpointer->in_debt());
    checkpointer->mark(1, 10, 2, false);
    checkpointer->record({});
    EXPECT_TRUE(wait_for(*checkpointer, [&] { return checkpointer->behind() == 0; }));
  }
  EXPECT_TRUE(wait_for(*due, [&] { return due->written() == 1; }));
  EXPECT_EQ(due->last_offset(), 10u);
  EXPECT_NE(not_yet->finish(std::chrono::minutes(1)), "") << "nothing is marked after the last record";
  EXPECT_EQ(not_yet->written(), 0u);
}

TEST_F(CheckpointerTest, AResetEndsTheDebt) {
  const auto checkpointer = make(500, 1u << 20, 500);
  JournalRecord reset;
  reset.kind = Kind::kReset;
  reset.session = 8;
  checkpointer->record(reset);
  checkpointer->mark(1, 10, 2, false);
  checkpointer->record({});
  EXPECT_TRUE(wait_for(*checkpointer, [&] { return checkpointer->behind() == 0; }));
  EXPECT_NE(checkpointer->finish(std::chrono::minutes(1)), "") << "nothing is marked after the last record";
  EXPECT_EQ(checkpointer->written(), 0u);
}

TEST_F(CheckpointerTest, AtRestASmallerDebtIsPaid) {
  const auto checkpointer = make(500, 1u << 20, 300, std::chrono::milliseconds(1));
  checkpointer->mark(1, 10, 2, false);
  EXPECT_TRUE(wait_for(*checkpointer, [&] { return checkpointer->written() == 1; }));
  EXPECT_EQ(checkpointer->last_offset(), 10u);
}

// However little it is; and what leads to no other state is not written again.
TEST_F(CheckpointerTest, TheEndIsSavedWhereAnythingHasHappened) {
  const auto records = stroke();
  const auto checkpointer = make(1000);
  for (const JournalRecord& record : records) checkpointer->record(record);
  checkpointer->mark(5, 77, records.size(), false);
  EXPECT_EQ(checkpointer->finish(std::chrono::minutes(1)), "");
  EXPECT_EQ(checkpointer->written(), 1u);
  std::string error;
  const auto checkpoint = read_checkpoint(checkpoint_path(journal(), 0), error);
  ASSERT_TRUE(checkpoint) << error;
  EXPECT_EQ(checkpoint->offset, 77u);
  EXPECT_GE(checkpoint->revision, 5u);
  const auto idle = make(1000);
  idle->mark(6, 78, 0, false);
  EXPECT_EQ(idle->finish(std::chrono::minutes(1)), "");
  EXPECT_EQ(idle->written(), 0u);
}

// It is behind for as long as it is held: the end says so and does not wait for it.
TEST_F(CheckpointerTest, TheEndDoesNotWaitForWhoIsFarBehind) {
  held_ = true;
  const auto checkpointer = make(1000);
  for (const JournalRecord& record : stroke()) checkpointer->record(record);
  checkpointer->mark(5, 77, 300, false);
  const std::string why = checkpointer->finish(std::chrono::milliseconds(10));
  held_ = false;
  EXPECT_NE(why.find("records that wait: 3"), std::string::npos) << why;
}

// A gap that only a checkpoint leads across, or a debt, is not forgotten because the disk had no room for it.
TEST_F(CheckpointerTest, WhatCouldNotBeWrittenIsStillOwed) {
  fs::create_directory(checkpoint_path(journal(), 0) + ".part");
  const auto checkpointer = make(500, 1u << 20, 500);
  checkpointer->mark(1, 10, 2, true);
  EXPECT_TRUE(wait_for(*checkpointer, [&] { return !told().empty(); }));
  EXPECT_NE(told().find("a checkpoint cannot be written"), std::string::npos) << told();
  fs::remove(checkpoint_path(journal(), 0) + ".part");
  EXPECT_EQ(checkpointer->finish(std::chrono::minutes(1)), "");
  EXPECT_EQ(checkpointer->written(), 1u);
  EXPECT_EQ(checkpointer->last_offset(), 10u);
}

TEST_F(CheckpointerTest, AFileIsWholeOrRefused) {
  Checkpoint checkpoint;
  checkpoint.id = 0x0123456789abcdef;
  checkpoint.offset = 99;
  checkpoint.state.assign(5000, std::byte{42});
  const std::string path = checkpoint_path(journal(), 0);
  std::string error = "before";
  EXPECT_FALSE(read_checkpoint(path, error));
  EXPECT_EQ(error, "") << "none is no error";
  write_checkpoint(path, checkpoint);
  const auto read = read_checkpoint(path, error);
  ASSERT_TRUE(read) << error;
  EXPECT_EQ(read->id, checkpoint.id);
  EXPECT_EQ(read->offset, 99u);
  EXPECT_EQ(read->state, checkpoint.state);
  EXPECT_FALSE(fs::exists(path + ".part"));
  std::ifstream in(path, std::ios::binary);
  const std::string bytes(std::istreambuf_iterator<char>(in), {});
  ASSERT_EQ(bytes.size(), 64u + 5000u);
  const auto refused = [&](const std::string& wrong) {
    std::ofstream(path, std::ios::binary) << wrong;
    const bool none = !read_checkpoint(path, error);
    return none && !error.empty();
  };
  for (std::size_t length = 0; length < bytes.size(); length += length < 70 ? 1 : 493)
    EXPECT_TRUE(refused(bytes.substr(0, length))) << length;
  for (std::size_t at = 0; at < bytes.size(); at += at < 70 ? 1 : 311) {
    std::string wrong = bytes;
    wrong[at] = static_cast<char>(wrong[at] ^ 8);
    EXPECT_TRUE(refused(wrong)) << at;
  }
  EXPECT_TRUE(refused(bytes + "x"));
  EXPECT_FALSE(refused(bytes));
  // What cannot be written leaves what was there.
  fs::create_directory(path + ".part");
  checkpoint.id = 1;
  EXPECT_THROW(write_checkpoint(path, checkpoint), std::system_error);
  EXPECT_EQ(read_checkpoint(path, error)->id, 0x0123456789abcdefu);
}

}  // namespace
}  // namespace incise::loop
