// Peers that connect, break off, stall, lie and come back, while a stroke runs: those that survive hold the server's mesh.
// INCISE_CHAOS_ROUNDS=2000 makes it long.

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <memory>
#include <optional>
#include <random>
#include <thread>
#include <variant>

#include "client/client.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/stream/viewer.hpp"

namespace incise::stream {
namespace {

using protocol::Role;
using protocol::View;

constexpr int kRounds = 150;

int rounds() {
  const char* const given = std::getenv("INCISE_CHAOS_ROUNDS");
  return given ? std::max(1, std::atoi(given)) : kRounds;
}

// One who comes and goes, and keeps what it has in between.
class Wanderer {
 public:
  Wanderer(std::uint16_t port, View view, const std::optional<protocol::Box>& box) : port_(port) {
    hello_ = hello(Role::Viewer, view);
    hello_.box = box;
    if (view == View::Surface) {
      held_.emplace<protocol::SurfaceReplica>();
    } else if (box) {
      held_.emplace<protocol::VolumePart>();
    }
  }

  // A visit, with what it holds, or as if it held something else; it stays for so many messages, and leaves in the middle
  // of one. False where a part of the state did not fit.
  bool visit(std::uint64_t messages, bool lies, std::size_t more_bytes) {
    connect(lies);
    // Half of the visits last until the state is whole.
    while (messages % 2 == 0 && awaits_snapshot_)
      if (!take_one()) return false;
    // So that as much comes also where nothing is cut meanwhile.
    for (std::uint64_t i = 0; i < messages + 2; ++i) peer_->send(protocol::Ping{i, 0}, 2 + i);
    for (; messages > 0; --messages)
      if (!take_one()) return false;
    peer_->read_all(1 + more_bytes % (awaits_snapshot_ ? 2000 : 40));
    peer_->vanish();
    return true;
  }
  // The last one.
  bool follow(std::uint64_t revision) {
    connect(false);
    while (awaits_snapshot_ || this->revision() < revision)
      if (!take_one()) return false;
    return true;
  }
  std::vector<std::byte> canonical_bytes() const {
    return std::visit([](const auto& state) { return state.canonical_bytes(); }, held_);
  }
  std::uint64_t resumed() const { return resumed_; }

 private:
  std::uint64_t revision() const {
    return std::visit([](const auto& state) { return state.revision(); }, held_);
  }
  void connect(bool lies) {
    protocol::Hello back = hello_;
    if (has_state_ || lies) {
      back.resume_session = 4711;
      back.resume_revision = revision() + (lies ? 1'000'000 : 0);
    }
    awaits_snapshot_ = true;
    peer_ = std::make_unique<RawPeer>(port_);
    peer_->send(back);
  }
  bool take_one() {
    const auto received = peer_->receive();
    if (!received) return false;
    const protocol::Body& body = received->message.body;
    if (const auto* welcome = std::get_if<protocol::Welcome>(&body)) {
      awaits_snapshot_ = !welcome->resumed;
      resumed_ += welcome->resumed;
    }
    const protocol::ApplyResult result =
        std::visit([&](auto& state) { return this->take(state, body); }, held_);
    EXPECT_TRUE(result) << result.text;
    return static_cast<bool>(result);
  }
  template <class State>
  protocol::ApplyResult take(State& state, const protocol::Body& body) {
    using Delta = std::conditional_t<std::is_same_v<State, protocol::SurfaceReplica>, protocol::SurfaceDelta,
                                     protocol::Delta>;
    if (const auto* begin = std::get_if<protocol::SnapshotBegin>(&body)) return state.begin(*begin);
    if (const auto* chunk = std::get_if<protocol::SnapshotChunk>(&body)) return state.chunk(*chunk);
    if (const auto* delta = std::get_if<Delta>(&body)) return state.apply(*delta);
    if (const auto* end = std::get_if<protocol::SnapshotEnd>(&body)) {
      awaits_snapshot_ = false;
      has_state_ = true;
      return state.end(*end);
    }
    return {};
  }

