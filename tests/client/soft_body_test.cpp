// The example soft body on a virtual clock: time is counted in its steps.

#include <gtest/gtest.h>

#include <algorithm>
#include <climits>
#include <cmath>
#include <string>
#include <vector>

#include "server/mesh_io/phantom.hpp"
#include "tests/client/soft_bench.hpp"
#include "tests/haptics/random.hpp"
#include "tests/support/bodies.hpp"

namespace incise::tests {
namespace {

using core::Vec3;

constexpr int kStepsToRest = 3 * SoftBench::kRate_hz;
// Of a single vertex in a step, while the rest of the body is still, m.
constexpr double kJump_m = 8e-4, kStill_m = 1e-4;

core::MeshData phantom(mesh_io::PhantomKind kind, std::size_t tets) {
  mesh_io::FillOptions options;
  options.target_tets = tets;
  std::vector<std::string> warnings;
  return mesh_io::make_phantom(kind, options, warnings);
}

haptics::ForceConfig forces() {
  haptics::ForceConfig config;
  config.limits.most_n = 10;
  config.limits.slew_n_s = 2000;
  config.limits.ramp_s = 0;
  config.limits.frozen_s = 1e6;
  config.materials.tissue.stiffness_n_m = 600;
  config.materials.tissue.stiffness_pa = 0;
  return config;
}

// A body, and a long blade that comes from above.
struct Theatre {
  explicit Theatre(const core::MeshData& mesh)
      : low(mesh.positions[0]), high(low), bench(mesh, {{0, 0, 0}, {0, 0, -1}}, forces()) {
    for (const Vec3& p : mesh.positions) {
      low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
      high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
    }
    bench.on_step = [this] { watch(); };
  }
  // The tip goes there in a millisecond; from 0 to 1 across the body.
  void move(double x, double y, double z, bool engaged) {
    core::Pose pose;
    pose.position = {low.x + x * (high.x - low.x), low.y + y * (high.y - low.y),
                     low.z + z * (high.z - low.z) + 1};
    pose.buttons = engaged ? 1 : 0;
    bench.tick(&pose);
  }
  // A straight cut at 0 to 1 of the other axis, as low as that. Its end is where time is counted from.
  void cut(bool along_x, double beside, double z) {
    ended = INT_MAX / 2;
    for (int i = 0; i <= 600; ++i) {
      const double s = -0.15 + 1.3 * i / 600;
      move(along_x ? s : beside, along_x ? beside : s, z, i < 600);
    }
    ended = bench.steps;
    sent = bench.sent;
    // The hand has left.
    core::Pose away;
    away.position = {low.x, low.y, high.z + 3};
    bench.tick(&away);
  }
  // Steps from the end of the last stroke until the body rests; more than kStepsToRest: it does not.
  int steps_to_rest() {
    for (int i = 0; i < 20'000 && bench.stepper.awake() && bench.steps - ended <= kStepsToRest; ++i)
      bench.tick(nullptr);
    const int steps = bench.steps - ended;
    const int sent_then = bench.sent;
    for (int i = 0; i < 500; ++i) bench.tick(nullptr);
    if (!bench.stepper.awake()) {
      EXPECT_EQ(bench.sent, sent_then) << "what rests sends nothing";
    }
    return steps;
  }
  // The farthest that a vertex is from its place at rest, m.
  double bent() const {
    const core::TetMesh& mesh = bench.session->mesh();
    double most = 0;
    for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) {
      if (mesh.vertex_tet(v) != core::kNone)
        most = std::max(most, distance(mesh.position(v), mesh.rest_position(v)));
    }
    return most;
  }
  // Looks for vertices that jump, once the body has had a moment to open.
  void watch() {
    const auto now = bench.stepper.positions();
    if (before.size() == now.size() && bench.steps > ended + SoftBench::kRate_hz / 5) {
      double most = 0;
      std::size_t moving = 0;
      for (std::size_t i = 0; i < now.size(); i += 3) {
        const double way =
            std::hypot(now[i] - before[i], now[i + 1] - before[i + 1], now[i + 2] - before[i + 2]);
        most = std::max(most, way);
        moving += way > kStill_m;
      }
      jumps += most > kJump_m && moving < now.size() / 3 / 50;
    }
    before.assign(now.begin(), now.end());
  }

