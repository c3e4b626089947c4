// How a restart copes with full disks and damaged files.

#include <gtest/gtest.h>
#include <sys/mount.h>
#include <sys/resource.h>

#include <csignal>
#include <ctime>
#include <fstream>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "server/loop/checkpoint_file.hpp"
#include "tests/e2e/recovery.hpp"

namespace incise::e2e {
namespace {

namespace fs = std::filesystem;

// Ends the motion, and waits until what it made is with the viewer and in the capture.
Held settle(const ServedSession& session, PoseDriver& driver, const client::Client& viewer) {
  EXPECT_TRUE(driver.settle());
  // The loop publishes a frame at its end: the second one from here on is after the last pose.
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

// The disk that a session's capture is on, which can be full: a small file system of its own where that can be mounted,
// else a limit on the length of the server's files, which fails at the same place with another code.
class SmallDisk {
 public:
  // Before the first start.
  explicit SmallDisk(ServedSession& session)
      : session_(session),
        mounted_(::mount("tmpfs", session.file("disk").c_str(), "tmpfs", 0, "size=32m") == 0) {}
  ~SmallDisk() {
    if (mounted_) ::umount2(session_.file("disk").c_str(), MNT_DETACH);
  }
  SmallDisk(const SmallDisk&) = delete;
  SmallDisk& operator=(const SmallDisk&) = delete;
  void fill() {
    if (!mounted_) {
      set_file_limit(session_.server(), fs::file_size(session_.capture()) + 50);
      return;
    }
    std::ofstream out(ballast(), std::ios::binary);
    const std::string block(4096, 'x');
    while (out.write(block.data(), static_cast<std::streamsize>(block.size())).flush()) {
    }
  }
  // Not for one server alone.
  bool real() const { return mounted_; }
  void make_room() {
    if (mounted_) {
      fs::remove(ballast());
    } else {
      set_file_limit(session_.server(), RLIM_INFINITY);
    }
  }

 private:
  std::string ballast() const { return session_.file("disk/ballast"); }
  ServedSession& session_;
  const bool mounted_;
};

// How many poses a capture has up to its last whole record, and whether one of them has that source time.
std::pair<std::uint64_t, bool> poses_of(const std::string& path, std::int64_t source_ns) {
  std::ifstream in(path, std::ios::binary);
  protocol::CaptureReader reader(in);
  protocol::CaptureRecord record;
  std::pair<std::uint64_t, bool> found{0, false};
  while (reader.next(record) == protocol::CaptureReader::Status::Record) {
    const auto* pose = std::get_if<protocol::PoseRecord>(&record);
    if (!pose) continue;
    ++found.first;
    found.second = found.second || pose->pose.source_ns == source_ns;
  }
  return found;
}

// Where the server says that it went on from, in what it has logged since.
std::string resumed_from(const ServedSession& session, std::size_t logged) {
  const std::string log = session.log().substr(logged);
  const auto at = log.find(" s: from ");
  return at == std::string::npos ? log : log.substr(at + 4, log.find('\n', at) - at - 4);
}

void damage(const std::string& path) {
  std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
  file.seekg(1000);
  const auto byte = static_cast<char>(file.get() ^ 4);
  file.seekp(1000);
  file.put(byte);
  ASSERT_TRUE(file) << path;
}

// Cutting goes on, the gap is marked, and the checkpoint that follows it is where a restart begins: only then is it said
// that recording goes on.
TEST(Recovery, BehindAGapASessionGoesOnFromTheNextCheckpoint) {
  ServedSession session("gap", 4000, R"(, "checkpoint_replay_s": 1000)");
  SmallDisk disk(session);
  ASSERT_TRUE(session.start(false)) << session.log();
  auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  Held before;
  {
    PoseDriver driver(session, 500, 0.2);
    ASSERT_TRUE(viewer->wait_for_revision(3, 60));
    EXPECT_TRUE(wait_for([&] { return driver.recording() == protocol::Recording::On; }));
    disk.fill();
    EXPECT_TRUE(wait_for([&] { return session.stat("/journal/failing") == 1.0; }));
    EXPECT_TRUE(wait_for([&] { return driver.recording() == protocol::Recording::Stopped; }));
    ASSERT_TRUE(viewer->wait_for_revision(viewer->revision() + 3, 60))
        << "cutting does not wait for the disk";
    disk.make_room();
    EXPECT_TRUE(wait_for([&] { return driver.recording() == protocol::Recording::On; }));
    EXPECT_EQ(session.stat("/journal/failing"), 0.0);
    EXPECT_GE(session.stat("/checkpoints/written").value_or(0), 1)
        << "the journal asks for a checkpoint after a gap";
    EXPECT_EQ(driver.warnings(), 1);
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

// What a report counts as recorded is in the capture, whatever happens next; what it counts as accepted alone may be gone. And
// operators hear of it, also those who come later.
TEST(Recovery, OnAFullDiskAPoseThatIsReportedAsRecordedIsInTheCapture) {
  ServedSession session("full", 4000, "");
  SmallDisk disk(session);
  ASSERT_TRUE(session.start(false)) << session.log();
  PoseDriver driver(session, 500, 0.2);
  EXPECT_TRUE(wait_for([&] { return driver.recorded() > 200; }));
  EXPECT_EQ(driver.recording(), protocol::Recording::On);
  disk.fill();
  EXPECT_TRUE(wait_for([&] { return driver.recording() == protocol::Recording::Stopped; }));
  const std::uint64_t accepted = driver.accepted();
  EXPECT_TRUE(wait_for([&] { return driver.accepted() > accepted + 1000; })) << "taken all the same";
  EXPECT_EQ(driver.warnings(), 1);
  client::Options options;
  options.role = protocol::Role::Operator;
  options.source_name = "second";
  std::atomic<bool> warned{false};
  client::Callbacks callbacks;
  callbacks.on_error = [&](const protocol::Error& error) {
    warned = error.code == protocol::ErrorCode::NotRecorded;
  };
  const auto second = client::Client::connect("127.0.0.1", session.tcp_port(), options, callbacks);
  EXPECT_EQ(second->welcome().recording, protocol::Recording::Stopped);
  EXPECT_TRUE(wait_for([&] { return warned.load(); }));
  session.kill();
  const auto [poses, last] = poses_of(session.capture(), driver.recorded_ns());
  EXPECT_GE(poses, driver.recorded());
  EXPECT_TRUE(last);
  EXPECT_LT(poses, driver.accepted()) << "and the others are not: the disk was full";

  // It goes on all the same, from what the capture has; and is whole again when there is room.
  if (!disk.real()) return;
  const std::size_t logged = session.log().size();
  ASSERT_TRUE(session.start(true)) << session.log();
  const std::uint64_t from = what_the_server_has(session).revision;
  EXPECT_GT(from, 0u);
  EXPECT_EQ(resumed_from(session, logged).find("from "), 0u);
  EXPECT_TRUE(wait_for([&] { return session.stat("/journal/failing") == 1.0; }));
  disk.make_room();
  EXPECT_TRUE(
      wait_for([&] { return session.stat("/revision").value_or(0) > static_cast<double>(from) + 3; }));
  EXPECT_TRUE(wait_for([&] { return driver.recording() == protocol::Recording::On; }));
  const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
  const Held before = settle(session, driver, *viewer);
  session.kill();
  ASSERT_TRUE(session.start(true)) << session.log();
  EXPECT_EQ(what_the_server_has(session), before) << session.log();
}

// Whoever ends it, a person or a service manager, hears that the capture lacks something.
TEST(Recovery, AServerThatCouldNotRecordAllSaysSoAtItsEnd) {
  ServedSession session("incomplete", 4000, "");
  SmallDisk disk(session);
  ASSERT_TRUE(session.start(false)) << session.log();
  {
    PoseDriver driver(session, 500, 0.2);
    EXPECT_TRUE(wait_for([&] { return driver.recorded() > 200; }));
    disk.fill();
    EXPECT_TRUE(wait_for([&] { return driver.recording() == protocol::Recording::Stopped; }));
    const std::uint64_t accepted = driver.accepted();
    EXPECT_TRUE(wait_for([&] { return driver.accepted() > accepted + 100; }));
  }
  session.server().signal(SIGTERM);
  EXPECT_EQ(session.server().wait(), 1);
  EXPECT_NE(session.log().find("incised: " + session.capture() + ": is incomplete: "), std::string::npos)
      << session.log();
}

// Even after a short run, what a resume would have to compute is saved when the server ends, and when it
// has nothing else to do.
TEST(Recovery, ACleanEndLeavesNothingToReplay) {
  ServedSession session("end", 4000, R"(, "checkpoint_replay_s": 3000)");
  ASSERT_TRUE(session.start(false)) << session.log();
  Held before;
  {
    const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
    PoseDriver driver(session, 500, 0.2);
    ASSERT_TRUE(viewer->wait_for_revision(4, 60));
    before = settle(session, driver, *viewer);
  }
  session.server().signal(SIGTERM);
  EXPECT_EQ(session.server().wait(), 0);
  for (int round = 0; round < 2; ++round) {
    const std::size_t logged = session.log().size();
    ASSERT_TRUE(session.start(true)) << session.log();
    EXPECT_EQ(resumed_from(session, logged),
              "from the checkpoint at revision " + std::to_string(before.revision) + ", 0 poses replayed");
    EXPECT_EQ(what_the_server_has(session), before);
    // Killed, with nothing done since.
    session.kill();
  }
}

// Of a run that was killed before its first checkpoint.
TEST(Recovery, AnIdleServerPaysTheDebtOfTheRunsBefore) {
  ServedSession session("idle", 4000, R"(, "checkpoint_replay_s": 0)");
  Held before;
  for (const bool resume : {false, true}) {
    ASSERT_TRUE(session.start(resume)) << session.log();
    const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
    PoseDriver driver(session, 500, 0.2);
    ASSERT_TRUE(viewer->wait_for_revision(before.revision + 8, 60));
    before = settle(session, driver, *viewer);
    session.kill();
  }
  // Less than a resume would write one for, more than is left undone at rest.
  std::clock_t spent = std::clock();
  EXPECT_EQ(CaptureFollower(session).follow(), "");
  spent = std::clock() - spent;
  session.set_capture(", \"checkpoint_replay_s\": " +
                      std::to_string(1.5 * static_cast<double>(spent) / CLOCKS_PER_SEC));
  std::size_t logged = session.log().size();
  ASSERT_TRUE(session.start(true)) << session.log();
  EXPECT_EQ(resumed_from(session, logged).find("from the beginning"), 0u) << session.log();
  EXPECT_TRUE(wait_for([&] { return fs::exists(loop::checkpoint_path(session.capture(), 0)); }));
  session.kill();
  logged = session.log().size();
  ASSERT_TRUE(session.start(true)) << session.log();
  EXPECT_EQ(resumed_from(session, logged),
            "from the checkpoint at revision " + std::to_string(before.revision) + ", 0 poses replayed");
  EXPECT_EQ(what_the_server_has(session), before);
}

// At any moment of the end.
TEST(Recovery, AKillWhileItEndsLosesNothing) {
  ServedSession session("killed_end", 4000, R"(, "checkpoint_replay_s": 1000)");
  Held before;
  for (const int wait_ms : {0, 10, 30, 60, 120}) {
    ASSERT_TRUE(session.start(wait_ms > 0)) << session.log();
    EXPECT_EQ(what_the_server_has(session), before.revision > 0 ? before : what_the_server_has(session));
    {
      const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
      PoseDriver driver(session, 500, 0.2);
      ASSERT_TRUE(viewer->wait_for_revision(before.revision + 2, 60));
      before = settle(session, driver, *viewer);
    }
    session.server().signal(SIGTERM);
    std::this_thread::sleep_for(std::chrono::milliseconds(wait_ms));
    session.kill();
  }
  ASSERT_TRUE(session.start(true)) << session.log();
  EXPECT_EQ(what_the_server_has(session), before) << session.log();
}

// A resume begins with the mesh as loaded where it was reset, and says so; what came before is no debt.
TEST(Recovery, AResetIsWhereAResumeBegins) {
  ServedSession session("reset", 4000, R"(, "checkpoint_replay_s": 0)");
  ASSERT_TRUE(session.start(false)) << session.log();
  Held before;
  {
    auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
    {
      PoseDriver driver(session, 500, 0.2);
      ASSERT_TRUE(viewer->wait_for_revision(8, 60));
      settle(session, driver, *viewer);
    }
    client::Options options;
    options.role = protocol::Role::Admin;
    const auto admin = client::Client::connect("127.0.0.1", session.tcp_port(), options);
    EXPECT_TRUE(admin->reset());
    EXPECT_TRUE(wait_for([&] { return session.stat("/revision") == 0.0; }));
    viewer = client::Client::connect("127.0.0.1", session.tcp_port());
    PoseDriver driver(session, 500, 0.2);
    ASSERT_TRUE(viewer->wait_for_revision(2, 60));
    before = settle(session, driver, *viewer);
  }
  session.kill();
  const std::size_t logged = session.log().size();
  ASSERT_TRUE(session.start(true)) << session.log();
  EXPECT_EQ(resumed_from(session, logged).find("from the last reset, "), 0u) << session.log();
  EXPECT_EQ(what_the_server_has(session), before);
}

// A server that its manager starts again and again must not put captures without a pose in the place of the last good one.
TEST(Recovery, ACaptureWithoutAPoseTakesNobodysPlace) {
  ServedSession session("empty", 4000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  {
    const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
    PoseDriver driver(session, 500, 0.2);
    ASSERT_TRUE(viewer->wait_for_revision(3, 60));
    settle(session, driver, *viewer);
  }
  session.kill();
  const auto length = fs::file_size(session.capture());
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(session.start(false)) << session.log();
    session.kill();
    EXPECT_EQ(fs::file_size(session.capture() + ".old"), length) << i;
  }
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

// It would go on, and what it records then could be read by no offline tool.
TEST(Recovery, ACaptureThatIsDamagedBeforeItsCheckpointIsRefused) {
  ServedSession session("early", 4000, R"(, "checkpoint_replay_s": 0.0001)");
  ASSERT_TRUE(session.start(false)) << session.log();
  {
    const auto viewer = client::Client::connect("127.0.0.1", session.tcp_port());
    PoseDriver driver(session, 500, 0.2);
    ASSERT_TRUE(wait_for([&] { return session.stat("/checkpoints/written").value_or(0) >= 2; }))
        << session.log();
    settle(session, driver, *viewer);
  }
  session.kill();
  std::string error;
  const auto checkpoint = loop::read_checkpoint(loop::checkpoint_path(session.capture(), 0), error);
  ASSERT_TRUE(checkpoint) << error;
  std::ifstream in(session.capture(), std::ios::binary);
  const protocol::CaptureReader reader(in);
  const auto place = static_cast<std::streamoff>(reader.good_bytes()) + 12;  // in the first record
  ASSERT_GT(static_cast<std::streamoff>(checkpoint->offset), place);
  const auto flip = [&] {
    std::fstream file(session.capture(), std::ios::binary | std::ios::in | std::ios::out);
    file.seekg(place);
    const char byte = static_cast<char>(file.get() ^ 1);
    file.seekp(place);
    file.put(byte);
  };
  flip();
  const auto length = fs::file_size(session.capture());
  EXPECT_FALSE(session.start(true)) << session.log();
  EXPECT_EQ(session.server().wait(), 1);
  const std::string said = session.capture() + ": offset " + std::to_string(reader.good_bytes()) +
                           ": a record's checksum is wrong";
  EXPECT_NE(session.log().find(said), std::string::npos) << session.log();
  EXPECT_NE(session.log().find("--until-damage"), std::string::npos) << session.log();
  EXPECT_EQ(fs::file_size(session.capture()), length);
  flip();
  fs::resize_file(session.capture(), length - 5);  // a crash may leave that, and it is no damage
  ASSERT_TRUE(session.start(true)) << session.log();
  EXPECT_NE(session.log().find("from the checkpoint"), std::string::npos) << session.log();
}

}  // namespace
}  // namespace incise::e2e
