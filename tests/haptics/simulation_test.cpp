// Forces, the loads that a host simulation gets, and a stand-in for that simulation, as one system.

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <deque>
#include <memory>
#include <vector>

#include "server/core/geometry/quality.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/haptics/force_stage.hpp"
#include "tests/haptics/random.hpp"
#include "tests/support/bodies.hpp"

namespace incise::haptics {
namespace {

using core::Vec3;
using tests::Random;

constexpr double kSize = 0.1;
constexpr std::int64_t kMillisecond_ns = 1'000'000;

// Each vertex on a damped spring to its rest place. Loads come `delay` steps late.
class Springs {
 public:
  Springs(core::CutSession& session, double stiffness_n_m, int delay)
      : session_(session), stiffness_(stiffness_n_m), delay_(delay), shift_(session.mesh().vertex_slots()) {}

  void take(const BladeLoad& load, std::uint32_t source = 0) {
    waiting_.push_back({steps_ + delay_, source, load.loads});
  }
  // A millisecond on; positions go out every `interval` steps.
  void step(int interval, const std::function<void(const core::Delta&)>& committed) {
    constexpr double kRelaxation_s = 0.02;
    while (!waiting_.empty() && waiting_.front().due <= steps_) {
      now_[waiting_.front().source] = waiting_.front().loads;
      waiting_.pop_front();
    }
    for (Vec3& u : shift_) u = u - (0.001 / kRelaxation_s) * u;
    for (const VertexLoads& now : now_) {
      for (std::size_t i = 0; i < now.count; ++i)
        shift_[now.ids[i]] += (0.001 / kRelaxation_s / stiffness_) * now.forces[i];
    }
    if (steps_++ % interval != 0) return;
    auto positions = std::make_shared<core::VertexPositions>();
    positions->revision = session_.revision();
    for (core::VertexId v = 0; v < shift_.size(); ++v)
      positions->positions.push_back(session_.mesh().rest_position(v) + shift_[v] + sway);
    session_.deform(positions);
    core::Delta delta;
    auto budget = core::WorkBudget::unlimited();
    while (session_.advance(budget, delta) == core::CutSession::Progress::kCommitted) committed(delta);
  }
  const std::vector<Vec3>& shift() const { return shift_; }
  Vec3 sway;  // that the body does by itself, m

 private:
  struct Waiting {
    int due;
    std::uint32_t source;
    VertexLoads loads;
  };
  core::CutSession& session_;
  const double stiffness_;
  const int delay_;
  std::vector<Vec3> shift_;
  std::deque<Waiting> waiting_;
  std::array<VertexLoads, core::kMaxSources> now_;
  int steps_ = 0;
};

// The loop's part: a hand, the forces, the simulation, a millisecond a step.
struct Rig {
  explicit Rig(std::uint32_t n, double stiffness_n_m, int delay = 0, int every = 4,
               const ForceConfig& config = forces())
      : session(tests::cube(n, kSize), cut()),
        springs(session, stiffness_n_m, delay),
        interval(every),
        stage(config, cut(), std::make_unique<Tissue>(tests::cube(n, kSize)), nullptr, &slots) {
    stage.follow(session.mesh(), session.revision());
    stage.join(link);
    stage.opened(0, cut().blade);
    link.wanted_until_ns = INT64_MAX;
  }
  static core::CutConfig cut() {
    core::CutConfig config;
    config.blade = {{0, 0, 0}, {0, 0, -0.05}};
    config.speed_limit_m_s = 1000;
    config.gap_limit_s = 10;
    return config;
  }
  static ForceConfig forces() {
    ForceConfig config;
    config.materials.tissue.stiffness_pa = 0;  // the spring of a point
    config.materials.tissue.stiffness_n_m = 400;
    config.limits.ramp_s = 0;
    config.limits.frozen_s = 1e6;
    return config;
  }

