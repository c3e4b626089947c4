#include "server/loop/undo_history.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "tests/loop/rig.hpp"

namespace incise::loop {
namespace {

// A session, its history, and what the session was before each stroke.
class UndoHistoryTest : public ::testing::Test {
 protected:
  void apply(const JournalRecord& record) {
    history_->note(record, *session_);
    loop::apply(*session_, record);
    core::Delta delta;
    auto budget = core::WorkBudget::unlimited();
    while (session_->advance(budget, delta) == core::CutSession::Progress::kCommitted) history_->note(delta);
  }
  // A sweep across the cube at `x`, as the loop records it; beside the cube where x > 1.5.
  void stroke(double x, std::uint32_t source = 0) {
    JournalRecord record;
    record.source = source;
    for (const core::Pose& pose : tests::sweep_through(150, 1000, x, 0.1, clock_ns_)) {
      record.kind = JournalRecord::Kind::kPose;
      record.pose = pose;
      record.arrival_ns = pose.t_ns + 5;
      record.begins_stroke = !session_->in_stroke(source);
      if (record.begins_stroke) before_.push_back({session_->revision(), session_->mesh().state_hash()});
      apply(record);
    }
    record.kind = JournalRecord::Kind::kEndStroke;
    record.begins_stroke = false;
    apply(record);
    clock_ns_ += 1'000'000'000;
  }
  void deform(double by_m) {
    auto positions = std::make_shared<core::VertexPositions>();
    positions->revision = session_->revision();
    for (core::VertexId v = 0; v < 20; ++v) {
      positions->ids.push_back(v);
      positions->positions.push_back(session_->mesh().position(v) + core::Vec3{by_m, 0, 0});
    }
    JournalRecord record;
    record.kind = JournalRecord::Kind::kDeform;
    record.positions = positions;
    apply(record);
    EXPECT_EQ(positions.use_count(), 2) << "the source's buffer is kept";  // here, and in the record
  }
  // Goes back once, and looks whether that is where stroke `number` began.
  void undo_to(std::size_t number) {
    const BeforeStroke* const last = history_->last();
    ASSERT_NE(last, nullptr);
    const BeforeStroke before = *last;
    auto session = history_->before(before, session_->config());
    ASSERT_NE(session, nullptr);
    session_ = std::move(session);
    history_->went_back(before);
    EXPECT_EQ(session_->revision(), before_[number].revision);
    EXPECT_EQ(before.revision, before_[number].revision);
    EXPECT_EQ(session_->mesh().state_hash(), before_[number].hash) << "stroke " << number;
    before_.resize(number);
  }
  void limit(std::size_t bytes) { history_ = std::make_unique<UndoHistory>(bytes); }

