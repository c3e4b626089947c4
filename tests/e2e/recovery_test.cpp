// What a restart makes of full disks and damaged files.

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <fstream>
#include <functional>

#include "server/loop/checkpoint_file.hpp"
#include "tests/e2e/served_session.hpp"

namespace incise::e2e {
namespace {

namespace fs = std::filesystem;

bool wait_for(const std::function<bool()>& condition) {
  for (int i = 0; i < 6000; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return false;
}

struct Held {
  std::uint64_t revision = 0, hash = 0;
  friend bool operator==(const Held&, const Held&) = default;
};

Held held(const client::Client& viewer) {
  return viewer.read([](const protocol::Replica& m) { return Held{m.revision(), m.compute_state_hash()}; });
}

Held what_the_server_has(const ServedSession& session) {
  const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  EXPECT_TRUE(viewer->wait_for_revision(0, 60));
  return held(*viewer);
}

// The last mark and the gaps of a capture.
std::pair<std::uint64_t, int> last_mark_and_gaps(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  protocol::CaptureReader reader(in);
  protocol::CaptureRecord record;
  std::pair<std::uint64_t, int> found{0, 0};
  while (reader.next(record) == protocol::CaptureReader::Status::Record) {
    if (const auto* mark = std::get_if<protocol::BatchMark>(&record)) found.first = mark->revision;
    found.second += std::holds_alternative<protocol::GapRecord>(record);
  }
  return found;
}

// Ends the motion, and waits until what it made is with the viewer and in the capture.
Held settle(const ServedSession& session, PoseDriver& driver, const client::Client& viewer) {
  EXPECT_TRUE(driver.settle());
  // The loop tells of a frame at its end: the second one from here on is after the last pose.
  const double frames = session.stat("/frames/count").value_or(0);
  EXPECT_TRUE(wait_for([&] { return session.stat("/frames/count").value_or(0) >= frames + 2; }));
  EXPECT_TRUE(wait_for([&] {
    return session.stat("/sources") == 0.0 && session.stat("/backlog/batches") == 0.0 &&
           viewer.revision() == session.stat("/revision") &&
           last_mark_and_gaps(session.capture()).first == viewer.revision();
  }));
  return held(viewer);
}

void set_file_limit(Process& process, rlim_t bytes) {
  rlimit limit{};
  ASSERT_EQ(prlimit(process.pid(), RLIMIT_FSIZE, nullptr, &limit), 0);
  limit.rlim_cur = std::min(bytes, limit.rlim_max);
  ASSERT_EQ(prlimit(process.pid(), RLIMIT_FSIZE, &limit, nullptr), 0);
}

void damage(const std::string& path) {
  std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
  file.seekg(1000);
  const auto byte = static_cast<char>(file.get() ^ 4);
  file.seekp(1000);
  file.put(byte);
  ASSERT_TRUE(file) << path;
}

// The limit on a file's size stands for a full disk: the same error at the same place. Cutting goes on, the gap is
// marked, and the checkpoint that follows it is where a restart begins.
TEST(Recovery, BehindAGapASessionGoesOnFromTheNextCheckpoint) {
  ServedSession session("gap", 4000, R"(, "checkpoint_replay_s": 1000)");
  ASSERT_TRUE(session.start(false)) << session.log();
  auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  Held before;
  {
    PoseDriver driver(session, 500, 0.2);
    ASSERT_TRUE(viewer->wait_for_revision(3, 60));
    set_file_limit(session.server(), fs::file_size(session.capture()) + 50);
    EXPECT_TRUE(wait_for([&] { return session.stat("/journal/failing") == 1.0; }));
    ASSERT_TRUE(viewer->wait_for_revision(viewer->revision() + 3, 60))
        << "cutting does not wait for the disk";
    set_file_limit(session.server(), RLIM_INFINITY);
    EXPECT_TRUE(wait_for([&] { return session.stat("/journal/failing") == 0.0; }));
    EXPECT_TRUE(wait_for([&] { return session.stat("/checkpoints/written").value_or(0) >= 1; }))
        << "the journal asks for a checkpoint after a gap";
    ASSERT_TRUE(viewer->wait_for_revision(viewer->revision() + 2, 60));
    EXPECT_GT(session.stat("/journal/lost").value_or(0), 0);
    before = settle(session, driver, *viewer);
  }
  EXPECT_EQ(last_mark_and_gaps(session.capture()).second, 1);
  session.kill();
  ASSERT_TRUE(session.start(true)) << session.log();
  EXPECT_EQ(what_the_server_has(session), before) << session.log();
  EXPECT_NE(session.log().find("from the checkpoint"), std::string::npos) << session.log();
  EXPECT_NE(session.log().find("the capture cannot be written"), std::string::npos);
  EXPECT_NE(session.log().find("the gap is marked in it"), std::string::npos);
  {  // and it goes on
    PoseDriver driver(session, 500, 0.2);
    viewer = client::Client::connect("127.0.0.1", session.tcp_port());
    ASSERT_TRUE(viewer->wait_for_revision(before.revision + 2, 60));
  }
  session.kill();

  // Without that checkpoint there is no way on, and it says what can be done.
  for (int number = 0; number < loop::kCheckpointFiles; ++number)
    fs::remove(loop::checkpoint_path(session.capture(), number));
  EXPECT_FALSE(session.start(true));
  EXPECT_EQ(session.server().wait(), 1);
  EXPECT_NE(session.log().find("records are missing after record"), std::string::npos) << session.log();
  const std::string mesh = session.file("before.vtu");
  EXPECT_NE(session.log().find("incise export " + session.capture()), std::string::npos) << session.log();
  Process exporting({"incise", "export", session.capture(), "--out", mesh});
  EXPECT_EQ(exporting.wait(), 0);
  EXPECT_TRUE(fs::exists(mesh));
  Process replay({"incise", "replay", session.capture(), "--verify"});
  EXPECT_EQ(replay.wait(), 1) << "a capture with a gap is not verified";
}

// Where a start has had to replay more than checkpoints allow, it writes one itself: a server that is killed again and again
// before its checkpoints come around would else have more to replay each time.
TEST(Recovery, AStartThatHadToReplayMuchWritesACheckpoint) {
  ServedSession session("replayed", 4000, R"(, "checkpoint_replay_s": 0)");
  ASSERT_TRUE(session.start(false)) << session.log();
  Held before;
  {
    const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
    PoseDriver driver(session, 500, 0.2);
    ASSERT_TRUE(viewer->wait_for_revision(8, 60));
    before = settle(session, driver, *viewer);
  }
  session.kill();
  EXPECT_FALSE(fs::exists(loop::checkpoint_path(session.capture(), 0))) << "0: none";
  session.set_capture(R"(, "checkpoint_replay_s": 0.000001)");
  for (const char* from : {"from the beginning", "from the checkpoint at revision "}) {
    const std::size_t logged = session.log().size();
    ASSERT_TRUE(session.start(true)) << session.log();
    session.kill();
    EXPECT_NE(session.log().find(from, logged), std::string::npos) << session.log();
  }
  ASSERT_TRUE(session.start(true)) << session.log();
  EXPECT_EQ(what_the_server_has(session), before);
}

TEST(Recovery, DamagedCheckpointsFallBackToTheOneBeforeAndToTheBeginning) {
  ServedSession session("damage", 4000, R"(, "checkpoint_replay_s": 0.0001)");
  ASSERT_TRUE(session.start(false)) << session.log();
  Held before;
  {
    const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
    PoseDriver driver(session, 500, 0.2);
    ASSERT_TRUE(wait_for([&] { return session.stat("/checkpoints/written").value_or(0) >= 2; }))
        << session.log();
    before = settle(session, driver, *viewer);
  }
  session.kill();
  // Nor does a start write one, where what it has replayed is less than this.
  session.set_capture(R"(, "checkpoint_replay_s": 1000)");
  std::string error;
  const auto first = loop::read_checkpoint(loop::checkpoint_path(session.capture(), 0), error);
  const auto second = loop::read_checkpoint(loop::checkpoint_path(session.capture(), 1), error);
  ASSERT_TRUE(first && second) << error;
  const int newest = first->offset > second->offset ? 0 : 1;
  const auto resumed_from = [](std::uint64_t revision) {
    return "from the checkpoint at revision " + std::to_string(revision) + ",";
  };
  // Nothing has to be recorded between these starts, so no new checkpoint is written.
  const std::string damaged[] = {"", loop::checkpoint_path(session.capture(), newest),
                                 loop::checkpoint_path(session.capture(), 1 - newest)};
  const std::string expected[] = {resumed_from((newest == 0 ? first : second)->revision),
                                  resumed_from((newest == 0 ? second : first)->revision),
                                  "from the beginning"};
  for (int i = 0; i < 3; ++i) {
    if (!damaged[i].empty()) damage(damaged[i]);
    const std::size_t logged = session.log().size();
    ASSERT_TRUE(session.start(true)) << session.log();
    EXPECT_EQ(what_the_server_has(session), before) << session.log();
    const std::string log = session.log().substr(logged);
    EXPECT_NE(log.find(expected[i]), std::string::npos) << expected[i] << "\n" << log;
    EXPECT_EQ(log.find("checksum is wrong") != std::string::npos, i > 0) << log;
    session.kill();
  }
  // A new session keeps the old capture, and its checkpoints with it.
  ASSERT_TRUE(session.start(false)) << session.log();
  EXPECT_EQ(what_the_server_has(session).revision, 0u);
  EXPECT_TRUE(fs::exists(session.capture() + ".old"));
  EXPECT_TRUE(fs::exists(session.capture() + ".old.checkpoint-0"));
  EXPECT_FALSE(fs::exists(session.capture() + ".checkpoint-0"));
}

}  // namespace
}  // namespace incise::e2e
