#include "server/stream/server.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <cstring>
#include <random>
#include <thread>

#include "server/stream/delta_arrays.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/stream/viewer.hpp"

namespace incise::stream {
namespace {

using protocol::ByeReason;
using protocol::ErrorCode;
using protocol::Role;
using protocol::View;

// That somebody else is served as if nothing had happened.
void expect_serves_others(TestServer& test) {
  test.cut();
  Viewer viewer(test.server.tcp_port());
  ASSERT_TRUE(viewer.follow(test.loop.revision()));
  EXPECT_EQ(viewer.replica.state_hash(), test.loop.state_hash());
}

ErrorCode answer_to(TestServer& test, const std::vector<std::byte>& bytes) {
  RawPeer peer(test.server.tcp_port());
  peer.send(bytes);
  const auto error = peer.receive_until<protocol::Error>();
  return error ? std::get<protocol::Error>(error->message.body).code : ErrorCode::Unknown;
}

TEST(Server, WelcomesAndSendsTheState) {
  TestServer test;
  test.cut(2);
  ASSERT_GT(test.loop.revision(), 5u);
  Viewer viewer(test.server.tcp_port());
  ASSERT_TRUE(viewer.follow(test.loop.revision()));
  EXPECT_EQ(viewer.welcome.session, 4711u);
  EXPECT_EQ(viewer.welcome.mesh.name, "box");
  EXPECT_EQ(viewer.welcome.revision, test.loop.revision());
  EXPECT_EQ(viewer.welcome.state_hash, test.loop.state_hash());
  const ServerFacts facts = test.loop.facts();
  EXPECT_EQ(viewer.welcome.blade_heel.z, facts.blade_heel.z);
  EXPECT_EQ(viewer.welcome.blade_tip.z, facts.blade_tip.z);
  EXPECT_NE(facts.blade_tip.z, facts.blade_heel.z);
  EXPECT_EQ(viewer.welcome.max_speed_m_s, facts.max_speed_m_s);
  EXPECT_EQ(viewer.welcome.frame_rate_hz, facts.frame_rate_hz);
  EXPECT_EQ(viewer.welcome.policy, facts.policy);
  EXPECT_EQ(viewer.welcome.max_message_bytes, protocol::kMaxClientBytes);
  EXPECT_EQ(viewer.replica.compute_state_hash(), test.loop.state_hash());
  EXPECT_EQ(viewer.deltas, 0u);
  const std::uint64_t joined = test.loop.revision();
  test.cut(2);
  ASSERT_TRUE(viewer.follow(test.loop.revision()));
  EXPECT_EQ(viewer.deltas, test.loop.revision() - joined)
      << "one delta for each revision, none twice, none missing";
  EXPECT_EQ(viewer.replica.compute_state_hash(), test.loop.state_hash());
}

TEST(Server, JoinersInTheMiddleOfAStrokeMissNothing) {
  TestServer test(6);
  std::vector<std::unique_ptr<Viewer>> viewers;
  for (int i = 0; i < 12; ++i) {
    viewers.push_back(std::make_unique<Viewer>(test.server.tcp_port()));
    test.loop.cut(sweep(0.004 + 0.004 * i, 80, std::int64_t{i} * 1'000'000'000 + 1, test.side));
  }
  test.wait_for_mirror();
  ASSERT_TRUE(viewers[0]->follow(test.loop.revision()));
  const auto bytes = viewers[0]->replica.canonical_bytes();
  for (auto& viewer : viewers) {
    ASSERT_TRUE(viewer->follow(test.loop.revision()));
    EXPECT_EQ(viewer->replica.canonical_bytes(), bytes);
  }
  EXPECT_EQ(viewers[0]->replica.compute_state_hash(), test.loop.state_hash());
}

TEST(Server, ReturningViewersGoOnFromTheRing) {
  TestServer test;
  test.cut(2);
  protocol::Replica held;
  std::uint64_t at = 0;
  {
    Viewer viewer(test.server.tcp_port());
    ASSERT_TRUE(viewer.follow(test.loop.revision()));
    held = std::move(viewer.replica);
    at = held.revision();
    viewer.peer.vanish();
  }
  test.cut(2);
  protocol::Hello back = hello(Role::Viewer, View::Volume);
  back.resume_session = 4711;
  back.resume_revision = at;
  Viewer viewer(test.server.tcp_port(), back);
  viewer.replica = std::move(held);
  viewer.whole = true;
  ASSERT_TRUE(viewer.follow(test.loop.revision()));
  EXPECT_TRUE(viewer.welcome.resumed);
  EXPECT_TRUE(viewer.causes.empty());
  EXPECT_EQ(viewer.replica.compute_state_hash(), test.loop.state_hash());
  EXPECT_EQ(test.server.counters().resumed, 1u);
}

// As a server does that goes on with a session: it begins at a state of before, and publishes the steps since.
TEST(Server, WhatWasPublishedBeforeTheStartIsThereForThoseWhoReturn) {
  MiniLoop loop(box_mesh(6));
  Server server(test_config(), loop.facts(), loop.initial(), loop);
  loop.attach(server);
  loop.cut(sweep(0.03, 80, 1, 0.06));
  ASSERT_GT(loop.revision(), 2u);
  server.start();
  EXPECT_EQ(server.counters().revision, loop.revision()) << "before the first client can come";
  protocol::Hello back = hello(Role::Viewer, View::Volume);
  back.resume_session = 4711;
  Viewer viewer(server.tcp_port(), back);
  viewer.replica = protocol::Replica(protocol::kMaxVertices, protocol::kMaxTets);
  MiniLoop fresh(box_mesh(6));
  ASSERT_EQ(load_initial(fresh.initial(), viewer.replica), "");
  viewer.whole = true;
  ASSERT_TRUE(viewer.follow(loop.revision()));
  EXPECT_TRUE(viewer.welcome.resumed);
  EXPECT_EQ(viewer.replica.compute_state_hash(), loop.state_hash());
  server.stop();
}

TEST(Server, WhoLiesAboutItsRevisionGetsASnapshot) {
  TestServer test;
  test.cut(2);
  for (const auto& [session, revision] : std::vector<std::pair<std::uint64_t, std::uint64_t>>{
           {4711, test.loop.revision() + 1}, {4711, ~0ull}, {4712, test.loop.revision()}, {1, 0}}) {
    protocol::Hello back = hello(Role::Viewer, View::Volume);
    back.resume_session = session;
    back.resume_revision = revision;
    Viewer viewer(test.server.tcp_port(), back);
    ASSERT_TRUE(viewer.follow(test.loop.revision()));
    EXPECT_FALSE(viewer.welcome.resumed);
    ASSERT_EQ(viewer.causes.size(), 1u);
    EXPECT_EQ(viewer.causes[0], protocol::SnapshotCause::ResumeGone);
    EXPECT_EQ(viewer.replica.compute_state_hash(), test.loop.state_hash());
  }
}

// A server that went on with a capture after a crash may have lost a viewer's last steps and made others since. Only the
// hash tells: the session is the same, and the revision is one that the server has.
TEST(Server, AStateOfAnotherHistoryGetsASnapshot) {
  TestServer test;
  test.cut(1);
  const std::uint64_t middle = test.loop.revision();
  const std::uint64_t middle_hash = test.loop.state_hash();
  test.cut(1);
  const std::uint64_t head = test.loop.revision();
  MiniLoop fresh(box_mesh(6));
  const struct {
    std::uint64_t revision, hash;
  } states[] = {{0, fresh.state_hash()}, {middle, middle_hash}, {head, test.loop.state_hash()}};
  for (const auto& state : states) {
    for (const View view : {View::Volume, View::Surface}) {
      for (const std::uint64_t hash : {state.hash, state.hash ^ 1, std::uint64_t{0}}) {
        RawPeer first(test.server.tcp_port());
        first.send(hello(Role::Viewer, view));
        const auto named = first.receive_until<protocol::Welcome>();
        ASSERT_TRUE(named);
        protocol::Hello back = hello(Role::Viewer, view);
        back.resume_session = std::get<protocol::Welcome>(named->message.body).session;
        back.resume_revision = state.revision;
        back.resume_hash = hash;
        RawPeer peer(test.server.tcp_port());
        peer.send(back);
        const auto welcome = peer.receive_until<protocol::Welcome>();
        ASSERT_TRUE(welcome);
        const bool other = hash == (state.hash ^ 1);
        EXPECT_EQ(std::get<protocol::Welcome>(welcome->message.body).resumed, !other) << state.revision;
        if (!other) continue;
        const auto begin = peer.receive_until<protocol::SnapshotBegin>();
        ASSERT_TRUE(begin);
        EXPECT_EQ(std::get<protocol::SnapshotBegin>(begin->message.body).cause,
                  protocol::SnapshotCause::ResumeGone);
      }
    }
  }
}

// Deltas of one view mean nothing to a state of another: that of the surface, or what a box held.
TEST(Server, AStateIsGoneOnFromInItsOwnViewAlone) {
  TestServer test;
  test.cut(2);
  const auto session = [&](View view, bool boxed) {
    protocol::Hello h = hello(Role::Viewer, view);
    if (boxed) h.box = protocol::Box{{0, 0, 0}, {0.01, 0.01, 0.01}};
    RawPeer peer(test.server.tcp_port());
    peer.send(h);
    const auto welcome = peer.receive_until<protocol::Welcome>();
    return welcome ? std::get<protocol::Welcome>(welcome->message.body).session : 0;
  };
  const auto resumed = [&](View view, std::uint64_t of, std::uint64_t revision) {
    protocol::Hello back = hello(Role::Viewer, view);
    back.resume_session = of;
    back.resume_revision = revision;
    RawPeer peer(test.server.tcp_port());
    peer.send(back);
    const auto welcome = peer.receive_until<protocol::Welcome>();
    if (!welcome) return false;
    const bool yes = std::get<protocol::Welcome>(welcome->message.body).resumed;
    if (!yes) {
      EXPECT_TRUE(peer.receive_until<protocol::SnapshotEnd>());
    }
    return yes;
  };
  for (const std::uint64_t revision : {test.loop.revision(), std::uint64_t{0}}) {
    EXPECT_TRUE(resumed(View::Surface, session(View::Surface, false), revision));
    EXPECT_TRUE(resumed(View::Volume, session(View::Volume, false), revision));
    EXPECT_FALSE(resumed(View::Volume, session(View::Surface, false), revision));
    EXPECT_FALSE(resumed(View::Surface, session(View::Volume, false), revision));
    EXPECT_FALSE(resumed(View::Volume, session(View::Volume, true), revision));
    EXPECT_FALSE(resumed(View::Surface, session(View::Surface, true), revision));
  }
}

TEST(Server, WhatTheRingHasLetGoOfComesAsASnapshot) {
  StreamConfig config = test_config();
  config.ring_bytes = 20'000;  // a few deltas
  TestServer test(6, config);
  test.cut(4);
  EXPECT_LE(test.server.counters().ring_bytes, 20'000u);
  protocol::Hello back = hello(Role::Viewer, View::Volume);
  back.resume_session = 4711;
  back.resume_revision = 0;
  Viewer viewer(test.server.tcp_port(), back);
  ASSERT_TRUE(viewer.follow(test.loop.revision()));
  EXPECT_FALSE(viewer.welcome.resumed);
  EXPECT_EQ(viewer.replica.compute_state_hash(), test.loop.state_hash());
}

TEST(Server, ARateLimitedViewerGetsCoalescedDeltas) {
  TestServer test;
  protocol::Hello slow = hello(Role::Viewer, View::Volume);
  slow.max_rate_hz = 5;
  Viewer viewer(test.server.tcp_port(), slow);
  Viewer every(test.server.tcp_port());
  ASSERT_TRUE(viewer.follow(0));
  ASSERT_TRUE(every.follow(0));
  test.cut(6);
  ASSERT_TRUE(every.follow(test.loop.revision()));
  ASSERT_TRUE(viewer.follow(test.loop.revision()));
  EXPECT_LT(viewer.deltas, every.deltas / 2);
  EXPECT_EQ(viewer.steps, test.loop.revision());
  EXPECT_EQ(viewer.replica.canonical_bytes(), every.replica.canonical_bytes());
}

TEST(Server, ASlowReaderIsCaughtUpAndHurtsNobody) {
  StreamConfig config = test_config();
  config.outbox_bytes = 16 << 10;
  config.write_timeout_s = config.idle_timeout_s = 600;  // it reads nothing for as long as the cutting takes
  TestServer test(10, config);
  Viewer slow(test.server.tcp_port(), hello(Role::Viewer, View::Volume), 4096);
  ReadingViewer reading(test.server.tcp_port());
  ASSERT_TRUE(slow.follow(0));
  // Twice what the kernel's buffers hold, while the slow one reads nothing.
  for (int i = 0; i < 50; ++i) test.cut(2);
  ASSERT_TRUE(eventually([&] { return reading.at(test.loop.revision()); }));
  const Viewer& other = reading.stop();
  ASSERT_TRUE(slow.follow(test.loop.revision()));
  EXPECT_EQ(slow.steps, test.loop.revision());
  EXPECT_LT(slow.deltas, test.loop.revision() / 2);
  EXPECT_EQ(slow.causes.size(), 1u);
  EXPECT_EQ(slow.replica.canonical_bytes(), other.replica.canonical_bytes());
  EXPECT_GT(test.server.counters().coalesced, 0u);
}

// A peer that catches up each time may fall behind as often as it likes.
TEST(Server, SlowSnapshotsCountOnlyInARow) {
  StreamConfig config = test_config();
  config.ring_bytes = 0;  // no step is kept, so each takes a snapshot
  config.max_slow_snapshots = 40;
  TestServer test(2, config);
  Viewer viewer(test.server.tcp_port());
  ASSERT_TRUE(viewer.follow(0));
  const auto slow_snapshots = [&] { return test.server.counters().slow_snapshots; };
  while (slow_snapshots() <= 2 * config.max_slow_snapshots) {
    const std::uint64_t before = slow_snapshots();
    test.cut();
    ASSERT_TRUE(viewer.follow(test.loop.revision()));
    ASSERT_GT(slow_snapshots(), before);
  }
  EXPECT_EQ(test.server.counters().slow_disconnects, 0u);
}

TEST(Server, WhoNeverReadsIsDisconnected) {
  StreamConfig config = test_config();
  config.outbox_bytes = 16 << 10;
  config.ring_bytes = 64 << 10;
  config.write_timeout_s = 2;
  config.max_slow_snapshots = 1000;  // only the deadline of a write may end a session here
  TestServer test(8, config);
  Viewer stalled(test.server.tcp_port(), hello(Role::Viewer, View::Volume), 4096);
  ReadingViewer other(test.server.tcp_port());
  ASSERT_TRUE(eventually([&] { return test.server.counters().peers == 2; }));
  ASSERT_TRUE(eventually([&] {
    test.cut();
    return test.server.counters().slow_disconnects > 0;
  }));
  ASSERT_TRUE(eventually([&] { return other.at(test.loop.revision()); }));
  EXPECT_FALSE(other.ended());
  EXPECT_EQ(test.server.counters().slow_disconnects, 1u);
  ASSERT_TRUE(eventually([&] { return test.server.counters().peers == 1; }));
  expect_serves_others(test);
  // It begins to read after all: what was on its way is whole, and Bye is behind it.
  const auto bye = stalled.peer.receive_until<protocol::Bye>();
  ASSERT_TRUE(bye);
  EXPECT_EQ(std::get<protocol::Bye>(bye->message.body).reason, ByeReason::TooSlow);
  EXPECT_TRUE(stalled.peer.closes());
  EXPECT_EQ(test.server.counters().slow_disconnects, 1u);
}

TEST(Server, RefusesWhatIsNoHello) {
  TestServer test;
  {
    RawPeer peer(test.server.tcp_port());
    peer.send(protocol::Ping{1, 2}, 7);
    const auto error = peer.receive_until<protocol::Error>();
    ASSERT_TRUE(error);
    const auto& body = std::get<protocol::Error>(error->message.body);
    EXPECT_EQ(body.code, ErrorCode::BadState);
    EXPECT_TRUE(body.fatal);
    EXPECT_EQ(body.in_reply_to, 7u);
    const auto bye = peer.receive_until<protocol::Bye>();
    ASSERT_TRUE(bye);
    EXPECT_EQ(std::get<protocol::Bye>(bye->message.body).reason, ByeReason::Refused);
    EXPECT_TRUE(peer.closes());
  }
  {
    RawPeer peer(test.server.tcp_port());
    protocol::Hello old = hello(Role::Viewer, View::None);
    old.protocol_version = 99;
    peer.send(old);
    const auto error = peer.receive_until<protocol::Error>();
    ASSERT_TRUE(error);
    EXPECT_EQ(std::get<protocol::Error>(error->message.body).code, ErrorCode::BadVersion);
  }
  {
    // An old viewer gets what has not changed since.
    RawPeer peer(test.server.tcp_port());
    protocol::Hello old = hello(Role::Viewer, View::Volume);
    old.protocol_version = 1;
    peer.send(old);
    const auto error = peer.receive_until<protocol::Error>();
    ASSERT_TRUE(error);
    EXPECT_EQ(std::get<protocol::Error>(error->message.body).code, ErrorCode::BadVersion);
    RawPeer surface(test.server.tcp_port());
    old.view = View::Surface;
    surface.send(old);
    const auto welcome = surface.receive_until<protocol::Welcome>();
    ASSERT_TRUE(welcome);
    EXPECT_EQ(std::get<protocol::Welcome>(welcome->message.body).protocol_version, 1u);
    surface.send(protocol::Subscribe{View::Volume, 0, {}}, 8);
    const auto refused = surface.receive_until<protocol::Error>();
    ASSERT_TRUE(refused);
    EXPECT_EQ(std::get<protocol::Error>(refused->message.body).code, ErrorCode::NotAvailable);
    EXPECT_FALSE(std::get<protocol::Error>(refused->message.body).fatal);
  }
  {
    // Two Hellos: the second is out of place, but not fatal.
    Viewer viewer(test.server.tcp_port());
    ASSERT_TRUE(viewer.follow(0));
    viewer.peer.send(hello(Role::Viewer, View::Volume), 2);
    const auto error = viewer.peer.receive_until<protocol::Error>();
    ASSERT_TRUE(error);
    EXPECT_FALSE(std::get<protocol::Error>(error->message.body).fatal);
    test.cut();
    EXPECT_TRUE(viewer.follow(test.loop.revision()));
  }
}

TEST(Server, GarbageIsAnsweredAndTheRestLives) {
  TestServer test;
  const auto bytes = [](std::string_view text) {
    const auto span = std::as_bytes(std::span(text));
    return std::vector<std::byte>(span.begin(), span.end());
  };
  EXPECT_EQ(answer_to(test, bytes("GET / HTTP/1.1\r\nHost: x\r\n\r\n")), ErrorCode::TooLong);
  EXPECT_EQ(answer_to(test, bytes(std::string_view("\0\0\0\0", 4))), ErrorCode::TooLong);
  EXPECT_EQ(answer_to(test, bytes(std::string_view("\xff\xff\xff\xff", 4))), ErrorCode::TooLong);
  // A stranger may send a few kilobytes, not the megabyte that a session may.
  EXPECT_EQ(answer_to(test, bytes(std::string_view("\0\0\x08\0", 4))), ErrorCode::TooLong);
  std::string no_message(36, 'x');
  no_message.replace(0, 4, std::string_view("\x20\0\0\0", 4));
  EXPECT_EQ(answer_to(test, bytes(no_message)), ErrorCode::BadFrame);

  // Every kind of damage to a good Hello: each an answer or a goodbye, never a silent hang, never a death.
  const protocol::Frame good = protocol::encode(hello(Role::Viewer, View::Volume), {1, 0});
  std::mt19937_64 random(20260807);
  int refused = 0;
  for (int i = 0; i < 150; ++i) {
    std::vector<std::byte> damaged(good.tcp().begin(), good.tcp().end());
    const int hits = 1 + i % 4;
    for (int k = 0; k < hits; ++k) damaged[4 + random() % (damaged.size() - 4)] = std::byte(random() & 0xff);
    RawPeer peer(test.server.tcp_port());
    ASSERT_TRUE(peer.connected());
    peer.send(damaged);
    const auto answer = peer.receive();
    ASSERT_TRUE(answer) << "seed 20260807, case " << i;
    refused += std::holds_alternative<protocol::Error>(answer->message.body);
  }
  EXPECT_GT(refused, 20);
  expect_serves_others(test);
}

TEST(Server, DamagedMessagesInAnOpenSessionEndThatSessionOnly) {
  TestServer test;
  test.loop.start();
  ReadingViewer bystander(test.server.tcp_port());
  const auto poses = sweep(0.03, 40, 1, test.side);
  const protocol::Frame good = protocol::encode(protocol::PoseBatch{poses}, {2, 0});
  std::mt19937_64 random(7);
  std::uint64_t refused = 0;
  for (int i = 0; i < 60; ++i) {
    RawPeer peer(test.server.tcp_port());
    peer.send(hello(Role::Operator, View::None));
    ASSERT_TRUE(peer.receive_until<protocol::Welcome>()) << "seed 7, case " << i;
    std::vector<std::byte> damaged(good.tcp().begin(), good.tcp().end());
    if (i % 3 == 0) {
      damaged.resize(4 + random() % (damaged.size() - 4));  // cut off in the middle
      peer.send(damaged);
      peer.vanish();
    } else {
      for (int k = 0; k < 8; ++k) damaged[4 + random() % 60] = std::byte(random() & 0xff);
      peer.send(damaged);
      peer.send(protocol::Ping{1, 2}, 3);
      if (protocol::decode(std::span(damaged).subspan(4))) {
        EXPECT_TRUE(peer.receive_until<protocol::Pong>()) << "seed 7, case " << i << ": still a message";
        peer.vanish();
      } else {
        ++refused;
        const auto error = peer.receive_until<protocol::Error>();
        ASSERT_TRUE(error) << "seed 7, case " << i;
        EXPECT_TRUE(std::get<protocol::Error>(error->message.body).fatal) << "seed 7, case " << i;
        EXPECT_TRUE(peer.closes()) << "seed 7, case " << i;
      }
    }
    ASSERT_TRUE(eventually([&] { return test.loop.open_count() == 0; })) << "seed 7, case " << i;
  }
  EXPECT_GT(refused, 10u);
  EXPECT_EQ(test.server.counters().bad_messages, refused);
  EXPECT_FALSE(bystander.ended());
  EXPECT_TRUE(eventually([&] { return bystander.at(test.loop.revision()); }));
  EXPECT_EQ(bystander.stop().replica.compute_state_hash(), test.loop.state_hash());
}

TEST(Server, WhoSaysNothingIsShownTheDoor) {
  StreamConfig config = test_config();
  config.handshake_timeout_s = 0.2;
  TestServer test(2, config);
  RawPeer silent(test.server.tcp_port());
  RawPeer drip(test.server.tcp_port());
  drip.send(std::string_view("\x40\0", 2));
  const auto bye = silent.receive_until<protocol::Bye>();
  ASSERT_TRUE(bye);
  EXPECT_EQ(std::get<protocol::Bye>(bye->message.body).reason, ByeReason::HandshakeTimeout);
  EXPECT_TRUE(silent.closes());
  EXPECT_TRUE(drip.closes());
  ASSERT_TRUE(eventually([&] { return test.server.counters().connections == 0; }));
}

TEST(Server, IdlePeersArePingedAndThenLeave) {
  StreamConfig config = test_config();
  config.idle_timeout_s = 3;  // a third of it for a starved server to send its ping in
  TestServer test(2, config);
  RawPeer peer(test.server.tcp_port());
  peer.send(hello(Role::Viewer, View::None));
  const auto ping = peer.receive_until<protocol::Ping>();
  ASSERT_TRUE(ping);
  const auto bye = peer.receive_until<protocol::Bye>();
  ASSERT_TRUE(bye);
  EXPECT_EQ(std::get<protocol::Bye>(bye->message.body).reason, ByeReason::Idle);
}

TEST(Server, SilentConnectionsKeepNobodyOut) {
  StreamConfig config = test_config();
  config.max_handshakes = 4;
  config.handshake_timeout_s = 60;
  TestServer test(2, config);
  std::vector<std::unique_ptr<RawPeer>> flood;
  for (int i = 0; i < 40; ++i) flood.push_back(std::make_unique<RawPeer>(test.server.tcp_port()));
  ASSERT_TRUE(eventually([&] { return test.server.counters().half_open_closed == 36; }));
  ASSERT_TRUE(eventually([&] { return test.server.counters().connections == 4; }));
  // The first have gone, the last are still heard.
  EXPECT_TRUE(flood.front()->closes());
  EXPECT_TRUE(flood.back()->send(hello(Role::Viewer, View::None)));
  EXPECT_TRUE(flood.back()->receive_until<protocol::Welcome>());
  // A peer that has sent Hello stays, however many connect after it.
  Viewer viewer(test.server.tcp_port());
  ASSERT_TRUE(viewer.follow(0));
  for (int i = 0; i < 40; ++i) flood.push_back(std::make_unique<RawPeer>(test.server.http_port()));
  ASSERT_TRUE(eventually([&] { return test.server.counters().half_open_closed >= 75; }));
  test.cut();
  EXPECT_TRUE(viewer.follow(test.loop.revision()));
  viewer.peer.vanish();
  flood.clear();
  ASSERT_TRUE(eventually([&] { return test.server.counters().connections == 0; }));
  expect_serves_others(test);
}

TEST(Server, SessionsAreCounted) {
  StreamConfig config = test_config();
  config.max_sessions = 2;
  TestServer test(2, config);
  Viewer a(test.server.tcp_port()), b(test.server.tcp_port());
  ASSERT_TRUE(a.follow(0));
  ASSERT_TRUE(b.follow(0));
  RawPeer c(test.server.tcp_port());
  c.send(hello(Role::Viewer, View::Volume));
  const auto error = c.receive_until<protocol::Error>();
  ASSERT_TRUE(error);
  EXPECT_EQ(std::get<protocol::Error>(error->message.body).code, ErrorCode::TooManySessions);
}

TEST(Server, AFloodOfSmallMessagesEndsTheFlooder) {
  StreamConfig config = test_config();
  config.max_messages_per_s = 50;
  TestServer test(2, config);
  RawPeer peer(test.server.tcp_port());
  peer.send(hello(Role::Viewer, View::None));
  for (std::uint64_t i = 0; i < 300; ++i) peer.send(protocol::Ping{i, 0}, 2 + i);
  const auto error = peer.receive_until<protocol::Error>();
  ASSERT_TRUE(error);
  EXPECT_EQ(std::get<protocol::Error>(error->message.body).code, ErrorCode::RateExceeded);
  EXPECT_GE(std::get<protocol::Error>(error->message.body).in_reply_to, 51u);
  EXPECT_TRUE(peer.closes());
  expect_serves_others(test);
}

TEST(Server, PosesAreCountedAndReported) {
  TestServer test;
  test.loop.start();
  RawPeer peer(test.server.tcp_port());
  peer.send(hello(Role::Operator, View::None));
  ASSERT_TRUE(peer.receive_until<protocol::Welcome>());
  auto poses = sweep(0.03, 50, 1, test.side);
  poses[10].source_ns = poses[11].source_ns = 5;                          // in the past
  poses[20].orientation = {2, 0, 0, 0};                                   // no rotation
  for (const std::size_t i : {30u, 31u, 32u}) poses[i].position.x = 5e5;  // nowhere near
  peer.send(protocol::PoseBatch{std::span(poses).first(25)}, 2);
  peer.send(protocol::PoseBatch{std::span(poses).subspan(25)}, 3);
  protocol::PoseReport report;
  while (report.through_sequence < 3) {
    const auto received = peer.receive_until<protocol::PoseReport>();
    ASSERT_TRUE(received);
    report = std::get<protocol::PoseReport>(received->message.body);
  }
  EXPECT_EQ(report.accepted + report.not_finite + report.not_unit + report.time_not_rising, 50u);
  EXPECT_EQ(report.accepted, 44u);
  EXPECT_EQ(report.time_not_rising, 2u);
  EXPECT_EQ(report.not_unit, 1u);
  EXPECT_EQ(report.not_finite, 3u);
  EXPECT_EQ(report.last_source_ns, poses.back().source_ns);
}

// A report tells what was taken from what is recorded; an operator hears when recording stops and when it goes on, sooner or
// later joined; others have it in the statistics.
TEST(Server, OperatorsAreToldWhatIsRecordedAndWhenRecordingStops) {
  using protocol::Recording;
  std::atomic<Recording> state{Recording::On};
  Providers providers;
  providers.recording = [&]() -> RecordingNow {
    return {state, state == Recording::Stopped ? "disk.capture: No space left on device" : ""};
  };
  providers.statistics = [] { return protocol::Stats{}; };
  TestServer test(6, test_config(), std::move(providers));
  test.loop.start();
  const auto join = [&](RawPeer& peer, Role role, const char* blade) {
    protocol::Hello asks = hello(role, View::None);
    asks.source_name = blade;
    peer.send(asks);
    const auto welcome = peer.receive_until<protocol::Welcome>();
    EXPECT_TRUE(welcome);
    return welcome ? std::get<protocol::Welcome>(welcome->message.body).recording : Recording::Off;
  };
  const auto report_until = [](RawPeer& peer, auto condition) {
    for (;;) {
      const auto received = peer.receive_until<protocol::PoseReport>();
      if (!received) return protocol::PoseReport{};
      const auto report = std::get<protocol::PoseReport>(received->message.body);
      if (condition(report)) return report;
    }
  };
  // The next notice; before it no report may have said so without one.
  const auto notice = [](RawPeer& peer) {
    const auto received = peer.receive_until<protocol::Error>();
    return received ? std::get<protocol::Error>(received->message.body) : protocol::Error{};
  };
  RawPeer peer(test.server.tcp_port()), viewer(test.server.tcp_port()), late(test.server.tcp_port());
  EXPECT_EQ(join(peer, Role::Operator, "first"), Recording::On);
  EXPECT_EQ(join(viewer, Role::Viewer, ""), Recording::On);
  const auto poses = sweep(0.03, 50, 1, test.side);
  test.loop.record(true);
  peer.send(protocol::PoseBatch{std::span(poses).first(20)}, 2);
  auto report = report_until(peer, [](const auto& r) { return r.through_sequence == 2; });
  EXPECT_EQ(report.accepted, 20u);
  EXPECT_EQ(report.recorded, 20u);
  EXPECT_EQ(report.recorded_source_ns, poses[19].source_ns);
  EXPECT_EQ(report.recording, Recording::On);

  test.loop.record(false);
  state = Recording::Stopped;
  const protocol::Error stopped = notice(peer);
  EXPECT_EQ(stopped.code, ErrorCode::NotRecorded);
  EXPECT_FALSE(stopped.fatal);
  EXPECT_EQ(stopped.in_reply_to, 0u);
  EXPECT_NE(stopped.text.find("disk.capture: No space left on device"), std::string::npos) << stopped.text;
  // Without a pose, too.
  report = report_until(peer, [](const auto& r) { return r.recording == Recording::Stopped; });
  EXPECT_EQ(report.recorded, 20u);
  peer.send(protocol::PoseBatch{std::span(poses).subspan(20)}, 3);
  report = report_until(peer, [](const auto& r) { return r.through_sequence == 3; });
  EXPECT_EQ(report.accepted, 50u);
  EXPECT_EQ(report.recorded, 20u);
  EXPECT_EQ(report.recorded_source_ns, poses[19].source_ns);

  EXPECT_EQ(join(late, Role::Operator, "second"), Recording::Stopped);
  EXPECT_EQ(notice(late).code, ErrorCode::NotRecorded);

  state = Recording::On;
  for (RawPeer* other : {&peer, &late})
    EXPECT_EQ(report_until(*other, [](const auto& r) { return r.recording == Recording::On; }).recording,
              Recording::On);
  // The viewer has it in its statistics, and in no Error.
  state = Recording::Stopped;
  for (;;) {
    const auto received = viewer.receive();
    ASSERT_TRUE(received);
    EXPECT_FALSE(std::holds_alternative<protocol::Error>(received->message.body));
    const auto* statistics = std::get_if<protocol::Stats>(&received->message.body);
    if (statistics && statistics->recording == Recording::Stopped) break;
  }
}

TEST(Server, StatisticsHaveWhatTheStreamKnows) {
  Providers providers;
  providers.statistics = [] {
    protocol::Stats stats;
    stats.frames = 17;
    return stats;
  };
  TestServer test(2, test_config(), std::move(providers));
  test.cut();
  RawPeer a(test.server.tcp_port()), b(test.server.tcp_port());
  for (RawPeer* peer : {&a, &b}) {
    peer->send(hello(Role::Viewer, View::None));
    ASSERT_TRUE(peer->receive_until<protocol::Welcome>());
  }
  const auto received = a.receive_until<protocol::Stats>();
  ASSERT_TRUE(received);
  const auto& stats = std::get<protocol::Stats>(received->message.body);
  EXPECT_EQ(stats.frames, 17u);
  EXPECT_EQ(stats.revision, test.loop.revision());
  EXPECT_EQ(stats.live_tets, test.loop.live_tets());
  EXPECT_GT(stats.live_tets, 0u);
  EXPECT_EQ(stats.sessions, 2u);
}

TEST(Server, ABladeIsEngagedByMessageWithoutAButton) {
  TestServer test;
  test.loop.start();
  RawPeer peer(test.server.tcp_port());
  peer.send(hello(Role::Operator, View::None));
  ASSERT_TRUE(peer.receive_until<protocol::Welcome>());
  std::uint64_t sequence = 1;
  const auto send_all = [&](double y, std::int64_t t0_ns) {
    auto poses = sweep(y, 50, t0_ns, test.side);
    for (protocol::PoseSample& pose : poses) pose.buttons = 0;
    peer.send(protocol::PoseBatch{poses}, ++sequence);
    for (protocol::PoseReport report; report.through_sequence < sequence;) {
      const auto received = peer.receive_until<protocol::PoseReport>();
      ASSERT_TRUE(received);
      report = std::get<protocol::PoseReport>(received->message.body);
    }
  };
  send_all(0.2 * test.side, 1);
  EXPECT_EQ(test.loop.revision(), 0u);
  peer.send(protocol::StrokeControl{protocol::StrokeAction::Engage, 0}, ++sequence);
  send_all(0.4 * test.side, 1'000'000'000);
  peer.send(protocol::StrokeControl{protocol::StrokeAction::End, 0}, ++sequence);
  ASSERT_TRUE(eventually([&] { return test.loop.strokes_ended() == 1; }));
  const std::uint64_t cut = test.loop.revision();
  EXPECT_GT(cut, 3u);
  send_all(0.6 * test.side, 2'000'000'000);  // lifted
  EXPECT_EQ(test.loop.revision(), cut);
}

TEST(Server, ABladeFarLongerThanTheMeshIsRefused) {
  TestServer test;
  protocol::Hello hand = hello(Role::Operator, View::None);
  hand.blade = protocol::BladeEdge{{0, 0, 0}, {0, 0, -5000}};
  RawPeer peer(test.server.tcp_port());
  peer.send(hand);
  const auto error = peer.receive_until<protocol::Error>();
  ASSERT_TRUE(error);
  EXPECT_EQ(std::get<protocol::Error>(error->message.body).code, ErrorCode::BadRequest);
  EXPECT_TRUE(std::get<protocol::Error>(error->message.body).fatal);
  hand.blade->tip.z = -50;
  RawPeer other(test.server.tcp_port());
  other.send(hand);
  EXPECT_TRUE(other.receive_until<protocol::Welcome>());
}

TEST(Server, ABoxThereIsNoMemoryForGetsEverything) {
  StreamConfig config = test_config();
  config.max_part_bytes = 20'000;
  TestServer test(6, config);
  protocol::Hello small = hello(Role::Viewer, View::Volume), large = small;
  small.box = protocol::Box{{0, 0, 0}, {0, 0, 0}};
  large.box = protocol::Box{{-1, -1, -1}, {1, 1, 1}};
  RawPeer first(test.server.tcp_port());
  first.send(small);
  const auto begin = first.receive_until<protocol::SnapshotBegin>();
  ASSERT_TRUE(begin);
  EXPECT_EQ(std::get<protocol::SnapshotBegin>(begin->message.body).box, small.box);
  ASSERT_TRUE(first.receive_until<protocol::SnapshotEnd>());
  EXPECT_GT(test.server.counters().part_bytes, 0u);
  RawPeer second(test.server.tcp_port());
  second.send(large);
  const auto error = second.receive_until<protocol::Error>();
  ASSERT_TRUE(error);
  EXPECT_EQ(std::get<protocol::Error>(error->message.body).code, ErrorCode::NotAvailable);
  EXPECT_FALSE(std::get<protocol::Error>(error->message.body).fatal);
  const auto whole = second.receive_until<protocol::SnapshotBegin>();
  ASSERT_TRUE(whole);
  EXPECT_FALSE(std::get<protocol::SnapshotBegin>(whole->message.body).box);
  first.vanish();
  EXPECT_TRUE(eventually([&] { return test.server.counters().part_bytes == 0; }));
}

TEST(Server, OnlyOperatorsSendPoses) {
  TestServer test(2);
  RawPeer peer(test.server.tcp_port());
  peer.send(hello(Role::Viewer, View::None));
  const auto poses = sweep(0.03, 5, 1);
  peer.send(protocol::PoseBatch{poses}, 2);
  const auto error = peer.receive_until<protocol::Error>();
  ASSERT_TRUE(error);
  EXPECT_EQ(std::get<protocol::Error>(error->message.body).code, ErrorCode::Forbidden);
  EXPECT_FALSE(std::get<protocol::Error>(error->message.body).fatal);
  peer.send(protocol::Reset{}, 3);
  const auto second = peer.receive_until<protocol::Error>();
  ASSERT_TRUE(second);
  EXPECT_EQ(std::get<protocol::Error>(second->message.body).in_reply_to, 3u);
}

TEST(Server, ASecondOperatorIsRefusedOrTakesOver) {
  TestServer test;
  test.loop.start();
  RawPeer first(test.server.tcp_port());
  first.send(hello(Role::Operator, View::None));
  ASSERT_TRUE(first.receive_until<protocol::Welcome>());
  const auto poses = sweep(0.03, 80, 1, test.side);
  first.send(protocol::PoseBatch{std::span(poses).first(60)}, 2);
  ASSERT_TRUE(first.receive_until<protocol::PoseReport>());

  RawPeer second(test.server.tcp_port());
  second.send(hello(Role::Operator, View::None));
  const auto error = second.receive_until<protocol::Error>();
  ASSERT_TRUE(error);
  EXPECT_EQ(std::get<protocol::Error>(error->message.body).code, ErrorCode::BladeTaken);

  RawPeer other_blade(test.server.tcp_port());
  protocol::Hello other = hello(Role::Operator, View::None);
  other.source_name = "left";
  other_blade.send(other);
  const auto welcome = other_blade.receive_until<protocol::Welcome>();
  ASSERT_TRUE(welcome);
  EXPECT_EQ(std::get<protocol::Welcome>(welcome->message.body).source, 1u);

  RawPeer third(test.server.tcp_port());
  protocol::Hello take = hello(Role::Operator, View::None);
  take.take_over = true;
  third.send(take);
  ASSERT_TRUE(third.receive_until<protocol::Welcome>());
  const auto bye = first.receive_until<protocol::Bye>();
  ASSERT_TRUE(bye);
  EXPECT_EQ(std::get<protocol::Bye>(bye->message.body).reason, ByeReason::HandedOver);
  EXPECT_EQ(test.loop.strokes_ended(), 1u) << "the stroke of who held the blade has ended";
}

// Without a name it is "blade", whichever way it is asked for.
TEST(Server, ABladeWithoutANameIsHeldUnderItsDefault) {
  TestServer test;
  test.loop.start();
  const auto greeting = [](const std::string& name, bool take_over) {
    protocol::Hello wish = hello(Role::Operator, View::None);
    wish.source_name = name;
    wish.take_over = take_over;
    return wish;
  };
  for (const auto& [held, asked] : {std::pair{"", "blade"}, {"blade", ""}}) {
    RawPeer first(test.server.tcp_port());
    first.send(greeting(held, true));
    ASSERT_TRUE(first.receive_until<protocol::Welcome>());
    RawPeer second(test.server.tcp_port());
    second.send(greeting(asked, false));
    const auto error = second.receive_until<protocol::Error>();
    ASSERT_TRUE(error);
    EXPECT_EQ(std::get<protocol::Error>(error->message.body).text,
              "the blade \"blade\" is held by another operator");
    RawPeer third(test.server.tcp_port());
    third.send(greeting(asked, true));
    EXPECT_TRUE(third.receive_until<protocol::Welcome>());
    EXPECT_TRUE(first.receive_until<protocol::Bye>());
  }
}

// Who finds no blade free is told how many there are and who holds them, in names that cannot harm a terminal.
TEST(Server, WhereAllBladesAreHeldTheirHoldersAreNamed) {
  TestServer test;
  test.loop.start();
  std::vector<std::unique_ptr<PoseInput>> held;
  for (const char* name : {"h0", "h1", "h2", "h3", "h4", "h5", "h6", "left \x1b[31m"})
    held.push_back(test.loop.open(name, std::nullopt));
  RawPeer peer(test.server.tcp_port());
  protocol::Hello wish = hello(Role::Operator, View::None);
  wish.source_name = "h8";
  peer.send(wish);
  const auto error = peer.receive_until<protocol::Error>();
  ASSERT_TRUE(error);
  EXPECT_EQ(std::get<protocol::Error>(error->message.body).text,
            "no blade is free for \"h8\": all 8 are held, by \"h0\", \"h1\", \"h2\", \"h3\", \"h4\", \"h5\", "
            "\"h6\", \"left ?[31m\"; one of them has to leave first");
}

// A blade that no operator holds cannot be taken over, and the reason says so.
TEST(Server, ABladeOfADeviceIsRefusedAsThat) {
  TestServer test;
  test.loop.start();
  const auto device = test.loop.open("same", std::nullopt);
  for (const bool take_over : {false, true}) {
    RawPeer peer(test.server.tcp_port());
    protocol::Hello wish = hello(Role::Operator, View::None);
    wish.source_name = "same";
    wish.take_over = take_over;
    peer.send(wish);
    const auto error = peer.receive_until<protocol::Error>();
    ASSERT_TRUE(error);
    EXPECT_EQ(std::get<protocol::Error>(error->message.body).code, ErrorCode::BladeTaken);
    const std::string text(std::get<protocol::Error>(error->message.body).text);
    EXPECT_NE(text.find("\"same\" is held by a device"), std::string::npos) << text;
  }
  EXPECT_EQ(test.loop.open_count(), 1u);
}

TEST(Server, AVanishedOperatorEndsItsStroke) {
  TestServer test;
  test.loop.start();
  {
    RawPeer peer(test.server.tcp_port());
    peer.send(hello(Role::Operator, View::None));
    ASSERT_TRUE(peer.receive_until<protocol::Welcome>());
    const auto poses = sweep(0.03, 60, 1, test.side);
    peer.send(protocol::PoseBatch{std::span(poses).first(40)}, 2);
    ASSERT_TRUE(eventually([&] { return test.loop.revision() > 0; }));
    peer.vanish();
  }
  EXPECT_TRUE(eventually([&] { return test.loop.strokes_ended() == 1 && test.loop.open_count() == 0; }));
}

TEST(Server, AFullQueueHoldsTheSenderBackAndLosesNothing) {
  TestServer test(2);
  test.loop.hold(true);
  test.loop.start();
  RawPeer peer(test.server.tcp_port());
  peer.send(hello(Role::Operator, View::None));
  ASSERT_TRUE(peer.receive_until<protocol::Welcome>());
  // Outside the tissue, so that nothing is cut; more than the queue holds.
  std::vector<protocol::PoseSample> poses(30'000);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    poses[i].source_ns = 1'000'000'000'000 + static_cast<std::int64_t>(i) * 1000;
    poses[i].position = {5, 5, 5};
  }
  std::thread sender([&] {
    for (std::size_t i = 0; i < poses.size(); i += 1000) {
      peer.send(protocol::PoseBatch{std::span(poses).subspan(i, 1000)}, 2 + i / 1000);
    }
  });
  expect_serves_others(test);
  test.loop.hold(false);
  sender.join();
  protocol::PoseReport report;
  while (report.through_sequence < 31) {
    const auto received = peer.receive_until<protocol::PoseReport>();
    ASSERT_TRUE(received);
    report = std::get<protocol::PoseReport>(received->message.body);
  }
  EXPECT_EQ(report.accepted, 30'000u);
  EXPECT_EQ(report.queue_full, 0u);
}

TEST(Server, ForcesGoToWhoHoldsTheBlade) {
  TestServer test(2);
  RawPeer right(test.server.tcp_port()), left(test.server.tcp_port());
  right.send(hello(Role::Operator, View::None));
  ASSERT_TRUE(right.receive_until<protocol::Welcome>());
  protocol::Hello other = hello(Role::Operator, View::None);
  other.source_name = "left";
  left.send(other);
  ASSERT_TRUE(left.receive_until<protocol::Welcome>());
  protocol::Force force;
  force.source = 1;
  force.force_n = {0, 0, 2.5};
  test.server.publish_force(force);
  force.source = 0;
  for (int i = 1; i <= 100; ++i) {
    force.source_ns = i;
    test.server.publish_force(force);
  }
  const auto at_left = left.receive_until<protocol::Force>();
  ASSERT_TRUE(at_left);
  EXPECT_EQ(std::get<protocol::Force>(at_left->message.body).force_n.z, 2.5);
  std::int64_t last = 0;
  while (last < 100) {
    const auto at_right = right.receive_until<protocol::Force>();
    ASSERT_TRUE(at_right);
    EXPECT_GT(std::get<protocol::Force>(at_right->message.body).source_ns, last);
    last = std::get<protocol::Force>(at_right->message.body).source_ns;
  }
}

// A simulator gets the newest load of each blade, each once, those in between counted; others none.
TEST(Server, LoadsGoToSimulatorsThatAskedTheNewestOnly) {
  std::atomic<std::uint64_t> number{0};
  std::atomic<int> models{0};
  const std::vector<std::uint32_t> ids{2, 5};
  const std::vector<double> forces{0, 0, -1, 0, 0.5, -2};
  protocol::BladeLoad load;
  Providers providers;
  providers.loads = [&]() -> std::span<const protocol::BladeLoad> {
    load.source = 3;
    load.force_n = {0, -0.5, 3};
    load.ids = ids;
    load.forces = forces;
    load.number = number;
    return {&load, load.number > 0 ? 1u : 0u};
  };
  providers.use_model = [&](const protocol::BladeModel& model) {
    ++models;
    return model.damping_n_s_per_m < 0 ? std::string("damping below 0") : std::string();
  };
  TestServer test(4, test_config(), std::move(providers));
  protocol::Hello asks = hello(Role::Simulator, View::Volume);
  asks.load_rate_hz = 100;
  Viewer simulator(test.server.tcp_port(), asks),
      other(test.server.tcp_port(), hello(Role::Simulator, View::Volume));
  const auto error_on = [](Viewer& viewer, const protocol::BladeModel& model) {
    viewer.peer.send(model);
    const auto received = viewer.peer.receive_until<protocol::Error>();
    return received ? std::get<protocol::Error>(received->message.body).text : std::string();
  };
  protocol::BladeModel model;
  model.source = 3;
  EXPECT_NE(error_on(simulator, model).find("blade 3: no BladeLoad"), std::string::npos);
  number = 7;
  const auto next = [&] {
    const auto received = simulator.peer.receive_until<protocol::BladeLoad>();
    if (!received) return std::pair<std::uint64_t, std::uint64_t>{};
    const auto& got = std::get<protocol::BladeLoad>(received->message.body);
    EXPECT_EQ(got.source, 3u);
    EXPECT_EQ(got.force_n.z, 3);
    EXPECT_TRUE(std::ranges::equal(got.ids, ids));
    EXPECT_TRUE(std::ranges::equal(got.forces, forces));
    return std::pair{got.number, got.skipped};
  };
  EXPECT_EQ(next(), (std::pair<std::uint64_t, std::uint64_t>{7, 0}));
  number = 12;
  EXPECT_EQ(next(), (std::pair<std::uint64_t, std::uint64_t>{12, 4}));
  number = 13;
  EXPECT_EQ(next(), (std::pair<std::uint64_t, std::uint64_t>{13, 4}));
  // Its own model: used, or refused with a reason, and the connection stays.
  model.damping_n_s_per_m = -1;
  EXPECT_NE(error_on(simulator, model).find("blade 3: damping below 0"), std::string::npos);
  model.source = 4;
  EXPECT_NE(error_on(simulator, model).find("blade 4: no BladeLoad"), std::string::npos);
  model = {};
  model.source = 3;
  simulator.peer.send(model);
  number = 20;
  EXPECT_EQ(next().first, 20u);
  EXPECT_EQ(models, 2);
  EXPECT_NE(error_on(other, model).find("no BladeLoad"), std::string::npos) << "it has not asked";
}

TEST(Server, RefusesLoadRatesThatItDoesNotOffer) {
  TestServer test(4);
  for (const auto& [role, rate] :
       {std::pair{Role::Simulator, 59.0F}, {Role::Simulator, 1001.0F}, {Role::Viewer, 100.0F}}) {
    protocol::Hello asks = hello(role, View::None);
    asks.load_rate_hz = rate;
    RawPeer peer(test.server.tcp_port());
    peer.send(asks);
    const auto received = peer.receive_until<protocol::Error>();
    ASSERT_TRUE(received);
    EXPECT_NE(std::get<protocol::Error>(received->message.body).text.find("60 to 1000"), std::string::npos);
  }
}

TEST(Server, BladesAreShownToWhoAskedEachPoseOnceAndNoOftenerThanAsked) {
  std::atomic<std::int64_t> arrival_ns{1};
  std::atomic<bool> moving{false};
  std::atomic<double> newtons{0};
  Providers providers;
  providers.blades = [&]() -> std::vector<protocol::BladePose> {
    if (moving) ++arrival_ns;
    protocol::BladePose pose{3, true, {0.01, 0.02, 0.11}, {0.01, 0.02, -0.01}, arrival_ns, std::nullopt};
    if (newtons > 0) pose.force_n = protocol::Vec3{0, 0, newtons};
    return {pose};
  };
  TestServer test(4, test_config(), std::move(providers));
  protocol::Hello asks = hello(Role::Viewer, View::Volume);
  asks.blade_rate_hz = 60;
  protocol::Hello seldom = asks;
  seldom.blade_rate_hz = 0.02F;
  Viewer watcher(test.server.tcp_port(), asks), patient(test.server.tcp_port(), seldom),
      other(test.server.tcp_port());
  const auto next = [](Viewer& viewer) {
    const auto received = viewer.peer.receive_until<protocol::BladePose>();
    return received ? std::get<protocol::BladePose>(received->message.body) : protocol::BladePose{};
  };
  const protocol::BladePose first = next(watcher);
  EXPECT_EQ(first.source, 3u);
  EXPECT_TRUE(first.cutting);
  EXPECT_EQ(first.heel.z, 0.11);
  EXPECT_EQ(first.tip.z, -0.01);
  EXPECT_EQ(first.arrival_ns, 1);

  moving = true;
  std::int64_t last_ns = 1;
  for (int i = 0; i < 10; ++i) {
    const std::int64_t now_ns = next(watcher).arrival_ns;
    EXPECT_GT(now_ns, last_ns) << "each pose once";
    last_ns = now_ns;
  }
  moving = false;
  // A force without another pose is told as well, and its end.
  newtons = 1.5;
  protocol::BladePose felt;
  for (int i = 0; i < 1000 && !felt.force_n; ++i) felt = next(watcher);
  ASSERT_TRUE(felt.force_n);
  EXPECT_EQ(felt.force_n->z, 1.5);
  newtons = 0;
  EXPECT_FALSE(next(watcher).force_n);
  // What else they got, up to a revision: at most one pose for a client that wants one in fifty seconds, none unasked.
  test.cut();
  const auto poses_until_cut = [&](Viewer& viewer) {
    int poses = 0;
    while (!viewer.whole || viewer.replica.revision() < test.loop.revision()) {
      const auto received = viewer.peer.receive();
      if (!received || !viewer.take(received->message.body)) return -1;
      poses += std::holds_alternative<protocol::BladePose>(received->message.body);
    }
    return poses;
  };
  EXPECT_EQ(poses_until_cut(other), 0);
  const int seen = poses_until_cut(patient);
  EXPECT_GE(seen, 0);
  EXPECT_LE(seen, 1);
}

TEST(Server, AResetStartsAnotherSession) {
  TestServer test;
  test.cut(2);
  Viewer viewer(test.server.tcp_port());
  ASSERT_TRUE(viewer.follow(test.loop.revision()));
  test.loop.start();
  RawPeer admin(test.server.tcp_port());
  admin.send(hello(Role::Admin, View::None));
  ASSERT_TRUE(admin.receive_until<protocol::Welcome>());
  admin.send(protocol::Reset{}, 2);
  viewer.whole = false;
  ASSERT_TRUE(viewer.follow(0));
  EXPECT_EQ(viewer.welcome.session, 4712u);
  ASSERT_EQ(viewer.causes.back(), protocol::SnapshotCause::Reset);
  EXPECT_EQ(viewer.replica.revision(), 0u);
  EXPECT_EQ(viewer.replica.compute_state_hash(), test.loop.state_hash());
}

TEST(Server, AsksForATokenWhereThereAreSome) {
  StreamConfig config = test_config();
  config.tokens = {{"open sesame", {Role::Viewer}}, {"scalpel", {Role::Operator, Role::Viewer}}};
  TestServer test(2, config);
  const auto answer = [&](Role role, const std::string& token) {
    RawPeer peer(test.server.tcp_port());
    protocol::Hello h = hello(role, View::None);
    h.token = token;
    peer.send(h);
    const auto received = peer.receive();
    return received && std::holds_alternative<protocol::Welcome>(received->message.body);
  };
  EXPECT_TRUE(answer(Role::Viewer, "open sesame"));
  EXPECT_TRUE(answer(Role::Viewer, "scalpel"));
  EXPECT_TRUE(answer(Role::Operator, "scalpel"));
  EXPECT_FALSE(answer(Role::Operator, "open sesame"));
  EXPECT_FALSE(answer(Role::Admin, "scalpel"));
  EXPECT_FALSE(answer(Role::Viewer, ""));
  EXPECT_FALSE(answer(Role::Viewer, "open sesam"));
  EXPECT_FALSE(answer(Role::Viewer, "open sesame "));
}

TEST(Server, BeyondLoopbackItWantsTokensAndTls) {
  MiniLoop loop(box_mesh(2));
  StreamConfig config = test_config();
  config.address = "0.0.0.0";
  const auto problem = [&] {
    try {
      Server server(config, loop.facts(), loop.initial(), loop);
      return std::string();
    } catch (const std::runtime_error& error) {
      return std::string(error.what());
    }
  };
  EXPECT_NE(problem().find("not loopback"), std::string::npos);
  config.tokens = {{"secret", {Role::Viewer}}};
  EXPECT_NE(problem().find("not loopback"), std::string::npos);
  // TLS alone lets everybody in just the same. The files are not looked at before that.
  config.tokens.clear();
  config.certificate_file = config.private_key_file = "/nowhere.pem";
  EXPECT_NE(problem().find("not loopback"), std::string::npos) << problem();
  config.tokens = {{"secret", {Role::Viewer}}};
  EXPECT_NE(problem().find("/nowhere.pem"), std::string::npos) << "both: allowed";
  config.certificate_file = config.private_key_file = "";
  config.insecure = true;
  EXPECT_EQ(problem(), "");
  config.address = "somewhere";
  EXPECT_NE(problem().find("\"somewhere\""), std::string::npos);
}

TEST(Server, APortInUseIsNamed) {
  TestServer test(2);
  MiniLoop loop(box_mesh(2));
  StreamConfig config = test_config();
  config.tcp_port = test.server.tcp_port();
  try {
    Server server(config, loop.facts(), loop.initial(), loop);
    FAIL() << "listened twice on one port";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("tcp_port"), std::string::npos);
    EXPECT_NE(std::string(error.what()).find(std::to_string(config.tcp_port)), std::string::npos);
  }
}

TEST(Server, ManyViewersAreServedWhileSomeStall) {
  StreamConfig config = test_config();
  config.max_handshakes = 300;
  config.outbox_bytes = 32 << 10;
  config.ring_bytes = 256 << 10;
  config.write_timeout_s = 20;
  TestServer test(5, config);
  std::vector<std::unique_ptr<Viewer>> stalled, viewers;
  for (int i = 0; i < 5; ++i) {
    stalled.push_back(
        std::make_unique<Viewer>(test.server.tcp_port(), hello(Role::Viewer, View::Volume), 4096));
  }
  for (int i = 0; i < 251; ++i) viewers.push_back(std::make_unique<Viewer>(test.server.tcp_port()));
  for (auto& viewer : viewers) ASSERT_TRUE(viewer->follow(0));
  for (int i = 0; i < 4; ++i) {
    test.cut(2);
    for (auto& viewer : viewers) ASSERT_TRUE(viewer->follow(test.loop.revision()));
  }
  const auto bytes = viewers[0]->replica.canonical_bytes();
  EXPECT_EQ(viewers[0]->replica.compute_state_hash(), test.loop.state_hash());
  for (auto& viewer : viewers) EXPECT_EQ(viewer->replica.canonical_bytes(), bytes);
}

TEST(Server, SaysGoodbyeWhenItStops) {
  auto test = std::make_unique<TestServer>();
  Viewer viewer(test->server.tcp_port());
  ASSERT_TRUE(viewer.follow(0));
  test->cut();
  test->server.stop();
  ASSERT_TRUE(viewer.follow(test->loop.revision())) << "what was published comes before the goodbye";
  const auto bye = viewer.peer.receive_until<protocol::Bye>();
  ASSERT_TRUE(bye);
  EXPECT_EQ(std::get<protocol::Bye>(bye->message.body).reason, ByeReason::ServerStops);
}

}  // namespace
}  // namespace incise::stream
