#include "server/app/offline/source_names.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <string>
#include <vector>

#include "protocol/capture.hpp"

namespace incise::app {
namespace {

namespace fs = std::filesystem;
using Records = std::vector<protocol::CaptureRecord>;
using Names = std::vector<std::string>;

class SourceNamesTest : public ::testing::Test {
 protected:
  ~SourceNamesTest() override { fs::remove(path_); }
  // Someone takes the blade, and sends a pose if told so.
  void come(const std::string& name, bool pose = true, std::uint32_t source = 0) {
    records_.emplace_back(protocol::BladeRecord{source, 0, {}});
    records_.emplace_back(
        protocol::NoteRecord{R"({"source": )" + std::to_string(source) + R"(, "name": ")" + name + "\"}"});
    if (!pose) return;
    protocol::PoseRecord record;
    record.source = source;
    record.pose.source_ns = ++clock_ns_;
    records_.emplace_back(record);
  }
  SourceNames names(const std::string& config = "{}") {
    protocol::FileSink sink(path_, true);
    protocol::CaptureHeader header;
    header.config_json = config;
    protocol::CaptureWriter writer(sink, header);
    for (const protocol::CaptureRecord& record : records_) writer.append(record);
    EXPECT_FALSE(writer.flush());
    const auto names = source_names(read_recorded_motion(path_));
    const auto first = names.find(0);
    return first == names.end() ? SourceNames{} : first->second;
  }
  Records records_;
  std::int64_t clock_ns_ = 0;
  const std::string path_ =
      (fs::temp_directory_path() / ("incise_names_" + std::to_string(::getpid()) + ".capture")).string();
};

TEST_F(SourceNamesTest, AreThoseWhosePosesAreThereAndTheRestIsCounted) {
  come("nobody", false);
  for (int i = 0; i < 11; ++i) come("hand " + std::to_string(i));
  come("hand 0");
  const SourceNames all = names();
  EXPECT_EQ(all.names,
            (Names{"hand 0", "hand 1", "hand 2", "hand 3", "hand 4", "hand 5", "hand 6", "hand 7"}));
  EXPECT_EQ(all.others, 3u);
}

TEST_F(SourceNamesTest, AResetAndAnUndoTakeTheirsAlong) {
  for (int i = 0; i < 9; ++i) come("before the reset " + std::to_string(i));
  records_.emplace_back(protocol::ResetRecord{6, 0});
  come("before the reset 8", false);  // as the server names those who are there, or were last
  come("left");
  come("undone");
  const std::int64_t undone_ns = clock_ns_;
  for (int i = 0; i < 9; ++i) come("undone, too");
  records_.emplace_back(protocol::UndoRecord{7, 0, 0, undone_ns, 0, 0});
  come("undone, too", false);
  come("last");
  EXPECT_EQ(names().names, (Names{"left", "last"}));
}

TEST_F(SourceNamesTest, AreThoseOfTheConfigurationWhereNothingElseIsKnown) {
  const std::string config = R"({"sources": [{"name": "stylus"}]})";
  EXPECT_EQ(names(config).names, Names{"stylus"});
  come("left");
  EXPECT_EQ(names(config).names, Names{"left"});
}

}  // namespace
}  // namespace incise::app
