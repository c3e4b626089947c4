#include "server/app/offline/terminal.hpp"

#include <gtest/gtest.h>

#include "tests/support/run_program.hpp"

namespace incise::app {
namespace {

using namespace std::chrono_literals;

// What is shown for a step that does not report progress, and that all of it is erased at the end.
TEST(Terminal, ProgressIsDrawnWhileASilentStepRunsAndGoesAway) {
  const auto directory = tests::fresh_directory("Progress");
  const auto file = directory / "terminal";
  const auto drawn = [&](const std::string& text) {
    for (int i = 0; i < 60'000 / 5; ++i) {
      if (tests::read_file(file).find(text) != std::string::npos) return true;
      std::this_thread::sleep_for(5ms);
    }
    return false;
  };
  std::FILE* out = std::fopen(file.c_str(), "wb");
  ASSERT_NE(out, nullptr);
  {
    Progress progress("loading", out, true, 0ms);
    EXPECT_TRUE(drawn("\r\033[Kloading ("));
    progress.show(0.5, "liver");
    EXPECT_TRUE(drawn("loading [###############               ] 50 % liver ("));
    progress.stage("cutting");
    EXPECT_TRUE(drawn("\r\033[Kcutting ("));
  }
  EXPECT_TRUE(tests::read_file(file).ends_with("\r\033[K"));
  std::fclose(out);

  out = std::fopen(file.c_str(), "wb");
  ASSERT_NE(out, nullptr);
  { Progress quick("quick", out, true, 1h); }
  { Progress piped("piped", out, false, 0ms); }
  std::fclose(out);
  EXPECT_EQ(tests::read_file(file), "");
  std::filesystem::remove_all(directory);
}

}  // namespace
}  // namespace incise::app
