#include "server/core/session/late_vertices.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/validate.hpp"
#include "tests/core/session/moving_body.hpp"

namespace incise::core {
namespace {

using testing::all;
using testing::at;
using testing::body;
using testing::config;
using testing::deform;
using testing::run_all;
using testing::some;

// How a body goes that is turned, and then moved.
Vec3 turned(const Vec3& p, double angle, const Vec3& way) {
  const Vec3 middle{0.04, 0.03, 0.03}, r = p - middle;
  return middle + way +
         Vec3{std::cos(angle) * r.x - std::sin(angle) * r.y, std::sin(angle) * r.x + std::cos(angle) * r.y,
              r.z};
}

// Positions of before a cut move what the cut has not touched, and what it has goes along.
TEST(LateVertices, GoAlong) {
  std::uint64_t hash = 0;
  for (const std::int64_t units : {INT64_MAX, std::int64_t{40}}) {
    CutSession session(body(), config());
    for (int i = 0; i <= 50; ++i) session.push(0, at(1 + 8 * i, {-0.02 + 0.12 * i / 50, 0.03, 0}, i < 50));
    std::vector<bool> touched(session.mesh().vertex_slots(), false);
    for (const Delta& delta : run_all(session)) {
      for (const VertexId v : delta.moved) touched[v] = true;
    }
    const auto before = static_cast<std::uint32_t>(touched.size()), now = session.mesh().vertex_slots();
    ASSERT_GT(now, before);
    std::vector<Vec3> places;
    for (VertexId v = 0; v < now; ++v) places.push_back(session.mesh().position(v));
    const auto goes = [](const Vec3& p) { return turned(p, 0.5, {0.05, 0.02, -0.01}); };
    auto late = all(session, [&](VertexId v, const Vec3& p) {
      // Of what it does not know a simulation says anything.
      return v < before && !touched[v] ? goes(p) : p + Vec3{0.3, 0.3, 0.3};
    });
    late->revision = 0;
    session.deform(late);
    const Delta delta = std::move(run_all(session, units).back());
    EXPECT_TRUE(delta.deformation.held.empty());
    EXPECT_EQ(delta.deformation.moved, now);
    EXPECT_EQ(delta.deformation.passed_over,
              now - before + static_cast<std::uint32_t>(std::ranges::count(touched, true)));
    for (VertexId v = 0; v < now; ++v)
      EXPECT_LT(distance(session.mesh().position(v), goes(places[v])), 1e-12) << v;
    EXPECT_EQ(validate(session.mesh()), "");
    if (units == INT64_MAX) hash = session.mesh().state_hash();
    EXPECT_EQ(session.mesh().state_hash(), hash);
  }
}

// However far the body is strained from what it is at rest.
TEST(LateVertices, GoAlongInABodyThatIsStretchedByHalf) {
  CutSession session(body(), config());
  for (int i = 0; i <= 50; ++i) session.push(0, at(1 + 8 * i, {-0.02 + 0.12 * i / 50, 0.03, 0}, i < 50));
  run_all(session);
  const auto goes = [](const Vec3& p) {
    return Vec3{1.5 * p.x + 0.4 * p.y, 1.2 * p.y, 0.7 * p.z - 0.3 * p.x};
  };
  for (int step = 1; step <= 10; ++step) {
    auto positions = all(session, [&](VertexId v, const Vec3&) {
      const Vec3& rest = session.mesh().rest_position(v);
      return lerp(rest, goes(rest), 0.1 * step);
    });
    positions->revision = 0;
    EXPECT_TRUE(deform(session, positions).deformation.held.empty()) << step;
  }
  for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v)
    EXPECT_LT(distance(session.mesh().position(v), goes(session.mesh().rest_position(v))),
              0.1 * testing::kCell)
        << v;
  EXPECT_EQ(validate(session.mesh()), "");
}

// A slice between two cuts that the simulation has not heard of.
TEST(LateVertices, GoAlongWhereNothingOfAPartIsKnown) {
  CutSession session(body(), config());
  for (const double y : {0.028, 0.036}) {
    const int first = y > 0.03 ? 100 : 0;
    for (int i = 0; i <= 50; ++i)
      session.push(0, at(1 + 8 * (first + i), {-0.02 + 0.12 * i / 50, y, 0}, i < 50));
  }
  run_all(session);
  EXPECT_EQ(measure(session.mesh()).pieces, 3u);
  std::vector<Vec3> places;
  for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v) places.push_back(session.mesh().position(v));
  const auto goes = [](const Vec3& p) { return turned(p, 0.4, {0.05, 0.02, -0.01}); };
  auto late = all(session, [&](VertexId, const Vec3& p) { return goes(p); });
  late->revision = 0;
  EXPECT_TRUE(deform(session, late).deformation.held.empty());
  for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v) {
    if (session.mesh().vertex_tet(v) == kNone) continue;
    EXPECT_LT(distance(session.mesh().position(v), goes(places[v])), 1e-10) << v;
  }
}

