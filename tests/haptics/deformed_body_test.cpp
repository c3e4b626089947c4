// Forces in a body that a simulation deforms: against the same motion in a body at rest, and against formulas.

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <memory>

#include "server/core/session/cut_session.hpp"
#include "server/haptics/force_model.hpp"
#include "tests/haptics/random.hpp"
#include "tests/support/bodies.hpp"

namespace incise::haptics {
namespace {

using core::Vec3;
using tests::Random;

constexpr double kSize = 0.1;
constexpr double kStep_s = 0.001;

using Place = std::function<Vec3(const Vec3&)>;

// A cube whose vertices are where a function of their rest positions puts them, and a blade in it.
class Body {
 public:
  explicit Body(std::uint32_t n = 10)
      : session_(tests::cube(n, kSize), config()), tissue_(tests::cube(n, kSize)) {
    tissue_.follow(session_.mesh());
  }

  void deform(const Place& place) {
    auto positions = std::make_shared<core::VertexPositions>();
    positions->revision = session_.revision();
    for (core::VertexId v = 0; v < session_.mesh().vertex_slots(); ++v)
      positions->positions.push_back(place(session_.mesh().rest_position(v)));
    session_.deform(positions);
    advance();
  }
  void cut(const Vec3& from, const Vec3& to, const core::Quat& turn = {}) {
    for (int i = 0; i <= 100; ++i) {
      core::Pose pose;
      pose.t_ns = ++time_ns_ * 1'000'000;
      pose.position = lerp(from, to, i / 100.0);
      pose.orientation = turn;
      pose.buttons = 1;
      session_.push(0, pose);
      advance();
    }
    session_.end_stroke(0);
    advance();
  }
  const Tissue& tissue() const { return tissue_; }
  const core::CutSession& session() const { return session_; }

 private:
  static core::CutConfig config() {
    core::CutConfig config;
    config.blade = {{0, 0, 0}, {0, 0, -0.15}};
    config.speed_limit_m_s = 1000;
    return config;
  }
  void advance() {
    core::Delta delta;
    auto budget = core::WorkBudget::unlimited();
    while (session_.advance(budget, delta) == core::CutSession::Progress::kCommitted)
      tissue_.note_cuts(session_.mesh(), delta.boundary_upserted);
  }
  core::CutSession session_;
  Tissue tissue_;
  std::int64_t time_ns_ = 0;
};

// A blade whose edge is given by its ends; the tool's origin is the heel.
class Hand {
 public:
  explicit Hand(const Body& body) : body_(body) {}
  const Feel& to(const Vec3& heel, const Vec3& tip, bool engaged = false, double dt_s = kStep_s) {
    if (has_pose_) work_ -= dot(feel_.force, heel - tool_);
    BladeMotion motion;
    motion.line = {heel, tip};
    motion.tool = heel;
    motion.engaged = engaged;
    motion.elapsed_s = has_pose_ ? kStep_s : 0;
    motion.dt_s = has_pose_ ? dt_s : 0;
    feel_ = model_.update(body_.tissue(), motion, feel_.force);
    EXPECT_FALSE(feel_.work.cut_short);
    tool_ = heel;
    has_pose_ = true;
    return feel_;
  }
  // The same pose until what is transient is over.
  const Feel& rest(const Vec3& heel, const Vec3& tip, bool engaged = false) {
    for (int i = 0; i < 200; ++i) to(heel, tip, engaged);
    return feel_;
  }
  const Feel& feel() const { return feel_; }
  double work() const { return work_; }
  Materials materials;

