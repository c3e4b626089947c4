// Captures played in scratch sessions, behind a real server whose live mesh goes on.

#include "server/app/capture_library.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <variant>

#include "protocol/capture.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/viewer.hpp"
#include "tests/support/bodies.hpp"
#include "tests/support/run_program.hpp"

namespace incise::app {
namespace {

namespace fs = std::filesystem;
using protocol::ErrorCode;
using protocol::ReplayAction;
using protocol::Role;
using protocol::View;
using stream::Viewer;

class CaptureLibraryTest : public ::testing::Test {
 protected:
  void SetUp() override {
    dir_ = tests::fresh_directory(::testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::create_directories(dir_ / "captures");
    mesh_io::write_mesh(dir_ / "cube.node", tests::cube(4));
    std::ofstream motion(dir_ / "sweep.csv");
    motion.precision(17);
    motion << "t_s,x_m,y_m,z_m,qw,qx,qy,qz,button\n";
    for (const core::Pose& p : tests::sweep_through(200)) {
      motion << static_cast<double>(p.t_ns) * 1e-9 << ',' << p.position.x << ',' << p.position.y << ','
             << p.position.z << ',' << p.orientation.w << ',' << p.orientation.x << ',' << p.orientation.y
             << ',' << p.orientation.z << ",1\n";
    }
    motion.close();
    std::ofstream(dir_ / "c.json") << R"({"blade": {"heel": [0,0,0], "tip": [0,0,-0.14]}})";
    const tests::RunResult made =
        tests::run_program("incise",
                           {"convert", "sweep.csv", "--mesh", (dir_ / "cube").string(), "--config", "c.json",
                            "--out", "captures/sweep.capture", "--json"},
                           dir_);
    ASSERT_EQ(made.exit_code, 0) << made.err;
    const auto facts = nlohmann::json::parse(made.out);
    last_ = facts["batches"];
    hash_ = std::stoull(facts["state_hash"].get<std::string>(), nullptr, 16);
    ASSERT_GT(last_, 4u);
    library_ = std::make_unique<CaptureLibrary>(dir_ / "captures", live_);
    stream::Providers providers;
    providers.library = library_.get();
    server_ = std::make_unique<stream::TestServer>(4, stream::test_config(), std::move(providers));
  }
  void TearDown() override {
    if (library_) library_->stop();
    server_.reset();
    if (!HasFailure()) fs::remove_all(dir_);
  }

  std::uint16_t port() const { return server_->server.tcp_port(); }
  static void ask(Viewer& viewer, ReplayAction action, std::uint64_t revision = 0, float speed = 1,
                  const std::string& capture = "") {
    if (action == ReplayAction::Open || action == ReplayAction::Close)
      viewer.whole = false;  // another state comes
    viewer.peer.send(protocol::ReplayControl{action, capture, speed, revision});
  }
  // Follows until the player says that it is at `revision`, and the replica is there, too: for a minute, since a server may
  // send other messages for ever.
  static protocol::ReplayState follow(Viewer& viewer, std::uint64_t revision, bool playing = false) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(1);
    for (protocol::ReplayState state;;) {
      if (!state.capture.empty() && state.revision == revision && state.playing == playing && viewer.whole &&
          viewer.replica.revision() == revision) {
        return state;
      }
      auto received = viewer.peer.receive();
      if (!received || !viewer.take(received->message.body) || std::chrono::steady_clock::now() > end) {
        ADD_FAILURE() << "the stream ended before revision " << revision;
        return {};
      }
      if (const auto* part = std::get_if<protocol::ReplayState>(&received->message.body)) state = *part;
      EXPECT_FALSE(std::holds_alternative<protocol::Error>(received->message.body));
    }
  }
  static ErrorCode answer(Viewer& viewer) {
    const auto error = viewer.peer.receive_until<protocol::Error>();
    return error ? std::get<protocol::Error>(error->message.body).code : ErrorCode::Unknown;
  }

