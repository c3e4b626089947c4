#include "client/client.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <string>
#include <thread>
#include <utility>

#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::client {
namespace {

using protocol::Role;
using protocol::View;
using stream::TestServer;

constexpr double kPatience_s = 20;

Options options(Role role = Role::Viewer, TransportKind transport = TransportKind::kTcp,
                View view = View::Volume) {
  Options o;
  o.role = role;
  o.transport = transport;
  o.view = view;
  o.full_check_interval = 5;
  return o;
}

std::unique_ptr<Client> connect(TestServer& test, Options o, Callbacks callbacks = {}) {
  const std::uint16_t port =
      o.transport == TransportKind::kTcp ? test.server.tcp_port() : test.server.http_port();
  return Client::connect("127.0.0.1", port, std::move(o), std::move(callbacks));
}

std::vector<std::byte> bytes_of(const Client& client) {
  return client.read([](const protocol::Replica& mesh) { return mesh.canonical_bytes(); });
}

TEST(Client, BothTransportsHoldTheServersMesh) {
  TestServer test;
  std::atomic<int> resyncs{0};
  Callbacks count;
  count.on_resync = [&](const std::string&) { ++resyncs; };
  const auto tcp = connect(test, options(), count);
  const auto web = connect(test, options(Role::Viewer, TransportKind::kWebSocket), count);
  test.cut(3);
  const auto late = connect(test, options(Role::Viewer, TransportKind::kWebSocket), count);
  test.cut(3);
  for (Client* client : {tcp.get(), web.get(), late.get()}) {
    ASSERT_TRUE(client->wait_for_revision(test.loop.revision(), kPatience_s)) << client->last_error();
  }
  EXPECT_EQ(tcp->counters().steps, test.loop.revision());
  const auto bytes = bytes_of(*tcp);
  EXPECT_GT(bytes.size(), 10'000u);
  EXPECT_EQ(bytes_of(*web), bytes);
  EXPECT_EQ(bytes_of(*late), bytes);
  EXPECT_EQ(tcp->read([](const protocol::Replica& m) { return m.compute_state_hash(); }),
            test.loop.state_hash());
  EXPECT_EQ(resyncs, 0);
}

TEST(Client, TheSurfaceIsThatOfTheVolume) {
  TestServer test;
  const auto volume = connect(test, options());
  const auto surface = connect(test, options(Role::Viewer, TransportKind::kTcp, View::Surface));
  auto slow_options = options(Role::Viewer, TransportKind::kWebSocket, View::Surface);
  slow_options.max_rate_hz = 10;
  const auto slow = connect(test, slow_options);
  test.cut(4);
  ASSERT_TRUE(volume->wait_for_revision(test.loop.revision(), kPatience_s));
  ASSERT_TRUE(surface->wait_for_revision(test.loop.revision(), kPatience_s));
  ASSERT_TRUE(slow->wait_for_revision(test.loop.revision(), kPatience_s));
  protocol::SurfaceReplica expected;
  volume->read([&](const protocol::Replica& mesh) { expected.load(mesh); });
  surface->read_surface([&](const protocol::SurfaceReplica& s) {
    EXPECT_EQ(s.canonical_bytes(), expected.canonical_bytes());
    EXPECT_EQ(s.compute_surface_hash(), expected.surface_hash());
  });
  slow->read_surface(
      [&](const protocol::SurfaceReplica& s) { EXPECT_EQ(s.canonical_bytes(), expected.canonical_bytes()); });
  EXPECT_LT(slow->counters().deltas, surface->counters().deltas);
  EXPECT_EQ(slow->counters().steps, surface->counters().steps);
}

TEST(Client, AnOperatorCutsAndKnowsWhatBecameOfItsPoses) {
  for (const TransportKind transport : {TransportKind::kTcp, TransportKind::kWebSocket}) {
    TestServer test;
    test.loop.start();
    const auto client = connect(test, options(Role::Operator, transport));
    EXPECT_EQ(client->welcome().engage_button, 0);
    const auto poses = stream::sweep(0.03, 20'000, 1, test.side);  // more than one message
    const std::uint64_t sequence = client->send_poses(poses);
    ASSERT_NE(sequence, 0u);
    ASSERT_TRUE(client->wait_for_report(sequence, kPatience_s));
    EXPECT_EQ(client->report().accepted, poses.size());
    ASSERT_TRUE(client->wait_for_revision(test.loop.revision(), kPatience_s));
    EXPECT_GT(test.loop.revision(), 3u);
    EXPECT_EQ(client->read([](const protocol::Replica& m) { return m.state_hash(); }),
              test.loop.state_hash());
  }
}

TEST(Client, EngagesWithoutAButton) {
  TestServer test;
  test.loop.start();
  const auto client = connect(test, options(Role::Operator));
  auto poses = stream::sweep(0.5 * test.side, 60, 1, test.side);
  for (protocol::PoseSample& pose : poses) pose.buttons = 0;
  ASSERT_TRUE(client->engage(0));
  ASSERT_TRUE(client->wait_for_report(client->send_poses(poses), kPatience_s));
  ASSERT_TRUE(client->end_stroke(poses.back().source_ns));
  ASSERT_TRUE(stream::eventually([&] { return test.loop.strokes_ended() == 1; }));
  EXPECT_GT(test.loop.revision(), 3u);
}

TEST(Client, ComesBackWhereItWas) {
  TestServer test;
  std::atomic<int> disconnects{0}, snapshots{0};
  Callbacks callbacks;
  callbacks.on_disconnect = [&](const std::string&) { ++disconnects; };
  callbacks.on_snapshot = [&](const protocol::SnapshotEnd&, protocol::SnapshotCause) { ++snapshots; };
  Options o = options();
  o.reconnect = true;
  const auto client = connect(test, o, callbacks);
  ASSERT_TRUE(client->wait_for_revision(0, kPatience_s));
  for (int i = 1; i <= 5; ++i) {
    test.cut();
    client->drop_connection();
    test.cut();
    ASSERT_TRUE(client->wait_for_revision(test.loop.revision(), kPatience_s));
    ASSERT_TRUE(
        stream::eventually([&] { return client->counters().reconnects == static_cast<std::uint64_t>(i); }));
  }
  EXPECT_EQ(disconnects, 5);
  EXPECT_EQ(snapshots, 1) << "each time the ring had what was missed";
  EXPECT_EQ(client->read([](const protocol::Replica& m) { return m.compute_state_hash(); }),
            test.loop.state_hash());
  EXPECT_EQ(client->counters().steps, test.loop.revision());
}

TEST(Client, OperatorsComeBackToTheirBlade) {
  TestServer test;
  test.loop.start();
  Options o = options(Role::Operator);
  o.reconnect = true;
  const auto client = connect(test, o);
  client->drop_connection();
  ASSERT_TRUE(stream::eventually([&] { return client->counters().reconnects == 1; })) << client->last_error();
  const auto poses = stream::sweep(0.03, 100, 1, test.side);
  const std::uint64_t sequence = client->send_poses(poses);
  ASSERT_TRUE(client->wait_for_report(sequence, kPatience_s));
  EXPECT_EQ(client->report().accepted, poses.size());
}

TEST(Client, FollowsAReset) {
  TestServer test;
  test.cut(2);
  test.loop.start();
  const auto viewer = connect(test, options());
  const auto admin = connect(test, options(Role::Admin, TransportKind::kWebSocket, View::None));
  ASSERT_TRUE(viewer->wait_for_revision(test.loop.revision(), kPatience_s));
  const std::uint64_t session = viewer->welcome().session;
  ASSERT_TRUE(admin->reset());
  ASSERT_TRUE(
      stream::eventually([&] { return viewer->welcome().session != session && viewer->revision() == 0; }));
  EXPECT_EQ(viewer->read([](const protocol::Replica& m) { return m.compute_state_hash(); }),
            test.loop.state_hash());
}

TEST(Client, ChangesItsView) {
  TestServer test;
  test.cut();
  const auto client = connect(test, options(Role::Viewer, TransportKind::kTcp, View::None));
  test.cut();
  ASSERT_TRUE(client->subscribe(View::Surface, 0));
  ASSERT_TRUE(client->wait_for_revision(test.loop.revision(), kPatience_s));
  EXPECT_EQ(client->read_surface([](const protocol::SurfaceReplica& s) { return s.revision(); }),
            test.loop.revision());
  ASSERT_TRUE(client->subscribe(View::Volume, 0));
  ASSERT_TRUE(stream::eventually([&] { return client->counters().snapshots == 2; }));
  test.cut();
  ASSERT_TRUE(client->wait_for_revision(test.loop.revision(), kPatience_s));
  EXPECT_EQ(client->read([](const protocol::Replica& m) { return m.state_hash(); }), test.loop.state_hash());
}

TEST(Client, WithoutAThreadItWorksInPoll) {
  TestServer test;
  const std::thread::id here = std::this_thread::get_id();
  int deltas = 0;
  Callbacks callbacks;
  callbacks.on_delta = [&](const protocol::Replica&, const protocol::Delta&, const Arrival&) {
    EXPECT_EQ(std::this_thread::get_id(), here);
    ++deltas;
  };
  Options o = options();
  o.background = false;
  const auto client = connect(test, o, callbacks);
  test.cut();
  EXPECT_TRUE(stream::eventually([&] {
    client->poll(0.01);
    return client->revision() == test.loop.revision();
  }));
  test.cut();
  ASSERT_TRUE(client->wait_for_revision(test.loop.revision(), kPatience_s));
  EXPECT_GT(deltas, 0);
  client->close();
  EXPECT_FALSE(client->poll());
}

TEST(Client, MeasuresTheClocks) {
  TestServer test(2);
  const auto client = connect(test, options());
  ASSERT_TRUE(stream::eventually([&] { return client->round_trip_ns() > 0; }));
  // One machine, one clock.
  EXPECT_LE(std::abs(client->clock_offset_ns()), client->round_trip_ns());
}

TEST(Client, SaysWhyItCannotConnect) {
  const auto problem = [](const std::string& host, std::uint16_t port, Options o = {}) {
    try {
      o.connect_timeout_s = 20;
      Client::connect(host, port, o);
      return std::string();
    } catch (const ConnectError& error) {
      return std::string(error.what());
    }
  };
  std::uint16_t gone = 0;
  {
    TestServer test(2);
    gone = test.server.tcp_port();
    Options web;
    web.transport = TransportKind::kWebSocket;
    const std::string tcp = problem("127.0.0.1", test.server.tcp_port(), web);
    EXPECT_NE(tcp.find("the port does not speak HTTP: use incised's HTTP port"), std::string::npos) << tcp;
    EXPECT_NE(problem("127.0.0.1", test.server.http_port()), "") << "TCP on the HTTP port";
    test.loop.start();
    Options op = options(Role::Operator);
    const auto first = Client::connect("127.0.0.1", gone, op);
    const std::string taken = problem("127.0.0.1", gone, op);
    EXPECT_NE(taken.find("held by another operator"), std::string::npos) << taken;
    try {
      Client::connect("127.0.0.1", gone, op);
      ADD_FAILURE() << "two hold a blade";
    } catch (const ConnectError& error) {
      EXPECT_EQ(error.code, protocol::ErrorCode::BladeTaken);
    }
  }
  EXPECT_NE(problem("127.0.0.1", gone).find("127.0.0.1:" + std::to_string(gone)), std::string::npos);
}

// An IPv6 address in brackets, or the port could not be told from it (RFC 3986, section 3.2.2).
TEST(Client, AWebSocketNamesItsHostAndPort) {
  for (const auto& [host, named] : {std::pair<std::string, std::string>{"127.0.0.1", "127.0.0.1"},
                                    {"::ffff:127.0.0.1", "[::ffff:127.0.0.1]"}}) {
    const stream::Listener listener;
    std::string request;
    std::thread server([&] { request = listener.accept()->read_head(); });
    EXPECT_THROW(Client::connect(host, listener.port(), options(Role::Viewer, TransportKind::kWebSocket)),
                 ConnectError);
    server.join();
    EXPECT_NE(request.find("\r\nHost: " + named + ":" + std::to_string(listener.port()) + "\r\n"),
              std::string::npos)
        << request;
  }
}

TEST(Client, AReplicaThatMayNotGrowEndsTheSessionWithTheReason) {
  TestServer test;
  Options o = options();
  o.max_tets = 100;
  o.reconnect = true;
  // The snapshot may arrive before connect() is done, or after.
  std::string reason;
  try {
    const auto client = connect(test, o);
    ASSERT_TRUE(stream::eventually([&] { return client->status() == Status::kClosed; }));
    reason = client->last_error();
  } catch (const std::exception& e) {
    reason = e.what();
  }
  EXPECT_NE(reason.find("and 100"), std::string::npos) << reason;
}

TEST(Client, ServerThatStopsIsNoticedAndFoundAgain) {
  auto test = std::make_unique<TestServer>();
  stream::StreamConfig config = stream::test_config();
  config.tcp_port = test->server.tcp_port();
  Options o = options();
  o.reconnect = true;
  const auto client = connect(*test, o);
  test->cut(2);
  ASSERT_TRUE(client->wait_for_revision(test->loop.revision(), kPatience_s));
  test.reset();
  ASSERT_TRUE(stream::eventually([&] { return client->status() == Status::kReconnecting; }));
  TestServer again(4, config);  // another mesh
  ASSERT_TRUE(stream::eventually([&] {
    return client->status() == Status::kConnected &&
           client->read([](const protocol::Replica& m) { return m.state_hash(); }) == again.loop.state_hash();
  }));
}

// Who wants a part: at every revision, seldom, and cut off now and then.
struct BoxClients {
  std::vector<std::unique_ptr<Client>> all;
  BoxClients(TestServer& test, View view, const protocol::Box& box) {
    Options boxed = options(Role::Viewer, TransportKind::kTcp, view);
    boxed.box = box;
    boxed.full_check_interval = 7;
    all.push_back(connect(test, boxed));
    boxed.max_rate_hz = 20;
    boxed.transport = TransportKind::kWebSocket;
    all.push_back(connect(test, boxed));
    boxed.max_rate_hz = 0;
    boxed.reconnect = true;
    all.push_back(connect(test, boxed));
  }
  void expect_at(std::uint64_t revision) const {
    for (const auto& client : all) {
      ASSERT_TRUE(client->wait_for_revision(revision, kPatience_s)) << client->last_error();
      EXPECT_EQ(client->counters().resyncs, 0u);
    }
    EXPECT_GT(all[2]->counters().reconnects, 0u);
  }
};

TEST(Client, WithABoxHoldsThatPartOfEitherView) {
  TestServer test;
  const double side = test.side;
  const protocol::Box box{{0.2 * side, 0.2 * side, 0.6 * side}, {0.7 * side, 0.6 * side, 2 * side}};
  const auto whole_surface = connect(test, options(Role::Viewer, TransportKind::kTcp, View::Surface));
  const auto whole = connect(test, options());
  const BoxClients surfaces(test, View::Surface, box), volumes(test, View::Volume, box);
  for (int i = 0; i < 6; ++i) {
    test.cut();
    if (i % 2 == 0) surfaces.all[2]->drop_connection(), volumes.all[2]->drop_connection();
  }
  ASSERT_TRUE(whole->wait_for_revision(test.loop.revision(), kPatience_s)) << whole->last_error();
  ASSERT_TRUE(whole_surface->wait_for_revision(test.loop.revision(), kPatience_s)) << whole->last_error();
  surfaces.expect_at(test.loop.revision());
  volumes.expect_at(test.loop.revision());

  protocol::SurfaceReplica surface;
  whole_surface->read_surface([&](const protocol::SurfaceReplica& s) {
    surface.load_part(s, box);
    EXPECT_GT(surface.triangles().size(), 20u);
    EXPECT_LT(surface.triangles().size(), s.triangles().size() / 2);
  });
  for (const auto& client : surfaces.all) {
    EXPECT_EQ(client->read_surface([](const protocol::SurfaceReplica& s) { return s.canonical_bytes(); }),
              surface.canonical_bytes());
  }
  protocol::VolumePart volume;
  whole->read([&](const protocol::Replica& mesh) {
    volume.load_part(mesh, box);
    EXPECT_GT(volume.tets().size(), 50u);
    EXPECT_LT(volume.tets().size(), mesh.live_tets() / 2);
  });
  for (const auto& client : volumes.all) {
    EXPECT_EQ(client->read_part([](const protocol::VolumePart& p) { return p.canonical_bytes(); }),
              volume.canonical_bytes());
  }
  EXPECT_LT(surfaces.all[0]->counters().bytes_in, whole_surface->counters().bytes_in);
  EXPECT_LT(volumes.all[0]->counters().bytes_in, whole->counters().bytes_in);
}

}  // namespace
}  // namespace incise::client
