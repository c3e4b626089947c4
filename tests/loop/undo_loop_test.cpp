// Undoing in the loop, with a journal and the checkpointer that has the history.

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "tests/loop/rig.hpp"

namespace incise::loop {
namespace {

class UndoLoop : public ::testing::Test {
 protected:
  UndoLoop() {
    Checkpointer::Options options;
    std::filesystem::create_directories(folder_);
    options.journal = (folder_ / "journal").string();  // the only checkpoint is the one of the end
    options.replay_s = 1e9;
    options.rest = std::chrono::hours(1);
    options.fresh = [this] {
      return std::make_unique<core::CutSession>(mesh_, config(core::Policy::kConforming));
    };
    options.undone = [this](Undone undone) {
      const std::scoped_lock lock(mutex_);
      undone_ = std::make_unique<Undone>(std::move(undone));
    };
    auto checkpointer = std::make_unique<Checkpointer>(
        options, 7, 0, options.fresh, [](bool, const std::string& text) { ADD_FAILURE() << text; });
    checkpointer_ = checkpointer.get();
    journal_ = std::make_unique<Journal>(
        std::make_unique<Memory>(records_), Journal::Options{}, [](const std::string&) {},
        std::move(checkpointer));
    LoopOptions loop_options;
    loop_options.undo_patience_ns = 500'000'000;
    loop_ = std::make_unique<FrameLoop>(session_, sources_, kept_, journal_.get(), loop_options);
    loop_->offer_undo(
        [this] {
          const std::scoped_lock lock(mutex_);
          return std::move(undone_);
        },
        [this](std::unique_ptr<core::CutSession>) { return 100 + ++undos_; });
    source_ = sources_.open("blade");
  }
  ~UndoLoop() override {
    loop_.reset();
    journal_.reset();
    std::filesystem::remove_all(folder_);
  }
  void cut(double x) {
    for (core::Pose pose : tests::sweep_through(150, 1000, x, 0.1, clock_ns_)) send(pose);
    clock_ns_ += 1'000'000'000;
    lift();
  }
  void lift() {
    core::Pose up = tests::sweep_through(2, 1000, 3, 0.1, clock_ns_)[0];
    up.buttons = 0;
    clock_ns_ += 1'000'000'000;
    send(up);
  }
  void send(const core::Pose& pose) { send(pose, *source_); }
  void send(const core::Pose& pose, input::PoseSource& source) {
    const input::TimedPose timed{pose, monotonic_ns()};
    source.enqueue(std::span(&timed, 1));
    loop_->frame(monotonic_ns());
  }
  bool frames_until(const std::function<bool()>& condition) {
    for (int i = 0; i < 20'000; ++i) {
      if (condition()) return true;
      loop_->frame(monotonic_ns());
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return false;
  }
  bool caught_up(std::uint32_t strokes) {
    return frames_until([&] { return checkpointer_->undoable() == strokes && state().backlog_batches == 0; });
  }
  bool ask(std::optional<std::uint32_t> source = std::nullopt, bool others = false) {
    UndoWish wish{source, nullptr, others};
    if (source) wish.name = std::make_shared<const std::string>(sources_.name_of(*source));
    return loop_->request_undo(wish, [this](const UndoAnswer& answer) {
      answers_.push_back(answer.end);
      in_the_way_ = answer.source;
      blades_ = answer.blades;
      was_reset_ = answer.was_reset;
    });
  }
  // Half of a stroke: the blade is still in it.
  void cut_halfway(double x, input::PoseSource& source) {
    for (const core::Pose& pose : tests::sweep_through(150, 1000, x, 0.1, clock_ns_)) {
      if (pose.t_ns - clock_ns_ < 75'000'000) send(pose, source);
    }
    clock_ns_ += 1'000'000'000;
  }
  // Ends a stroke, and lets the loop know.
  void end(input::PoseSource& source) {
    ASSERT_TRUE(source.end_stroke(monotonic_ns()));
    loop_->frame(monotonic_ns());
  }
  LoopState state() const { return loop_->stats().state.load(); }

  const core::MeshData mesh_ = tests::cube(5);
  core::CutSession session_{mesh_, config(core::Policy::kConforming)};
  input::PoseSources sources_{tests::long_blade()};
  Kept kept_;
  std::vector<JournalRecord> records_;
  std::mutex mutex_;
  std::unique_ptr<Undone> undone_;
  std::uint64_t undos_ = 0;
  std::vector<UndoEnd> answers_;
  // Of the last answer.
  std::uint32_t in_the_way_ = 99;
  std::vector<std::string> blades_;
  bool was_reset_ = false;
  std::filesystem::path folder_ =
      std::filesystem::temp_directory_path() / ("incise_undo_" + std::to_string(::getpid()));
  Checkpointer* checkpointer_ = nullptr;
  std::unique_ptr<Journal> journal_;
  std::unique_ptr<FrameLoop> loop_;
  std::optional<input::PoseSource> source_;
  std::int64_t clock_ns_ = 1'000'000'000;
};

TEST_F(UndoLoop, GoesBackAndCutsOnAndTwoAtOnceAreTwo) {
  cut(0.5);
  ASSERT_TRUE(caught_up(1));
  const LoopState one = state();
  cut(0.2);
  cut(0.8);
  ASSERT_TRUE(caught_up(3));
  EXPECT_TRUE(ask());
  EXPECT_TRUE(ask());
  ASSERT_TRUE(frames_until([&] { return undos_ == 2; }));
  EXPECT_EQ(state().state_hash, one.state_hash);
  EXPECT_EQ(state().revision, one.revision);
  EXPECT_EQ(state().cut_faces, one.cut_faces);
  EXPECT_EQ(state().strokes, 3u) << "what was undone was begun";
  EXPECT_EQ(state().cut_area_m2, one.cut_area_m2);
  ASSERT_TRUE(caught_up(1));
  cut(0.35);
  ASSERT_TRUE(caught_up(2));
  EXPECT_GT(state().revision, one.revision);
  EXPECT_TRUE(ask());
  ASSERT_TRUE(frames_until([&] { return undos_ == 3; }));
  EXPECT_EQ(state().state_hash, one.state_hash);
  // One more than there are strokes: nothing happens.
  EXPECT_TRUE(ask());
  EXPECT_TRUE(ask());
  ASSERT_TRUE(frames_until([&] { return undos_ == 4; }));
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 5; }));
  EXPECT_EQ(undos_, 4u);
  EXPECT_EQ(state().revision, 0u);
  EXPECT_EQ(answers_, (std::vector{UndoEnd::kDone, UndoEnd::kDone, UndoEnd::kDone, UndoEnd::kDone,
                                   UndoEnd::kNoStroke}));
}