  Vec3 to(const Vec3& tool, bool engaged = false) {
    now_ns += kMillisecond_ns;
    if (posed) work -= dot(force, tool - at);
    at = tool;
    core::Pose pose;
    pose.t_ns = now_ns;
    pose.position = tool;
    pose.buttons = engaged ? 1 : 0;
    stage.posed(0, pose, now_ns, false);
    posed = true;
    stage.frame(now_ns, 0);
    ForceCommand command;
    EXPECT_TRUE(slots[0].read(command));
    force = {command.newtons[0], command.newtons[1], command.newtons[2]};
    told = link.loads[0].read(load);
    if (told) {
      check_load();
      if (!lost) springs.take(load);
    }
    if (!lost) springs.step(interval, [&](const core::Delta& delta) { stage.cut(session.mesh(), delta); });
    return force;
  }
  // Sum and moment.
  void check_load() {
    EXPECT_EQ(load.force, force);
    Vec3 sum, moment;
    for (std::size_t i = 0; i < load.loads.count; ++i) {
      if (i > 0) {
        EXPECT_LT(load.loads.ids[i - 1], load.loads.ids[i]);
      }
      sum += load.loads.forces[i];
      moment += cross(session.mesh().position(load.loads.ids[i]) - load.loads.center, load.loads.forces[i]);
    }
    if (load.engaged_m > 0) {
      largest_error = std::max(largest_error, length(sum + load.force));
      largest_moment = std::max(largest_moment, length(moment));
    }
    EXPECT_NEAR(distance(load.torque, cross(load.loads.center - at, load.force)), 0, 1e-12);
  }

