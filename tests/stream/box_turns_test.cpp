// What sessions with a box of interest may cost.

#include "server/stream/box_turns.hpp"
#include "server/base/clock.hpp"

#include <gtest/gtest.h>

#include <ctime>
#include <memory>
#include <vector>

#include "protocol/volume_part.hpp"
#include "server/stream/counters.hpp"
#include "server/stream/mirror.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/viewer.hpp"

namespace incise::stream {
namespace {

using protocol::Role;
using protocol::View;

constexpr protocol::Box kEverything{{-1, -1, -1}, {1, 1, 1}};

protocol::Hello boxed(View view = View::Volume) {
  protocol::Hello h = hello(Role::Viewer, view);
  h.box = kEverything;
  return h;
}

// A viewer of view Volume with a box.
struct BoxViewer {
  explicit BoxViewer(std::uint16_t port) : peer(port) { peer.send(boxed()); }
  // Until the part is at `revision`, or the server says that the box is not available.
  bool follow(std::uint64_t revision) {
    while (!whole || part.revision() < revision) {
      const auto received = peer.receive();
      if (!received) return false;
      const protocol::Body& body = received->message.body;
      protocol::ApplyResult result;
      if (const auto* begin = std::get_if<protocol::SnapshotBegin>(&body)) {
        result = part.begin(*begin);
      } else if (const auto* chunk = std::get_if<protocol::SnapshotChunk>(&body)) {
        result = part.chunk(*chunk);
      } else if (const auto* end = std::get_if<protocol::SnapshotEnd>(&body)) {
        result = part.end(*end);
        whole = true;
      } else if (const auto* delta = std::get_if<protocol::Delta>(&body)) {
        result = part.apply(*delta);
        ++deltas;
        steps += delta->steps.size();
      }
      EXPECT_TRUE(result) << result.text;
      if (!result) return false;
    }
    return true;
  }

  RawPeer peer;
  protocol::VolumePart part;
  bool whole = false;
  std::size_t deltas = 0, steps = 0;
};

TEST(TimeShare, WorkGetsItsShareAndWhatWasSaved) {
  constexpr std::int64_t kMs = 1'000'000, kSecond = 1000 * kMs;
  for (const double share : {0.2, 0.01}) {
    for (const std::int64_t cost : {kMs / 100, kMs, 30 * kMs}) {
      TimeShare time(share);
      std::int64_t now = 100 * kSecond, spent = 0;
      const std::int64_t end = now + 20 * kSecond;
      while (now < end) {
        now = std::max(now, time.free_at_ns());
        now += cost;
        time.spend(cost, now);
        spent += cost;
      }
      const double most = share * static_cast<double>(20 * kSecond + TimeShare::kSaved_ns);
      EXPECT_LE(static_cast<double>(spent), most + 2 * static_cast<double>(cost)) << share << ' ' << cost;
      EXPECT_GE(static_cast<double>(spent), 0.95 * share * 20 * kSecond - static_cast<double>(cost));
    }
  }
}

// Three boxes want more than their share: each still gets every step, in fewer deltas, and what they cost stays within the
// share. A session without a box gets each delta.
TEST(BoxTurns, BeyondTheirShareBoxesGetFewerDeltas) {
  StreamConfig config = test_config();
  config.box_share = 0.02;  // the third waits for a tenth of the time after which a box is refused
  const std::int64_t began = monotonic_ns();
  TestServer test(6, config);
  std::vector<std::unique_ptr<BoxViewer>> viewers;
  for (int i = 0; i < 3; ++i) viewers.push_back(std::make_unique<BoxViewer>(test.server.tcp_port()));
  for (const auto& viewer : viewers) ASSERT_TRUE(viewer->follow(0));
  Viewer plain(test.server.tcp_port());
  ASSERT_TRUE(plain.follow(0));
  test.cut(10);
  const std::uint64_t head = test.loop.revision();
  ASSERT_TRUE(plain.follow(head));
  protocol::VolumePart expected;
  expected.load_part(plain.replica, kEverything);
  for (const auto& viewer : viewers) {
    ASSERT_TRUE(viewer->follow(head));
    EXPECT_EQ(viewer->steps, head);
    EXPECT_LT(viewer->deltas, head / 2);
    EXPECT_EQ(viewer->part.canonical_bytes(), expected.canonical_bytes());
  }
  EXPECT_EQ(plain.deltas, head);
  // A turn is counted once its delta is on its way.
  const std::uint64_t deltas = viewers[0]->deltas + viewers[1]->deltas + viewers[2]->deltas;
  EXPECT_TRUE(eventually([&] { return test.server.counters().box_turns >= deltas; }));
  const StreamCounters counters = test.server.counters();
  EXPECT_GT(counters.box_coalesced, 0u);
  EXPECT_EQ(counters.boxes_refused, 0u);
  EXPECT_EQ(counters.box_turns, deltas);
  const std::uint64_t last =
      counters.box_turns_ns / counters.box_turns * 20;  // one that took long may be the last
  EXPECT_LE(counters.box_turns_ns,
            last + static_cast<std::uint64_t>(config.box_share * static_cast<double>(monotonic_ns() - began +
                                                                                     TimeShare::kSaved_ns)));
}

// A box whose turn takes so long of the thread's time.
struct BusyBox final : BoxHolder {
  explicit BusyBox(std::int64_t ns) : turn_ns(ns) {}
  bool wants_box_turn() const override { return !lost; }
  void skip_box_turn() override {}
  bool make_box_delta() override {
    const std::int64_t until_ns = clock_ns(CLOCK_THREAD_CPUTIME_ID) + turn_ns;
    while (clock_ns(CLOCK_THREAD_CPUTIME_ID) < until_ns) {
    }
    ++turns;
    return true;
  }
  void lose_box() override { lost = true; }