 private:
  const Body& body_;
  ForceModel model_{materials, 2000, 0.5};
  Feel feel_;
  Vec3 tool_;
  bool has_pose_ = false;
  double work_ = 0;
};

Engagement probe_line(const Tissue& tissue, const core::BladeLine& line) {
  ProbeWork work;
  const Engagement e = probe(tissue, {}, tissue.rest().line(line, work), work);
  EXPECT_FALSE(work.cut_short);
  return e;
}

Vec3 turned(const Vec3& p, double angle) {
  return {std::cos(angle) * p.x - std::sin(angle) * p.y, std::sin(angle) * p.x + std::cos(angle) * p.y, p.z};
}

struct Affine {
  const char* name;
  Place place;
  Vec3 top;  // outward normal of the face z = kSize, as it is then, not of unit length
};

std::vector<Affine> affine_maps() {
  return {
      {"moved far",
       [](const Vec3& p) {
         return p + Vec3{0.5, -0.3, 0.7};
       },
       {0, 0, 1}},
      {"turned", [](const Vec3& p) { return turned(p, 0.8); }, {0, 0, 1}},
      {"sheared",
       [](const Vec3& p) {
         return Vec3{p.x + 0.4 * p.z, p.y - 0.2 * p.z, p.z};
       },
       {0, 0, 1}},
      {"tilted",
       [](const Vec3& p) {
         return Vec3{p.x, p.y, p.z + 0.3 * p.x};
       },
       {-0.3, 0, 1}},
      {"pressed",
       [](const Vec3& p) {
         return Vec3{1.2 * p.x, 1.2 * p.y, 0.6 * p.z};
       },
       {0, 0, 1}},
      {"tilted, moved and pressed",
       [](const Vec3& p) {
         return Vec3{p.x - 0.2, 1.1 * p.y + 0.4, 0.7 * p.z + 0.25 * p.x + 0.1 * p.y};
       },
       {-0.25, -0.1 / 1.1, 1}},
  };
}

// Any line through a deformed cube has as much inside as the line that is taken back, stretched.
TEST(DeformedBody, MeasuresAnyLineThroughAnAffineCube) {
  const std::uint64_t seed = 5;
  SCOPED_TRACE("seed " + std::to_string(seed));
  const Body rest;
  for (const Affine& affine : affine_maps()) {
    SCOPED_TRACE(affine.name);
    Random random(seed);
    Body body;
    body.deform(affine.place);
    int met = 0;
    for (int i = 0; i < 500; ++i) {
      const core::BladeLine line{random.in_box({-0.05, -0.05, -0.05}, {0.15, 0.15, 0.15}),
                                 random.in_box({-0.05, -0.05, -0.05}, {0.15, 0.15, 0.15})};
      const core::BladeLine now{affine.place(line.heel), affine.place(line.tip)};
      const Engagement expected = probe_line(rest.tissue(), line), found = probe_line(body.tissue(), now);
      const double stretch = distance(now.heel, now.tip) / distance(line.heel, line.tip);
      ASSERT_NEAR(found.length_m, stretch * expected.length_m, 1e-9) << i;
      ASSERT_NEAR(found.uncut_m, found.length_m, 1e-9);
      if (expected.length_m == 0) continue;
      ++met;
      ASSERT_NEAR(found.from, expected.from, 1e-7) << i;
      ASSERT_NEAR(found.to, expected.to, 1e-7) << i;
      ASSERT_NEAR(found.middle, expected.middle, 1e-7) << i;
    }
    EXPECT_GT(met, 150);
  }
}

// A tip pressed d deep into a face, wherever that is now, is pushed along the face's normal by (k + k' d) d.
TEST(DeformedBody, ATipFeelsTheFaceWhereItIsNow) {
  for (const Affine& affine : affine_maps()) {
    SCOPED_TRACE(affine.name);
    Body body;
    body.deform(affine.place);
    const Vec3 normal = normalized(affine.top), at = affine.place({0.052, 0.047, kSize});
    Hand hand(body);
    for (double height = 0.002; height > -0.003; height -= 2e-5)
      hand.to(at + (0.05 + height) * normal, at + height * normal);
    const Feel& feel = hand.rest(at + 0.047 * normal, at - 0.003 * normal);
    const double expected = (300 + 40e3 * 0.003) * 0.003;
    EXPECT_NEAR(dot(feel.force, normal), expected, 0.01 * expected);
    EXPECT_NEAR(length(feel.force - dot(feel.force, normal) * normal), 0, 0.01 * expected);
    ASSERT_TRUE(feel.contact.has_value());
    EXPECT_NEAR(dot(feel.contact->normal, normal), 1, 1e-9);
  }
}

// Blade and body moved together feel like both at rest, friction and front included.
void compare_with_rest(double turn_rad_s, double share, double newtons, int steps) {
  Body still, moving;
  Hand at_rest(still), along(moving);
  double most = 0;
  for (int i = 0; i < steps; ++i) {
    const double s = i * 1e-3, angle = turn_rad_s * s;
    const Vec3 shift{0.05 * std::sin(9 * s), 0.03 * s, 0.04 * std::sin(5 * s)};
    const auto place = [&](const Vec3& p) { return turned(p, angle) + shift; };
    moving.deform(place);
    // In from the side: press, puncture, cut, withdraw.
    const double in = i < 200 ? 0.3e-3 * i : 0.06 - 0.3e-3 * (i - 200);
    const Vec3 heel{0.05, -0.02 + in, 0.13}, tip{0.05 + 0.1 * in, -0.02 + in, 0.03};
    const bool engaged = i >= 80;
    const Feel& a = at_rest.to(heel, tip, engaged);
    const Feel& b = along.to(place(heel), place(tip), engaged);
    ASSERT_EQ(a.contact.has_value(), b.contact.has_value()) << i;
    ASSERT_NEAR(a.engagement.length_m, b.engagement.length_m, 1e-8) << i;
    const Vec3 expected = turned(a.force, angle);
    most = std::max(most, length(a.force));
    ASSERT_NEAR(distance(b.force, expected), 0, share * length(a.force) + newtons) << i;
  }
  EXPECT_GT(most, 0.5);
}

TEST(DeformedBody, ABodyThatMovesWithTheBladeFeelsLikeOneAtRest) {
  // But for what a spring whose force grows by a newton in a frame falls behind, which tissue that moves makes up for.
  compare_with_rest(0, 0.04, 2e-4, 400);
}

// A hand that turns and feels no torque does other work than its blade, so it gets in a moment earlier or later; when it withdraws, the account
// knows that.
TEST(DeformedBody, ABodyThatTurnsWithTheBladeFeelsLikeOneAtRest) {
  compare_with_rest(0.4, 0.04, 2e-4, 200);
}

// A hand that holds still is dragged along by tissue that slides past the blade.
TEST(DeformedBody, TissueThatMovesPushesTheHand) {
  Body body;
  body.deform([](const Vec3& p) { return p; });
  Hand hand(body);
  const Vec3 heel{0.05, 0.05, 0.15}, tip{0.05, 0.05, 0.05};
  // Put there: the front is where it is, and only what moves from here on is felt.
  hand.rest(heel, tip);
  double moved = 0;
  for (int i = 0; i < 100; ++i) {
    moved += 1e-5;  // 10 mm/s along the edge
    body.deform([&](const Vec3& p) { return p + Vec3{0, 0, moved}; });
    hand.to(heel, tip);
  }
  const double length_inside = 0.05;
  EXPECT_NEAR(hand.feel().force.z, 20 * length_inside * 0.01, 1e-3);
  EXPECT_NEAR(hand.feel().force.x, 0, 1e-6);
  hand.rest(heel, tip);
  EXPECT_NEAR(length(hand.feel().force), 0, 1e-6) << "until it stands still";

  // Lifted against a tip that presses on it: the spring is compressed as if the hand had gone down.
  Body lifted;
  lifted.deform([](const Vec3& p) { return p; });
  Hand above(lifted);
  const Vec3 high{0.052, 0.047, 0.151}, low{0.052, 0.047, 0.1005};
  above.rest(high, low);
  double up = 0;
  for (int i = 0; i < 250; ++i) {
    up += 1e-5;
    lifted.deform([&](const Vec3& p) { return p + Vec3{0, 0, up}; });
    above.to(high, low);
  }
  const double depth = up - 0.0005, expected = (300 + 40e3 * depth) * depth;
  EXPECT_NEAR(above.rest(high, low).force.z, expected, 0.02 * expected);
}

// In a body that bends the edge is straight now and curved at rest. The curve's crossing with the boundary is what counts.
TEST(DeformedBody, FindsTheBoundaryOfABodyThatBends) {
  const auto place = [](const Vec3& p) { return Vec3{p.x, p.y, p.z - 4 * (p.x - 0.05) * (p.x - 0.05)}; };
  Body body(20);
  body.deform(place);
  for (const double x : {0.013, 0.05, 0.081}) {
    const double top = kSize - 4 * (x - 0.05) * (x - 0.05);
    for (const double depth : {0.002, 0.01, 0.05}) {
      const Engagement e =
          probe_line(body.tissue(), {{x, 0.052, top - depth + 0.12}, {x, 0.052, top - depth}});
      EXPECT_NEAR(e.length_m, depth, 4 * 0.005 * 0.005 / 4 + 1e-5) << x << ' ' << depth;  // chords of 5 mm
    }
  }
}

// Cuts stay where they are in the material; between sides that have parted there is no tissue.
TEST(DeformedBody, ACutMovesWithTheBodyAndItsGapIsEmpty) {
  Body body;
  body.cut({0.052, -0.02, 0.12}, {0.052, 0.12, 0.12});  // the plane x = 0.052, through
  const auto part = [&](double width) {
    return [&, width](const Vec3& p) { return p + Vec3{0.3 + (p.x > 0.052 ? width : 0), 0, 0}; };
  };
  body.deform(part(0));
  // In the slit, a line across x crosses it, a line in it is in what is cut.
  const Engagement in_slit = probe_line(body.tissue(), {{0.352, 0.05, 0.15}, {0.352, 0.05, 0.05}});
  EXPECT_NEAR(in_slit.length_m, 0.05, 1e-3);
  EXPECT_NEAR(in_slit.uncut_m, 0, 0.005);
  // Opened by 2 cm: rest positions of the copies tell the sides apart by which tetrahedra have them.
  auto positions = std::make_shared<core::VertexPositions>();
  std::vector<std::uint8_t> right(body.session().mesh().vertex_slots());
  const core::TetMesh& mesh = body.session().mesh();
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    double x = 0;
    for (const auto v : mesh.vertices(t)) x += mesh.rest_position(v).x / 4;
    for (const auto v : mesh.vertices(t)) right[v] = x > 0.052;
  }
  Body& open = body;
  core::VertexId next = 0;
  open.deform([&](const Vec3& p) { return p + Vec3{0.3 + (right[next++] ? 0.02 : 0), 0, 0}; });
  const Engagement in_gap = probe_line(body.tissue(), {{0.362, 0.05, 0.15}, {0.362, 0.05, 0.05}});
  EXPECT_EQ(in_gap.length_m, 0);
  // On either side there is tissue, as much as before.
  for (const double x : {0.33, 0.40}) {
    const Engagement beside = probe_line(body.tissue(), {{x, 0.05, 0.15}, {x, 0.05, 0.05}});
    EXPECT_NEAR(beside.length_m, 0.05, 1e-9) << x;
    EXPECT_NEAR(beside.uncut_m, 0.05, 1e-9) << x;
  }
}

// What a frame looks at does not grow with the mesh beyond what a blade meets in it, nor with cuts, and stays within the bounds.
TEST(DeformedBody, AFrameLooksAtNoMoreInALargerOrCutBody) {
  const auto bend = [](const Vec3& p) {
    return Vec3{p.x + 0.01 * std::sin(30 * p.z), p.y, p.z - 2 * (p.x - 0.05) * (p.x - 0.05)};
  };
  const auto most = [&](Body& body) {
    const std::uint64_t seed = 3;
    Random random(seed);
    ProbeWork worst;
    for (int i = 0; i < 300; ++i) {
      ProbeWork work;
      const core::BladeLine line{random.in_box({-0.05, -0.05, 0}, {0.15, 0.15, 0.2}),
                                 random.in_box({-0.02, -0.02, -0.02}, {0.12, 0.12, 0.12})};
      probe(body.tissue(), {}, body.tissue().rest().line(line, work), work);
      worst.boxes = std::max(worst.boxes, work.boxes);
      worst.triangles = std::max(worst.triangles, work.triangles);
      worst.tets = std::max(worst.tets, work.tets);
      EXPECT_FALSE(work.cut_short) << i;
    }
    return worst;
  };
  Body small(6), large(24), cut(24);
  for (const double x : {0.02, 0.04, 0.06, 0.08}) cut.cut({x, -0.02, 0.12}, {x, 0.12, 0.12});
  small.deform(bend);
  large.deform(bend);
  cut.deform(bend);
  const ProbeWork a = most(small), b = most(large), c = most(cut);
  // 64 times the tetrahedra, four times as many along a line.
  EXPECT_LT(b.tets, 5 * a.tets);
  EXPECT_LT(b.boxes, 3 * a.boxes);
  EXPECT_LT(c.tets, 1.3 * b.tets);
  EXPECT_LT(c.boxes, 1.3 * b.boxes);
}

// Whatever hand and body do, what comes out is bounded.
TEST(DeformedBody, NoEnergyComesOutOfABodyThatShakes) {
  const std::uint64_t seed = 17;
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  Body body(6);
  body.deform([](const Vec3& p) { return p; });
  Hand hand(body);
  Vec3 at{0.05, 0.05, 0.12}, heading;
  double most = 0;
  int felt = 0;
  for (int i = 0; i < 6000; ++i) {
    if (i % 100 == 0) heading = random.in_box({-1, -1, -1}, {1, 1, 1});
    const Vec3 pull = Vec3{0.05, 0.05, 0.12} - at;
    at += 2e-4 * heading + 0.01 * pull;
    if (i % 16 == 0) {  // some 60 Hz
      const double up = 0.01 * std::sin(0.04 * i), shear = 0.1 * std::sin(0.017 * i);
      body.deform([&](const Vec3& p) { return Vec3{p.x + shear * p.z, p.y, p.z + up}; });
    }
    const Feel& feel = hand.to(at, at + Vec3{0.01, 0, -0.05}, i % 1000 < 500);
    felt += length(feel.force) > 0.01;
    most = std::max(most, -hand.work() - i * kStep_s * (ForceModel::kLeak_w + ForceModel::kTissueLeak_w));
  }
  EXPECT_GT(felt, 1000);
  EXPECT_LT(most, ForceModel::kReserve_j + ForceModel::kTissueReserve_j + 1e-3);
}

}  // namespace
}  // namespace incise::haptics