// Asked for in the middle of the asker's stroke: it waits for the stroke's end, and undoes that one.
TEST_F(UndoLoop, WaitsForTheStrokeToEnd) {
  cut(0.5);
  ASSERT_TRUE(caught_up(1));
  const LoopState one = state();
  const auto poses = tests::sweep_through(150, 1000, 0.2, 0.1, clock_ns_);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (i == 75) ask(source_->number());
    send(poses[i]);
  }
  EXPECT_EQ(undos_, 0u);
  clock_ns_ += 1'000'000'000;
  lift();
  ASSERT_TRUE(frames_until([&] { return undos_ == 1; }));
  EXPECT_EQ(state().state_hash, one.state_hash);
}

// What waits in vain is answered, each in its turn, and what is asked for afterwards is done.
TEST_F(UndoLoop, IsGivenUpWhereTheStrokeDoesNotEnd) {
  cut(0.5);
  ASSERT_TRUE(caught_up(1));
  cut_halfway(0.2, *source_);
  ASSERT_TRUE(frames_until([&] { return state().backlog_batches == 0; }));
  const std::uint64_t hash = state().state_hash;
  // The hand stands still, and is heard of.
  core::Pose last = tests::sweep_through(150, 1000, 0.2, 0.1, clock_ns_ - 1'000'000'000)[74];
  ask(source_->number());
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] {
    last.t_ns += 1'000'000;
    send(last);
    return answers_.size() == 2;
  }));
  EXPECT_EQ(answers_, (std::vector{UndoEnd::kInStroke, UndoEnd::kInStroke}));
  EXPECT_EQ(in_the_way_, source_->number());
  EXPECT_EQ(undos_, 0u);
  EXPECT_EQ(state().state_hash, hash);
  lift();
  ask();
  ASSERT_TRUE(frames_until([&] { return undos_ == 1; }));
  EXPECT_EQ(answers_.back(), UndoEnd::kDone);
}

