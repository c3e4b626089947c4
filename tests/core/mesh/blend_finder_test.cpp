#include "server/core/mesh/blend_finder.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "server/core/session/cut_session.hpp"
#include "tests/core/test_meshes.hpp"

// Whether the deltas of cuts say which material each vertex stands for. PlainModel carries the rest positions, a linear
// field, by provenance and blends alone.
namespace incise::core {
namespace {

using testing::PlainModel;
using testing::Random;

// Strokes of a short blade that tumbles through the body and wanders: batches that meet older cuts, ends and turns in the tissue.
class Strokes {
 public:
  Strokes(std::uint64_t seed, const MeshData& mesh, Policy policy)
      : random_(seed), session_(mesh, config(mesh, policy)) {
    low_ = high_ = mesh.positions[0];
    for (const Vec3& p : mesh.positions) {
      low_ = {std::min(low_.x, p.x), std::min(low_.y, p.y), std::min(low_.z, p.z)};
      high_ = {std::max(high_.x, p.x), std::max(high_.y, p.y), std::max(high_.z, p.z)};
    }
  }
  const TetMesh& mesh() const { return session_.mesh(); }
  CutSession& session() { return session_; }
  double size() const { return distance(low_, high_); }

  // One stroke across the body's box, or a way into it.
  std::vector<Delta> next() {
    const double h = mesh().mean_edge_length();
    const Vec3 p = place(), to = place();
    const Vec3 across = 3 * h * random_.direction();
    const int steps = static_cast<int>(distance(p, to) / (0.2 * h)) + 2;
    for (int i = 0; i <= steps; ++i) {
      const double s = static_cast<double>(i) / steps;
      session_.push(
          0, {t_ns_ += 80'000'000, lerp(p, to, s) + std::sin(7 * s) * across, {}, i < steps ? 1u : 0u});
    }
    return run();
  }
  std::vector<Delta> run() {
    std::vector<Delta> deltas;
    for (;;) {
      WorkBudget budget{random_.below(3) == 0 ? 40 : INT64_MAX};
      Delta delta;
      const auto progress = session_.advance(budget, delta);
      if (progress == CutSession::Progress::kIdle) return deltas;
      if (progress == CutSession::Progress::kCommitted) deltas.push_back(std::move(delta));
    }
  }

 private:
  static CutConfig config(const MeshData& mesh, Policy policy) {
    CutConfig c;
    const double h = TetMesh(mesh).mean_edge_length();
    c.blade = {{0, 0, -4 * h}, {0.5 * h, 0, 4 * h}};
    c.policy = policy;
    return c;
  }
  Vec3 place() { return random_.in_box(low_, high_); }

