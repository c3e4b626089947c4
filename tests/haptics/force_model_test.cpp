#include "server/haptics/force_model.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "server/core/session/cut_session.hpp"
#include "tests/haptics/random.hpp"
#include "tests/support/bodies.hpp"

namespace incise::haptics {
namespace {

using core::Vec3;
using tests::Random;

constexpr double kSize = 0.1;
constexpr double kStep_s = 0.001;

// A blade in the cube, moved by hand: the force of each step acts until the next, as a device holds it.
class Hand {
 public:
  explicit Hand(const core::Blade& blade, bool cuts = true)
      : blade_(blade), session_(tests::cube(10, kSize), config(blade)), cuts_(cuts) {}

  // Moves the tool there in one step; what the hand has put in is in work().
  const Feel& to_pose(const core::Pose& pose) {
    if (has_pose_) work_ -= dot(feel_.force, pose.position - pose_.position);
    BladeMotion motion;
    motion.line = core::blade_line(blade_, pose);
    motion.tool = pose.position;
    motion.engaged = pose.buttons != 0;
    motion.dt_s = motion.elapsed_s = has_pose_ ? kStep_s : 0;
    feel_ = model_.update(tissue_, motion, feel_.force);
    largest_step_ = std::max(largest_step_,
                             has_pose_ ? length(feel_.force) * distance(pose.position, pose_.position) : 0);
    pose_ = pose;
    has_pose_ = true;
    if (cuts_) {
      pose_.t_ns = ++steps_ * 1'000'000;
      session_.push(0, pose_);
      core::Delta delta;
      auto budget = core::WorkBudget::unlimited();
      while (session_.advance(budget, delta) == core::CutSession::Progress::kCommitted)
        tissue_.note_cuts(session_.mesh(), delta.boundary_upserted);
    }
    return feel_;
  }
  const Feel& to(const Vec3& position, bool engaged = true) {
    core::Pose pose;
    pose.position = position;
    pose.buttons = engaged ? 1 : 0;
    return to_pose(pose);
  }
  // A frame without a pose.
  const Feel& wait() {
    BladeMotion motion;
    motion.line = core::blade_line(blade_, pose_);
    motion.tool = pose_.position;
    motion.engaged = pose_.buttons != 0;
    motion.elapsed_s = kStep_s;
    return feel_ = model_.update(tissue_, motion, feel_.force);
  }
  // Straight on at a speed, m/s, to there.
  const Feel& slide(const Vec3& there, double speed, bool engaged = true) {
    const Vec3 from = pose_.position;
    const int n = std::max(1, static_cast<int>(distance(from, there) / (speed * kStep_s)));
    for (int i = 1; i <= n; ++i) to(lerp(from, there, static_cast<double>(i) / n), engaged);
    return feel_;
  }

  const Feel& feel() const { return feel_; }
  const core::Pose& pose() const { return pose_; }
  // The tool is elsewhere at its next pose, and did not move there.
  void jump() {
    model_.jump();
    has_pose_ = false;
  }
  double work() const { return work_; }
  void begin_account() { work_ = 0; }
  double largest_step() const { return largest_step_; }
  const core::CutSession& session() const { return session_; }
  Materials materials;