TEST_F(UndoLoop, AResetThatOvertakesItIsItsAnswer) {
  loop_->offer_reset(
      [this] { return std::make_unique<core::CutSession>(mesh_, config(core::Policy::kConforming)); },
      [](std::unique_ptr<core::CutSession>) { return 50; });
  cut(0.5);
  ASSERT_TRUE(caught_up(1));
  cut_halfway(0.2, *source_);
  ask(source_->number());
  ask();
  loop_->frame(monotonic_ns());
  EXPECT_TRUE(loop_->request_reset());
  loop_->frame(monotonic_ns());
  EXPECT_EQ(answers_, (std::vector{UndoEnd::kReset, UndoEnd::kReset}));
  EXPECT_EQ(undos_, 0u);
  EXPECT_EQ(state().revision, 0u);
}

// An operator does not wait for another's stroke: the answer comes at once and names the blade. An admin waits for its end.
TEST_F(UndoLoop, AnotherBladesStrokeIsWaitedForByAnAdminAlone) {
  auto other = sources_.open("another");
  cut(0.5);
  ASSERT_TRUE(caught_up(1));
  cut_halfway(0.2, *other);
  ask(source_->number());
  loop_->frame(monotonic_ns());
  ASSERT_EQ(answers_, std::vector{UndoEnd::kInStroke});
  EXPECT_EQ(in_the_way_, other->number());
  answers_.clear();
  // An operator may undo its own strokes only.
  other->end_stroke(monotonic_ns());
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 1; }));
  EXPECT_EQ(blades_, std::vector<std::string>{"another"});
  ask(other->number());
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 3; }));
  EXPECT_EQ(answers_, (std::vector{UndoEnd::kOtherCut, UndoEnd::kDone, UndoEnd::kDone}));
  EXPECT_EQ(in_the_way_, source_->number()) << "whose stroke it was";
  EXPECT_EQ(state().revision, 0u);
  cut_halfway(0.2, *other);
  ask();
  loop_->frame(monotonic_ns());
  ASSERT_EQ(answers_.size(), 3u);
  other->end_stroke(monotonic_ns());
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 4; }));
  EXPECT_EQ(answers_.back(), UndoEnd::kDone);
  EXPECT_EQ(in_the_way_, other->number());
  EXPECT_EQ(state().revision, 0u);
}

// What another blade has cut since the stroke began is taken back only where that was asked for.
TEST_F(UndoLoop, WhatAnotherBladeHasCutSinceIsLeftUnlessAskedFor) {
  auto other = sources_.open("another");
  const auto idle = [&] { return state().backlog_batches == 0; };
  cut_halfway(0.2, *other);
  end(*other);
  ASSERT_TRUE(caught_up(1));
  const LoopState before = state();
  cut(0.5);
  ASSERT_TRUE(caught_up(2));
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 1; }));
  EXPECT_EQ(answers_[0], UndoEnd::kDone) << "what the other one cut before does not matter";
  EXPECT_EQ(state().state_hash, before.state_hash);

  const auto theirs = tests::sweep_through(150, 1000, 0.8, 0.1, clock_ns_);
  for (std::size_t i = 0; i < 100; ++i) send(theirs[i], *other);
  ASSERT_TRUE(frames_until(idle));
  cut(0.5);
  for (std::size_t i = 100; i < theirs.size(); ++i) send(theirs[i], *other);
  end(*other);
  ASSERT_TRUE(caught_up(3));
  const LoopState both = state();
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 2; }));
  EXPECT_EQ(answers_[1], UndoEnd::kOtherCut);
  EXPECT_EQ(blades_, std::vector<std::string>{"another"});
  EXPECT_EQ(state().state_hash, both.state_hash);
  ask(source_->number(), true);
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 3; }));
  EXPECT_EQ(answers_[2], UndoEnd::kDone);
  EXPECT_GT(state().revision, before.revision) << "what the other one had cut when the stroke began is left";
  EXPECT_LT(state().revision, both.revision);
  EXPECT_EQ(blades_, (std::vector<std::string>{"blade", "another"}));
}

