// A server that sends a wrong hash: what the client library does about it.

#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <optional>
#include <thread>
#include <variant>
#include <vector>

#include "client/client.hpp"
#include "tests/client/recorded_session.hpp"

namespace incise::client {
namespace {

using protocol::Delta;
using stream::RawPeer;

constexpr double kPatience_s = 20;

TEST(Resync, AWrongHashIsAnsweredByAskingForTheWholeState) {
  const Recording recording;
  ASSERT_GT(recording.steps.size(), 4u);
  const stream::Listener listener;
  std::optional<protocol::Resync> asked;
  std::thread server([&] {
    const std::unique_ptr<RawPeer> accepted = listener.accept();
    RawPeer& peer = *accepted;
    if (!peer.receive_until<protocol::Hello>()) return;
    play(peer, recording.welcome);
    play(peer, recording.snapshot);
    peer.send(recording.steps[0].message.body);
    Delta wrong = std::get<Delta>(recording.steps[1].message.body);
    wrong.state_hash ^= 1;
    peer.send(wrong);
    peer.send(recording.steps[2].message.body);  // on its way already
    const auto received = peer.receive_until<protocol::Resync>();
    if (!received) return;
    asked = std::get<protocol::Resync>(received->message.body);
    play(peer, recording.snapshot);
    play(peer, recording.steps);
    peer.receive_until<protocol::Bye>();
  });
  std::atomic<int> told{0};
  Callbacks callbacks;
  callbacks.on_resync = [&](const std::string&) { ++told; };
  auto client = Client::connect("127.0.0.1", listener.port(), Options{}, callbacks);
  EXPECT_TRUE(client->wait_for_revision(recording.steps.size(), kPatience_s)) << client->last_error();
  EXPECT_EQ(client->read([](const protocol::Replica& mesh) { return mesh.compute_state_hash(); }),
            recording.hash);
  EXPECT_EQ(client->counters().resyncs, 1u) << "what came before the snapshot is no further fault";
  EXPECT_EQ(client->counters().snapshots, 2u);
  EXPECT_EQ(told, 1);
  client.reset();
  server.join();
  ASSERT_TRUE(asked) << "the client never asked";
  EXPECT_EQ(asked->revision, 1u);
  EXPECT_FALSE(asked->reason.empty());
}

// As after an undo, which goes back to a revision that the client has had already.
TEST(Resync, AnotherSessionIsWaitedForUntilItsStateIsHere) {
  const Recording recording;
  ASSERT_GT(recording.steps.size(), 4u);
  const stream::Listener listener;
  std::atomic<bool> welcomed{false}, held_back{true};
  std::thread server([&] {
    const std::unique_ptr<RawPeer> peer = listener.accept();
    if (!peer->receive_until<protocol::Hello>()) return;
    play(*peer, recording.welcome);
    play(*peer, recording.snapshot);
    play(*peer, recording.steps);
    play(*peer, recording.welcome);
    stream::eventually([&] { return !held_back; });
    play(*peer, recording.snapshot);
    peer->receive_until<protocol::Bye>();
  });
  int welcomes = 0;
  Callbacks callbacks;
  callbacks.on_welcome = [&](const protocol::Welcome&) { welcomed = ++welcomes == 2; };
  auto client = Client::connect("127.0.0.1", listener.port(), Options{}, callbacks);
  EXPECT_TRUE(stream::eventually([&] { return welcomed.load(); }));
  EXPECT_FALSE(client->wait_for_revision(0, 0.2)) << "it holds the state of the session before";
  held_back = false;
  EXPECT_TRUE(client->wait_for_revision(0, kPatience_s));
  EXPECT_EQ(client->revision(), 0u);
  client.reset();
  server.join();
}

// The connection is lost before the snapshot that was asked for came: the client must not go on from what it holds.
TEST(Resync, AStateThatWasRefusedIsNotResumed) {
  const Recording recording;
  ASSERT_GT(recording.steps.size(), 4u);
  const stream::Listener listener;
  std::vector<protocol::Hello> hellos;
  bool ponged = false;
  std::thread server([&] {
    const auto accept = [&] {
      std::unique_ptr<RawPeer> peer = listener.accept();
      const auto received = peer->receive_until<protocol::Hello>();
      if (received) hellos.push_back(std::get<protocol::Hello>(received->message.body));
      play(*peer, recording.welcome);
      return peer;
    };
    {
      const auto peer = accept();
      play(*peer, recording.snapshot);
      peer->send(recording.steps[0].message.body);
      peer->send(protocol::Ping{7, 8});
      const auto received = peer->receive_until<protocol::Pong>();  // so it has read the step
      const auto* pong = received ? std::get_if<protocol::Pong>(&received->message.body) : nullptr;
      ponged = pong && pong->nonce == 7 && pong->ping_sent_ns == 8;
    }
    {
      const auto peer = accept();
      play(*peer, recording.snapshot);
      peer->send(recording.steps[0].message.body);
      Delta wrong = std::get<Delta>(recording.steps[1].message.body);
      wrong.state_hash ^= 1;
      peer->send(wrong);
      peer->receive_until<protocol::Resync>();
    }
    const auto peer = accept();
    play(*peer, recording.snapshot);
    play(*peer, recording.steps);
    peer->receive_until<protocol::Bye>();
  });
  Options options;
  options.reconnect = true;
  auto client = Client::connect("127.0.0.1", listener.port(), options);
  EXPECT_TRUE(client->wait_for_revision(recording.steps.size(), kPatience_s)) << client->last_error();
  EXPECT_EQ(client->counters().resyncs, 1u);
  client.reset();
  server.join();
  EXPECT_TRUE(ponged);
  ASSERT_EQ(hellos.size(), 3u);
  EXPECT_EQ(hellos[0].resume_session, 0u);
  EXPECT_EQ(hellos[1].resume_revision, 1u) << "a whole state, of a connection that was lost";
  EXPECT_EQ(hellos[1].resume_hash, std::get<Delta>(recording.steps[0].message.body).state_hash);
  EXPECT_EQ(hellos[2].resume_session, 0u);
  EXPECT_EQ(hellos[2].resume_hash, 0u);
}

// A wrong snapshot is asked for again, but not for ever.
TEST(Resync, AServerWhoseSnapshotsAreAllWrongIsGivenUp) {
  const Recording recording;
  const stream::Listener listener;
  int asked = 0;
  std::thread server([&] {
    const std::unique_ptr<RawPeer> peer = listener.accept();
    if (!peer->receive_until<protocol::Hello>()) return;
    play(*peer, recording.welcome);
    do {
      for (const auto& one : recording.snapshot) {
        protocol::Body body = one.message.body;
        if (auto* end = std::get_if<protocol::SnapshotEnd>(&body)) end->state_hash ^= 1;
        peer->send(body);
      }
    } while (peer->receive_until<protocol::Resync>() && ++asked < 20);
  });
  std::string reason;
  try {
    const auto client = Client::connect("127.0.0.1", listener.port(), Options{});
    EXPECT_TRUE(stream::eventually([&] { return client->status() == Status::kClosed; }));
    reason = client->last_error();
  } catch (const ConnectError& error) {
    reason = error.what();
  }
  server.join();
  EXPECT_EQ(asked, 5);
  EXPECT_NE(reason.find("cannot hold the server's state"), std::string::npos) << reason;
}

TEST(Resync, OnlyFaultsInARowMakeAClientGiveUp) {
  const Recording recording;
  ASSERT_GT(recording.steps.size(), 4u);
  const stream::Listener listener;
  std::thread server([&] {
    const std::unique_ptr<RawPeer> peer = listener.accept();
    if (!peer->receive_until<protocol::Hello>()) return;
    play(*peer, recording.welcome);
    for (int i = 0; i < 9; ++i) {
      play(*peer, recording.snapshot);
      Delta wrong = std::get<Delta>(recording.steps[0].message.body);
      wrong.state_hash ^= 1;
      peer->send(wrong);
      if (!peer->receive_until<protocol::Resync>()) return;
    }
    play(*peer, recording.snapshot);
    play(*peer, recording.steps);
    peer->receive_until<protocol::Bye>();
  });
  auto client = Client::connect("127.0.0.1", listener.port(), Options{});
  EXPECT_TRUE(client->wait_for_revision(recording.steps.size(), kPatience_s)) << client->last_error();
  EXPECT_EQ(client->counters().resyncs, 9u);
  client.reset();
  server.join();
}

}  // namespace
}  // namespace incise::client
