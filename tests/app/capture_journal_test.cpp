#include "server/app/capture_journal.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <stdexcept>

namespace incise::app {
namespace {

namespace fs = std::filesystem;

class CaptureJournalTest : public ::testing::Test {
 protected:
  ~CaptureJournalTest() override { fs::remove(path_); }
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
  CaptureJournal journal(path_, {"", "", 1, 2, "test", "{}"});
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
  CaptureJournal journal(path_, {"", "", 1, 2, "test", "{}"});
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

}  // namespace
}  // namespace incise::app