 private:
  static core::CutConfig config(const core::Blade& blade) {
    core::CutConfig config;
    config.blade = blade;
    config.speed_limit_m_s = 1000;
    return config;
  }
  core::Blade blade_;
  core::CutSession session_;
  Tissue tissue_{tests::cube(10, kSize)};
  bool cuts_;
  ForceModel model_{materials, 2000, 0.5};
  core::Pose pose_;
  bool has_pose_ = false;
  std::int64_t steps_ = 0;
  Feel feel_;
  double work_ = 0, largest_step_ = 0;
};

core::Blade short_blade() {
  return {{0, 0, 0}, {0, 0, -0.05}};
}

TEST(ForceModel, NothingIsFeltInAir) {
  Hand hand(tests::long_blade(kSize));
  hand.to({0.05, -0.05, 0.12});
  const Feel& feel = hand.slide({0.05, -0.002, 0.12}, 0.1);
  EXPECT_EQ(length(feel.force), 0);
  EXPECT_FALSE(feel.contact.has_value());
  EXPECT_EQ(hand.work(), 0);
}

// A tip that presses on the top without cutting: a spring along the normal, and a plane that says so.
TEST(ForceModel, ATipPressesOnASpring) {
  Hand hand(short_blade());
  hand.to({0.05, 0.05, 0.17}, false);
  hand.slide({0.05, 0.05, 0.15}, 0.1, false);
  for (const double depth : {0.001, 0.003, 0.006}) {
    hand.slide({0.05, 0.05, 0.15 - depth}, 0.02, false);
    for (int i = 0; i < 100; ++i) hand.to({0.05, 0.05, 0.15 - depth}, false);  // until its damping is over
    const Feel& feel = hand.feel();
    const double expected = (300 + 40e3 * depth) * depth;  // as much of the edge is inside
    EXPECT_NEAR(feel.force.z, expected, 0.15 * expected) << depth;
    EXPECT_NEAR(feel.force.x, 0, 1e-6);
    ASSERT_TRUE(feel.contact.has_value());
    EXPECT_FALSE(feel.contact->penetrated);
    EXPECT_NEAR(feel.contact->point.z, 0.15, 1e-9);
    EXPECT_NEAR(feel.contact->normal.z, 1, 1e-9);
    EXPECT_EQ(feel.contact->resistance_n, 0) << "a blade that is not engaged does not get in";
  }
}

// Engaged, the surface holds until the puncture force, then gives way: less force, deeper.
TEST(ForceModel, ATipPuncturesAtItsThreshold) {
  Hand hand(short_blade());
  hand.to({0.051, 0.052, 0.151});
  double most = 0;
  double at = 0;
  for (int i = 0; i < 200; ++i) {
    const Feel& feel = hand.to({0.051, 0.052, 0.151 - 5e-5 * i});
    if (feel.force.z > most) {
      most = feel.force.z;
      at = 0.15 - hand.pose().position.z;
    }
  }
  EXPECT_NEAR(most, hand.materials.tissue.puncture_n, 0.1);
  EXPECT_NEAR((300 + 40e3 * at) * at, hand.materials.tissue.puncture_n, 0.1);
  EXPECT_TRUE(hand.feel().contact->penetrated);
  EXPECT_LT(hand.feel().force.z, 0.2 * most) << "along the edge only friction is left";
}

// A through-cut: the work of the hand is the toughness times the area, and friction on top.
TEST(ForceModel, CuttingCostsTheToughnessForEachArea) {
  Hand hand(tests::long_blade(kSize));
  hand.to({0.0371, -0.02, 0.12});
  hand.slide({0.0373, 0.05, 0.12}, 0.02);
  const Feel steady = hand.feel();
  const double fracture = hand.materials.tissue.toughness_j_m2 * kSize;
  const double friction = hand.materials.tissue.friction_n_s_m2 * kSize * 0.02;
  EXPECT_NEAR(steady.engagement.uncut_m, kSize, 1e-6);
  EXPECT_NEAR(steady.force.y, -(fracture + friction), 0.01 * fracture);
  EXPECT_NEAR(steady.force.z, 0, 0.01 * fracture);
  ASSERT_TRUE(steady.contact.has_value());
  EXPECT_TRUE(steady.contact->penetrated);
  EXPECT_NEAR(steady.contact->resistance_n, fracture, 0.01 * fracture);
  EXPECT_NEAR(steady.contact->normal.y, -1, 0.01);
  hand.slide({0.0375, 0.13, 0.12}, 0.02);
  EXPECT_EQ(length(hand.feel().force), 0);
  EXPECT_NEAR(hand.work(), (fracture + friction) * kSize, 0.1 * fracture * kSize);
}

// Back through one's own slit: friction, no second fracture, nothing that pushes.
TEST(ForceModel, TheWayBackIsFree) {
  Hand hand(tests::long_blade(kSize));
  hand.to({0.0371, -0.02, 0.12});
  hand.slide({0.0373, 0.07, 0.12}, 0.02);
  const double fracture = hand.materials.tissue.toughness_j_m2 * kSize;
  ASSERT_NEAR(hand.feel().force.y, -fracture, 0.05 * fracture);
  const double stretch = fracture / 2000;
  // The spring lets go first; from there to where the blade came in there is friction.
  hand.slide({0.0373, 0.07 - stretch - 0.002, 0.12}, 0.02);
  double most = 0;
  for (int i = 0; i < 400 && hand.pose().position.y > 0.001; ++i) {
    hand.to({0.0373, hand.pose().position.y - 5e-5, 0.12});
    most = std::max(most, std::abs(hand.feel().force.y));
  }
  EXPECT_LT(most, 0.2 * fracture);
}

// A second stroke along an existing cut feels the cut, even if another blade made it.
TEST(ForceModel, AnOldCutIsOpen) {
  Hand hand(tests::long_blade(kSize));
  hand.to({0.0371, -0.02, 0.12});
  hand.slide({0.0371, 0.13, 0.12}, 0.05);
  const double first = hand.work();
  hand.to({0.0371, 0.13, 0.12}, false);
  hand.slide({0.0371, -0.02, 0.22}, 1.0, false);
  hand.to({0.0371, -0.02, 0.12}, false);
  hand.begin_account();
  hand.slide({0.0371, 0.13, 0.12}, 0.05);
  EXPECT_LT(hand.work(), 0.15 * first);
  EXPECT_GT(first, 0.1);
}

TEST(ForceModel, APlaneSaysWhatTheForceIs) {
  // The spring part of the force is what the plane gives at the tool's origin.
  Hand hand(short_blade());
  hand.to({0.05, 0.05, 0.151}, false);
  hand.slide({0.05, 0.05, 0.147}, 0.05, false);
  for (int i = 0; i < 100; ++i) hand.to({0.05, 0.05, 0.147}, false);
  const ContactPlane& plane = *hand.feel().contact;
  const double depth = -dot(plane.normal, hand.pose().position - plane.point);
  EXPECT_NEAR(length(hand.feel().force), plane.stiffness_n_m * depth, 1e-3);
}

// Random motions of every kind through the tissue, cutting and not, with turns: whatever happens, no more comes out
// than went in, but for the stated tolerance.
TEST(ForceModel, IsPassive) {
  int felt = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    const bool jitter = seed % 4 == 0, turns = seed % 2 == 0;
    Hand hand(seed % 3 == 0 ? tests::long_blade(kSize) : short_blade(), seed % 5 != 0);
    const double speed = std::exp(random.uniform(std::log(0.03), std::log(0.5)));
    double phase[6], rate[6];
    for (int i = 0; i < 6; ++i) {
      phase[i] = random.uniform(0, 6.28);
      rate[i] = speed / 0.05 * random.uniform(0.3, 3);
    }
    constexpr int kSteps = 3000;
    double force = 0;
    for (int i = 0; i < kSteps; ++i) {
      const double t = i * kStep_s;
      core::Pose pose;
      pose.position = {0.05 + 0.05 * std::sin(phase[0] + rate[0] * t),
                       0.05 + 0.08 * std::sin(phase[1] + rate[1] * t),
                       0.12 + 0.05 * std::sin(phase[2] + rate[2] * t)};
      if (jitter) pose.position += random.in_box({-3e-4, -3e-4, -3e-4}, {3e-4, 3e-4, 3e-4});
      if (turns) {
        const double angle = std::sin(phase[3] + rate[3] * t), tilt = std::sin(phase[4] + 0.3 * rate[4] * t);
        const Vec3 axis = normalized(Vec3{1, tilt, 0.2});
        pose.orientation = {std::cos(angle / 2), std::sin(angle / 2) * axis.x, std::sin(angle / 2) * axis.y,
                            std::sin(angle / 2) * axis.z};
      }
      pose.buttons = std::sin(phase[5] + 0.5 * rate[5] * t) > -0.3 ? 1 : 0;
      const Feel& feel = hand.to_pose(pose);
      ASSERT_TRUE(is_finite(feel.force)) << "step " << i;
      force += length(feel.force) * kStep_s;
      const double tolerance =
          ForceModel::kReserve_j + ForceModel::kLeak_w * kStep_s * (i + 1) + hand.largest_step();
      ASSERT_GE(hand.work(), -tolerance) << "step " << i;
    }
    felt += force > 0.05;
  }
  EXPECT_GT(felt, 30) << "there must be forces for this to mean anything";
}

// What was spent on a cut does not come back: a blade that turns into tissue, which takes no work of the hand, is felt as
// weakly after a long cut as before one.
TEST(ForceModel, WorkSpentOnACutIsNotStored) {
  Hand hand(short_blade());
  hand.to({0.05, -0.02, 0.12});
  hand.slide({0.05, 0.13, 0.12}, 0.05);
  ASSERT_GT(hand.work(), 0.1);
  hand.slide({-0.005, 0.13, 0.12}, 0.2, false);
  hand.slide({-0.005, 0.05, 0.12}, 0.2, false);
  ASSERT_EQ(length(hand.feel().force), 0);
  double most = 0;
  for (int i = 1; i <= 20; ++i) {
    core::Pose pose = hand.pose();
    pose.orientation = {std::cos(0.0125 * i), 0, -std::sin(0.0125 * i), 0};
    most = std::max(most, length(hand.to_pose(pose).force));
  }
  ASSERT_GT(hand.feel().engagement.length_m, 0.01);
  EXPECT_LT(most, 2);
}

// A velocity is smoothed, so the friction on a trembling blade pushes it on: only as long as the account lasts.
// A device that makes torques, too: what comes out by pushing and by turning is bounded together, and a hand that turns the
// blade in the tissue feels it at once, since its turning is work.
TEST(ForceModel, IsPassiveWithTorques) {
  const std::uint64_t seed = 31;
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  const Tissue tissue(tests::cube(8, kSize));
  Materials materials;
  ForceModel model(materials, 2000, 0.5);
  const core::Blade blade = short_blade();
  Vec3 at{0.05, 0.05, 0.14}, heading, axis;
  core::Quat orientation;
  Feel feel;
  Vec3 torque;
  double work = 0, most = 0, largest = 0, turned = 0;
  for (int i = 0; i < 20'000; ++i) {
    if (i % 60 == 0) {
      heading = random.in_box({-1, -1, -1}, {1, 1, 1});
      axis = random.in_box({-1, -1, -1}, {1, 1, 1});
    }
    const Vec3 step = 1.5e-4 * heading + 0.01 * (Vec3{0.05, 0.05, 0.135} - at);
    // A small turn as a quaternion, of unit length again.
    const Vec3 half = 2e-3 * axis;
    const core::Quat q = orientation;
    core::Quat next{
        q.w - half.x * q.x - half.y * q.y - half.z * q.z, q.x + half.x * q.w + half.y * q.z - half.z * q.y,
        q.y + half.y * q.w + half.z * q.x - half.x * q.z, q.z + half.z * q.w + half.x * q.y - half.y * q.x};
    const double norm = std::sqrt(next.w * next.w + next.x * next.x + next.y * next.y + next.z * next.z);
    next = {next.w / norm, next.x / norm, next.y / norm, next.z / norm};
    const double angle = 2 * std::atan(length(half));
    const Vec3 turn = angle * normalized(half);
    if (i > 0) work -= dot(feel.force, step) + dot(torque, turn);
    turned += std::abs(dot(torque, turn));
    largest = std::max(largest, length(feel.force) * length(step) + length(torque) * length(turn));
    at += step;
    orientation = next;
    core::Pose pose;
    pose.position = at;
    pose.orientation = orientation;
    BladeMotion motion;
    motion.line = core::blade_line(blade, pose);
    motion.tool = at;
    motion.orientation = orientation;
    motion.torque = torque;
    motion.engaged = i / 3000 % 2 == 1;
    motion.dt_s = motion.elapsed_s = i > 0 ? kStep_s : 0;
    feel = model.update(tissue, motion, feel.force);
    torque = cross(feel.arm, feel.force);
    most = std::max(most, -work - i * kStep_s * ForceModel::kLeak_w);
  }
  EXPECT_GT(turned, 0.05) << "turning is a part of it";
  EXPECT_LT(most, ForceModel::kReserve_j + largest);
}

TEST(ForceModel, ATremblingBladeGetsNoEnergyOut) {
  Hand hand(tests::long_blade(kSize), false);
  hand.to({0.05, 0.05, 0.12}, false);
  for (int i = 1; i <= 2000; ++i) {
    hand.to({0.05 + (i % 2) * 1e-3, 0.05, 0.12}, false);
    ASSERT_GE(hand.work(),
              -(ForceModel::kReserve_j + ForceModel::kLeak_w * kStep_s * i + hand.largest_step()))
        << "step " << i;
  }
}

TEST(ForceModel, FrictionEndsWithTheMotion) {
  Hand hand(tests::long_blade(kSize), false);
  hand.to({0.05, 0.05, 0.12}, false);
  hand.slide({0.06, 0.05, 0.12}, 0.1, false);
  const double sliding = length(hand.feel().force);
  ASSERT_GT(sliding, 0.01);
  for (int i = 0; i < 50; ++i) hand.wait();
  EXPECT_LT(length(hand.feel().force), 0.01 * sliding);
}

TEST(ForceModel, AJumpEndsTheMotionAndItsFriction) {
  Hand hand(tests::long_blade(kSize));
  hand.to({0.05, -0.01, 0.12});
  EXPECT_GT(length(hand.slide({0.05, 0.05, 0.12}, 0.2).force), 0);
  hand.jump();
  EXPECT_EQ(length(hand.to({0.08, 0.05, 0.12}).force), 0);
}

// A blade that is far behind where it has cut feels what is there, not its front: the map of cuts knows the way by then.
TEST(ForceModel, AFrontFarAheadIsForgotten) {
  Hand hand(tests::long_blade(kSize), false);  // which no cut opens
  hand.to({0.05, -0.01, 0.12});
  hand.slide({0.05, 0.07, 0.12}, 0.05);
  hand.slide({0.05, 0.055, 0.12}, 0.05);
  const double near_front = length(hand.slide({0.05, 0.06, 0.12}, 0.05).force);
  hand.slide({0.05, 0.02, 0.12}, 0.05);
  const double far_behind = length(hand.slide({0.05, 0.025, 0.12}, 0.05).force);
  EXPECT_GT(far_behind, 2 * near_front);
}

TEST(ForceModel, ASurfaceDoesNotPull) {
  Hand hand(short_blade());
  hand.to({0.05, 0.05, 0.151}, false);
  hand.slide({0.05, 0.05, 0.146}, 0.05, false);
  for (int i = 0; i < 50; ++i) hand.to({0.05, 0.05, 0.146}, false);
  ASSERT_GT(hand.feel().force.z, 0.5);
  for (int i = 1; i <= 20; ++i) {
    const Feel& feel = hand.to({0.05, 0.05, 0.146 + 2.5e-4 * i}, false);
    EXPECT_GE(feel.force.z, -1e-9) << "step " << i;
  }
}

// Behind the front of a cut the blade is in its slit; aside of it there is fresh tissue.
TEST(ForceModel, AsideOfItsSlitABladeCutsAgain) {
  Hand hand(tests::long_blade(kSize), false);
  hand.to({0.05, -0.02, 0.12});
  hand.slide({0.05, 0.05, 0.12}, 0.05);
  const double fracture = hand.feel().engagement.fracture_n;
  hand.slide({0.05, 0.036, 0.12}, 0.05);
  EXPECT_LT(std::abs(hand.feel().force.y), 0.5 * fracture) << "in the slit";
  hand.slide({0.075, 0.036, 0.12}, 0.05);
  EXPECT_LT(hand.feel().force.x, -0.8 * fracture);
}

TEST(ForceModel, NoTissueIsStifferThanADeviceCanRender) {
  Hand hand(short_blade());
  hand.materials.tissue.stiffness_n_m = 1e5;
  hand.to({0.05, 0.05, 0.151}, false);
  hand.slide({0.05, 0.05, 0.149}, 0.05, false);
  EXPECT_EQ(hand.feel().engagement.stiffness_n_m, 2000);
  EXPECT_EQ(hand.feel().contact->stiffness_n_m, 2000);
}

TEST(ForceModel, IntoAnOpenSlitNothingIsPunctured) {
  Hand hand(short_blade());
  hand.to({0.05, -0.02, 0.12});
  hand.slide({0.05, 0.12, 0.12}, 0.05);
  hand.slide({0.05, 0.12, 0.16}, 0.5);
  hand.slide({0.05, 0.05, 0.16}, 0.5);
  double most = 0;
  for (int i = 0; i < 250; ++i) {
    hand.to({0.05, 0.05, 0.155 - 1e-4 * i});
    most = std::max(most, length(hand.feel().force));
  }
  ASSERT_GT(hand.feel().engagement.length_m, 0.015);
  EXPECT_LT(most, 0.5 * hand.materials.tissue.puncture_n);
}

}  // namespace
}  // namespace incise::haptics