  fs::path dir_;
  std::uint64_t last_ = 0, hash_ = 0;  // of the capture
  Body live_;                          // another mesh than the capture's: that one is loaded from its file
  std::unique_ptr<CaptureLibrary> library_;
  std::unique_ptr<stream::TestServer> server_;
};

TEST_F(CaptureLibraryTest, ScrubbedForthAndBackEachRevisionIsTheSame) {
  Viewer viewer(port());
  ASSERT_TRUE(viewer.follow(0));
  const std::uint64_t live_hash = viewer.replica.state_hash();
  ask(viewer, ReplayAction::Open, 0, 1, "sweep.capture");
  const protocol::ReplayState opened = follow(viewer, 0);
  EXPECT_EQ(opened.capture, "sweep.capture");
  EXPECT_EQ(opened.last_revision, last_);
  // What there is, revision by revision, before anything is played; said once.
  ASSERT_EQ(opened.revision_ms.size(), last_);
  EXPECT_TRUE(std::is_sorted(opened.revision_ms.begin(), opened.revision_ms.end()));
  EXPECT_GT(opened.revision_ms.back(), opened.revision_ms.front());
  EXPECT_EQ(opened.revision_sources, std::vector<std::uint32_t>(last_, 0));
  EXPECT_EQ(opened.revision_strokes.front(), 1U);
  EXPECT_NE(viewer.replica.state_hash(), live_hash);

  std::map<std::uint64_t, std::uint64_t> hashes{{0, viewer.replica.compute_state_hash()}};
  for (std::uint64_t revision = 1; revision <= last_; ++revision) {
    ask(viewer, ReplayAction::Step);
    EXPECT_TRUE(follow(viewer, revision).revision_ms.empty());
    hashes[revision] = viewer.replica.compute_state_hash();
  }
  EXPECT_EQ(hashes[last_], hash_) << "of the conversion";
  for (const std::uint64_t revision : {last_ / 2, std::uint64_t{1}, last_, std::uint64_t{0}, last_ - 1}) {
    ask(viewer, ReplayAction::Seek, revision);
    follow(viewer, revision);
    EXPECT_EQ(viewer.replica.compute_state_hash(), hashes[revision]) << revision;
  }
  // Beyond the end is the end.
  ask(viewer, ReplayAction::Seek, last_ + 100);
  follow(viewer, last_);
  EXPECT_EQ(viewer.replica.compute_state_hash(), hash_);
  // A speed beyond the limits is the limit.
  ask(viewer, ReplayAction::Seek, 0);
  follow(viewer, 0);
  ask(viewer, ReplayAction::Play, 0, 1e6F);
  EXPECT_EQ(follow(viewer, last_).speed, 1000);
}

TEST_F(CaptureLibraryTest, PlaysToItsEndWhileTheLiveMeshIsCutForTheOthers) {
  Viewer player(port()), other(port());
  ASSERT_TRUE(player.follow(0));
  ASSERT_TRUE(other.follow(0));
  ask(player, ReplayAction::Open, 0, 1, "sweep.capture");
  follow(player, 0);
  ask(player, ReplayAction::Play, 0, 1000);
  server_->cut();
  const protocol::ReplayState end = follow(player, last_);
  EXPECT_EQ(end.last_revision, last_);
  EXPECT_EQ(player.replica.compute_state_hash(), hash_);
  ASSERT_TRUE(other.follow(server_->loop.revision()));
  EXPECT_EQ(other.replica.compute_state_hash(), server_->loop.state_hash());
  // Played again it starts from the beginning; closed, the viewer is back at the live mesh.
  ask(player, ReplayAction::Play, 0, 1000);
  follow(player, last_);
  ask(player, ReplayAction::Close);
  // States of the capture may still be under way.
  const std::uint64_t live = server_->loop.state_hash();
  while (!player.whole || player.replica.state_hash() != live) {
    auto received = player.peer.receive();
    ASSERT_TRUE(received && player.take(received->message.body)) << "the live mesh never came";
  }
  EXPECT_EQ(player.replica.compute_state_hash(), live);
}

// A recording that lay still for a month plays as if that had been half a second.
TEST_F(CaptureLibraryTest, ALongSilenceIsShortened) {
  {
    std::ifstream in(dir_ / "captures/sweep.capture", std::ios::binary);
    protocol::CaptureReader reader(in);
    protocol::FileSink sink((dir_ / "captures/silent.capture").string(), true);
    protocol::CaptureWriter writer(sink, reader.header());
    protocol::CaptureRecord record;
    int poses = 0;
    while (reader.next(record) == protocol::CaptureReader::Status::Record) {
      auto* pose = std::get_if<protocol::PoseRecord>(&record);
      if (pose && ++poses > 100) pose->arrival_ns += 30 * 24 * std::int64_t{3'600'000'000'000};
      if (!std::holds_alternative<protocol::EndRecord>(record)) writer.append(record);
    }
    ASSERT_EQ(poses, 200);
    ASSERT_FALSE(writer.flush());
  }
  Viewer viewer(port());
  ASSERT_TRUE(viewer.follow(0));
  ask(viewer, ReplayAction::Open, 0, 1, "silent.capture");
  follow(viewer, 0);
  // Poses for 0.2 s and the silence, however slow the machine is.
  const auto begin = std::chrono::steady_clock::now();
  ask(viewer, ReplayAction::Play);
  follow(viewer, last_);
  EXPECT_EQ(viewer.replica.compute_state_hash(), hash_);
  EXPECT_GE(std::chrono::steady_clock::now() - begin, std::chrono::milliseconds(650));
}

TEST_F(CaptureLibraryTest, SaysWhyACaptureIsNotPlayed) {
  std::ofstream(dir_ / "captures/broken.capture") << "no capture";
  std::ofstream(dir_ / "secret.capture") << "";
  Viewer viewer(port());
  ASSERT_TRUE(viewer.follow(0));
  ask(viewer, ReplayAction::Play);
  EXPECT_EQ(answer(viewer), ErrorCode::BadState);
  for (const char* name : {"none.capture", "../secret.capture", ""}) {
    ask(viewer, ReplayAction::Open, 0, 1, name);
    EXPECT_EQ(answer(viewer), ErrorCode::BadRequest) << name;
  }
  viewer.peer.send(protocol::ReplayControl{ReplayAction::Open, "broken.capture", 1, 0}, 77);
  const auto error = viewer.peer.receive_until<protocol::Error>();
  ASSERT_TRUE(error);
  EXPECT_EQ(std::get<protocol::Error>(error->message.body).code, ErrorCode::NotAvailable);
  EXPECT_EQ(std::get<protocol::Error>(error->message.body).in_reply_to, 77u);
  EXPECT_EQ(std::get<protocol::Error>(error->message.body).text,
            "broken.capture: is not a capture of incised: offset 0: does not begin with INCISCAP");
  // It still serves whole captures, and the live mesh.
  ask(viewer, ReplayAction::Open, 0, 1, "sweep.capture");
  follow(viewer, 0);
  // One that is not played in its place ends it, and the viewer is told: the live mesh follows.
  ask(viewer, ReplayAction::Open, 0, 1, "none.capture");
  EXPECT_EQ(answer(viewer), ErrorCode::BadRequest);
  const auto ended = viewer.peer.receive_until<protocol::ReplayState>();
  ASSERT_TRUE(ended);
  EXPECT_EQ(std::get<protocol::ReplayState>(ended->message.body).capture, "");
  ask(viewer, ReplayAction::Open, 0, 1, "sweep.capture");
  follow(viewer, 0);

  protocol::Hello operate = stream::hello(Role::Operator, View::Volume);
  Viewer operating(port(), operate);
  ask(operating, ReplayAction::Open, 0, 1, "sweep.capture");
  EXPECT_EQ(answer(operating), ErrorCode::Forbidden);
}

TEST_F(CaptureLibraryTest, SaysThatTheMeshHasChanged) {
  mesh_io::write_mesh(dir_ / "cube.node", tests::cube(5));
  Viewer viewer(port());
  ASSERT_TRUE(viewer.follow(0));
  ask(viewer, ReplayAction::Open, 0, 1, "sweep.capture");
  const auto error = viewer.peer.receive_until<protocol::Error>();
  ASSERT_TRUE(error);
  EXPECT_NE(std::get<protocol::Error>(error->message.body)
                .text.find(" has changed since this was recorded; a replay needs the mesh as it was"),
            std::string::npos)
      << std::get<protocol::Error>(error->message.body).text;
}

TEST_F(CaptureLibraryTest, ListsWhatLiesInItsFolderByWhateverName) {
  const auto body = [&] {
    const std::string answer = stream::http(server_->server.http_port(), "/captures");
    return nlohmann::json::parse(answer.substr(answer.find("\r\n\r\n")));
  };
  const fs::path captures = dir_ / "captures";
  fs::create_directories(captures / "older.capture");
  std::ofstream(captures / ".hidden.capture") << "";
  std::ofstream(captures / "not\xfftext.capture") << "";
  std::ofstream(captures / "two\nlines.capture") << "";
  std::ofstream(captures / "sweep.txt") << "";
  std::ofstream(dir_ / "secret.capture") << "";
  fs::create_symlink(dir_ / "secret.capture", captures / "outside.capture");
  fs::create_symlink(dir_ / "nowhere", captures / "broken.capture");
  fs::create_symlink("sweep.capture", captures / "inside.capture");
  fs::copy(captures / "sweep.capture", captures / "a \"good\" \\ day.capture");
  EXPECT_EQ(body(), (nlohmann::json{"a \"good\" \\ day.capture", "inside.capture", "sweep.capture"}));
  Viewer viewer(port());
  ASSERT_TRUE(viewer.follow(0));
  ask(viewer, ReplayAction::Open, 0, 1, "outside.capture");
  EXPECT_EQ(answer(viewer), ErrorCode::BadRequest);
  ask(viewer, ReplayAction::Open, 0, 1, "a \"good\" \\ day.capture");
  follow(viewer, 0);
}

TEST_F(CaptureLibraryTest, SoManyAtATimeAndAPlaceIsFreeAgainWhenOneGoes) {
  std::vector<std::unique_ptr<Viewer>> players;
  for (int i = 0; i < 4; ++i) {
    players.push_back(std::make_unique<Viewer>(port()));
    ask(*players.back(), ReplayAction::Open, 0, 1, "sweep.capture");
    follow(*players.back(), 0);
  }
  Viewer late(port());
  ASSERT_TRUE(late.follow(0));
  ask(late, ReplayAction::Open, 0, 1, "sweep.capture");
  EXPECT_EQ(answer(late), ErrorCode::BadRequest);
  players.pop_back();
  EXPECT_TRUE(stream::eventually([&] { return server_->server.counters().peers == 4; }));
  ask(late, ReplayAction::Open, 0, 1, "sweep.capture");
  EXPECT_EQ(follow(late, 0).last_revision, last_);
}

}  // namespace
}  // namespace incise::app
