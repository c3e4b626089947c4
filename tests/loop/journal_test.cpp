#include "server/loop/journal.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <mutex>
#include <stdexcept>
#include <thread>
#include <vector>

namespace incise::loop {
namespace {

using Kind = JournalRecord::Kind;

// What reached the "disk"; can be told to fail.
struct Disk {
  std::mutex mutex;
  std::vector<JournalRecord> records;
  std::atomic<int> syncs{0};
  std::atomic<bool> closed{false};
  std::atomic<bool> full{false}, slow{false}, hangs{false};
};

class DiskSink : public JournalSink {
 public:
  explicit DiskSink(Disk& disk) : disk_(disk) {}
  void write(const JournalRecord& record) override {
    while (disk_.slow) std::this_thread::yield();
    buffer_.push_back(record);
  }
  void flush() override {
    if (disk_.full) {
      buffer_.clear();
      throw std::runtime_error("no space left on device");
    }
    const std::scoped_lock lock(disk_.mutex);
    disk_.records.insert(disk_.records.end(), buffer_.begin(), buffer_.end());
    buffer_.clear();
  }
  void sync() override {
    ++disk_.syncs;
    while (disk_.hangs) std::this_thread::yield();
  }
  void close() override { disk_.closed = true; }

 private:
  std::vector<JournalRecord> buffer_;
  Disk& disk_;
};

JournalRecord pose(std::uint64_t number) {
  JournalRecord record;
  record.revision = number;
  return record;
}

TEST(Journal, WritesEverythingInOrderAndSyncsAtTheEnd) {
  Disk disk;
  {
    Journal journal(std::make_unique<DiskSink>(disk), {}, [](const std::string&) {});
    for (std::uint64_t i = 0; i < 1000; ++i) EXPECT_TRUE(journal.record(pose(i)));
  }
  ASSERT_EQ(disk.records.size(), 1000u);
  for (std::uint64_t i = 0; i < 1000; ++i) EXPECT_EQ(disk.records[i].revision, i);
  EXPECT_GE(disk.syncs, 1);
  EXPECT_TRUE(disk.closed);
}

TEST(Journal, WithoutAPolicyItLeavesTheDiskToTheSystem) {
  Disk disk;
  {
    Journal journal(std::make_unique<DiskSink>(disk), {SyncPolicy::kNone, 100, 64},
                    [](const std::string&) {});
    journal.record(pose(1));
  }
  EXPECT_EQ(disk.records.size(), 1u);
  EXPECT_EQ(disk.syncs, 0);
}

// In groups: the first records at once, others when the interval is over, and the rest at the end.
TEST(Journal, SyncsNoOftenerThanItsInterval) {
  Disk disk;
  {
    Journal::Options options;
    options.policy = SyncPolicy::kGroup;
    options.sync_interval_ms = 3'600'000;
    Journal journal(std::make_unique<DiskSink>(disk), options, [](const std::string&) {});
    for (std::uint64_t i = 1; i <= 5; ++i) {
      EXPECT_TRUE(journal.record(pose(i)));
      const auto written = [&] {
        const std::scoped_lock lock(disk.mutex);
        return disk.records.size();
      };
      while (written() < i || disk.syncs == 0) std::this_thread::yield();
    }
  }
  EXPECT_EQ(disk.records.size(), 5u);
  EXPECT_EQ(disk.syncs, 2);
}

// The queue of a slow disk overflows: the records that were lost are counted, and a gap of so many stands
// where they were.
TEST(Journal, ASlowDiskLeavesAnHonestGap) {
  Disk disk;
  disk.slow = true;
  std::uint64_t taken = 0, lost = 0;
  {
    Journal journal(std::make_unique<DiskSink>(disk), {SyncPolicy::kGroup, 100, 16},
                    [](const std::string&) {});
    for (std::uint64_t i = 0; i < 100; ++i) ++(journal.record(pose(i)) ? taken : lost);
    EXPECT_GT(lost, 0u);
    EXPECT_EQ(journal.lost(), lost);
    disk.slow = false;
  }
  std::uint64_t written = 0, next = 0;
  for (const JournalRecord& record : disk.records) {
    if (record.kind == Kind::kGap) {
      next += record.lost;
    } else {
      EXPECT_EQ(record.revision, next++);
      ++written;
    }
  }
  EXPECT_EQ(written, taken);
  EXPECT_EQ(next, 100u);
}

TEST(Journal, AFullDiskIsToldOnceAndTheGapIsMarkedWhenThereIsRoomAgain) {
  Disk disk;
  disk.full = true;
  std::mutex mutex;
  std::vector<std::string> told;
  std::uint64_t lost = 0;
  {
    Journal journal(std::make_unique<DiskSink>(disk), {}, [&](const std::string& text) {
      const std::scoped_lock lock(mutex);
      told.push_back(text);
    });
    for (std::uint64_t i = 0; i < 10; ++i) journal.record(pose(i));
    while (!journal.failing() || journal.waiting() > 0) std::this_thread::yield();
    disk.full = false;
    while (journal.failing()) std::this_thread::yield();
    EXPECT_TRUE(journal.record(pose(10)));
    lost = journal.lost();
  }
  ASSERT_EQ(told.size(), 2u);
  EXPECT_EQ(told[0], "no space left on device");
  EXPECT_EQ(told[1], "");
  EXPECT_EQ(lost, 10u);
  ASSERT_EQ(disk.records.size(), 2u);
  EXPECT_EQ(disk.records[0].kind, Kind::kGap);
  EXPECT_EQ(disk.records[0].lost, 10u);
  EXPECT_EQ(disk.records[1].revision, 10u);
}

// A disk may take its time to make things durable: until then they are written all the same.
TEST(Journal, ADiskThatHangsInASyncDoesNotHoldBackWhatIsWritten) {
  Disk disk;
  disk.hangs = true;
  std::atomic<int> told{0};
  {
    Journal journal(
        std::make_unique<DiskSink>(disk), {SyncPolicy::kAlways, 100, 64}, [](const std::string&) {}, nullptr,
        [&](const JournalRecord&, bool) { ++told; });
    journal.record(pose(0));
    while (disk.syncs == 0) std::this_thread::yield();
    for (std::uint64_t i = 1; i <= 20; ++i) journal.record(pose(i));
    while (told < 21) std::this_thread::yield();
    EXPECT_EQ(disk.syncs, 1) << "it hangs";
    const std::scoped_lock lock(disk.mutex);
    EXPECT_EQ(disk.records.size(), 21u);
    disk.hangs = false;
  }
  EXPECT_GE(disk.syncs, 2);
}

// A pose is reported once it is written, never earlier; a lost pose is reported as lost.
TEST(Journal, TellsOfPosesOnceTheyAreWrittenOrLost) {
  Disk disk;
  disk.slow = true;
  std::atomic<std::uint64_t> told{0}, recorded{0};
  std::atomic<bool> early{false};
  {
    Journal journal(
        std::make_unique<DiskSink>(disk), {SyncPolicy::kNone, 100, 64}, [](const std::string&) {}, nullptr,
        [&](const JournalRecord& record, bool kept) {
          const std::scoped_lock lock(disk.mutex);
          recorded += kept;
          EXPECT_EQ(kept, !disk.full);
          early = early ||
                  (!disk.full && (disk.records.empty() || disk.records.back().revision < record.revision));
          EXPECT_EQ(record.revision, told++);
        });
    for (std::uint64_t i = 0; i < 30; ++i) journal.record(pose(i));
    EXPECT_EQ(told, 0u);
    disk.slow = false;
    while (told < 30) std::this_thread::yield();
    EXPECT_FALSE(early);
    disk.full = true;
    for (std::uint64_t i = 30; i < 40; ++i) journal.record(pose(i));
    while (told < 40) std::this_thread::yield();
    EXPECT_EQ(disk.records.size(), 30u);
    disk.full = false;
  }
  EXPECT_EQ(told, 40u);
  EXPECT_EQ(recorded, 30u);
}

// What was taken does not outlive a restart from the first loss on, also once there is room again: nothing leads across
// the gap but a checkpoint or a reset.
TEST(Journal, AfterAGapItIsInTroubleUntilTheMeshIsReset) {
  Disk disk;
  Journal journal(std::make_unique<DiskSink>(disk), {}, [](const std::string&) {});
  journal.record(pose(0));
  while (journal.waiting() > 0) std::this_thread::yield();
  EXPECT_EQ(journal.trouble(), "");
  disk.full = true;
  journal.record(pose(1));
  while (journal.trouble().empty()) std::this_thread::yield();
  EXPECT_EQ(journal.trouble(), "no space left on device");
  disk.full = false;
  while (journal.failing()) std::this_thread::yield();
  journal.record(pose(2));
  while (journal.waiting() > 0) std::this_thread::yield();
  EXPECT_NE(journal.trouble().find("no restart can cross the gap"), std::string::npos) << journal.trouble();
  JournalRecord reset;
  reset.kind = Kind::kReset;
  journal.record(reset);
  while (!journal.trouble().empty()) std::this_thread::yield();
}

// A session that is resumed on a full disk begins with records that are missing.
TEST(Journal, ItMayBeginWithAGap) {
  Disk disk;
  Journal::Options options;
  options.lost = 7;
  Journal journal(std::make_unique<DiskSink>(disk), options, [](const std::string&) {});
  EXPECT_TRUE(journal.failing());
  EXPECT_EQ(journal.lost(), 7u);
  EXPECT_NE(journal.trouble(), "");
  journal.record(pose(1));
  while (journal.failing()) std::this_thread::yield();
  EXPECT_NE(journal.trouble(), "");
  const std::scoped_lock lock(disk.mutex);
  ASSERT_EQ(disk.records.size(), 2u);
  EXPECT_EQ(disk.records[0].kind, Kind::kGap);
  EXPECT_EQ(disk.records[0].lost, 7u);
}

TEST(Journal, WhatItsQueueLostIsTroubleToo) {
  Disk disk;
  disk.slow = true;
  Journal journal(std::make_unique<DiskSink>(disk), {SyncPolicy::kNone, 100, 16}, [](const std::string&) {});
  while (journal.record(pose(0))) {
  }
  EXPECT_EQ(journal.trouble(), "") << "nobody knows yet";
  disk.slow = false;
  while (!journal.record(pose(1))) std::this_thread::yield();
  while (journal.trouble().empty()) std::this_thread::yield();
  EXPECT_FALSE(journal.failing());
}

}  // namespace
}  // namespace incise::loop