  Random random_;
  CutSession session_;
  Vec3 low_, high_;
  std::int64_t t_ns_ = 0;
};

// The weights of each blend add up to 1, and are those in one tetrahedron of the state before. Returns how many blends there are.
std::size_t check_blends(const Delta& delta, const PlainModel* before) {
  std::set<std::array<VertexId, 4>> tets;
  if (before != nullptr) {
    for (const auto& [id, tet] : before->tets()) {
      auto vertices = tet.vertices;
      std::sort(vertices.begin(), vertices.end());
      tets.insert(vertices);
    }
  }
  for (const Blend& blend : delta.blends) {
    const auto& w = blend.weights;
    EXPECT_NEAR(w[0] + w[1] + w[2] + w[3], 1, 1e-12 * (1 + std::abs(w[1]) + std::abs(w[2]) + std::abs(w[3])));
    auto from = blend.from;
    std::sort(from.begin(), from.end());
    EXPECT_TRUE(before == nullptr || tets.contains(from)) << "vertex " << blend.vertex;
  }
  return delta.blends.size();
}

struct Case {
  std::string mesh;  // empty: a box
  Policy policy;
  bool deforms;
  int batches;
};

class Blends : public ::testing::TestWithParam<Case> {};

TEST_P(Blends, ALinearFieldStaysLinear) {
  const Case& c = GetParam();
  if (!c.mesh.empty() && testing::data_folder().empty()) GTEST_SKIP() << "INCISE_DATA is not set";
  const std::uint64_t seed = 20261;
  SCOPED_TRACE("seed " + std::to_string(seed));
  Strokes strokes(seed,
                  c.mesh.empty() ? testing::shaken_box(c.deforms ? 8 : 20, 12, 12, 1, 0.1, 0.01)
                                 : testing::real_mesh(c.mesh),
                  c.policy);
  PlainModel model(strokes.mesh());
  std::size_t blends = 0, added = 0;
  int batches = 0;
  while (batches < c.batches && !::testing::Test::HasFailure()) {
    if (c.deforms) {
      auto positions = std::make_shared<VertexPositions>();
      positions->revision = strokes.session().revision();
      const double size = strokes.size(), phase = 0.3 * batches;
      for (VertexId v = 0; v < strokes.mesh().vertex_slots(); ++v) {
        const Vec3 rest = strokes.mesh().rest_position(v);
        positions->positions.push_back(rest +
                                       0.05 * size * std::sin(6 * rest.x / size + phase) * Vec3{0.2, 1, 0.5});
      }
      strokes.session().deform(positions);
    }
    for (const Delta& delta : strokes.next()) {
      EXPECT_TRUE(delta.stroke != 0 || delta.blends.empty()) << "a deformation moves no material";
      blends += check_blends(delta, batches % 16 == 0 ? &model : nullptr);
      for (const Blend& blend : delta.blends) added += blend.vertex >= delta.first_added;
      model.apply(delta);
      ++batches;
    }
  }
  model.expect_equals(strokes.mesh());
  EXPECT_GT(blends, static_cast<std::size_t>(c.batches) / 2);
  EXPECT_GT(added, 0u) << "none of an added vertex";
  RecordProperty("blends", static_cast<int>(blends));
}

INSTANTIATE_TEST_SUITE_P(
    Cuts, Blends,
    ::testing::Values(Case{"", Policy::kConforming, false, 1000}, Case{"", Policy::kConforming, true, 300},
                      Case{"", Policy::kCroll, false, 100},
                      Case{"liver_6564.node", Policy::kConforming, false, 200},
                      Case{"bunny_27226.node", Policy::kConforming, true, 60}),
    [](const auto& test) {
      return (test.param.mesh.empty() ? "box" : test.param.mesh.substr(0, test.param.mesh.find('_'))) +
             std::string(test.param.policy == Policy::kCroll ? "_croll" : "") +
             (test.param.deforms ? "_deforming" : "");
    });

// A field that differs on the two sides of an older cut is not mixed by later ones that meet it.
TEST(BlendFinder, StaysOnItsSideOfAnOlderCut) {
  Strokes strokes(7, testing::shaken_box(8, 6, 6, 3, 0.1, 0.01), Policy::kConforming);
  CutSession& session = strokes.session();
  session.set_blade(1, {{0, 0, -0.1}, {0, 0, 0.2}});
  for (int i = 0; i <= 50; ++i)
    session.push(1, {1 + 80'000'000ll * i, {-0.02 + 0.12 * i / 50, 0.031, 0}, {}, i < 50 ? 1u : 0u});
  strokes.run();
  ASSERT_EQ(session.pieces().size(), 1u);
  std::vector<double> side(session.mesh().vertex_slots(), 0);
  for (TetId t = 0; t < session.mesh().tet_slots(); ++t) {
    if (!session.mesh().alive(t)) continue;
    for (const VertexId v : session.mesh().vertices(t)) side[v] = session.piece(t) == 0 ? 1000 : -1000;
  }
  std::size_t blends = 0;
  for (int stroke = 0; stroke < 8; ++stroke) {
    for (const Delta& delta : strokes.next()) {
      const std::vector<double> before = side;
      side.resize(side.size() + delta.provenance.size());
      std::vector<bool> done(side.size(), false);
      for (const Blend& blend : delta.blends) {
        side[blend.vertex] = 0;
        for (std::size_t k = 0; k < 4; ++k) side[blend.vertex] += blend.weights[k] * before.at(blend.from[k]);
        done[blend.vertex] = true;
        ++blends;
      }
      for (std::size_t i = 0; i < delta.provenance.size(); ++i) {
        const Provenance& p = delta.provenance[i];
        if (!done[before.size() + i]) side[before.size() + i] = (1 - p.t) * side[p.a] + p.t * side[p.b];
      }
    }
  }
  EXPECT_GT(blends, 200u);
  for (TetId t = 0; t < session.mesh().tet_slots(); ++t) {
    if (!session.mesh().alive(t)) continue;
    const auto& tet = session.mesh().vertices(t);
    for (const VertexId v : tet) {
      EXPECT_NEAR(std::abs(side[v]), 1000, 1e-6) << "vertex " << v;
      EXPECT_NEAR(side[v], side[tet[0]], 1e-6) << "tetrahedron " << t;
    }
  }
}

}  // namespace
}  // namespace incise::core
