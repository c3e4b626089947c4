#include "server/app/capture_journal.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <utility>

#include "server/app/capture_lock.hpp"
#include "server/app/config.hpp"
#include "server/loop/checkpoint_file.hpp"

namespace {

// A disk of 1000 blocks that the journal sees instead of the real one, and how often it has looked.
struct SimulatedDisk {
  fsblkcnt_t free_blocks;
  unsigned long block_bytes = 512;
  int looks = 0;
};
std::optional<SimulatedDisk> g_disk;

}  // namespace

// Takes the place of the C library's.
extern "C" int statvfs(const char* path, struct statvfs* out) noexcept {
  if (g_disk) {
    ++g_disk->looks;
    *out = {};
    out->f_blocks = 1000;
    out->f_bavail = g_disk->free_blocks;
    out->f_bfree = g_disk->free_blocks + 50;  // those of root's own, too
    out->f_frsize = g_disk->block_bytes;
    out->f_bsize = 4096;
    return 0;
  }
  const int fd = ::open(path, O_RDONLY | O_CLOEXEC);
  const int status = ::fstatvfs(fd, out);
  ::close(fd);
  return status;
}

namespace incise::app {
namespace {

namespace fs = std::filesystem;

class CaptureJournalTest : public ::testing::Test {
 protected:
  ~CaptureJournalTest() override {
    g_disk.reset();
    for (int number = 0; number < loop::kCheckpointFiles; ++number)
      fs::remove(loop::checkpoint_path(path_, number));
    fs::remove(path_);
  }
  static protocol::CaptureHeader header() { return {"", "", 1, 2, "test", "{}"}; }
  // Whether a pose can be written while that many blocks are free.
  static bool writes(CaptureJournal& journal, fsblkcnt_t free_blocks) {
    g_disk->free_blocks = free_blocks;
    journal.write({});
    try {
      journal.flush();
      return true;
    } catch (const std::runtime_error&) {
      return false;
    }
  }
  std::uint64_t poses() const {
    std::ifstream in(path_, std::ios::binary);
    protocol::CaptureReader reader(in);
    protocol::CaptureRecord record;
    std::uint64_t found = 0;
    while (reader.next(record) == protocol::CaptureReader::Status::Record)
      found += std::holds_alternative<protocol::PoseRecord>(record);
    return found;
  }
  const std::string path_ =
      (fs::temp_directory_path() / ("incise_journal_" + std::to_string(::getpid()))).string();
};

// No file system that we can write to is completely free, so requiring 100 % always fails.
TEST_F(CaptureJournalTest, WhatMustStayFreeIsNotWritten) {
  CaptureJournal journal(path_, header());
  journal.write({});
  journal.flush();
  journal.keep_free(1);
  journal.write({});
  try {
    journal.flush();
    ADD_FAILURE() << "it was written";
  } catch (const std::runtime_error& error) {
    EXPECT_EQ(std::string(error.what()),
              path_ + ": less than 100 % of its file system is free (capture.keep_free_percent)");
  }
  EXPECT_EQ(poses(), 1u);
  const auto bytes = journal.position().bytes;
  journal.keep_free(0);
  journal.write({});
  journal.flush();
  EXPECT_EQ(poses(), 2u) << "what was refused is not kept for later";
  EXPECT_GT(journal.position().bytes, bytes);
}

// The free space is checked only after enough was written, and each time while there is no room.
TEST_F(CaptureJournalTest, ItLooksAgainWhileItWrites) {
  CaptureJournal journal(path_, header());
  journal.keep_free(1e-9);
  journal.write({});
  journal.flush();
  journal.keep_free(1);
  const std::uint64_t before = journal.position().bytes;
  EXPECT_THROW(
      {
        for (int i = 0; i < 100'000; ++i) {
          journal.write({});
          journal.flush();
        }
      },
      std::runtime_error);
  EXPECT_LE(journal.position().bytes, before + (2u << 20));
}

TEST_F(CaptureJournalTest, OnlyOneWritesACapture) {
  const std::string file = path_ + ".lock";
  {
    const CaptureLock lock(path_);
    EXPECT_TRUE(lock.held());
    CaptureJournal journal(path_, header());
    journal.write({});
    journal.flush();
    try {
      const CaptureLock second(path_);
      ADD_FAILURE() << "two have it";
    } catch (const ConfigError& error) {
      EXPECT_EQ(std::string(error.what()), "capture.path: " + path_ +
                                               " is being written by another incised (process " +
                                               std::to_string(::getpid()) + "); give each its own");
    }
    EXPECT_EQ(poses(), 1u);
    // A start moves the old capture away, and a failover replaces it: the lock stays.
    fs::rename(path_, path_ + ".old");
    EXPECT_THROW(CaptureLock{path_}, ConfigError);
    fs::rename(path_ + ".old", path_);
    const CaptureLock leased(path_, CaptureLock::IfHeld::kGoOn);
    EXPECT_FALSE(leased.held());
  }
  EXPECT_FALSE(fs::exists(file));
  std::ofstream(file) << "4711\n";  // as after a crash
  EXPECT_TRUE(CaptureLock(path_).held());
  EXPECT_FALSE(fs::exists(file));
}

TEST_F(CaptureJournalTest, WhereNothingCanBeLockedItGoesOn) {
  const CaptureLock lock(path_ + "/none");
  EXPECT_FALSE(lock.held());
  EXPECT_NE(lock.trouble().find("/none.lock: cannot be locked: "), std::string::npos) << lock.trouble();
}

// The end mark tells how many records the whole capture has, in however many runs it was written.
TEST_F(CaptureJournalTest, AContinuedCaptureCountsOn) {
  loop::JournalSink::Position at;
  {
    CaptureJournal journal(path_, header());
    for (int i = 0; i < 3; ++i) journal.write({});
    journal.flush();
    at = journal.position();
  }
  EXPECT_EQ(at.records, 3u);
  CaptureJournal journal(path_, at.bytes, at.records);
  journal.write({});
  journal.close();
  EXPECT_EQ(poses(), 4u);
  std::ifstream in(path_, std::ios::binary);
  protocol::CaptureReader reader(in);
  protocol::CaptureRecord record;
  while (reader.next(record) == protocol::CaptureReader::Status::Record) {
  }
  ASSERT_TRUE(std::holds_alternative<protocol::EndRecord>(record));
  EXPECT_EQ(std::get<protocol::EndRecord>(record).records, 4u);
}

// Once the limit is reached it takes one percent more to go on.
TEST_F(CaptureJournalTest, AFreeSpaceThatIsJustEnoughDoesNotLetItGoOn) {
  g_disk = {.free_blocks = 1000};
  CaptureJournal journal(path_, header());
  journal.keep_free(0.1);
  EXPECT_FALSE(writes(journal, 99));
  EXPECT_FALSE(writes(journal, 101));
  EXPECT_FALSE(writes(journal, 109));
  EXPECT_TRUE(writes(journal, 111));
  EXPECT_EQ(poses(), 1u);
  EXPECT_EQ(g_disk->looks, 4);
  for (int i = 0; i < 100; ++i) EXPECT_TRUE(writes(journal, 99));
  EXPECT_EQ(g_disk->looks, 4) << "the next look is a megabyte later";
  CaptureJournal other(path_, header());
  other.keep_free(0.1);
  EXPECT_TRUE(writes(other, 101)) << "this one has not stopped";
}

// After a gap only a checkpoint helps: the disk must have room for two of the larger size, and for some records.
TEST_F(CaptureJournalTest, AfterAFailureItGoesOnOnlyWithRoomForTheCheckpoints) {
  g_disk = {.free_blocks = 0};
  CaptureJournal journal(path_, header());
  EXPECT_TRUE(writes(journal, 0)) << "nothing has to stay free";
  for (const auto& [number, bytes] : {std::pair{0, 30'000}, std::pair{1, 10'000}}) {
    std::ofstream(loop::checkpoint_path(path_, number)).close();
    fs::resize_file(loop::checkpoint_path(path_, number), static_cast<std::uintmax_t>(bytes));
  }
  rlimit limit{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &limit), 0);
  const auto before = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit full{journal.position().bytes, limit.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &full), 0);
  EXPECT_FALSE(writes(journal, 1000));
  ::setrlimit(RLIMIT_FSIZE, &limit);
  std::signal(SIGXFSZ, before);
  EXPECT_FALSE(writes(journal, 0));
  EXPECT_FALSE(writes(journal, ((64u << 10) + 60'000) / 512));
  EXPECT_EQ(poses(), 1u);
  EXPECT_TRUE(writes(journal, ((64u << 10) + 60'000) / 512 + 1));
  EXPECT_EQ(poses(), 2u);
}

}  // namespace
}  // namespace incise::app
