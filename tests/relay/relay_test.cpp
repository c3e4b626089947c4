// What viewers of a relay see: what those of the origin see.

#include <gtest/gtest.h>

#include <chrono>
#include <thread>
#include <vector>

#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/write_vtk.hpp"
#include "tests/e2e/recovery.hpp"
#include "tests/e2e/served_session.hpp"
#include "tests/relay/relay_process.hpp"
#include "tests/stream/viewer.hpp"
#include "tests/support/images.hpp"

namespace incise::relay {
namespace {

using e2e::PoseDriver;
using e2e::ServedSession;
using e2e::wait_for;
using protocol::View;

client::Options viewing(View view, std::optional<protocol::Box> box = {}, float rate_hz = 0) {
  client::Options options;
  options.view = view;
  options.box = box;
  options.max_rate_hz = rate_hz;
  options.full_check_interval = 25;
  return options;
}

// The middle of the body.
protocol::Box middle(const ServedSession& session) {
  core::Vec3 low{1, 1, 1}, high{-1, -1, -1};
  for (const core::Vec3& p : session.body().loaded.mesh.positions) extend(p, low, high);
  const auto at = [&](double s) {
    return protocol::Vec3{low.x + s * (high.x - low.x), low.y + s * (high.y - low.y),
                          low.z + s * (high.z - low.z)};
  };
  return {at(0.3), at(0.6)};
}

// Of what they hold, whatever the view.
std::vector<std::byte> bytes_of(client::Client& viewer, const client::Options& options) {
  if (options.view == View::Surface)
    return viewer.read_surface([](const auto& surface) { return surface.canonical_bytes(); });
  if (options.box) return viewer.read_part([](const auto& part) { return part.canonical_bytes(); });
  return viewer.read([](const auto& mesh) { return mesh.canonical_bytes(); });
}

double cut_area(const ServedSession& session) {
  return session.stat("/cut_area_m2").value_or(0);
}

TEST(Relay, ShowsWhatTheOriginShowsAtEachRevision) {
  ServedSession session("relay", 6000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  RelayProcess near("127.0.0.1:" + std::to_string(session.tcp_port()), session.http_port());
  ASSERT_TRUE(near.start()) << near.log();
  RelayProcess far(near.place(), near.http_port());
  ASSERT_TRUE(far.start()) << far.log();

  const protocol::Box box = middle(session);
  std::vector<client::Options> views{viewing(View::Volume),        viewing(View::Surface),
                                     viewing(View::Volume, box),   viewing(View::Surface, box),
                                     viewing(View::Volume, {}, 5), viewing(View::Surface, {}, 5)};
  views.push_back(viewing(View::Volume));
  views.back().transport = client::TransportKind::kWebSocket;
  const auto port = [](const client::Options& options, const auto& server) {
    return options.transport == client::TransportKind::kWebSocket ? server.http_port() : server.tcp_port();
  };
  std::vector<std::unique_ptr<Witness>> at_origin, at_near, at_far;
  for (const client::Options& options : views) {
    at_origin.push_back(std::make_unique<Witness>(port(options, session), options));
    at_near.push_back(std::make_unique<Witness>(port(options, near), options));
    at_far.push_back(std::make_unique<Witness>(port(options, far), options));
  }
  // One that does not read for a while: it gets combined deltas, or a snapshot.
  stream::Viewer slow(near.tcp_port(), stream::hello(protocol::Role::Viewer, View::Volume), 8192);

  PoseDriver driver(session, 1000, 0.4, "blade", far.tcp_port());
  ASSERT_TRUE(wait_for([&] { return session.stat("/revision").value_or(0) > 300; })) << session.log();
  ASSERT_TRUE(driver.settle());
  EXPECT_EQ(driver.rejected(), 0u);
  EXPECT_EQ(driver.accepted(), driver.sent()) << "each pose is acknowledged through two relays";
  ASSERT_TRUE(wait_for([&] { return session.stat("/backlog/batches") == 0.0; }));
  const auto head = static_cast<std::uint64_t>(session.stat("/revision").value_or(0));
  ASSERT_GT(head, 300u);
  EXPECT_GT(cut_area(session), 0);

  for (std::size_t i = 0; i < views.size(); ++i) {
    SCOPED_TRACE(i);
    ASSERT_TRUE(at_origin[i]->client().wait_for_revision(head, 60));
    const Seen truth = at_origin[0]->seen();
    const std::vector<std::byte> bytes = bytes_of(at_origin[i]->client(), views[i]);
    for (const auto& relayed : {&at_near[i], &at_far[i]}) {
      Witness& witness = **relayed;
      ASSERT_TRUE(witness.client().wait_for_revision(head, 60));
      bool equal = true;
      const int shared = common(witness.seen(), truth, equal);
      EXPECT_TRUE(equal) << "a hash that the origin did not have";
      EXPECT_GT(shared, views[i].max_rate_hz > 0 || views[i].box ? 1 : 200);
      EXPECT_EQ(witness.went_back(), 0);
      EXPECT_EQ(witness.resyncs(), 0) << "its own replica found no fault";
      EXPECT_EQ(witness.client().welcome().session, at_origin[i]->client().welcome().session)
          << "a client may go on at another server";
      EXPECT_EQ(bytes_of(witness.client(), views[i]), bytes);
    }
  }
  ASSERT_TRUE(slow.follow(head));
  EXPECT_EQ(slow.replica.compute_state_hash(), at_origin[0]->seen().at(head));

  // The relay is one viewer to the origin, and says where it is.
  EXPECT_EQ(near.stat("/relay/refused"), 0.0);
  EXPECT_EQ(near.stat("/relay/hops"), 1.0);
  EXPECT_TRUE(wait_for([&] { return far.stat("/relay/hops") == 2.0; })) << "once the first has told";
  EXPECT_EQ(session.stat("/access/peers"), static_cast<double>(views.size()) + 1)
      << "its own viewers and one relay; the operator has gone";
}

// A client that leaves the origin goes on at a relay with the deltas alone, and back.
TEST(Relay, AViewerGoesOnWhereAnotherServerLeftIt) {
  ServedSession session("relay_resume", 4000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  RelayProcess relay("127.0.0.1:" + std::to_string(session.tcp_port()), session.http_port());
  ASSERT_TRUE(relay.start()) << relay.log();
  PoseDriver driver(session, 1000, 0.4);
  ASSERT_TRUE(wait_for([&] { return relay.stat("/revision").value_or(0) > 30; }));
  for (const View view : {View::Volume, View::Surface}) {
    for (int i = 0; i < 2; ++i) {
      const std::uint16_t from = i == 0 ? session.tcp_port() : relay.tcp_port();
      const std::uint16_t to = i == 0 ? relay.tcp_port() : session.tcp_port();
      client::Options options = viewing(view);
      const auto viewer = client::Client::connect("127.0.0.1", from, options);
      ASSERT_TRUE(viewer->wait_for_revision(1, 60));
      const std::uint64_t held = viewer->revision();
      const std::uint64_t session_name = viewer->welcome().session;
      viewer->close();
      // The other server may be a revision behind.
      ASSERT_TRUE(wait_for([&] { return relay.stat("/revision").value_or(0) > static_cast<double>(held); }));
      stream::RawPeer raw(to);
      protocol::Hello hello = stream::hello(protocol::Role::Viewer, view);
      hello.resume_session = session_name;
      hello.resume_revision = held;
      raw.send(hello);
      const auto welcome = raw.receive();
      ASSERT_TRUE(welcome);
      EXPECT_TRUE(std::get<protocol::Welcome>(welcome->message.body).resumed) << i;
    }
  }
}

// How the body looks is the origin's, also after it was started with another configuration.
TEST(Relay, LooksPassThrough) {
  ServedSession session("relay_looks", 4000, "");
  const auto looks_like = [&](const std::string& tissue) {
    session.set_keys(R"(, "materials": [{"region": 0, "tissue": ")" + tissue +
                     R"(", "inside": {"texture": "inside.png"}}])");
  };
  const std::string png = tests::tiny_png();
  std::ofstream(session.file("inside.png"), std::ios::binary) << png;
  looks_like("muscle");
  ASSERT_TRUE(session.start(false)) << session.log();
  RelayProcess relay("127.0.0.1:" + std::to_string(session.tcp_port()), session.http_port());
  ASSERT_TRUE(relay.start()) << relay.log();
  const auto body_of = [](std::uint16_t port, const std::string& path) {
    const std::string answer = stream::http(port, path);
    return answer.substr(std::min(answer.size(), answer.find("\r\n\r\n") + 4));
  };
  const std::string muscle = body_of(relay.http_port(), "/look.json");
  EXPECT_EQ(muscle, body_of(session.http_port(), "/look.json"));
  EXPECT_NE(muscle.find("fibres"), std::string::npos) << muscle;
  EXPECT_EQ(body_of(relay.http_port(), "/look/0.png"), png);