// Each of two hands can undo, whichever began last; what the other has done since goes along. So do the figures of both.
TEST_F(UndoLoop, WithOthersABladeGoesBackToBeforeItsOwnLastStroke) {
  auto other = sources_.open("another");
  const auto faces = [&] {
    const BladesNow blades = loop_->stats().blades.load();
    return std::array{blades[0].cut_faces, blades[1].cut_faces};
  };
  const auto strokes = [&] {
    const BladesNow blades = loop_->stats().blades.load();
    return std::array{blades[0].strokes, blades[1].strokes};
  };
  cut(0.2);
  ASSERT_TRUE(caught_up(1));
  const LoopState one = state();
  const auto faces_of_one = faces();
  EXPECT_GT(faces_of_one[0], 10u);
  cut(0.5);
  for (const core::Pose& pose : tests::sweep_through(150, 1000, 0.8, 0.1, clock_ns_)) send(pose, *other);
  clock_ns_ += 1'000'000'000;
  end(*other);
  ASSERT_TRUE(caught_up(3));
  const LoopState all = state();
  EXPECT_GT(faces()[1], 10u);
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 1; }));
  EXPECT_EQ(answers_.back(), UndoEnd::kOtherCut);
  EXPECT_EQ(blades_, std::vector<std::string>{"another"});
  EXPECT_EQ(state().state_hash, all.state_hash);
  ask(source_->number(), true);
  ASSERT_TRUE(frames_until([&] { return undos_ == 1; }));
  EXPECT_EQ(in_the_way_, source_->number());
  EXPECT_EQ(blades_, (std::vector<std::string>{"blade", "another"}));
  EXPECT_EQ(state().state_hash, one.state_hash);
  EXPECT_EQ(faces(), faces_of_one);
  EXPECT_EQ(strokes(), (std::array<std::uint64_t, 2>{1, 0}));
  ask(other->number(), true);
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 3; }));
  EXPECT_EQ(answers_.back(), UndoEnd::kOtherBlade) << "what it had cut is gone";
  EXPECT_EQ(blades_, std::vector<std::string>{"blade"});
  cut(0.5);
  ASSERT_TRUE(caught_up(2));
  EXPECT_GT(state().revision, one.revision);
}

// Numbers are used again. Whoever gets the number of a blade that has left does not get its strokes, and the one that left finds them under any number.
TEST_F(UndoLoop, AStrokeBelongsToTheNameOfItsBladeNotToItsNumber) {
  cut(0.5);
  ASSERT_TRUE(caught_up(1));
  const std::uint32_t number = source_->number();
  source_.reset();
  loop_->frame(monotonic_ns());
  std::vector<input::PoseSource> eight;
  for (int i = 0; i < 8; ++i) eight.push_back(*sources_.open("hand " + std::to_string(i)));
  loop_->frame(monotonic_ns());
  ASSERT_EQ(sources_.name_of(number).substr(0, 5), "hand ");
  for (const bool others : {false, true}) {
    ask(number, others);
    ASSERT_TRUE(frames_until([&] { return !answers_.empty(); }));
    EXPECT_EQ(answers_, std::vector{UndoEnd::kOtherBlade});
    EXPECT_EQ(blades_, std::vector<std::string>{"blade"}) << "whose stroke it was, not who has its number";
    answers_.clear();
  }
  const auto another =
      std::find_if(eight.begin(), eight.end(), [&](const auto& s) { return s.number() != number; });
  eight.erase(another);
  loop_->frame(monotonic_ns());
  source_ = sources_.open("blade");
  ASSERT_TRUE(source_ && source_->number() != number);
  loop_->frame(monotonic_ns());
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 1; }));
  EXPECT_EQ(answers_.back(), UndoEnd::kDone);
  EXPECT_EQ(state().revision, 0u);
}

// A hand that has said nothing for longer than the gap between two strokes keeps nobody waiting, an admin as little as another hand.
TEST_F(UndoLoop, ASilentStrokeKeepsNobodyFromUndoing) {
  auto other = sources_.open("another");
  const auto past_the_gap = [] { std::this_thread::sleep_for(std::chrono::milliseconds(300)); };
  cut_halfway(0.2, *other);
  cut(0.5);
  for (const bool admin : {false, true}) {
    SCOPED_TRACE(admin);
    past_the_gap();
    EXPECT_EQ(loop_->stats().blades.load()[other->number()].cutting, 1);
    answers_.clear();
    ask(admin ? std::nullopt : std::optional(source_->number()));
    ASSERT_TRUE(frames_until([&] { return answers_.size() == 1; }));
    EXPECT_EQ(answers_.back(), UndoEnd::kDone);
    EXPECT_EQ(loop_->stats().blades.load()[other->number()].cutting, 0);
    cut_halfway(0.35, *other);
    cut(0.8);
  }
}

