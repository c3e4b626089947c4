#include "server/stream/delta_arrays.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "protocol/carry.hpp"
#include "protocol/coalesce.hpp"
#include "protocol/framing.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::stream {
namespace {

TEST(DeltaArrays, AStepHasEachFieldOfItsDelta) {
  PublishedDelta published;
  core::Delta& d = published.delta;
  d.revision = 1;
  d.source = 2;
  d.stroke = 3;
  d.batch = 4;
  d.stroke_ended = true;
  d.from = {{1, 2, 3}, {4, 5, 6}};
  d.to = {{7, 8, 9}, {10, 11, 12}};
  d.from_t_ns = 21;
  d.to_t_ns = 22;
  d.cut_faces = 31;
  d.cut_area = 0.5;
  d.snaps = 32;
  d.splits = 33;
  d.min_dihedral_deg = 34;
  d.max_deviation_h = 0.25;
  d.state_hash = 35;
  published.arrival_ns = 41;
  published.drain_ns = 42;
  published.cut_ns = 43;
  DeltaArrays arrays;
  const protocol::Replica before;
  const protocol::Delta& delta = arrays.assign(published, before);
  ASSERT_EQ(delta.steps.size(), 1u);
  const protocol::Step& step = delta.steps[0];
  EXPECT_EQ(delta.base_revision, 0u);
  EXPECT_EQ(delta.revision, 1u);
  EXPECT_EQ(step.revision, 1u);
  EXPECT_EQ(step.source, 2u);
  EXPECT_EQ(step.stroke, 3u);
  EXPECT_EQ(step.batch, 4u);
  EXPECT_TRUE(step.stroke_ended);
  EXPECT_EQ(step.from_heel.x, 1);
  EXPECT_EQ(step.from_tip.y, 5);
  EXPECT_EQ(step.to_heel.z, 9);
  EXPECT_EQ(step.to_tip.x, 10);
  EXPECT_EQ(step.from_source_ns, 21);
  EXPECT_EQ(step.to_source_ns, 22);
  EXPECT_EQ(step.arrival_ns, 41);
  EXPECT_EQ(step.drain_ns, 42);
  EXPECT_EQ(step.cut_ns, 43);
  EXPECT_EQ(step.cut_faces, 31u);
  EXPECT_EQ(step.cut_area_m2, 0.5);
  EXPECT_EQ(step.snaps, 32u);
  EXPECT_EQ(step.splits, 33u);
  EXPECT_EQ(step.min_dihedral_deg, 34);
  EXPECT_EQ(step.max_deviation_h, 0.25);
  EXPECT_EQ(step.state_hash, 35u);
  EXPECT_EQ(delta.state_hash, 35u);
}

// Six tetrahedra around the diagonal of each cube.
core::MeshData box(std::uint32_t n, double h) {
  constexpr int kOrders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
  core::MeshData mesh;
  const auto id = [n](std::array<std::uint32_t, 3> at) {
    return (at[2] * (n + 1) + at[1]) * (n + 1) + at[0];
  };
  for (std::uint32_t i = 0; i < (n + 1) * (n + 1) * (n + 1); ++i)
    mesh.positions.push_back({h * (i % (n + 1)), h * (i / (n + 1) % (n + 1)), h * (i / (n + 1) / (n + 1))});
  for (std::uint32_t cube = 0; cube < n * n * n; ++cube) {
    for (int o = 0; o < 6; ++o) {
      std::array<std::uint32_t, 3> at{cube % n, cube / n % n, cube / n / n};
      std::array<core::VertexId, 4> tet{id(at)};
      for (std::size_t k = 0; k < 3; ++k) {
        ++at[static_cast<std::size_t>(kOrders[o][k])];
        tet[k + 1] = id(at);
      }
      if (o >= 3) std::swap(tet[2], tet[3]);
      mesh.tets.push_back(tet);
      mesh.regions.push_back(static_cast<std::int32_t>(cube % 5));
    }
  }
  return mesh;
}

// What a session does, as messages: cuts, and deformations in between. `each` gets every one, while the replica is still before it.
template <class Each>
void cut_and_deform(protocol::Replica& replica, core::CutSession& session, const Each& each) {
  PublishedDelta published;
  DeltaArrays arrays;
  core::WorkBudget budget = core::WorkBudget::unlimited();
  const auto run = [&] {
    while (session.advance(budget, published.delta) == core::CutSession::Progress::kCommitted) {
      const protocol::Delta& message = arrays.assign(published, replica);
      each(message);
      const auto applied = replica.apply(message);
      ASSERT_TRUE(applied) << applied.text;
    }
  };
  for (int stroke = 0; stroke < 6; ++stroke) {
    for (int i = 0; i <= 60; ++i) {
      const double s = i / 60.0;
      session.push(0, {10'000'000ll * (1 + i + 100 * stroke),
                       {-0.01 + 0.1 * s, 0.012 * (stroke + 1) + 0.004 * std::sin(9 * s), 0.01 * (stroke % 2)},
                       {},
                       i < 60 ? 1u : 0u});
    }
    run();
    if (stroke < 2) continue;
    auto positions = std::make_shared<core::VertexPositions>();
    positions->revision = session.revision();
    for (core::VertexId v = 0; v < session.mesh().vertex_slots(); ++v) {
      const core::Vec3& p = session.mesh().position(v);
      positions->positions.push_back(p + 0.001 * std::sin(60 * p.x + stroke) * core::Vec3{0.2, 0.5, 1});
    }
    session.deform(positions);
    run();
  }
}

// A client that carries fields over whatever comes, one by one or coalesced in any way, holds what the server holds.
TEST(DeltaArrays, FieldsFollowTheMaterialHoweverDeltasAreCoalesced) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  core::CutConfig config;
  config.blade = {{0, 0, -0.03}, {0, 0, 0.12}};
  core::CutSession session(box(8, 0.01), config);
  InitialState initial;
  const core::TetMesh& mesh = session.mesh();
  for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) initial.positions.push_back(mesh.position(v));
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) initial.tets.push_back(mesh.state(t));
  protocol::Replica replica;
  ASSERT_EQ(load_initial(initial, replica), "");

  struct Fields {
    std::vector<double> rest;
    std::vector<float> constant;
    std::vector<std::int32_t> label, region;
    void carry(const protocol::Delta& delta) {
      protocol::carry(delta, 3, rest);
      protocol::carry(delta, 1, constant);
      protocol::carry(delta, 1, label);
      protocol::carry_tets(delta, 1, region);
    }
  };
  Fields stepwise;
  for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) {
    const core::Vec3& p = mesh.position(v);
    stepwise.rest.insert(stepwise.rest.end(), {p.x, p.y, p.z});
    stepwise.constant.push_back(7);
    stepwise.label.push_back(static_cast<std::int32_t>(v));
  }
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) stepwise.region.push_back(mesh.region(t));
  Fields coalesced = stepwise, twice = stepwise;

  std::vector<protocol::Frame> frames, joined;
  const auto join = [](std::vector<protocol::Frame>& some) {
    std::vector<protocol::DecodeResult> kept;
    std::vector<protocol::Delta> deltas;
    for (const protocol::Frame& frame : some) {
      kept.push_back(protocol::decode(frame.body()));
      deltas.push_back(std::get<protocol::Delta>(kept.back().message->body));
    }
    protocol::Frame out =
        protocol::encode(protocol::coalesce(std::span<const protocol::Delta>(deltas)).view());
    some.clear();
    return out;
  };
  const auto carry = [](Fields& fields, const protocol::Frame& frame) {
    const auto decoded = protocol::decode(frame.body());
    fields.carry(std::get<protocol::Delta>(decoded.message->body));
  };
  std::size_t steps = 0, blends = 0;
  cut_and_deform(replica, session, [&](const protocol::Delta& delta) {
    ++steps;
    blends += delta.blend_ids.size();
    stepwise.carry(delta);
    frames.push_back(protocol::encode(delta));
    if (random() % 4 != 0) return;
    joined.push_back(join(frames));
    carry(coalesced, joined.back());
    if (random() % 2 == 0) carry(twice, join(joined));
  });
  if (!frames.empty()) {
    joined.push_back(join(frames));
    carry(coalesced, joined.back());
  }
  if (!joined.empty()) carry(twice, join(joined));

  EXPECT_GT(steps, 50u);
  EXPECT_GT(blends, 200u);
  for (const Fields* fields : {&coalesced, &twice}) {
    EXPECT_TRUE(fields->rest == stepwise.rest);
    EXPECT_TRUE(fields->constant == stepwise.constant);
    EXPECT_TRUE(fields->label == stepwise.label);
  }
  ASSERT_TRUE(replica.deformed());
  for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) {
    const core::Vec3 off =
        core::Vec3{stepwise.rest[3 * v], stepwise.rest[3 * v + 1], stepwise.rest[3 * v + 2]} -
        mesh.rest_position(v);
    ASSERT_LT(core::length(off), 1e-7 * 0.14) << "vertex " << v;
    ASSERT_NEAR(stepwise.constant[v], 7, 1e-5);
    ASSERT_LT(stepwise.label[v], 729);
  }
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    for (const Fields* fields : {&stepwise, &coalesced, &twice})
      ASSERT_EQ(fields->region.at(t), mesh.region(t)) << "tetrahedron " << t;
  }
}

}  // namespace
}  // namespace incise::stream