  Witness witness(relay.tcp_port());
  session.kill();
  ASSERT_TRUE(session.start(true)) << session.log();
  EXPECT_TRUE(wait_for([&] { return relay.stat("/relay/connections") == 2.0; }));
  EXPECT_EQ(body_of(relay.http_port(), "/look.json"), muscle) << "nothing has changed: viewers stay";
  EXPECT_EQ(witness.welcomes(), 1);

  session.kill();
  looks_like("bone");
  ASSERT_TRUE(session.start(true)) << session.log();
  EXPECT_TRUE(
      wait_for([&] { return body_of(relay.http_port(), "/look.json").find("pores") != std::string::npos; }));
  EXPECT_EQ(body_of(relay.http_port(), "/look.json"), body_of(session.http_port(), "/look.json"));
  EXPECT_TRUE(wait_for([&] { return witness.welcomes() == 2; })) << "viewers connect again, and ask anew";
}

TEST(Relay, FieldsAndDeformationsPassThrough) {
  ServedSession session("relay_fields", 4000, "");
  {
    const core::MeshData& mesh = session.body().loaded.mesh;
    std::vector<float> rest;
    std::vector<std::int32_t> region;
    for (const core::Vec3& p : mesh.positions)
      rest.insert(rest.end(), {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)});
    for (std::size_t t = 0; t < mesh.tets.size(); ++t) region.push_back(static_cast<std::int32_t>(t % 7));
    using On = core::Field::On;
    mesh_io::write_mesh(
        session.file("body.vtu"), mesh,
        std::vector<core::Field>{{"rest", On::kVertices, 3, rest}, {"tissue", On::kTets, 1, region}});
    session.use_body("body.vtu");
  }
  ASSERT_TRUE(session.start(false)) << session.log();
  RelayProcess relay("127.0.0.1:" + std::to_string(session.tcp_port()), session.http_port());
  ASSERT_TRUE(relay.start()) << relay.log();
  client::Options options = viewing(View::Volume);
  options.fields = {"*"};
  Witness direct(session.tcp_port(), options), relayed(relay.tcp_port(), options);
  const auto fields_of = [](Witness& witness) {
    return witness.client().read_fields([&](const protocol::FieldReplica& fields) {
      std::vector<std::pair<std::string, decltype(protocol::Field::values)>> all;
      for (const protocol::Field& field : fields.all()) all.emplace_back(field.facts.name, field.values);
      return all;
    });
  };
  EXPECT_EQ(direct.client().welcome().session, relayed.client().welcome().session);