// Where a reset has taken the strokes, that is what the refusal says, before and after there are others.
TEST_F(UndoLoop, ARefusalSaysWhereAResetWasTheCause) {
  loop_->offer_reset(
      [this] { return std::make_unique<core::CutSession>(mesh_, config(core::Policy::kConforming)); },
      [](std::unique_ptr<core::CutSession>) { return 50; });
  ask();
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 1; }));
  EXPECT_FALSE(was_reset_);
  cut(0.5);
  ASSERT_TRUE(caught_up(1));
  EXPECT_TRUE(loop_->request_reset());
  loop_->frame(monotonic_ns());
  EXPECT_EQ(loop_->stats().blades.load()[0].cut_faces, 0u);
  EXPECT_EQ(loop_->stats().blades.load()[0].strokes, 0u);
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 2; }));
  EXPECT_EQ(answers_.back(), UndoEnd::kNoStroke);
  EXPECT_TRUE(was_reset_);
}

// Who goes on cutting at once does not lose that stroke instead of the one before.
TEST_F(UndoLoop, AStrokeThatBeginsMeanwhileIsNotUndone) {
  cut(0.5);
  ASSERT_TRUE(caught_up(1));
  const LoopState one = state();
  cut(0.2);
  ASSERT_TRUE(caught_up(2));
  ask(source_->number());
  ask();
  cut(0.8);
  ASSERT_TRUE(caught_up(3));
  EXPECT_EQ(answers_, (std::vector{UndoEnd::kBegun, UndoEnd::kBegun}));
  EXPECT_EQ(undos_, 0u);
  // Asked for again it is that stroke's turn, and then the turn of the one that was meant.
  ask(source_->number());
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] { return undos_ == 2; }));
  EXPECT_EQ(state().state_hash, one.state_hash);
}

// What was sent before it counts, even if the loop comes to it only afterwards.
TEST_F(UndoLoop, AStrokeThatWaitsInTheQueueIsTheOneThatIsUndone) {
  cut(0.5);
  ASSERT_TRUE(caught_up(1));
  const LoopState one = state();
  std::vector<input::TimedPose> waiting;
  for (const core::Pose& pose : tests::sweep_through(150, 1000, 0.2, 0.1, clock_ns_))
    waiting.push_back({pose, monotonic_ns()});
  clock_ns_ += 1'000'000'000;
  ASSERT_EQ(source_->enqueue(waiting), waiting.size());
  ASSERT_TRUE(source_->end_stroke(monotonic_ns()));
  ask();
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 1; }));
  EXPECT_EQ(answers_, std::vector{UndoEnd::kDone});
  EXPECT_EQ(state().state_hash, one.state_hash);
  EXPECT_EQ(state().strokes, 2u);
}

// The journal says what a replay needs to come to the same: up to the pose that it names, and on from there.
TEST_F(UndoLoop, TheJournalReplaysToTheSame) {
  for (const double x : {0.5, 0.2}) cut(x);
  ASSERT_TRUE(caught_up(2));
  ask();
  ASSERT_TRUE(frames_until([&] { return undos_ == 1; }));
  cut(0.8);
  loop_->finish();
  const std::uint64_t hash = state().state_hash;
  journal_.reset();
  std::vector<JournalRecord> left;
  for (const JournalRecord& record : records_) {
    EXPECT_NE(record.kind, JournalRecord::Kind::kUndoWanted);
    if (record.kind == JournalRecord::Kind::kUndo) {
      EXPECT_EQ(record.session, 101u);
      while (left.back().pose.t_ns != record.pose.t_ns || left.back().arrival_ns != record.posed_ns ||
             left.back().kind != JournalRecord::Kind::kPose)
        left.pop_back();
      left.pop_back();
    } else {
      left.push_back(record);
    }
  }
  core::CutSession replay(mesh_, config(core::Policy::kConforming));
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  for (const JournalRecord& record : left) {
    apply(replay, record);
    while (replay.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
    }
  }
  EXPECT_EQ(replay.mesh().state_hash(), hash);
}

}  // namespace
}  // namespace incise::loop