  const std::int64_t turn_ns;
  int turns = 0;
  bool lost = false;
};

TEST(BoxTurns, TheBoxThatTookLongestIsRefusedFirst) {
  asio::io_context io{1};
  SharedCounters counters;
  BoxTurns turns(io, 0.001, counters);
  const auto quick = std::make_shared<BusyBox>(100'000), slow = std::make_shared<BusyBox>(30'000'000);
  const auto run_until = [&io](const auto& condition) {
    for (; !condition(); io.restart()) io.run_one();
  };
  for (const auto& box : {quick, slow}) {
    turns.ask(box);
    run_until([&box] { return box->turns > 0; });
  }
  // The slow one's turn has used up the time of the next 30 s, and none may wait for more than 2.
  turns.ask(quick);
  turns.ask(slow);
  run_until([&] { return quick->lost || slow->lost; });
  EXPECT_TRUE(slow->lost);
  EXPECT_FALSE(quick->lost);
}

// There is next to no time for boxes: each loses its own, is told so, and gets everything.
TEST(BoxTurns, ABoxThatWouldWaitTooLongIsRefused) {
  StreamConfig config = test_config();
  config.box_share = 1e-6;
  TestServer test(6, config);
  std::vector<std::unique_ptr<RawPeer>> peers;
  for (int i = 0; i < 2; ++i) {
    peers.push_back(std::make_unique<RawPeer>(test.server.tcp_port()));
    peers.back()->send(boxed(i == 0 ? View::Volume : View::Surface));
    ASSERT_TRUE(peers.back()->receive_until<protocol::SnapshotEnd>());
  }
  // The first turn costs nothing yet; who got it waits from the second cut on.
  test.cut(1);
  ASSERT_TRUE(eventually([&] { return test.server.counters().box_turns > 0; }));
  test.cut(1);
  for (const auto& peer : peers) {
    const auto error = peer->receive_until<protocol::Error>();
    ASSERT_TRUE(error);
    EXPECT_EQ(std::get<protocol::Error>(error->message.body).code, protocol::ErrorCode::NotAvailable);
    EXPECT_FALSE(std::get<protocol::Error>(error->message.body).fatal);
    const auto begin = peer->receive_until<protocol::SnapshotBegin>();
    ASSERT_TRUE(begin);
    EXPECT_FALSE(std::get<protocol::SnapshotBegin>(begin->message.body).box);
    EXPECT_EQ(std::get<protocol::SnapshotBegin>(begin->message.body).revision, test.loop.revision());
  }
  EXPECT_EQ(test.server.counters().boxes_refused, 2u);
  EXPECT_EQ(test.server.counters().part_bytes, 0u);
  EXPECT_EQ(test.server.counters().slow_snapshots, 0u) << "it was the server that was slow";
}

}  // namespace
}  // namespace incise::stream