  // A simulator at the origin sets a field and moves the body, while an operator at the relay cuts.
  client::Options simulating;
  simulating.role = protocol::Role::Simulator;
  simulating.view = View::Volume;
  const auto simulator = client::Client::connect("127.0.0.1", session.tcp_port(), simulating);
  ASSERT_TRUE(simulator->wait_for_revision(0, 60));
  PoseDriver driver(session, 1000, 0.4, "blade", relay.tcp_port());
  for (int i = 0; i < 40 || (i < 400 && session.stat("/deformations/count").value_or(0) < 6); ++i) {
    std::vector<float> values, positions;
    const std::uint64_t revision = simulator->read([&](const protocol::Replica& mesh) {
      for (std::uint32_t v = 0; v < mesh.vertex_count(); ++v) {
        const protocol::Vec3 p = mesh.position(v);
        values.push_back(static_cast<float>(i + p.x));
        positions.insert(positions.end(), {static_cast<float>(p.x + 1e-5 * (i % 3 - 1)),
                                           static_cast<float>(p.y), static_cast<float>(p.z)});
      }
      return mesh.revision();
    });
    simulator->send_field({2, 0, values, {}, revision, true});
    protocol::Positions moved;
    moved.frame = static_cast<std::uint64_t>(i);
    moved.revision = revision;
    moved.source_ns = i + 1;
    moved.f32 = positions;
    simulator->send_positions(moved);
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  ASSERT_TRUE(driver.settle());
  ASSERT_TRUE(wait_for([&] { return session.stat("/backlog/batches") == 0.0; }));
  EXPECT_GT(session.stat("/deformations/count").value_or(0), 5);
  EXPECT_GT(session.stat("/revision").value_or(0), 50);
  const auto head = static_cast<std::uint64_t>(session.stat("/revision").value_or(0));
  ASSERT_TRUE(direct.client().wait_for_revision(head, 60));
  ASSERT_TRUE(relayed.client().wait_for_revision(head, 60));
  EXPECT_EQ(direct.client().revision(), relayed.client().revision());
  EXPECT_TRUE(wait_for([&] { return fields_of(direct) == fields_of(relayed); }))
      << "values that a client has set, too";
  EXPECT_EQ(bytes_of(direct.client(), options), bytes_of(relayed.client(), options));
  EXPECT_TRUE(relayed.client().read([](const protocol::Replica& mesh) { return mesh.deformed(); }));
  bool equal = true;
  common(direct.seen(), relayed.seen(), equal);
  EXPECT_TRUE(equal);
  // One who comes late gets the same at once.
  Witness late(relay.tcp_port(), options);
  ASSERT_TRUE(late.client().wait_for_revision(head, 60));
  EXPECT_EQ(fields_of(late), fields_of(direct));
  EXPECT_EQ(bytes_of(late.client(), options), bytes_of(direct.client(), options));
}

std::uint64_t metric(std::uint16_t http_port, const std::string& name) {
  const std::string text = stream::http(http_port, "/metrics");
  const auto at = text.find("\n" + name + " ");
  return at == std::string::npos ? 0 : std::strtoull(text.c_str() + at + name.size() + 2, nullptr, 10);
}

TEST(Relay, CostsTheOriginOneViewerHoweverManyItServes) {
  ServedSession session("relay_bytes", 4000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  RelayProcess relay("127.0.0.1:" + std::to_string(session.tcp_port()), session.http_port());
  ASSERT_TRUE(relay.start()) << relay.log();
  std::vector<std::unique_ptr<Witness>> viewers;
  for (int i = 0; i < 20; ++i)
    viewers.push_back(std::make_unique<Witness>(relay.tcp_port(), viewing(View::Volume)));
  for (const auto& viewer : viewers) ASSERT_TRUE(viewer->client().wait_for_revision(0, 60));
  Witness direct(session.tcp_port(), viewing(View::Volume));
  ASSERT_TRUE(direct.client().wait_for_revision(0, 60));
  ASSERT_TRUE(wait_for([&] { return session.stat("/access/peers") == 2.0; }));

  const std::uint64_t origin_before = metric(session.http_port(), "incise_stream_bytes_out_total");
  const std::uint64_t relay_before = metric(relay.http_port(), "incise_stream_bytes_out_total");
  const std::uint64_t viewer_before = direct.client().counters().bytes_in;
  {
    PoseDriver driver(session, 1000, 0.4);
    ASSERT_TRUE(wait_for([&] { return session.stat("/revision").value_or(0) > 300; }));
    ASSERT_TRUE(driver.settle());
  }
  const auto head = static_cast<std::uint64_t>(session.stat("/revision").value_or(0));
  for (const auto& viewer : viewers) ASSERT_TRUE(viewer->client().wait_for_revision(head, 60));
  ASSERT_TRUE(direct.client().wait_for_revision(head, 60));
  const double one = static_cast<double>(direct.client().counters().bytes_in - viewer_before);
  const double origin =
      static_cast<double>(metric(session.http_port(), "incise_stream_bytes_out_total") - origin_before);
  const double relayed =
      static_cast<double>(metric(relay.http_port(), "incise_stream_bytes_out_total") - relay_before);
  ASSERT_GT(one, 100'000);
  // The direct viewer, the relay (with the blade's poses), and the forces and reports to the operator. Each viewer of its own would be 21.
  EXPECT_LT(origin, 4 * one);
  EXPECT_GT(relayed, 19 * one);
  EXPECT_EQ(session.stat("/access/peers"), 2.0);
  EXPECT_EQ(relay.stat("/access/peers"), 20.0);
}

}  // namespace
}  // namespace incise::relay
