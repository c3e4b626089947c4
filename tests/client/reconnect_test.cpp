// Connections that end: what a client keeps, what it forgets, and when it stays away.

#include <gtest/gtest.h>

#include <functional>
#include <future>
#include <memory>
#include <thread>
#include <vector>

#include "client/client.hpp"
#include "client/clock_estimate.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::client {
namespace {

using protocol::ByeReason;
using stream::eventually;
using stream::RawPeer;

constexpr double kPatience_s = 20;

// Accepts a client and welcomes it. Returns its connection.
std::unique_ptr<RawPeer> welcome(const stream::Listener& listener, std::vector<protocol::Hello>& hellos) {
  std::unique_ptr<RawPeer> peer = listener.accept();
  if (const auto hello = peer->receive_until<protocol::Hello>())
    hellos.push_back(std::get<protocol::Hello>(hello->message.body));
  peer->send(protocol::Welcome{});
  return peer;
}

Options operator_options() {
  Options options;
  options.role = protocol::Role::Operator;
  options.view = protocol::View::None;
  options.reconnect = true;
  return options;
}

TEST(Reconnect, AnOperatorTakesItsBladeBackAndForgetsTheLastReport) {
  const stream::Listener listener;
  std::vector<protocol::Hello> hellos;
  std::promise<void> reported;
  std::thread server([&] {
    {
      const auto peer = welcome(listener, hellos);
      protocol::PoseReport report;
      report.through_sequence = 9;
      peer->send(report);
      reported.get_future().wait();
    }
    welcome(listener, hellos)->receive_until<protocol::Bye>();
  });
  auto client = Client::connect("127.0.0.1", listener.port(), operator_options());
  EXPECT_TRUE(client->wait_for_report(9, kPatience_s));
  reported.set_value();
  EXPECT_TRUE(eventually([&] { return client->counters().reconnects == 1; }));
  EXPECT_EQ(client->report().through_sequence, 0u);
  client.reset();
  server.join();
  ASSERT_EQ(hellos.size(), 2u);
  EXPECT_FALSE(hellos[0].take_over);
  EXPECT_TRUE(hellos[1].take_over) << "the server may still count the blade as held";
}

// After a reset or an undo the server welcomes again, on the same connection.
TEST(Reconnect, AWelcomeOnAConnectionThatGoesOnIsNone) {
  const stream::Listener listener;
  std::vector<protocol::Hello> hellos;
  std::thread server([&] {
    const auto peer = welcome(listener, hellos);
    protocol::Welcome again;
    again.session = 7;
    peer->send(again);
    peer->receive_until<protocol::Bye>();
  });
  auto client = Client::connect("127.0.0.1", listener.port(), operator_options());
  EXPECT_TRUE(eventually([&] { return client->welcome().session == 7; }));
  EXPECT_EQ(client->counters().reconnects, 0u);
  client.reset();
  server.join();
}

// The welcome and the connection's end come at once, before connect() looks: it has been connected, and will be again.
TEST(Reconnect, AConnectionLostRightAfterTheWelcomeIsMadeAgain) {
  const stream::Listener listener;
  std::vector<protocol::Hello> hellos;
  const std::jthread server([&] {
    welcome(listener, hellos)->shut_down();
    welcome(listener, hellos)->receive_until<protocol::Bye>();
  });
  Options options = operator_options();
  options.background = false;  // then connect() handles all that has come before it looks
  const auto client = Client::connect("127.0.0.1", listener.port(), options);
  EXPECT_TRUE(eventually([&] { return client->poll(0.01) && client->counters().reconnects == 1; }));
}

// Poses wait for a network that is behind, up to a bound; with the connection they are gone, and so is the bound.
TEST(Reconnect, WhatWaitedForALostConnectionIsForgotten) {
  const stream::Listener listener;
  std::vector<protocol::Hello> hellos;
  std::promise<void> full;
  std::thread server([&] {
    {
      const auto peer = welcome(listener, hellos);
      full.get_future().wait();  // and reads nothing
    }
    welcome(listener, hellos)->receive_until<protocol::Bye>();
  });
  Options options = operator_options();
  options.max_outbox_bytes = 1u << 20;
  auto client = Client::connect("127.0.0.1", listener.port(), options);
  const std::vector<protocol::PoseSample> poses(protocol::kMaxPosesPerBatch);
  int accepted = 0;
  while (accepted < 100 && client->send_poses(poses) != 0) ++accepted;
  EXPECT_LT(accepted, 100) << "60 MB wait for a server that reads nothing";
  full.set_value();
  EXPECT_TRUE(eventually([&] { return client->counters().reconnects == 1; }));
  const std::vector<float> place(3);
  protocol::Positions positions;
  positions.f32 = place;
  EXPECT_TRUE(eventually([&] { return client->send_positions(positions) != 0; }, 5));
  client.reset();
  server.join();
}

TEST(Reconnect, WhoWasSentAwayForGoodStaysAway) {
  for (const ByeReason reason : {ByeReason::HandedOver, ByeReason::Refused, ByeReason::ServerStops}) {
    const bool comes_back = reason == ByeReason::ServerStops;
    const stream::Listener listener;
    std::vector<protocol::Hello> hellos;
    std::promise<void> connected;
    std::thread server([&] {
      const auto peer = welcome(listener, hellos);
      connected.get_future().wait();
      peer->send(protocol::Bye{reason, "goodbye"});
      if (comes_back) welcome(listener, hellos)->receive_until<protocol::Bye>();
    });
    auto client = Client::connect("127.0.0.1", listener.port(), operator_options());
    connected.set_value();
    EXPECT_TRUE(eventually(
        [&] { return comes_back ? client->counters().reconnects == 1 : client->status() == Status::kClosed; },
        5))
        << static_cast<int>(reason);
    EXPECT_TRUE(comes_back || client->last_error() == "goodbye") << client->last_error();
    client.reset();
    server.join();
  }
}

TEST(ClockEstimate, TheShortestOfTheLastPingsCounts) {
  ClockEstimate clock;
  const auto add = [&](std::int64_t sent_ns, std::int64_t round_trip_ns, std::int64_t offset_ns) {
    protocol::Pong pong;
    pong.ping_sent_ns = sent_ns;
    pong.received_ns = sent_ns + round_trip_ns / 2 + offset_ns;
    clock.add(pong, sent_ns + round_trip_ns);
  };
  add(1000, 500, 70);
  EXPECT_EQ(clock.round_trip_ns(), 500);
  EXPECT_EQ(clock.offset_ns(), 70);
  add(2000, 100, 50);
  add(3000, 900, 90);
  add(4000, -1, 10);  // a clock that goes backwards tells nothing
  EXPECT_EQ(clock.round_trip_ns(), 100);
  EXPECT_EQ(clock.offset_ns(), 50);
  for (std::size_t i = 0; i < ClockEstimate::kPings; ++i) add(5000, 200, 60);
  EXPECT_EQ(clock.round_trip_ns(), 200) << "the shortest was too long ago";
  EXPECT_EQ(clock.offset_ns(), 60);
}

}  // namespace
}  // namespace incise::client
