// What a capture's records become when they are read to be replayed.

#include "server/app/offline/recorded_motion.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>

#include "protocol/capture.hpp"

namespace incise::app {
namespace {

namespace fs = std::filesystem;
using protocol::Times;

protocol::PoseRecord pose(std::int64_t t_ns, std::uint32_t source = 0) {
  protocol::PoseRecord record;
  record.source = source;
  record.pose.source_ns = t_ns;
  return record;
}

protocol::BatchMark mark(std::uint64_t revision) {
  protocol::BatchMark record;
  record.revision = revision;
  return record;
}

class RecordedMotionTest : public ::testing::Test {
 protected:
  ~RecordedMotionTest() override { fs::remove(path_); }
  RecordedMotion read(const std::vector<protocol::CaptureRecord>& records, Times times = Times::kSkip) {
    protocol::FileSink sink(path_, true);
    protocol::CaptureHeader header;
    header.config_json = "{}";
    header.session = 5;
    protocol::CaptureWriter writer(sink, header);
    for (const protocol::CaptureRecord& record : records) writer.append(record);
    EXPECT_FALSE(writer.flush());
    return read_recorded_motion(path_, times);
  }
  const std::string path_ =
      (fs::temp_directory_path() / ("incise_motion_" + std::to_string(::getpid()) + ".capture")).string();
};

TEST_F(RecordedMotionTest, OnlyWhatCameAfterTheLastResetIsReplayed) {
  const RecordedMotion motion =
      read({pose(1), mark(1), protocol::CheckpointRecord{7}, protocol::GapRecord{3, 0, 0, 0, "full"}, pose(2),
            protocol::ResetRecord{6, 0}, pose(3), pose(4), mark(1), mark(2)});
  EXPECT_EQ(motion.resets, 1u);
  EXPECT_EQ(motion.session, 6u);
  EXPECT_FALSE(motion.gap);
  EXPECT_TRUE(motion.checkpoints.empty());
  ASSERT_EQ(motion.events.size(), 2u);
  EXPECT_EQ(motion.events[0].pose.t_ns, 3);
  ASSERT_EQ(motion.marks.size(), 2u);
  EXPECT_EQ(motion.marks[1].revision, 2u);
  EXPECT_EQ(motion.events_before, (std::vector<std::size_t>{2, 2}));
}

// A start from a checkpoint does not need what is before it, but every offline tool does.
TEST_F(RecordedMotionTest, DamageBeforeACheckpointIsFound) {
  protocol::FileSink sink(path_, true);
  protocol::CaptureWriter writer(sink, {});
  std::vector<std::uint64_t> offsets;
  const auto append = [&](const protocol::CaptureRecord& record) {
    EXPECT_FALSE(writer.flush());
    offsets.push_back(writer.written_bytes());
    writer.append(record);
  };
  for (int i = 0; i < 40; ++i) append(pose(i));
  // As long as what is looked at behind wrong bytes: from there it seems to be the end.
  for (int i = 0; i < 4; ++i) append(protocol::NoteRecord{std::string(500'000, ' ')});
  append(protocol::CheckpointRecord{7});
  append(pose(100));
  EXPECT_FALSE(writer.flush());
  const CaptureStart start{offsets[44], 44, 7, 0};
  EXPECT_NO_THROW(check_capture_before(path_, start));
  const auto flip = [&](std::uint64_t at) {
    std::fstream file(path_, std::ios::binary | std::ios::in | std::ios::out);
    file.seekg(static_cast<std::streamoff>(at));
    const char byte = static_cast<char>(file.get() ^ 1);
    file.seekp(static_cast<std::streamoff>(at));
    file.put(byte);
  };
  for (const std::size_t damaged : {0, 20, 41}) {
    for (const std::uint64_t behind : {0, 12}) {  // the record's length, and its contents
      flip(offsets[damaged] + behind);
      try {
        check_capture_before(path_, start);
        ADD_FAILURE() << damaged;
      } catch (const std::runtime_error& error) {
        const std::string text = error.what();
        EXPECT_NE(text.find(path_ + ": offset " + std::to_string(offsets[damaged]) + ": "), std::string::npos)
            << text;
        EXPECT_NE(text.find("--until-damage"), std::string::npos) << text;
      }
      EXPECT_TRUE(read_capture_from(path_, start)) << "it can be started from";
      flip(offsets[damaged] + behind);
    }
  }
  fs::resize_file(path_, fs::file_size(path_) - 5);  // what a kill leaves
  EXPECT_NO_THROW(check_capture_before(path_, start));
}

protocol::UndoRecord undo(std::int64_t t_ns, std::uint64_t revision) {
  protocol::UndoRecord record;
  record.session = 9;
  record.pose_source_ns = t_ns;
  record.revision = revision;
  return record;
}

TEST_F(RecordedMotionTest, WhatWasUndoneIsNotReplayed) {
  const RecordedMotion motion =
      read({pose(1), mark(1), pose(2), mark(2), mark(3), pose(3), undo(2, 1), pose(4), mark(2)});
  EXPECT_EQ(motion.undos, 1u);
  EXPECT_EQ(motion.session, 9u);
  ASSERT_EQ(motion.events.size(), 2u);
  EXPECT_EQ(motion.events[1].pose.t_ns, 4);
  ASSERT_EQ(motion.marks.size(), 2u);
  EXPECT_EQ(motion.marks[0].revision, 1u);
  EXPECT_EQ(motion.marks[1].revision, 2u);
  EXPECT_EQ(motion.events_before, (std::vector<std::size_t>{1, 2}));
  ASSERT_EQ(motion.warnings.size(), 1u);
  EXPECT_NE(motion.warnings[0].find("a stroke was undone"), std::string::npos) << motion.warnings[0];
}

// The last pose of that time: a source's times begin again where it is opened again. Twice, and past a gap.
TEST_F(RecordedMotionTest, UndosGoBackOneAfterTheOtherAndPastAGap) {
  EXPECT_EQ(read({pose(1), pose(2), protocol::BladeRecord{}, pose(2), pose(3), undo(2, 0)}).events.size(),
            3u);
  EXPECT_EQ(read({pose(1), pose(2), pose(3), undo(3, 0), undo(2, 0)}).events.size(), 1u);
  const RecordedMotion motion =
      read({pose(1), pose(2), protocol::GapRecord{3, 0, 0, 0, "full"}, pose(3), undo(2, 0), pose(4)});
  EXPECT_FALSE(motion.gap);
  EXPECT_EQ(motion.events.size(), 2u);
  EXPECT_TRUE(read({pose(1), protocol::GapRecord{3, 0, 0, 0, "full"}, pose(3), undo(3, 0), pose(4)}).gap);
  EXPECT_EQ(read({pose(1), undo(1, 0), protocol::ResetRecord{6, 0}, pose(2)}).undos, 0u);
}

TEST_F(RecordedMotionTest, AnUndoOfAStrokeThatIsNotThereIsRefused) {
  EXPECT_THROW(read({pose(1), undo(5, 0)}), std::runtime_error);
  EXPECT_THROW(read({pose(1, 3), undo(1, 0)}), std::runtime_error) << "another source's";
}

TEST_F(RecordedMotionTest, NothingAfterAGapIsReplayed) {
  const RecordedMotion motion =
      read({pose(1), mark(1), protocol::GapRecord{3, 0, 0, 0, "full"}, pose(2), mark(2)});
  ASSERT_TRUE(motion.gap);
  EXPECT_NE(motion.gap->text.find("3 records are missing after record 2 (full)"), std::string::npos)
      << motion.gap->text;
  EXPECT_EQ(motion.events.size(), 1u);
  EXPECT_EQ(motion.marks.size(), 1u);
  EXPECT_EQ(motion.events_before.size(), 1u);
}

// Times rise for each source, and begin again where it is opened again.
TEST_F(RecordedMotionTest, EachSourceHasItsClockAndEachOwnerAnother) {
  protocol::StrokeRecord hand_over;
  hand_over.action = protocol::StrokeAction::HandOver;
  EXPECT_EQ(read({pose(5), pose(3, 1), pose(6), pose(4, 1)}, Times::kRefuse).events.size(), 4u);
  EXPECT_EQ(read({pose(5), protocol::BladeRecord{}, pose(1)}, Times::kRefuse).events.size(), 3u);
  EXPECT_EQ(read({pose(5), hand_over, pose(1)}, Times::kRefuse).events.size(), 3u);
  EXPECT_THROW(read({pose(5), pose(5)}, Times::kRefuse), std::runtime_error);
  EXPECT_EQ(read({pose(5), pose(5)}).events.size(), 2u);
}

}  // namespace
}  // namespace incise::app