  Vec3 low, high;
  SoftBench bench;
  std::vector<float> before;
  int ended = 0, sent = 0, jumps = 0;
};

struct Case {
  const char* name;
  core::MeshData (*make)();
};
const Case kBodies[] = {
    {"slab", [] { return phantom(mesh_io::PhantomKind::kSlab, 3000); }},
    {"cylinder", [] { return phantom(mesh_io::PhantomKind::kCylinder, 3000); }},
    {"liver", [] { return phantom(mesh_io::PhantomKind::kLiver, 6000); }},
    {"cube", [] { return cube(8); }},
};

// Cuts in all directions, some through the whole body, so that pieces come off; each second one comes while the body still moves.
TEST(SoftBody, RestsWithinThreeSecondsOfAnyStroke) {
  for (const Case& body : kBodies) {
    for (const std::uint64_t seed : {1, 2, 3}) {
      SCOPED_TRACE(std::string(body.name) + ", seed " + std::to_string(seed));
      Random random(seed);
      Theatre theatre(body.make());
      for (int stroke = 0; stroke < 4; ++stroke) {
        const bool along_x = random.below(2) == 0;
        const double beside = random.uniform(0.2, 0.8);
        theatre.cut(along_x, beside, stroke == 3 ? -0.1 : random.uniform(-0.1, 0.7));
        if (stroke % 2 == 0) {
          for (int i = 0; i < 100; ++i) theatre.bench.tick(nullptr);
          EXPECT_TRUE(theatre.bench.stepper.awake());
          continue;
        }
        EXPECT_LE(theatre.steps_to_rest(), kStepsToRest) << "stroke " << stroke;
        EXPECT_GT(theatre.bent(), 1e-3) << "it opens";
        // Nothing pulls at what has come off and gone that far.
        EXPECT_LT(theatre.bent(), 2 * xpbd::Material{}.retraction_m);
      }
      EXPECT_GT(theatre.bench.session->pieces().size(), 0u);
      EXPECT_EQ(theatre.jumps, 0);
    }
  }
}

TEST(SoftBody, RestsUnderABladeThatStaysPressed) {
  for (const Case& body : kBodies) {
    SCOPED_TRACE(body.name);
    Theatre theatre(body.make());
    Random random(5);
    // Down until it resists, and as deep as that again. A hand trembles.
    const double height = theatre.high.z - theatre.low.z;
    double z = 1.1;
    const auto press = [&](double to, double step) {
      const double tremor = 1e-5 / height;
      theatre.move(
          0.4 + random.uniform(-1e-5, 1e-5), 0.45,
          (z = to < z ? std::max(to, z - step) : std::min(to, z + step)) + random.uniform(-tremor, tremor),
          false);
    };
    while (length(theatre.bench.force) < 1 && z > 0) press(0, 1e-5 / height);
    ASSERT_GT(z, 0);
    const double held = z;
    theatre.ended = theatre.bench.steps;
    for (int i = 0; i < 3000; ++i) press(held, 1);
    EXPECT_FALSE(theatre.bench.stepper.awake());
    EXPECT_LE(theatre.bench.steps - theatre.ended, kStepsToRest);
    EXPECT_GT(theatre.bent(), 5e-4) << "it gives way";
    const double pressed = length(theatre.bench.force), bent = theatre.bent();
    EXPECT_GT(pressed, 0.5);
    const int steps = theatre.bench.steps;
    for (int i = 0; i < 2000; ++i) press(held, 1);
    EXPECT_EQ(theatre.bench.steps, steps) << "it stays at rest";
    EXPECT_NEAR(length(theatre.bench.force), pressed, 0.05);
    // Farther, it moves again; and without the blade it is as it was.
    theatre.ended = INT_MAX / 2;
    for (int i = 0; i < 500; ++i) press(held - 0.002 / height, 1e-5 / height);
    EXPECT_GT(theatre.bench.steps, steps);
    EXPECT_GT(theatre.bent(), bent);
    for (int i = 0; i < 3000; ++i) press(1.2, 2e-5 / height);
    theatre.ended = theatre.bench.steps;
    EXPECT_LE(theatre.steps_to_rest(), kStepsToRest);
    EXPECT_LT(theatre.bent(), 1e-4);
    EXPECT_EQ(theatre.jumps, 0);
  }
}

TEST(SoftBody, RestsAfterResetUndoAndAgain) {
  Theatre theatre(phantom(mesh_io::PhantomKind::kSlab, 3000));
  EXPECT_LE(theatre.steps_to_rest(), kStepsToRest);
  EXPECT_EQ(theatre.bench.sent, 0) << "it rests as it was served";
  theatre.cut(false, 0.4, 0.3);
  EXPECT_LE(theatre.steps_to_rest(), kStepsToRest);
  // As it is, once more: a state that was saved, or another connection.
  const double bent = theatre.bent();
  theatre.bench.reload();
  theatre.ended = theatre.bench.steps;
  EXPECT_LE(theatre.steps_to_rest(), kStepsToRest);
  EXPECT_NEAR(theatre.bent(), bent, 2e-4);
  // Undone, while it moves.
  theatre.cut(true, 0.6, 0.2);
  EXPECT_TRUE(theatre.bench.stepper.awake());
  theatre.bench.restart();
  const int sent = theatre.bench.sent;
  theatre.ended = theatre.bench.steps;
  EXPECT_LE(theatre.steps_to_rest(), kStepsToRest);
  EXPECT_EQ(theatre.bench.sent, sent);
  EXPECT_EQ(theatre.bent(), 0);
  theatre.cut(true, 0.6, 0.2);
  EXPECT_LE(theatre.steps_to_rest(), kStepsToRest);
  EXPECT_GT(theatre.bent(), 1e-3);
  EXPECT_EQ(theatre.jumps, 0);
}

// The same motion gives the same body, to the bit.
TEST(SoftBody, IsDeterministic) {
  const auto run = [] {
    Theatre theatre(cube(6));
    theatre.cut(false, 0.4, 0.3);
    theatre.steps_to_rest();
    return std::pair(theatre.bench.session->mesh().state_hash(), theatre.bench.steps);
  };
  EXPECT_EQ(run(), run());
}

}  // namespace
}  // namespace incise::tests
