#include "server/loop/undo_history.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "server/core/mesh/measure.hpp"
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
  // The beginning of such a sweep: it moves vertices onto the blade's way, and opens nothing.
  void graze(double x) {
    const std::uint64_t hash = session_->mesh().state_hash();
    const std::uint64_t cut_faces = core::measure(session_->mesh()).cut_faces;
    before_.push_back({session_->revision(), hash});
    JournalRecord record;
    for (const core::Pose& pose : tests::sweep_through(150, 1000, x, 0.1, clock_ns_)) {
      if (pose.t_ns > clock_ns_ + 20'000'000) break;
      record.pose = pose;
      record.begins_stroke = pose.t_ns == clock_ns_;
      apply(record);
    }
    record.kind = JournalRecord::Kind::kEndStroke;
    record.begins_stroke = false;
    apply(record);
    clock_ns_ += 1'000'000'000;
    ASSERT_NE(session_->mesh().state_hash(), hash);
    ASSERT_EQ(core::measure(session_->mesh()).cut_faces, cut_faces);
  }
  // A stroke of source 1 that does not end; `meanwhile` is called after each pose, with its number.
  void begin_stroke(std::span<const core::Pose> poses, const std::function<void(std::size_t)>& meanwhile) {
    JournalRecord record;
    record.source = 1;
    for (std::size_t i = 0; i < poses.size(); ++i) {
      record.pose = poses[i];
      record.arrival_ns = poses[i].t_ns;
      record.begins_stroke = i == 0;
      apply(record);
      meanwhile(i);
    }
  }
  void open(std::uint32_t source, const std::string& name) {
    JournalRecord record;
    record.kind = JournalRecord::Kind::kOpened;
    record.source = source;
    record.blade = session_->config().blade;
    record.name = std::make_shared<const std::string>(name);
    apply(record);
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

// Who asks for an undo wants to see a cut go. What such a stroke has changed all the same goes back exactly, with the stroke before.
TEST_F(UndoHistoryTest, StrokesThatOpenedNothingArePassedOver) {
  graze(0.2);
  EXPECT_EQ(history_->size(), 0u);
  EXPECT_EQ(history_->last(), nullptr);
  stroke(0.5);
  graze(0.8);
  EXPECT_EQ(history_->size(), 1u);
  stroke(0.35);
  graze(0.7);
  EXPECT_EQ(history_->size(), 2u);
  undo_to(3);
  EXPECT_EQ(history_->size(), 1u);
  undo_to(1);
  EXPECT_EQ(history_->size(), 0u);
  EXPECT_EQ(history_->last(), nullptr);
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
  before_.push_back({session_->revision(), session_->mesh().state_hash()});
  begin_stroke(poses, [&](std::size_t i) {
    if (i == 200) stroke(0.7);
  });
  EXPECT_EQ(history_->size(), 2u);
  undo_to(1);
  EXPECT_TRUE(session_->in_stroke(1));
  EXPECT_FALSE(session_->in_stroke(0));
  undo_to(0);
}

// A number may have had other owners. What was cut under it is theirs, and who comes back under another one finds its own.
TEST_F(UndoHistoryTest, AStrokeIsOfTheNameThatItsBladeHad) {
  const std::string left = "left", right = "right", third = "third";
  open(0, left);
  stroke(0.2);
  open(0, right);
  EXPECT_EQ(history_->last(&right), nullptr);
  stroke(0.5);
  open(1, third);
  stroke(0.8, 1);
  open(1, left);
  const std::uint64_t from[] = {before_[0].revision, before_[1].revision, before_[2].revision};
  const std::string names[] = {left, right, third};
  for (std::size_t i = 0; i < 3; ++i) {
    const BeforeStroke* const last = history_->last(&names[i]);
    ASSERT_NE(last, nullptr) << names[i];
    EXPECT_EQ(last->name(), names[i]);
    EXPECT_EQ(last->revision, from[i]);
    EXPECT_EQ(history_->cut_since(*last).size(), 3 - i);
    EXPECT_EQ(history_->cut_since(*last)[0], names[i]);
  }
  EXPECT_EQ(history_->last()->name(), third);
}

// A blade that only sweeps through the air while another one cuts has no stroke to undo.
TEST_F(UndoHistoryTest, WhatAnotherBladeCutsMeanwhileMakesNoStrokeOfABlades) {
  const std::string left = "left", right = "right";
  open(0, left);
  open(1, right);
  const auto poses = tests::sweep_through(300, 1000, 0.3, 0.1, 1000);
  before_.push_back({session_->revision(), session_->mesh().state_hash()});
  begin_stroke(poses, [&](std::size_t i) {
    if (i == 150) stroke(3);  // beside the cube
  });
  EXPECT_EQ(history_->last(&left), nullptr);
  EXPECT_EQ(history_->last()->name(), right);
  before_.resize(1);
  undo_to(0);
}

// Two hands begin before either has cut anything: each has its stroke.
TEST_F(UndoHistoryTest, TwoThatBeginAtOnceHaveAStrokeEach) {
  const std::string left = "left", right = "right";
  open(0, left);
  open(1, right);
  const auto poses = tests::sweep_through(150, 1000, 0.7, 0.1, 1000);
  begin_stroke(poses, [&](std::size_t i) {
    if (i == 0) stroke(0.3);
  });
  EXPECT_EQ(history_->size(), 1u) << "both go with the first undo";
  for (const std::string& name : {left, right}) {
    const BeforeStroke* const last = history_->last(&name);
    ASSERT_NE(last, nullptr) << name;
    EXPECT_EQ(last->revision, 0u);
    EXPECT_EQ(history_->cut_since(*last).size(), 2u);
  }
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

TEST_F(UndoHistoryTest, TheSumsOfEachBladeToo) {
  open(0, "left");
  open(1, "right");
  stroke(0.5);
  stroke(0.2, 1);
  stroke(0.8);
  const BladesSums sums = history_->last()->blades;
  for (const std::uint32_t source : {0u, 1u}) {
    EXPECT_EQ(sums[source].strokes, 1u) << source;
    EXPECT_GT(sums[source].cut_faces, 10u) << source;
  }
  undo_to(2);
  undo_to(1);
  stroke(0.8, 1);
  EXPECT_EQ(history_->last()->blades[1].strokes, 0u);
  EXPECT_EQ(history_->last()->blades[1].cut_faces, 0u);
  EXPECT_EQ(history_->last()->blades[0].cut_faces, sums[0].cut_faces);
  open(0, "left");
  stroke(0.35, 1);
  EXPECT_EQ(history_->last()->blades[0].cut_faces, 0u) << "another owner";
}

// What a blade's last owner left to be cut when another one came is not the new one's.
TEST(UndoOfOwners, WhatIsCutAfterABladeHasAnotherOwnerIsTheOnesWhoseStrokeItWas) {
  const auto folder =
      std::filesystem::temp_directory_path() / ("incise_owners_" + std::to_string(::getpid()));
  std::filesystem::create_directories(folder);
  const std::string left = "left", right = "right";
  std::vector<Undone> found;
  Checkpointer::Options options;
  options.journal = (folder / "journal").string();
  options.replay_s = 1e9;
  options.fresh = [] {
    return std::make_unique<core::CutSession>(tests::cube(5), config(core::Policy::kConforming));
  };
  options.undone = [&](Undone undone) { found.push_back(std::move(undone)); };
  {
    Checkpointer checkpointer(options, 7, 0, options.fresh, [](bool, const std::string&) {});
    JournalRecord record;
    record.kind = JournalRecord::Kind::kOpened;
    record.blade = tests::long_blade();
    record.name = std::make_shared<const std::string>(left);
    checkpointer.record(record);
    record.kind = JournalRecord::Kind::kPose;
    record.begins_stroke = true;
    for (const core::Pose& pose : tests::sweep_through(150, 1000, 0.5)) {
      record.pose = pose;
      checkpointer.record(record);
      record.begins_stroke = false;
    }
    record.kind = JournalRecord::Kind::kOpened;
    record.name = std::make_shared<const std::string>(right);
    checkpointer.record(record);
    record.kind = JournalRecord::Kind::kUndoWanted;
    for (const std::string& name : {left, right}) {
      record.name = std::make_shared<const std::string>(name);
      checkpointer.record(record);
    }
    checkpointer.finish(std::chrono::seconds(60));
  }
  std::filesystem::remove_all(folder);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_TRUE(found[0].session);
  EXPECT_EQ(found[0].blades, std::vector<std::string>{left});
  EXPECT_FALSE(found[1].session);
  EXPECT_EQ(found[1].blades, std::vector<std::string>{left}) << "whose the last stroke is";
}

}  // namespace
}  // namespace incise::loop