  core::CutSession session;
  Springs springs;
  const int interval;
  ForceSlots slots;
  SimulationLink link;
  ForceStage stage;
  std::int64_t now_ns = 1'000'000'000;
  Vec3 at, force;
  BladeLoad load;
  bool posed = false, told = false, lost = false;
  double work = 0;  // of the hand, J
  double largest_error = 0, largest_moment = 0;
};

std::array<double, 4> barycentric(const core::TetMesh& mesh, core::TetId t, const Vec3& p) {
  const auto& v = mesh.vertices(t);
  const Vec3 x[4] = {mesh.position(v[0]), mesh.position(v[1]), mesh.position(v[2]), mesh.position(v[3])};
  const double all = core::signed_volume(x[0], x[1], x[2], x[3]);
  return {core::signed_volume(p, x[1], x[2], x[3]) / all, core::signed_volume(x[0], p, x[2], x[3]) / all,
          core::signed_volume(x[0], x[1], p, x[3]) / all, core::signed_volume(x[0], x[1], x[2], p) / all};
}

// The share of each vertex in a place, looked for everywhere.
std::vector<double> shares(const core::TetMesh& mesh, const Vec3& p) {
  std::vector<double> out(mesh.vertex_slots());
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    const auto b = barycentric(mesh, t, p);
    if (*std::min_element(b.begin(), b.end()) < -1e-9) continue;
    for (std::size_t i = 0; i < 4; ++i) out[mesh.vertices(t)[i]] = b[i];
    return out;
  }
  return out;
}

// A tip d deep: the spring of the contact and those of the vertices are in series. With c the way that the surface goes for a
// newton, f = k d / (1 + k c). k is that of the edge's material: a stiffness under a point, and more for the edge inside.
void expect_two_springs_in_series(const ForceConfig& config, double vertex_n_m, double point_n_m,
                                  double edge_pa) {
  Rig rig(5, vertex_n_m, 0, 4, config);
  const Vec3 over{0.052, 0.047, 0};
  for (double depth = -0.001; depth < 0.004; depth += 2e-5) rig.to(over + Vec3{0, 0, kSize + 0.05 - depth});
  constexpr double kDeep = 0.004;
  for (int i = 0; i < 400; ++i) rig.to(over + Vec3{0, 0, kSize + 0.05 - kDeep});
  ASSERT_TRUE(rig.told);
  EXPECT_EQ(rig.load.contact, ContactState::kPresses);
  const core::TetMesh& mesh = rig.session.mesh();
  double top = kSize;  // where the surface is over the tip
  while (top > 0.09 && shares(mesh, over + Vec3{0, 0, top}) == std::vector<double>(mesh.vertex_slots()))
    top -= 1e-6;
  const auto at_surface = shares(mesh, over + Vec3{0, 0, top});
  double c = 0;
  for (int i = 0; i < 8; ++i) {
    const double z = kSize - kDeep + (i + 0.5) / 8 * (top - kSize + kDeep);
    const auto of_load = shares(mesh, over + Vec3{0, 0, z});
    for (std::size_t v = 0; v < of_load.size(); ++v) c += of_load[v] / 8 * at_surface[v] / vertex_n_m;
  }
  const double contact = point_n_m + edge_pa * (top - kSize + kDeep);
  const double expected = contact * kDeep / (1 + contact * c);
  EXPECT_NEAR(rig.force.z, expected, 0.05 * expected);
  EXPECT_LT(expected, 0.8 * contact * kDeep) << "the body gives way enough to be seen";
  EXPECT_NEAR(top, kSize - expected * c, 0.05 * kDeep);
  EXPECT_LT(rig.largest_error, 1e-6);
  EXPECT_LT(rig.largest_moment, 1e-9);

  // Released it returns, and the last word is that nothing acts.
  for (double depth = kDeep; depth > -0.002; depth -= 2e-5) rig.to(over + Vec3{0, 0, kSize + 0.05 - depth});
  for (int i = 0; i < 400; ++i) rig.to(over + Vec3{0, 0, kSize + 0.052});
  for (const Vec3& u : rig.springs.shift()) EXPECT_LT(length(u), 1e-6);
  EXPECT_EQ(rig.load.contact, ContactState::kNone);
  EXPECT_EQ(rig.load.loads.count, 0u);
  EXPECT_FALSE(rig.told) << "and then it is silent";
}

TEST(Simulation, APressedBladeFeelsTwoSpringsInSeries) {
  expect_two_springs_in_series(Rig::forces(), 300, 400, 0);
}

TEST(Simulation, SoItDoesWithAStiffnessOfTheEdgeAndInARegion) {
  ForceConfig config = Rig::forces();
  config.materials.tissue.stiffness_pa = 60e3;
  expect_two_springs_in_series(config, 500, 400, 60e3);
  Material region = config.materials.tissue;
  region.stiffness_n_m = 250;
  region.stiffness_pa = 150e3;
  config.materials.by_region = {{0, region}};
  expect_two_springs_in_series(config, 500, 250, 150e3);
}

// In a cut body, too, while strokes go on: sum and moment are right whatever the mesh is like at that moment.
TEST(Simulation, LoadsSumToTheForceDuringCuts) {
  Rig rig(6, 2000);
  int inside = 0;
  for (int i = 0; i < 700; ++i) {
    const double s = i * 1e-3;
    const Vec3 tool{0.05 + 0.01 * std::sin(20 * s), -0.01 + 0.17 * s, 0.12 - 0.01 * std::sin(9 * s)};
    core::Pose pose;
    pose.t_ns = (i + 1) * kMillisecond_ns;
    pose.position = tool;
    pose.buttons = 1;
    rig.session.push(0, pose);
    // A little at a time, so that frames look at a mesh in the middle of a step.
    core::Delta delta;
    core::WorkBudget budget{40};
    while (rig.session.advance(budget, delta) == core::CutSession::Progress::kCommitted)
      rig.stage.cut(rig.session.mesh(), delta);
    rig.lost = rig.session.backlog_batches() > 0;
    rig.to(tool, true);
    inside += rig.told && rig.load.contact == ContactState::kInside && rig.load.loads.count > 0;
    if (rig.told) {
      for (std::size_t k = 0; k < rig.load.loads.count; ++k)
        ASSERT_FALSE(rig.session.mesh().is_new(rig.load.loads.ids[k])) << "an id that nobody knows";
    }
  }
  EXPECT_GT(inside, 300);
  EXPECT_LT(rig.largest_error, 1e-6);
}

// The force on the hand when the tissue gives way: the largest until then.
struct Entry {
  double force_n = 0, bent_m = 0;
  bool entered = false;
};
Entry enter(Rig& rig, double speed_m_s, const std::function<Vec3(int)>& sway) {
  Entry entry;
  Vec3 tool{0.052, 0.047, kSize + 0.0505};
  core::Pose pose;
  pose.buttons = 1;
  for (int i = 0; i < 20'000; ++i) {
    rig.springs.sway = sway(i);
    tool.z -= 1e-3 * speed_m_s;
    rig.to(tool, true);
    if (!rig.stage.holds_back(0, pose)) {
      if (rig.load.contact == ContactState::kInside) {
        entry.entered = true;
        return entry;
      }
    }
    entry.force_n = std::max(entry.force_n, length(rig.force));
    for (const Vec3& u : rig.springs.shift()) entry.bent_m = std::max(entry.bent_m, length(u));
  }
  return entry;
}

ForceConfig resisting(double holds_n) {
  ForceConfig config = Rig::forces();
  config.resists = true;
  config.materials.tissue.puncture_n = holds_n;
  config.materials.tissue.toughness_j_m2 = 10;
  config.limits.most_n = 20;
  config.limits.slew_n_s = 4000;
  return config;
}

// In stiff tissue and in such that bends by 8 mm, pressed slowly and fast, with positions at 60 Hz that come late, still and moving: what counts is
// what the hand got.
TEST(Simulation, TissueGivesWayAtTheForceThatIsStated) {
  constexpr double kHolds_n = 5;
  ForceConfig config = resisting(kHolds_n);
  double most_bent = 0;
  for (const double vertex : {1e6, 2000.0, 500.0, 250.0}) {
    for (const double contact : {400.0, 1500.0}) {
      for (const double speed : {0.01, 0.05}) {
        for (const int delay : {0, 30}) {
          for (const bool moves : {false, true}) {
            SCOPED_TRACE("vertices on " + std::to_string(vertex) + " N/m, contact " +
                         std::to_string(contact) + ", speed " + std::to_string(speed) + ", delay " +
                         std::to_string(delay) + (moves ? ", moving" : ""));
            config.materials.tissue.stiffness_n_m = contact;
            Rig rig(5, vertex, delay, 16, config);
            const Entry entry = enter(rig, speed, [&](int i) {
              return moves ? Vec3{0, 0.001 * std::sin(0.02 * i), 0.001 * std::sin(0.013 * i)} : Vec3{};
            });
            EXPECT_TRUE(entry.entered);
            EXPECT_NEAR(entry.force_n, kHolds_n, 0.05 * kHolds_n);
            most_bent = std::max(most_bent, entry.bent_m);
          }
        }
      }
    }
  }
  EXPECT_GT(most_bent, 0.007);
}

// So at the first contact, whose ramp gives the hand less than that: a blade that presses slowly waits for it, a stroke does not, and none
// waits for a force that has been turned off.
TEST(Simulation, AtTheFirstContactTissueGivesWayAtTheForceThatIsStated) {
  constexpr double kHolds_n = 2;
  ForceConfig config = resisting(kHolds_n);
  config.limits.ramp_s = 2;
  config.materials.tissue.toughness_j_m2 = 164;  // of the edge that gets in while it waits, more than that
  const auto still = [](int) { return Vec3{}; };
  for (const double speed : {0.002, 0.01, 0.02}) {
    SCOPED_TRACE("speed " + std::to_string(speed));
    Rig rig(5, 2000, 0, 16, config);
    const Entry entry = enter(rig, speed, still);
    EXPECT_TRUE(entry.entered);
    EXPECT_NEAR(entry.force_n, kHolds_n, 0.05 * kHolds_n);
  }
  Rig stroke(5, 2000, 0, 16, config);
  EXPECT_TRUE(enter(stroke, 0.1, still).entered);
  EXPECT_GT(stroke.at.z, kSize + 0.05 - 0.015);
  config.limits.most_faults = 1;
  Rig latched(5, 2000, 0, 16, config);
  latched.slots[0].device_lost();
  const Entry unfelt = enter(latched, 0.01, still);
  EXPECT_TRUE(unfelt.entered);
  EXPECT_EQ(unfelt.force_n, 0);
  EXPECT_GT(latched.at.z, kSize + 0.05 - 0.01);
}

// A device that makes less than the tissue holds gets in as well, not much deeper.
TEST(Simulation, TissueGivesWayToADeviceThatMakesLess) {
  ForceConfig config = resisting(5);
  config.limits.most_n = 3.3;
  Rig rig(5, 500, 0, 16, config);
  const Entry entry = enter(rig, 0.01, [](int) { return Vec3{}; });
  EXPECT_TRUE(entry.entered);
  EXPECT_NEAR(entry.force_n, 3.3, 0.01);
}

// No energy comes out, however late the simulation is, and when it is lost: ten minutes of it, and one where it is later or earlier.
class SimulationDelay : public ::testing::TestWithParam<int> {};

TEST_P(SimulationDelay, NoEnergyComesOutInRandomMotion) {
  const std::uint64_t seed = 23;
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  Rig rig(4, 300, GetParam(), 16);
  Vec3 at{0.05, 0.05, kSize + 0.06}, heading;
  double most = 0, lowest = 0;
  int felt = 0;
  const int steps = GetParam() == 50 ? 600'000 : 60'000;
  for (int i = 0; i < steps; ++i) {
    if (i % 80 == 0) heading = random.in_box({-1, -1, -1}, {1, 1, 1});
    at += 1.5e-4 * heading + 0.01 * (Vec3{0.05, 0.05, kSize + 0.045} - at);
    rig.lost = i > steps - 1000;
    rig.to(at);
    felt += length(rig.force) > 0.02;
    most = std::max(most, -rig.work - i * 1e-3 * (ForceModel::kLeak_w + ForceModel::kTissueLeak_w));
    lowest = std::min(lowest, rig.work);
  }
  EXPECT_GT(felt, steps / 10);
  EXPECT_LT(most, ForceModel::kReserve_j + ForceModel::kTissueReserve_j + 1e-3);
  // What the accounts get by themselves does not add up, either.
  EXPECT_GT(lowest, -ForceModel::kReserve_j - ForceModel::kTissueReserve_j);
  EXPECT_LT(rig.largest_error, 1e-6);
}
INSTANTIATE_TEST_SUITE_P(Simulation, SimulationDelay, ::testing::Values(0, 10, 50, 200));

// Three hands in one body, each of which feels what the others do to it, while the simulation stalls and comes back with what it
// had, and the body moves by itself: no hand gets more out than its own account allows, whatever the others put in.
class SeveralBlades : public ::testing::TestWithParam<int> {};

TEST_P(SeveralBlades, NoEnergyComesOutOfOneBodyWhoseSimulationStalls) {
  const std::uint64_t seed = 37;
  SCOPED_TRACE("seed " + std::to_string(seed));
  constexpr std::uint32_t kHands = 3;
  Random random(seed);
  Rig rig(4, 300, GetParam(), 16);
  struct Hand {
    Vec3 at, heading, force;
    double work = 0, most = 0;
    int felt = 0;
  };
  std::array<Hand, kHands> hands;
  for (std::uint32_t h = 0; h < kHands; ++h) {
    hands[h].at = {0.035 + 0.015 * h, 0.05, kSize + 0.06};
    if (h > 0) rig.stage.opened(h, Rig::cut().blade);
  }
  int stalls = 0;
  double bent = 0;  // the farthest that a vertex has moved, m
  for (int i = 0; i < 8000; ++i) {
    if (i % 400 == 0) {
      const bool before = rig.lost;
      rig.lost = i > 7200 || random.below(2) == 0;
      stalls += rig.lost && !before;
    }
    rig.now_ns += kMillisecond_ns;
    rig.springs.sway = {0, 0, 0.005 * std::sin(0.05 * i)};
    for (std::uint32_t h = 0; h < kHands; ++h) {
      Hand& hand = hands[h];
      if (i % (60 + 7 * static_cast<int>(h)) == 0) hand.heading = random.in_box({-1, -1, -1}, {1, 1, 1});
      const Vec3 home{0.035 + 0.015 * h, 0.05, kSize + 0.045};
      // Up while the body is high, down while it is low: what takes the most out.
      const Vec3 step =
          1.5e-4 * hand.heading + 0.01 * (home - hand.at) + Vec3{0, 0, 3e-4 * std::sin(0.05 * i)};
      hand.work -= dot(hand.force, step);
      hand.at += step;
      core::Pose pose;
      pose.t_ns = rig.now_ns;
      pose.position = hand.at;
      rig.stage.posed(h, pose, rig.now_ns, false);
    }
    rig.stage.frame(rig.now_ns, 0);
    for (std::uint32_t h = 0; h < kHands; ++h) {
      Hand& hand = hands[h];
      ForceCommand command;
      ASSERT_TRUE(rig.slots[h].read(command));
      hand.force = {command.newtons[0], command.newtons[1], command.newtons[2]};
      hand.felt += length(hand.force) > 0.02;
      hand.most =
          std::max(hand.most, -hand.work - i * 1e-3 * (ForceModel::kLeak_w + ForceModel::kTissueLeak_w));
      BladeLoad load;
      if (rig.link.loads[h].read(load) && !rig.lost) rig.springs.take(load, h);
    }
    if (!rig.lost)
      rig.springs.step(rig.interval, [&](const core::Delta& d) { rig.stage.cut(rig.session.mesh(), d); });
    for (const Vec3& u : rig.springs.shift()) bent = std::max(bent, length(u));
  }
  for (const Hand& hand : hands) {
    EXPECT_GT(hand.felt, 500);
    EXPECT_LT(hand.most, ForceModel::kReserve_j + ForceModel::kTissueReserve_j + 1e-3);
  }
  EXPECT_GE(stalls, 3);
  EXPECT_GT(bent, 1e-3) << "the body gives way";
}
INSTANTIATE_TEST_SUITE_P(Simulation, SeveralBlades, ::testing::Values(0, 50, 200));

LocalModel model_at(const Vec3& point, double stiffness, std::int64_t from_ns, std::int64_t valid_ns) {
  LocalModel model;
  model.point = point;
  model.normal = {0, 0, 1};
  model.stiffness = {{0.2 * stiffness, 0, 0}, {0, 0.2 * stiffness, 0}, {0, 0, stiffness}};
  model.from_ns = from_ns;
  model.expires_ns = from_ns + valid_ns;
  return model;
}

// The simulation's own model makes the force until it expires; then the server's does.
TEST(Simulation, ItsOwnModelIsRenderedUntilItExpires) {
  Rig rig(5, 1e9);
  const Vec3 start{0.05, 0.05, kSize + 0.051};
  for (int i = 0; i < 50; ++i) rig.to(start - Vec3{0, 0, 5e-5 * i});  // 1.5 mm deep
  const Vec3 deep = rig.at;
  for (int i = 0; i < 20; ++i) rig.to(deep);
  EXPECT_NEAR(rig.force.z, 400 * 0.00145, 0.02);
  LocalModel model = model_at(deep + Vec3{0.001, 0, 0.002}, 500, rig.now_ns, 50 * kMillisecond_ns);
  model.number = 1;
  rig.link.models[0].write(model);
  for (int i = 0; i < 49; ++i) rig.to(deep);
  // The account holds what the hand has put in; the rest comes in time.
  EXPECT_GT(rig.force.z, 0.5);
  EXPECT_NEAR(rig.force.x, 0.2 * 500 * 0.001 * rig.force.z / (500 * 0.002), 0.02);
  EXPECT_LT(rig.largest_error, 1e-6);
  for (int i = 0; i < 20; ++i) rig.to(deep);
  EXPECT_NEAR(rig.force.x, 0, 1e-6) << "expired";
  EXPECT_NEAR(rig.force.z, 400 * 0.00145, 0.02);

  // It gives way at its resistance, and does not come back.
  model = model_at(deep, 500, rig.now_ns, 500 * kMillisecond_ns);
  model.number = 2;
  model.resistance_n = 0.4;
  rig.link.models[0].write(model);
  for (int i = 0; i < 200; ++i) rig.to(deep - Vec3{0, 0, 2e-5 * i});
  EXPECT_NEAR(rig.force.z, 0.4, 0.01);
  for (int i = 0; i < 30; ++i) rig.to(rig.at + Vec3{0, 0, 5e-5});
  EXPECT_EQ(length(rig.force), 0);
}

TEST(Simulation, NoEnergyComesOutOfModelsThatJump) {
  const std::uint64_t seed = 29;
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  Rig rig(4, 1e9);
  rig.lost = true;
  Vec3 at{0.05, 0.05, kSize + 0.055}, heading;
  double most = 0;
  int felt = 0;
  for (int i = 0; i < 6000; ++i) {
    if (i % 50 == 0) heading = random.in_box({-1, -1, -1}, {1, 1, 1});
    if (i % 25 == 0) {
      LocalModel model = model_at(at + random.in_box({-0.003, -0.003, -0.003}, {0.003, 0.003, 0.003}),
                                  random.uniform(0, 3000), rig.now_ns, 40 * kMillisecond_ns);
      model.number = static_cast<std::uint64_t>(i + 1);
      model.normal = normalized(random.in_box({-1, -1, -1}, {1, 1, 1}));
      model.damping_n_s_m = random.uniform(0, 5);
      rig.link.models[0].write(model);
    }
    at += 1e-4 * heading + 0.01 * (Vec3{0.05, 0.05, kSize + 0.05} - at);
    rig.to(at);
    felt += length(rig.force) > 0.02;
    most = std::max(most, -rig.work - i * 1e-3 * ForceModel::kLeak_w);
  }
  EXPECT_GT(felt, 500);
  EXPECT_LT(most, ForceModel::kReserve_j + 1e-3);
}

TEST(Simulation, RefusesModelsThatCannotBeRendered) {
  const LocalModel good = model_at({0, 0, 0}, 100, 1000, 1'000'000);
  EXPECT_EQ(trouble_of(good, 2000), "");
  const auto trouble = [&](const std::function<void(LocalModel&)>& change) {
    LocalModel model = good;
    change(model);
    return trouble_of(model, 2000);
  };
  EXPECT_NE(trouble([](LocalModel& m) { m.point.y = NAN; }).find("NaN"), std::string::npos);
  EXPECT_NE(trouble([](LocalModel& m) { m.stiffness.x.y = INFINITY; }).find("infinite"), std::string::npos);
  EXPECT_NE(trouble([](LocalModel& m) { m.normal = {0, 0, 0.5}; }).find("unit vector"), std::string::npos);
  EXPECT_NE(trouble([](LocalModel& m) { m.stiffness.z.z = -1; }).find("semidefinite"), std::string::npos);
  EXPECT_NE(trouble([](LocalModel& m) {
              m.stiffness = {{1, 2, 0}, {2, 1, 0}, {0, 0, 1}};
            }).find("semidefinite"),
            std::string::npos);
  EXPECT_NE(trouble([](LocalModel& m) {  // all 2 x 2 minors are fine
              m.stiffness = {{1, -0.9, -0.9}, {-0.9, 1, -0.9}, {-0.9, -0.9, 1}};
            })
                .find("semidefinite"),
            std::string::npos);
  EXPECT_NE(trouble([](LocalModel& m) { m.stiffness.x.y = 1; }).find("symmetric"), std::string::npos);
  EXPECT_NE(trouble([](LocalModel& m) {
              m.stiffness = {{2e6, 0, 0}, {0, 2e6, 0}, {0, 0, 2e6}};
            }).find("1e6"),
            std::string::npos);
  EXPECT_NE(trouble([](LocalModel& m) { m.damping_n_s_m = -1; }).find("below 0"), std::string::npos);
  EXPECT_NE(trouble([](LocalModel& m) { m.expires_ns = 1500; }).find("expired"), std::string::npos);
  EXPECT_NE(trouble([](LocalModel& m) { m.expires_ns = m.from_ns; }).find("above 0"), std::string::npos);
  EXPECT_NE(trouble([](LocalModel& m) { m.from_ns = 3000; }).find("future"), std::string::npos);
  // A plane without any stiffness across it is fine.
  EXPECT_EQ(trouble([](LocalModel& m) { m.stiffness = {{0, 0, 0}, {0, 0, 0}, {0, 0, 100}}; }), "");
}

}  // namespace
}  // namespace incise::haptics