  struct Before {
    std::uint64_t revision, hash;
  };
  std::unique_ptr<core::CutSession> session_ =
      std::make_unique<core::CutSession>(tests::cube(5), config(core::Policy::kConforming));
  std::unique_ptr<UndoHistory> history_ = std::make_unique<UndoHistory>(256u << 20);
  std::vector<Before> before_;
  std::int64_t clock_ns_ = 1'000'000'000;
};

TEST_F(UndoHistoryTest, EachStrokeIsUndoneExactlyLastFirst) {
  EXPECT_EQ(history_->last(), nullptr);
  for (const double x : {0.2, 0.5, 0.8, 0.35}) stroke(x);
  EXPECT_EQ(history_->size(), 4u);
  for (std::size_t i = 4; i-- > 0;) undo_to(i);
  EXPECT_EQ(history_->size(), 0u);
  EXPECT_EQ(history_->last(), nullptr);
  EXPECT_EQ(session_->revision(), 0u);
}

TEST_F(UndoHistoryTest, CuttingGoesOnAfterAnUndoAndIsUndoneAsWell) {
  for (const double x : {0.2, 0.5}) stroke(x);
  undo_to(1);
  for (const double x : {0.6, 0.7}) stroke(x);
  undo_to(2);
  undo_to(1);
  stroke(0.5);
  undo_to(1);
  undo_to(0);
}

TEST_F(UndoHistoryTest, StrokesThatChangedNothingArePassedOver) {
  stroke(0.5);
  stroke(3);
  stroke(4);
  before_.resize(2);
  EXPECT_EQ(history_->size(), 1u);
  undo_to(0);
  EXPECT_EQ(history_->size(), 0u);
}

TEST_F(UndoHistoryTest, ADeformedBodyGoesBackToTheShapeItHad) {
  stroke(0.5);
  deform(0.001);
  stroke(0.2);
  deform(0.002);
  deform(0.001);
  EXPECT_EQ(history_->size(), 2u);
  undo_to(1);
  undo_to(0);
}

// A stroke of the one blade begins and ends within one of the other: the other goes on being under way.
TEST_F(UndoHistoryTest, AnotherBladesStrokeIsThereAsFarAsItWas) {
  const auto poses = tests::sweep_through(300, 1000, 0.3, 0.1, 1000);
  JournalRecord record;
  record.source = 1;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    record.pose = poses[i];
    record.arrival_ns = poses[i].t_ns;
    record.begins_stroke = i == 0;
    if (i == 0) before_.push_back({session_->revision(), session_->mesh().state_hash()});
    apply(record);
    if (i == 150) stroke(0.7);
  }
  EXPECT_EQ(history_->size(), 2u);
  undo_to(1);
  EXPECT_TRUE(session_->in_stroke(1));
  EXPECT_FALSE(session_->in_stroke(0));
  undo_to(0);
}

// However many strokes there are, the memory is bounded: the oldest can no longer be undone, the last one always can.
TEST_F(UndoHistoryTest, LittleRoomKeepsTheLastStroke) {
  limit(1);
  stroke(0.5);
  // More than a span keeps of what comes after a stroke's beginning: 32 MB of poses beside the body.
  JournalRecord hover;
  hover.pose = tests::sweep_through(2, 1000, 3)[0];
  hover.pose.buttons = 0;
  for (std::size_t i = 0; i < (40u << 20) / sizeof hover; ++i) {
    hover.pose.t_ns = clock_ns_ += 1000;
    apply(hover);
  }
  clock_ns_ += 1'000'000'000;
  EXPECT_EQ(history_->size(), 1u);
  stroke(0.2);
  EXPECT_EQ(history_->size(), 1u) << "the first one's state was dropped";
  undo_to(1);
  EXPECT_EQ(history_->last(), nullptr);
}

TEST_F(UndoHistoryTest, TheSumsGoBackToo) {
  stroke(0.5);
  stroke(0.2);
  const BeforeStroke second = *history_->last();
  EXPECT_EQ(second.strokes, 1u);
  EXPECT_GT(second.cut_faces, 10u);
  EXPECT_NEAR(second.cut_area_m2, 0.01, 0.003);
  undo_to(1);
  EXPECT_EQ(history_->last()->strokes, 0u);
  EXPECT_EQ(history_->last()->cut_faces, 0u);
}

// ---- In the loop, with a journal and the checkpointer that has the history ----

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
    return frames_until(
        [&] { return checkpointer_->undoable().strokes == strokes && state().backlog_batches == 0; });
  }
  bool ask(std::optional<std::uint32_t> source = std::nullopt, bool others = false) {
    return loop_->request_undo({source, others}, [this](UndoAnswer answer) {
      answers_.push_back(answer.end);
      in_the_way_ = answer.blade;
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
  std::uint32_t in_the_way_ = 99;  // of the last answer
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
  const std::uint64_t hash = state().state_hash;
  ask(source_->number());
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 2; }));
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
  EXPECT_EQ(in_the_way_, other->number());
  ask(other->number());
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 3; }));
  EXPECT_EQ(answers_, (std::vector{UndoEnd::kOtherBlade, UndoEnd::kDone, UndoEnd::kDone}));
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
  for (std::size_t i = 0; i < 75; ++i) send(theirs[i], *other);
  ASSERT_TRUE(frames_until(idle));
  cut(0.5);
  for (std::size_t i = 75; i < theirs.size(); ++i) send(theirs[i], *other);
  end(*other);
  ASSERT_TRUE(caught_up(3));
  const LoopState both = state();
  ask(source_->number());
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 2; }));
  EXPECT_EQ(answers_[1], UndoEnd::kOtherCut);
  EXPECT_EQ(in_the_way_, other->number());
  EXPECT_EQ(state().state_hash, both.state_hash);
  ask(source_->number(), true);
  ASSERT_TRUE(frames_until([&] { return answers_.size() == 3; }));
  EXPECT_EQ(answers_[2], UndoEnd::kDone);
  EXPECT_GT(state().revision, before.revision) << "what the other one had cut when the stroke began is left";
  EXPECT_LT(state().revision, both.revision);
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
