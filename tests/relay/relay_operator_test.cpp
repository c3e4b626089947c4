// Operators and administrators at a relay.

#include <gtest/gtest.h>

#include <atomic>
#include <mutex>
#include <thread>

#include "tests/e2e/recovery.hpp"
#include "tests/e2e/served_session.hpp"
#include "tests/relay/relay_process.hpp"
#include "tests/stream/viewer.hpp"

namespace incise::relay {
namespace {

using e2e::Held;
using e2e::ServedSession;
using e2e::wait_for;
using protocol::Role;
using protocol::View;

// An administrator, and the last refusal that it got: the sequence that it answers, and why.
struct Admin {
  explicit Admin(std::uint16_t port) {
    client::Options options;
    options.role = Role::Admin;
    options.view = View::None;
    client::Callbacks callbacks;
    callbacks.on_error = [this](const protocol::Error& error) {
      const std::scoped_lock lock(mutex);
      refusal = std::to_string(error.in_reply_to) + ' ' + error.text;
    };
    link = client::Client::connect("127.0.0.1", port, options, callbacks);
  }
  std::string said() {
    const std::scoped_lock lock(mutex);
    return refusal;
  }
  std::mutex mutex;
  std::string refusal;
  std::unique_ptr<client::Client> link;
};

// An operator that cuts straight across the body.
struct Hand {
  Hand(const ServedSession& session, std::uint16_t port, const std::string& blade, bool take_over = false) {
    for (const core::Vec3& p : session.body().loaded.mesh.positions) extend(p, low, high);
    client::Options options;
    options.role = Role::Operator;
    options.view = View::None;
    options.source_name = blade;
    options.take_over = take_over;
    options.client_name = "hand";
    client::Callbacks callbacks;
    callbacks.on_error = [this](const protocol::Error& error) {
      const std::scoped_lock lock(mutex);
      refusal = error.text;
    };
    callbacks.on_force = [this](const protocol::Force& force) {
      ++forces;
      const auto& f = force.force_n;
      if (f.x * f.x + f.y * f.y + f.z * f.z > 0) ++felt;
    };
    link = client::Client::connect("127.0.0.1", port, options, callbacks);
  }
  // Lifts the blade at the end, unless it stays in the body.
  bool cut(double x, bool lift = true, double until = 1) {
    std::vector<protocol::PoseSample> poses;
    const int count = static_cast<int>(200 * until);
    for (int i = 0; i <= count; ++i) {
      const double s = i / 200.0;
      poses.push_back(
          {clock_ns += 4'000'000,
           {low.x + x * (high.x - low.x), low.y + (1.2 * s - 0.1) * (high.y - low.y), high.z + 0.01},
           {1, 0, 0, 0},
           i < count || !lift ? 1u : 0u,
           0});
    }
    sent += poses.size();
    std::uint64_t last = 0;
    // As from a hand: forces are for poses that are new.
    for (std::size_t i = 0; i < poses.size(); i += 4) {
      last = link->send_poses(std::span(poses).subspan(i, std::min<std::size_t>(4, poses.size() - i)));
      std::this_thread::sleep_for(std::chrono::milliseconds(pace_ms));
    }
    return link->wait_for_report(last, 60);
  }
  std::string said() {
    const std::scoped_lock lock(mutex);
    return refusal;
  }
  core::Vec3 low{1, 1, 1}, high{-1, -1, -1};
  std::int64_t clock_ns = 1'000'000'000;
  std::uint64_t sent = 0;
  int pace_ms = 0;
  std::atomic<int> forces{0}, felt{0};
  std::mutex mutex;
  std::string refusal;
  std::unique_ptr<client::Client> link;
};

struct Served {
  explicit Served(const std::string& name) : session(name, 4000, R"(, "checkpoint_replay_s": 1000)") {
    EXPECT_TRUE(session.start(false)) << session.log();
    relay = std::make_unique<RelayProcess>("127.0.0.1:" + std::to_string(session.tcp_port()),
                                           session.http_port());
    EXPECT_TRUE(relay->start()) << relay->log();
  }
  Held settled(client::Client& viewer) const {
    EXPECT_TRUE(wait_for([&] {
      return session.stat("/backlog/batches") == 0.0 && session.stat("/revision") == viewer.revision() &&
             e2e::last_mark_and_gaps(session.capture()).first == viewer.revision();
    }));
    return e2e::held(viewer);
  }
  ServedSession session;
  std::unique_ptr<RelayProcess> relay;
};

TEST(RelayOperator, CutsAtTheOriginAndHearsOfEachPose) {
  Served served("relay_operator");
  Hand hand(served.session, served.relay->tcp_port(), "blade");
  Hand direct(served.session, served.session.tcp_port(), "second");
  EXPECT_EQ(hand.link->welcome().source, 0u);
  EXPECT_EQ(hand.link->welcome().blade_tip, direct.link->welcome().blade_tip);
  EXPECT_EQ(hand.link->welcome().max_message_bytes, direct.link->welcome().max_message_bytes);
  hand.pace_ms = 4;
  ASSERT_TRUE(hand.cut(0.3));
  hand.pace_ms = 0;
  ASSERT_TRUE(hand.cut(0.6));
  EXPECT_TRUE(wait_for([&] { return hand.link->report().recorded == hand.sent; }))
      << hand.link->report().recorded << " of " << hand.sent << " on the origin's disk";
  const protocol::PoseReport report = hand.link->report();
  EXPECT_EQ(report.accepted, hand.sent);
  EXPECT_EQ(report.last_source_ns, hand.clock_ns) << "the operator's own times";
  EXPECT_EQ(report.recorded_source_ns, hand.clock_ns);
  EXPECT_EQ(report.recording, protocol::Recording::On);
  EXPECT_GT(hand.forces, 10);
  EXPECT_GT(hand.felt, 10);
  EXPECT_GT(served.session.stat("/cut_area_m2").value_or(0), 0);
  EXPECT_TRUE(wait_for([&] {
    return served.relay->stat("/relay/operators/0/round_trip_ms").value_or(0) > 0;
  })) << "its latency is shown";
  e2e::CaptureFollower capture(served.session);
  EXPECT_EQ(capture.follow(), "");
  EXPECT_EQ(capture.poses(), hand.sent);
  EXPECT_EQ(capture.gaps(), 0u);

  // What is refused there is refused here, in the same words; and a blade can be taken over from either side.
  const auto refusal = [&](std::uint16_t port, const std::string& blade) {
    stream::RawPeer raw(port);
    protocol::Hello hello = stream::hello(Role::Operator, View::None);
    hello.source_name = blade;
    raw.send(hello, 7);
    const auto received = raw.receive();
    const auto* error = received ? std::get_if<protocol::Error>(&received->message.body) : nullptr;
    return error ? std::to_string(static_cast<int>(error->code)) + (error->fatal ? " fatal " : " ") +
                       std::to_string(error->in_reply_to) + ' ' + error->text
                 : std::string("none");
  };
  for (const char* blade : {"blade", "second"}) {
    EXPECT_EQ(refusal(served.relay->tcp_port(), blade),
              "7 fatal 7 the blade \"" + std::string(blade) + "\" is held by another operator");
    EXPECT_EQ(refusal(served.session.tcp_port(), blade), refusal(served.relay->tcp_port(), blade));
  }
  Hand taker(served.session, served.relay->tcp_port(), "second", true);
  EXPECT_TRUE(wait_for([&] { return direct.link->status() == client::Status::kClosed; }));
  EXPECT_EQ(direct.link->last_error(), "another operator has taken the blade");
  Hand back(served.session, served.session.tcp_port(), "blade", true);
  EXPECT_TRUE(wait_for([&] { return hand.link->status() == client::Status::kClosed; }));
  EXPECT_EQ(hand.link->last_error(), "another operator has taken the blade");
  Hand here(served.session, served.relay->tcp_port(), "second", true);
  EXPECT_TRUE(wait_for([&] { return taker.link->status() == client::Status::kClosed; }))
      << "both are at the relay";
  EXPECT_EQ(taker.link->last_error(), "another operator has taken the blade");
  ASSERT_TRUE(here.cut(0.8));
}

// A tool without a button, and with a blade of its own, which is handed over in the end.
TEST(RelayOperator, BringsABladeAndEngagesAndHandsOver) {
  Served served("relay_blade");
  core::Vec3 low{1, 1, 1}, high{-1, -1, -1};
  for (const core::Vec3& p : served.session.body().loaded.mesh.positions) extend(p, low, high);
  client::Options options;
  options.role = Role::Operator;
  options.view = View::None;
  options.blade = protocol::BladeEdge{{0, 0, 0.01}, {0, 0, -0.5}};
  const auto tool = client::Client::connect("127.0.0.1", served.relay->tcp_port(), options);
  EXPECT_EQ(tool->welcome().blade_tip, options.blade->tip);
  EXPECT_EQ(tool->welcome().blade_heel, options.blade->heel);
  const auto pass = [&](std::int64_t from_ns) {
    std::vector<protocol::PoseSample> poses;
    for (int i = 0; i <= 100; ++i) {
      poses.push_back({from_ns + i * 4'000'000,
                       {(low.x + high.x) / 2, low.y + (0.012 * i - 0.1) * (high.y - low.y), high.z + 0.01},
                       {1, 0, 0, 0},
                       0,
                       0});
    }
    EXPECT_TRUE(tool->wait_for_report(tool->send_poses(poses), 60));
  };
  pass(1'000'000'000);
  EXPECT_EQ(served.session.stat("/strokes"), 0.0) << "no button, no cut";
  ASSERT_TRUE(tool->engage(2'000'000'000));
  pass(2'000'000'000);
  ASSERT_TRUE(tool->end_stroke(3'000'000'000));
  EXPECT_TRUE(wait_for([&] { return served.session.stat("/strokes") == 1.0; }));
  pass(4'000'000'000);
  EXPECT_TRUE(wait_for([&] { return served.session.stat("/backlog/batches") == 0.0; }));
  EXPECT_EQ(served.session.stat("/strokes"), 1.0) << "it ended at the origin";
  EXPECT_GT(served.session.stat("/cut_area_m2").value_or(0), 0);
  e2e::CaptureFollower capture(served.session);
  EXPECT_TRUE(wait_for([&] { return capture.follow().empty() && capture.poses() == 303; }));
  EXPECT_EQ(capture.revision(), served.session.stat("/revision")) << "cut with that blade";
  tool->close();
  EXPECT_TRUE(wait_for([&] { return served.session.stat("/sources") == 0.0; }));

  stream::RawPeer raw(served.relay->tcp_port());
  raw.send(stream::hello(Role::Operator, View::None));
  ASSERT_TRUE(raw.receive_until<protocol::Welcome>());
  raw.send(protocol::StrokeControl{protocol::StrokeAction::HandOver, 1}, 2);
  const auto bye = raw.receive_until<protocol::Bye>();
  ASSERT_TRUE(bye);
  EXPECT_EQ(std::get<protocol::Bye>(bye->message.body).reason, protocol::ByeReason::HandedOver);
  EXPECT_TRUE(wait_for([&] { return served.session.stat("/sources") == 0.0; }))
      << "the blade is free at the origin";
}

TEST(RelayOperator, EndsItsStrokeWhenTheRelayIsKilled) {
  Served served("relay_killed");
  {
    Hand hand(served.session, served.relay->tcp_port(), "blade");
    ASSERT_TRUE(hand.cut(0.5, false, 0.5));
    ASSERT_EQ(served.session.stat("/sources"), 1.0);
    served.relay->kill();
    EXPECT_TRUE(wait_for([&] { return served.session.stat("/sources") == 0.0; })) << "its stroke ends";
  }
  e2e::CaptureFollower capture(served.session);
  EXPECT_TRUE(wait_for([&] { return capture.follow().empty() && !capture.in_stroke(); }));
  Hand direct(served.session, served.session.tcp_port(), "blade");
  EXPECT_TRUE(direct.cut(0.7));
}

TEST(RelayOperator, LeavesWhenTheOriginGoesAndComesBackWithIt) {
  Served served("relay_origin_gone");
  client::Options options;
  options.role = Role::Operator;
  options.view = View::None;
  options.reconnect = true;
  const auto hand = client::Client::connect("127.0.0.1", served.relay->tcp_port(), options);
  served.session.kill();
  EXPECT_TRUE(wait_for([&] { return hand->status() == client::Status::kReconnecting; }))
      << "what it sent may be lost, so it hears of it";
  ASSERT_TRUE(served.session.start(true)) << served.session.log();
  EXPECT_TRUE(wait_for([&] { return hand->status() == client::Status::kConnected; })) << hand->last_error();
  const protocol::PoseSample pose{1, {0, 0, 1}, {1, 0, 0, 0}, 0, 0};
  EXPECT_TRUE(hand->wait_for_report(hand->send_poses(std::span(&pose, 1)), 20));
}

// Before the client's own deadline, which began earlier.
TEST(RelayOperator, HearsWhyItsBladeDoesNotOpen) {
  Served served("relay_origin_away");
  served.session.kill();
  ASSERT_TRUE(wait_for([&] { return served.relay->health() == 503; }));
  client::Options options;
  options.role = Role::Operator;
  options.view = View::None;
  try {
    client::Client::connect("127.0.0.1", served.relay->tcp_port(), options);
    ADD_FAILURE() << "the blade opened without its server";
  } catch (const std::exception& error) {
    const std::string why = error.what();
    EXPECT_NE(why.find("the server that has the blade does not answer: no connection to"), std::string::npos)
        << why;
  }
}

TEST(RelayOperator, UndoAndResetReachTheOriginAndItsRefusalsComeBack) {
  Served served("relay_undo");
  Witness viewer(served.relay->tcp_port());
  ASSERT_TRUE(viewer.client().wait_for_revision(0, 60));
  std::vector<Held> before{served.settled(viewer.client())};
  Hand hand(served.session, served.relay->tcp_port(), "blade");
  for (const double x : {0.3, 0.6}) {
    ASSERT_TRUE(hand.cut(x));
    before.push_back(served.settled(viewer.client()));
  }
  Hand other(served.session, served.relay->tcp_port(), "another");
  other.link->undo();
  EXPECT_TRUE(wait_for([&] { return !other.said().empty(); }));
  EXPECT_EQ(other.said(),
            "Undo: the last stroke is that of blade \"blade\", and your blade has none to undo: its operator "
            "or an admin may undo it");
  const std::uint64_t epoch = viewer.client().welcome().session;
  hand.link->undo();
  EXPECT_TRUE(wait_for([&] { return viewer.client().welcome().session != epoch; })) << hand.said();
  EXPECT_EQ(viewer.client().welcome().restart,
            (protocol::Restart{protocol::RestartKind::Undo, Role::Operator, "blade", 0, "blade"}))
      << "behind a relay, too, it is known who it was";
  EXPECT_EQ(served.settled(viewer.client()), before[1]);
  EXPECT_EQ(viewer.went_back(), 0) << "it goes back in another epoch only";

  // An administrator, too.
  Admin admin(served.relay->tcp_port());
  admin.link->undo();
  EXPECT_TRUE(wait_for([&] { return viewer.epochs() == 2; }));
  EXPECT_EQ(served.settled(viewer.client()), before[0]);
  // The server may not have counted the last undo yet: then the next one does nothing.
  const auto refused = [&] {
    return admin.said().find("Undo: there is no stroke to undo: only those since") != std::string::npos &&
           !admin.said().starts_with("0 ");
  };
  for (int i = 0; i < 20 && !refused(); ++i) {
    admin.link->undo();
    std::this_thread::sleep_for(std::chrono::milliseconds(500));
  }
  EXPECT_TRUE(refused()) << admin.said();
  ASSERT_TRUE(hand.cut(0.5));
  ASSERT_GT(served.settled(viewer.client()).revision, 0u);
  admin.link->reset();
  EXPECT_TRUE(wait_for([&] { return viewer.epochs() >= 3 && viewer.client().revision() == 0; }));
  EXPECT_EQ(e2e::held(viewer.client()), before[0]);
  EXPECT_EQ(viewer.went_back(), 0);
}

// What the origin refuses only later comes back, too: here a reset overtakes undos that wait for a stroke to end.
TEST(RelayOperator, ALateRefusalOfAnUndoComesBack) {
  Served served("relay_late_undo");
  Witness viewer(served.relay->tcp_port());
  ASSERT_TRUE(viewer.client().wait_for_revision(0, 60));
  Hand hand(served.session, served.relay->tcp_port(), "blade");
  ASSERT_TRUE(hand.cut(0.3));
  ASSERT_GT(served.settled(viewer.client()).revision, 0u);
  ASSERT_TRUE(hand.cut(0.6, false, 0.5));
  Admin admin(served.relay->tcp_port());
  hand.link->undo();
  admin.link->undo();
  const std::string line = "an undo is asked for by ";
  const auto asked = [&] {
    const std::string log = served.session.log();
    return log.find(line) != log.rfind(line);
  };
  EXPECT_TRUE(wait_for(asked)) << served.session.log();
  Admin(served.session.tcp_port()).link->reset();
  const std::string refusal = "Undo: the mesh was reset first: there is no stroke to undo";
  EXPECT_TRUE(wait_for([&] { return hand.said() == refusal; })) << hand.said();
  EXPECT_TRUE(wait_for([&] { return admin.said().ends_with(refusal); })) << admin.said();
  EXPECT_FALSE(admin.said().starts_with("0 ")) << "it names what it answers";
  EXPECT_EQ(served.session.stat("/access/undos"), 0.0);
}

// Through a relay, too, an undo is for the strokes that were sent before it: what comes behind it is never removed.
TEST(RelayOperator, AStrokeBehindAnUndoStays) {
  Served served("relay_undo_order");
  Witness viewer(served.relay->tcp_port());
  ASSERT_TRUE(viewer.client().wait_for_revision(0, 60));
  Hand hand(served.session, served.relay->tcp_port(), "blade");
  for (const double x : {0.3, 0.6}) ASSERT_TRUE(hand.cut(x));
  const Held before = served.settled(viewer.client());
  const std::uint64_t epoch = viewer.client().welcome().session;
  const auto is_answered = [&] { return !hand.said().empty() || viewer.client().welcome().session != epoch; };
  hand.link->undo();
  ASSERT_TRUE(hand.cut(0.8));
  EXPECT_TRUE(wait_for(is_answered));
  EXPECT_NE(served.settled(viewer.client()).hash, before.hash) << "it is the last stroke that was removed";
  if (viewer.client().welcome().session != epoch) return;  // it was done before the stroke began
  EXPECT_TRUE(
      hand.said().starts_with("Undo: a stroke has begun since, of blade \"blade\", so nothing was undone"))
      << hand.said();
}

TEST(RelayOperator, SimulatorsAreSentToTheOrigin) {
  Served served("relay_simulator");
  client::Options options;
  options.role = Role::Simulator;
  try {
    client::Client::connect("127.0.0.1", served.relay->tcp_port(), options);
    FAIL() << "it was let in";
  } catch (const client::ConnectError& error) {
    EXPECT_NE(std::string(error.what()).find("simulators, and values of fields, go to the server that cuts"),
              std::string::npos)
        << error.what();
  }
}

}  // namespace
}  // namespace incise::relay