// Of a step that names some vertices the others stay, those that were cut since as well, unless they hang on these.
TEST(LateVertices, StayWhereNothingAroundThemMoves) {
  CutSession session(body(), config());
  for (int i = 0; i <= 50; ++i) session.push(0, at(1 + 8 * i, {-0.02 + 0.12 * i / 50, 0.03, 0}, i < 50));
  run_all(session);
  std::vector<Vec3> places;
  for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v) places.push_back(session.mesh().position(v));
  const Delta far = deform(session, some(0, {0}, {places[0] + Vec3{1e-4, 0, 0}}));
  EXPECT_EQ(far.moved, std::vector<VertexId>{0});
  // The end of x up to the cut's middle.
  std::vector<VertexId> ids;
  std::vector<Vec3> to;
  for (VertexId v = 0; v < body().positions.size(); ++v) {
    if (places[v].x > 0.035) continue;
    ids.push_back(v);
    to.push_back(places[v] + Vec3{0, 1e-3, 0});
  }
  const Delta half = deform(session, some(0, ids, to));
  std::size_t late = 0;
  for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v) {
    const double way = session.mesh().position(v).y - places[v].y;
    if (places[v].x < 0.02) {
      EXPECT_NEAR(way, 1e-3, 1e-4) << v;
    } else if (places[v].x > 0.06) {
      EXPECT_EQ(way, 0) << v;
    }
    if (v >= body().positions.size() && way > 0) ++late;
  }
  EXPECT_GT(late, 10u);
  EXPECT_EQ(validate(session.mesh()), "");
}

// A solver that is some steps behind, or never hears of the cut, carries what is cut all the same.
TEST(LateVertices, AreWhereTheBodyIs) {
  for (const std::size_t behind : {std::size_t{0}, std::size_t{1}, std::size_t{3}, std::size_t{1000}}) {
    CutSession session(body(), config());
    std::vector<std::pair<std::uint64_t, std::uint32_t>> known;  // revision, vertices
    double most_h = 0;
    for (int i = 0; i <= 60; ++i) {
      // It turns and goes, by up to 1.4 edge lengths a step, and bends.
      const double phase = 0.157 * i;
      const auto goes = [phase](const Vec3& rest) {
        const double s = std::sin(phase);
        return turned(rest + Vec3{0, 0, 1.0 * s * (rest.x - 0.04) * (rest.x - 0.04)}, 0.5 * s,
                      {0, 0.1 * s, 0});
      };
      known.emplace_back(session.revision(), session.mesh().vertex_slots());
      const auto [revision, vertices] = known[known.size() > behind ? known.size() - 1 - behind : 0];
      auto step = std::make_shared<VertexPositions>();
      step->revision = revision;
      for (VertexId v = 0; v < vertices; ++v)
        step->positions.push_back(goes(session.mesh().rest_position(v)));
      deform(session, step);
      session.push(0, {1 + 16'000'000 * std::int64_t{i},
                       goes({-0.02 + 0.12 * i / 50, 0.03, 0}),
                       {std::cos(0.25 * std::sin(phase)), 0, 0, std::sin(0.25 * std::sin(phase))},
                       1});
      run_all(session);
      for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v) {
        if (session.mesh().vertex_tet(v) == kNone) continue;
        const double off_m = distance(session.mesh().position(v), goes(session.mesh().rest_position(v)));
        most_h = std::max(most_h, off_m / session.mesh().mean_edge_length());
      }
    }
    session.end_stroke(0);
    run_all(session);
    EXPECT_EQ(validate(session.mesh()), "");
    EXPECT_LT(most_h, 0.06) << behind;
    EXPECT_EQ(measure(session.mesh()).pieces, 2u) << behind;
  }
}

}  // namespace
}  // namespace incise::core