  std::uint16_t port_;
  protocol::Hello hello_;
  std::unique_ptr<RawPeer> peer_;
  std::variant<protocol::Replica, protocol::SurfaceReplica, protocol::VolumePart> held_;
  bool has_state_ = false, awaits_snapshot_ = true;
  std::uint64_t resumed_ = 0;
};

TEST(Chaos, SurvivorsHoldTheServersMesh) {
  StreamConfig config = test_config();
  config.outbox_bytes = 64 << 10;
  config.ring_bytes = 4 << 20;
  TestServer test(6, config);
  // One who is always there, and one whose connection is cut again and again.
  client::Options options;
  options.full_check_interval = 20;
  const auto steady = client::Client::connect("127.0.0.1", test.server.tcp_port(), options);
  options.reconnect = true;
  options.transport = client::TransportKind::kWebSocket;
  const auto cut_off = client::Client::connect("127.0.0.1", test.server.http_port(), options);

  std::atomic<bool> done{false};
  std::atomic<int> round{0};
  std::thread strokes([&] {
    for (int i = 0; i < 60 || !done; ++i) {
      // As long as the peers come, and no faster: the mesh shall not be sliced to dust.
      while (!done && i > 60 + round) std::this_thread::sleep_for(std::chrono::milliseconds(1));
      const double y = test.side * (0.5 + 0.45 * (((i * 37) % 64 + 0.1 * (i / 64 % 10)) / 32.0 - 1));
      test.loop.cut(sweep(y, 60, std::int64_t{i} * 1'000'000'000 + 1, test.side));
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  });

  constexpr std::uint64_t kSeed = 90210;
  std::mt19937_64 random(kSeed);
  std::optional<protocol::Replica> held;
  const protocol::Box box{{0, 0, 0}, {test.side / 2, test.side / 2, test.side}};
  std::vector<std::unique_ptr<Wanderer>> wanderers;
  for (const View view : {View::Volume, View::Surface}) {
    wanderers.push_back(std::make_unique<Wanderer>(test.server.tcp_port(), view, std::nullopt));
    wanderers.push_back(std::make_unique<Wanderer>(test.server.tcp_port(), view, box));
  }
  for (; round < rounds(); ++round) {
    const std::string where = "seed " + std::to_string(kSeed) + ", round " + std::to_string(round);
    if (round % 25 == 0) cut_off->drop_connection();
    switch (random() % 9) {
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
      case 5:
      case 6: {  // one of those who keep theirs
        Wanderer& wanderer = *wanderers[random() % wanderers.size()];
        ASSERT_TRUE(wanderer.visit(1 + random() % 20, random() % 4 == 0, random())) << where;
        ASSERT_TRUE(wanderer.visit(1 + random() % 20, random() % 4 == 0, random())) << where;
        break;
      }
      case 7: {  // stalls, and then reads on
        Viewer viewer(test.server.tcp_port(), hello(Role::Viewer, View::Volume), 4096);
        std::this_thread::sleep_for(std::chrono::milliseconds(random() % 30));
        ASSERT_TRUE(viewer.follow(0)) << where;
        EXPECT_EQ(viewer.replica.compute_state_hash(), viewer.replica.state_hash()) << where;
        viewer.peer.vanish();
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

  protocol::SurfaceReplica surface, surface_part;
  protocol::VolumePart part;
  surface.load(late.replica);
  surface_part.load_part(surface, box);
  part.load_part(late.replica, box);
  const std::vector<std::byte> expected[] = {late.replica.canonical_bytes(), part.canonical_bytes(),
                                             surface.canonical_bytes(), surface_part.canonical_bytes()};
  std::uint64_t resumed = 0;
  for (std::size_t i = 0; i < wanderers.size(); ++i) {
    ASSERT_TRUE(wanderers[i]->follow(test.loop.revision())) << i;
    EXPECT_EQ(wanderers[i]->canonical_bytes(), expected[i]) << i;
    resumed += wanderers[i]->resumed();
  }
  EXPECT_GT(resumed, 0u);
}

}  // namespace
}  // namespace incise::stream
