// What incised tells its stream and its users: the configuration, the facts of Welcome, the state to begin with, forces, figures.

#include "server/app/stream_setup.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "server/app/stream_output.hpp"
#include "server/app/telemetry.hpp"
#include "server/stream/delta_arrays.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/stream/viewer.hpp"
#include "tests/support/bodies.hpp"

namespace incise::app {
namespace {

Body box(std::uint32_t cells) {
  Body body;
  body.name = "box";
  body.loaded.mesh = stream::box_mesh(cells);
  body.loaded.content_hash = "1234";
  return body;
}

TEST(StreamSetup, EveryKeyReachesTheStream) {
  Config config;
  config.listen.tcp_port = 1;
  config.listen.http_port = 2;
  config.listen.allowed_origins = {"https://a.example"};
  config.listen.insecure = true;
  config.listen.max_sessions = 11;
  config.listen.max_handshakes = 12;
  config.listen.max_messages_per_s = 13;
  config.listen.handshake_timeout_s = 1.5;
  config.listen.idle_timeout_s = 2.5;
  config.listen.write_timeout_s = 3.5;
  config.listen.stop_grace_s = 4.5;
  config.stream.outbox_bytes = 14;
  config.stream.ring_bytes = 15;
  config.stream.max_slow_snapshots = 16;
  config.stream.max_report_rate_hz = 17;
  const stream::StreamConfig made = stream_config(config);
  EXPECT_EQ(made.address, "127.0.0.1");
  EXPECT_EQ(made.tcp_port, 1);
  EXPECT_EQ(made.http_port, 2);
  EXPECT_EQ(made.allowed_origins, config.listen.allowed_origins);
  EXPECT_TRUE(made.insecure);
  EXPECT_EQ(made.max_sessions, 11u);
  EXPECT_EQ(made.max_handshakes, 12u);
  EXPECT_EQ(made.max_messages_per_s, 13u);
  EXPECT_EQ(made.handshake_timeout_s, 1.5);
  EXPECT_EQ(made.idle_timeout_s, 2.5);
  EXPECT_EQ(made.write_timeout_s, 3.5);
  EXPECT_EQ(made.stop_grace_s, 4.5);
  EXPECT_EQ(made.outbox_bytes, 14u);
  EXPECT_EQ(made.ring_bytes, 15u);
  EXPECT_EQ(made.max_slow_snapshots, 16u);
  EXPECT_EQ(made.max_report_rate_hz, 17);
}

TEST(StreamSetup, TheFactsAreThoseOfBodyAndConfiguration) {
  const Body body = box(2);
  Config config;
  config.cut.blade = {{1, 2, 3}, {4, 5, 6}};
  config.cut.engage_buttons = 0b1000;
  config.cut.speed_limit_m_s = 7;
  config.loop.rate_hz = 800;
  const core::CutSession session(body.loaded.mesh, config.cut);
  stream::ServerFacts facts = server_facts(config, body, session.mesh());
  EXPECT_EQ(facts.mesh.name, "box");
  EXPECT_EQ(facts.mesh.content_hash, "1234");
  EXPECT_EQ(facts.mesh.vertices, 27u);
  EXPECT_EQ(facts.mesh.tets, 48u);
  EXPECT_EQ(facts.mesh.boundary_faces, 48u);
  EXPECT_EQ(facts.mesh.box.min.x, 0);
  EXPECT_NEAR(facts.mesh.box.max.z, 0.02, 1e-12);
  EXPECT_EQ(facts.mesh.mean_edge_length_m, session.mesh().mean_edge_length());
  EXPECT_EQ(facts.blade_heel.y, 2);
  EXPECT_EQ(facts.blade_tip.z, 6);
  EXPECT_EQ(facts.engage_button, 3);
  EXPECT_EQ(facts.max_speed_m_s, 7);
  EXPECT_EQ(facts.frame_rate_hz, 800);
  EXPECT_EQ(facts.policy, "conforming");
  config.cut.always_engaged = true;
  config.cut.policy = core::Policy::kCroll;
  facts = server_facts(config, body, session.mesh());
  EXPECT_EQ(facts.engage_button, -1);
  EXPECT_EQ(facts.policy, "croll");
}

TEST(StreamSetup, ABodyThatDeformsBeginsWithItsRestPositions) {
  core::CutSession session(stream::box_mesh(2), {});
  EXPECT_TRUE(replay::initial_state(session, 5).rest.empty());
  const core::Vec3 at = session.mesh().position(26);
  auto positions = std::make_shared<core::VertexPositions>();
  positions->ids = {26};
  positions->positions = {at + core::Vec3{0.001, 0, 0}};
  session.deform(positions);
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  ASSERT_EQ(session.advance(budget, delta), core::CutSession::Progress::kCommitted);
  const stream::InitialState state = replay::initial_state(session, 5);
  EXPECT_EQ(state.epoch, 5u);
  EXPECT_EQ(state.revision, 1u);
  ASSERT_EQ(state.rest.size(), 27u);
  EXPECT_EQ(state.rest[26], at);
  EXPECT_EQ(state.positions[26], at + (core::Vec3{0.001, 0, 0}));
  EXPECT_EQ(state.tets.size(), 48u);
}

// What a cut has removed is not sent, and what it leaves comes with its piece.
TEST(StreamSetup, ACutBodyBeginsWithItsLivingTetrahedra) {
  core::CutConfig config;
  config.blade = tests::long_blade();
  core::CutSession session(tests::cube(4), config);
  for (core::Pose pose : tests::sweep_through(200)) {
    pose.position.x += 0.02 * std::sin(60 * pose.position.y);  // too bent to move vertices onto it
    session.push(0, pose);
  }
  session.end_stroke(0);
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
  }
  const core::TetMesh& mesh = session.mesh();
  ASSERT_LT(mesh.live_tets(), mesh.tet_slots());
  const stream::InitialState state = replay::initial_state(session, 5);
  ASSERT_EQ(state.tets.size(), mesh.live_tets());
  for (std::size_t i = 0; i < state.tets.size(); ++i) {
    const core::TetId t = state.tets[i].id;
    ASSERT_TRUE(mesh.alive(t)) << t;
    EXPECT_EQ(state.tets[i].vertices, mesh.vertices(t)) << t;
  }
  ASSERT_FALSE(state.piece_ids.empty());
  ASSERT_EQ(state.piece_names.size(), state.piece_ids.size());
  protocol::Replica replica;
  ASSERT_EQ(stream::load_initial(state, replica), "");
  for (const core::TetState& tet : state.tets)
    EXPECT_EQ(replica.piece(tet.id), session.piece(tet.id)) << tet.id;
}

TEST(ForceOutput, AForceIsSentWithItsFlagsAndItsContactUnlessItIsOff) {
  stream::TestServer test(2);
  test.loop.start();
  stream::RawPeer peer(test.server.tcp_port());
  peer.send(stream::hello(protocol::Role::Operator, protocol::View::None));
  const auto welcome = peer.receive_until<protocol::Welcome>();
  ASSERT_TRUE(welcome);
  ForceOutput output(test.server, 20'000'000, true), no_torques(test.server, 20'000'000, false);
  haptics::BladeForce force;
  force.source = std::get<protocol::Welcome>(welcome->message.body).source;
  force.newtons = {1, 2, 3};
  force.newton_metres = {0.1, 0.2, 0.3};
  force.feel.arm = {0.01, 0, -0.05};
  force.feel.engagement.length_m = 0.25;
  force.feel.contact = haptics::ContactPlane{{4, 5, 6}, {0, 0, 1}, 100, 2, 3, 5, true};
  const auto sent = [&](std::int64_t pose_t_ns, std::uint32_t flags) {
    force.pose_t_ns = pose_t_ns;
    force.flags = flags;
    output.feel(force);
    const auto received = peer.receive_until<protocol::Force>();
    EXPECT_TRUE(received);
    return received ? std::get<protocol::Force>(received->message.body) : protocol::Force{};
  };
  const protocol::Force plain = sent(7, 0);
  EXPECT_EQ(plain.source_ns, 7);
  EXPECT_EQ(plain.force_n.y, 2);
  EXPECT_EQ(plain.engaged_length_m, 0.25F);
  EXPECT_FALSE(plain.saturated || plain.ramping || plain.latched_off);
  ASSERT_TRUE(plain.contact);
  EXPECT_EQ(plain.contact->point.x, 4);
  EXPECT_EQ(plain.contact->normal.z, 1);
  EXPECT_EQ(plain.contact->stiffness_n_per_m, 100);
  EXPECT_EQ(plain.contact->damping_n_s_per_m, 2);
  EXPECT_EQ(plain.contact->cutting_resistance_n, 3);
  EXPECT_EQ(plain.contact->friction_n_s_per_m, 5);
  EXPECT_EQ(plain.contact->valid_for_ns, 20'000'000);
  EXPECT_TRUE(plain.contact->penetrated);
  ASSERT_TRUE(plain.torque_n_m && plain.contact->arm);
  EXPECT_EQ(plain.torque_n_m->z, 0.3);
  EXPECT_EQ(plain.contact->arm->z, -0.05);
  no_torques.feel(force);
  const auto without = peer.receive_until<protocol::Force>();
  ASSERT_TRUE(without);
  EXPECT_FALSE(std::get<protocol::Force>(without->message.body).torque_n_m);
  const protocol::Force limited = sent(8, haptics::kForceLimited);
  EXPECT_TRUE(limited.saturated && !limited.ramping && !limited.latched_off);
  const protocol::Force ramping = sent(9, haptics::kForceRamping);
  EXPECT_TRUE(!ramping.saturated && ramping.ramping && !ramping.latched_off);
  const protocol::Force off = sent(10, haptics::kForceLatchedOff);
  EXPECT_TRUE(!off.saturated && !off.ramping && off.latched_off);
  EXPECT_FALSE(off.contact);
}

TEST(Telemetry, EachFigureIsItsOwn) {
  loop::LoopStats stats;
  loop::LoopState state;
  state.revision = 1;
  state.live_tets = 2;
  state.frames = 3;
  state.skipped_frames = 4;
  state.backlog_events = 5;
  state.backlog_batches = 6;
  state.backlog_segments = 7;
  state.backlog_ns = 8'000'000;
  state.recovery_ns = 9'000'000;
  state.strokes = 10;
  stats.verdicts[static_cast<std::size_t>(core::PoseVerdict::kAccepted)] = 20;
  stats.verdicts[static_cast<std::size_t>(core::PoseVerdict::kNewStroke)] = 1;
  stats.verdicts[static_cast<std::size_t>(core::PoseVerdict::kNotUnit)] = 3;
  const input::PoseSources sources{core::Blade{}};
  const Telemetry telemetry(stats, sources, nullptr, 1000);
  const auto at = [&](std::uint64_t flags) {
    state.flags = flags;
    stats.state.store(state);
    return nlohmann::json::parse(telemetry.json());
  };
  const nlohmann::json json = at(0);
  EXPECT_EQ(json["frames"]["count"], 3);
  EXPECT_EQ(json["frames"]["skipped"], 4);
  EXPECT_EQ(json["frames"]["rate_hz"], 1000);
  EXPECT_EQ(json["backlog"],
            (nlohmann::json{
                {"poses", 5}, {"batches", 6}, {"segments", 7}, {"work_ms", 8.0}, {"recovery_ms", 9.0}}));
  const std::pair<const char*, std::uint64_t> limits[] = {{"budget_spent", loop::kBudgetSpent},
                                                          {"input_carried", loop::kInputCarried},
                                                          {"deltas_blocked", loop::kDeltasBlocked},
                                                          {"journal_blocked", loop::kJournalBlocked}};
  for (const auto& [name, flag] : limits) {
    const nlohmann::json told = at(flag)["limits"];
    EXPECT_EQ(told.size(), std::size(limits));
    for (const auto& [key, value] : told.items()) EXPECT_EQ(value.get<bool>(), key == name) << key;
  }
  const protocol::Stats message = telemetry.message();
  EXPECT_EQ(message.live_tets, 2u);
  EXPECT_EQ(message.backlog_segments, 7u);
  EXPECT_EQ(message.frames, 3u);
  EXPECT_EQ(message.poses_accepted, 21u);
  EXPECT_EQ(message.poses_rejected, 3u);
  const std::string metrics = telemetry.metrics();
  for (const char* line : {"\nincise_strokes_total 10.0\n", "\nincise_frames_skipped_total 4.0\n",
                           "\nincise_backlog_seconds 0.008\n"})
    EXPECT_NE(metrics.find(line), std::string::npos) << line;
}

}  // namespace
}  // namespace incise::app
