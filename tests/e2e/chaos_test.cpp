// Peers that connect, break off, stall, lie and come back, while a stroke runs: whoever survives holds the server's mesh.

#include <gtest/gtest.h>

#include <atomic>
#include <optional>
#include <random>
#include <thread>

#include "client/client.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/stream/viewer.hpp"

namespace incise::stream {
namespace {

using protocol::Role;
using protocol::View;

constexpr int kRounds = 300;

TEST(Chaos, SurvivorsHoldTheServersMesh) {
  StreamConfig config = test_config();
  config.outbox_bytes = 64 << 10;
  config.ring_bytes = 512 << 10;
  TestServer test(6, config);
  // One who is always there, and one whose connection is cut again and again.
  client::Options options;
  options.full_check_interval = 20;
  const auto steady = client::Client::connect("127.0.0.1", test.server.tcp_port(), options);
  options.reconnect = true;
  options.transport = client::TransportKind::kWebSocket;
  const auto cut_off = client::Client::connect("127.0.0.1", test.server.http_port(), options);

  std::atomic<bool> done{false};
  std::thread strokes([&] {
    for (int i = 0; i < 60 || !done; ++i) {
      const double y = test.side * (0.5 + 0.45 * (((i * 37) % 64) / 32.0 - 1));
      test.loop.cut(sweep(y, 60, std::int64_t{i} * 1'000'000'000 + 1, test.side));
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
      if (i == 400) break;
    }
  });

  constexpr std::uint64_t kSeed = 90210;
  std::mt19937_64 random(kSeed);
  std::optional<protocol::Replica> held;
  for (int round = 0; round < kRounds; ++round) {
    const std::string where = "seed " + std::to_string(kSeed) + ", round " + std::to_string(round);
    if (round % 25 == 0) cut_off->drop_connection();
    switch (random() % 6) {
      case 0: {  // leaves in the middle of its first message
        RawPeer peer(test.server.tcp_port());
        const protocol::Frame frame = protocol::encode(hello(Role::Viewer, View::Volume), {1, 0});
        peer.send(frame.tcp().first(1 + random() % frame.tcp().size()));
        if (random() % 2) peer.vanish();
        break;
      }
      case 1: {  // stays for a while, and keeps what it has
        Viewer viewer(test.server.tcp_port());
        ASSERT_TRUE(viewer.follow(0)) << where;
        ASSERT_TRUE(viewer.follow(viewer.replica.revision() + random() % 3)) << where;
        EXPECT_EQ(viewer.replica.compute_state_hash(), viewer.replica.state_hash()) << where;
        held = std::move(viewer.replica);
        viewer.peer.vanish();
        break;
      }
      case 2: {  // comes back
        if (!held) break;
        protocol::Hello back = hello(Role::Viewer, View::Volume);
        back.resume_session = 4711;
        back.resume_revision = held->revision();
        Viewer viewer(test.server.tcp_port(), back);
        viewer.replica = std::move(*held);
        held.reset();
        viewer.whole = true;
        const auto first = viewer.peer.receive_until<protocol::Welcome>();
        ASSERT_TRUE(first) << where;
        viewer.whole = std::get<protocol::Welcome>(first->message.body).resumed;
        ASSERT_TRUE(viewer.follow(std::get<protocol::Welcome>(first->message.body).revision)) << where;
        EXPECT_EQ(viewer.replica.compute_state_hash(), viewer.replica.state_hash()) << where;
        break;
      }
      case 3: {  // lies about where it was
        protocol::Hello liar = hello(Role::Viewer, View::Volume);
        liar.resume_session = random() % 2 ? 4711 : random();
        liar.resume_revision = random();
        Viewer viewer(test.server.tcp_port(), liar);
        ASSERT_TRUE(viewer.follow(0)) << where;
        EXPECT_FALSE(viewer.welcome.resumed) << where;
        break;
      }
      case 4: {  // asks for everything at once, and reads none of it
        RawPeer peer(test.server.tcp_port(), 4096);
        peer.send(hello(Role::Viewer, View::Volume));
        for (std::uint64_t i = 0; i < 20; ++i) peer.send(protocol::Resync{i, i, "again"}, 2 + i);
        break;
      }
      default: {  // garbage in an open session
        RawPeer peer(test.server.tcp_port());
        peer.send(hello(Role::Viewer, View::None));
        std::vector<std::byte> garbage(4 + random() % 200);
        for (std::byte& b : garbage) b = std::byte(random() & 0xff);
        peer.send(garbage);
        break;
      }
    }
  }
  done = true;
  strokes.join();
  test.wait_for_mirror();
  ASSERT_TRUE(steady->wait_for_revision(test.loop.revision(), 30)) << steady->last_error();
  ASSERT_TRUE(cut_off->wait_for_revision(test.loop.revision(), 30)) << cut_off->last_error();
  const auto bytes = [](const client::Client& c) {
    return c.read([](const protocol::Replica& mesh) { return mesh.canonical_bytes(); });
  };
  EXPECT_EQ(bytes(*steady), bytes(*cut_off));
  EXPECT_EQ(steady->read([](const protocol::Replica& m) { return m.compute_state_hash(); }),
            test.loop.state_hash());
  EXPECT_EQ(steady->counters().resyncs, 0u);
  EXPECT_GT(cut_off->counters().reconnects, 0u);
  Viewer late(test.server.tcp_port());
  ASSERT_TRUE(late.follow(test.loop.revision()));
  EXPECT_EQ(late.replica.canonical_bytes(), bytes(*steady));
}

}  // namespace
}  // namespace incise::stream
