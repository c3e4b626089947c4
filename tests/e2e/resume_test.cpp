// Clients that come back to a server which was killed and goes on.

#include <gtest/gtest.h>

#include <memory>

#include "tests/e2e/served_session.hpp"
#include "tests/stream/viewer.hpp"

namespace incise::e2e {
namespace {

using protocol::Role;
using protocol::View;

// Comes back with what `before` held; the server says whether it goes on from there.
std::unique_ptr<stream::Viewer> come_back(const ServedSession& session, stream::Viewer& before) {
  protocol::Hello hello = stream::hello(Role::Viewer, View::Volume);
  hello.resume_session = before.welcome.session;
  hello.resume_revision = before.replica.revision();
  auto viewer = std::make_unique<stream::Viewer>(session.tcp_port(), hello);
  viewer->replica = std::move(before.replica);
  viewer->whole = true;
  return viewer;
}

TEST(Resume, ThoseWhoAreBehindGetDeltasFromAServerThatWasKilled) {
  ServedSession session("resume", 4000, R"(, "checkpoint_replay_s": 1000)");
  ASSERT_TRUE(session.start(false)) << session.log();
  stream::Viewer behind(session.tcp_port());
  std::uint64_t recorded = 0;
  {
    PoseDriver driver(session, 500, 0.2);
    ASSERT_TRUE(behind.follow(3));
    behind.peer.vanish();
    const auto other = client::Client::connect("127.0.0.1", session.tcp_port());
    ASSERT_TRUE(other->wait_for_revision(behind.replica.revision() + 4, 60));
    ASSERT_TRUE(driver.settle());
    recorded = other->revision();
  }
  session.kill();
  ASSERT_TRUE(session.start(true)) << session.log();
  const auto back = come_back(session, behind);
  ASSERT_TRUE(back->follow(recorded));
  EXPECT_TRUE(back->welcome.resumed);
  EXPECT_TRUE(back->causes.empty()) << "a snapshot";
  EXPECT_EQ(back->replica.state_hash(), back->replica.compute_state_hash());

  // A client cannot resume from steps that were not recorded.
  protocol::Hello ahead = stream::hello(Role::Viewer, View::Volume);
  ahead.resume_session = back->welcome.session;
  ahead.resume_revision = back->welcome.revision + 1;
  stream::Viewer snapshot(session.tcp_port(), ahead);
  ASSERT_TRUE(snapshot.follow(back->welcome.revision));
  EXPECT_FALSE(snapshot.welcome.resumed);
  EXPECT_EQ(snapshot.replica.state_hash(), back->replica.state_hash());
}

}  // namespace
}  // namespace incise::e2e
