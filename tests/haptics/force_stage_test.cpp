#include "server/haptics/force_stage.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "server/core/session/cut_session.hpp"
#include "tests/haptics/random.hpp"
#include "tests/support/bodies.hpp"

namespace incise::haptics {
namespace {

using core::Vec3;
using tests::Random;

constexpr std::int64_t kMs = 1'000'000;
constexpr double kSize = 0.1;

struct Told : ForceSink {
  void feel(const BladeForce& force) noexcept override { forces.push_back(force); }
  std::vector<BladeForce> forces;
};

core::CutConfig cut_config() {
  core::CutConfig config;
  config.blade = {{0, 0, 0}, {0, 0, -0.05}};
  return config;
}

// A loop of 1 kHz around the stage, with a device that reads its slot in each frame. A tip that presses on the top of a
// cube and slides to and fro there.
struct Rig {
  Rig() {
    slots[0].device_came(3);
    stage.opened(0, cut_config().blade);
    for (int i = 0; i < 30; ++i) frame();  // down from the air
  }

  // One frame; checks what must hold in every frame.
  Vec3 frame(std::int64_t step_ns = kMs, std::int64_t late_ns = 0) {
    now += step_ns;
    if (!silent) {
      if (!frozen) {
        pose.position = {0.05 + 0.01 * std::sin(1e-9 * static_cast<double>(now - begun)), 0.05,
                         at + std::clamp(height - at, -1e-3, 1e-3)};
        at = pose.position.z;
        pose.buttons = engaged ? 1 : 0;
      }
      pose.t_ns = now;
      const auto verdict = session.push(0, pose);
      if (accepted(verdict)) stage.posed(0, pose, now, verdict == core::PoseVerdict::kNewStroke);
    }
    stage.frame(now, late_ns);
    ForceCommand command;
    EXPECT_TRUE(slots[0].read(command));
    EXPECT_EQ(command.time_ns, now);
    flags = command.flags;
    const Vec3 force{command.newtons[0], command.newtons[1], command.newtons[2]};
    EXPECT_LE(length(force), 3 + 1e-9);
    EXPECT_LE(distance(force, last), config.limits.slew_n_s * 1e-9 * static_cast<double>(step_ns) + 1e-9);
    if (force == Vec3{}) zero_ns = now;
    return last = force;
  }
  Vec3 frames(int n) {
    for (int i = 0; i < n; ++i) frame();
    return last;
  }

  ForceConfig config;
  core::CutSession session{tests::cube(8, kSize), cut_config()};
  Told told;
  ForceSlots slots;
  ForceStage stage{config, cut_config(), std::make_unique<Tissue>(tests::cube(8, kSize)), &told, &slots};
  const std::int64_t begun = 1'000'000 * kMs;
  std::int64_t now = begun, zero_ns = 0;
  core::Pose pose;
  double height = 0.146, at = 0.16;  // wanted, 4 mm deep; now
  bool engaged = false, silent = false, frozen = false;
  std::uint32_t flags = 0;
  Vec3 last;
};

TEST(ForceStage, TellsOfTissueAndOfItsEnd) {
  Rig rig;
  rig.height = 0.16;
  rig.frames(100);
  rig.told.forces.clear();
  rig.frames(100);
  EXPECT_TRUE(rig.told.forces.empty()) << "in air there is nothing to tell";
  EXPECT_EQ(rig.flags & kForceContact, 0u);
  rig.height = 0.1495;
  rig.frames(20);
  rig.told.forces.clear();
  rig.frames(100);
  ASSERT_EQ(rig.told.forces.size(), 100u) << "one for each pose";
  EXPECT_EQ(rig.told.forces.back().pose_t_ns, rig.now);
  EXPECT_TRUE(rig.told.forces.back().feel.contact.has_value());
  EXPECT_EQ(rig.flags & (kForceContact | kForceRamping), kForceContact | kForceRamping);
  EXPECT_GT(rig.last.z, 0);
  rig.height = 0.16;
  rig.frames(100);
  const BladeForce& end = rig.told.forces.back();
  EXPECT_FALSE(end.feel.contact.has_value());
  EXPECT_EQ(end.newtons, Vec3{});
  EXPECT_LT(rig.told.forces.size(), 115u) << "and then nothing";
}

// A tilted tip that presses: the torque about the tool's origin is that of the force at the edge, within limits of its own, and it
// ends with the force.
TEST(ForceStage, TheTorqueIsThatOfTheForceAtTheEdge) {
  for (const double limit : {0.05, 0.005}) {
    SCOPED_TRACE(limit);
    Rig rig;
    rig.slots[0].device_came(3, limit);
    rig.height = 0.18;
    rig.frames(100);
    rig.pose.orientation = {std::cos(0.25), 0, std::sin(0.25), 0};  // 0.5 rad about y
    rig.height = kSize + 0.05 * std::cos(0.5) - 0.004;
    const double slew = rig.config.torque_limits().slew_n_s;
    Vec3 last;
    const auto frame = [&] {
      rig.frame();
      const BladeForce& force = rig.told.forces.back();
      EXPECT_LE(length(force.newton_metres), limit + 1e-12);
      EXPECT_LE(distance(force.newton_metres, last), slew * 1e-3 + 1e-12);
      last = force.newton_metres;
      return force;
    };
    for (int i = 0; i < 2500; ++i) frame();
    const BladeForce steady = frame();
    EXPECT_GT(length(steady.newtons), 0.5);
    EXPECT_NEAR(distance(steady.feel.arm, core::rotate(rig.pose.orientation, {0, 0, -0.05})), 0, 0.003);
    const Vec3 expected = cross(steady.feel.arm, steady.newtons);
    EXPECT_GT(length(expected), 0.01);
    if (limit > 0.01) {
      EXPECT_NEAR(distance(steady.newton_metres, expected), 0, 0.02 * length(expected));
    } else {
      EXPECT_NEAR(length(steady.newton_metres), limit, 1e-9);
      EXPECT_GT(dot(steady.newton_metres, expected), 0.99 * limit * length(expected));
    }
    // Silence: both are gone within 10 ms of the fault, and grow again together.
    rig.silent = true;
    for (int i = 0; i < 35; ++i) rig.frame();
    rig.silent = false;
    EXPECT_EQ(rig.last, Vec3{});
    EXPECT_EQ(rig.told.forces.back().newton_metres, Vec3{});
    last = {};
    frame();
    for (int i = 0; i < 200; ++i) {
      const BladeForce again = frame();
      EXPECT_LE(length(again.newton_metres), length(again.feel.arm) * length(again.newtons) + 1e-4);
    }
  }
}

TEST(ForceStage, NoTorqueWhereNoneIsWanted) {
  ForceConfig config;
  config.most_torque_n_m = 0;
  Told told;
  ForceStage stage{config, cut_config(), std::make_unique<Tissue>(tests::cube(8, kSize)), &told, nullptr};
  stage.opened(0, cut_config().blade);
  core::Pose pose;
  pose.orientation = {std::cos(0.25), 0, std::sin(0.25), 0};
  for (int i = 0; i < 500; ++i) {
    pose.t_ns = (i + 1) * kMs;
    pose.position = {0.05, 0.05, 0.147 - 2e-5 * i};
    stage.posed(0, pose, pose.t_ns, false);
    stage.frame(pose.t_ns, 0);
  }
  ASSERT_FALSE(told.forces.empty());
  EXPECT_GT(length(told.forces.back().newtons), 0);
  for (const BladeForce& force : told.forces) ASSERT_EQ(force.newton_metres, Vec3{});
}

TEST(ForceStage, ThreeFaultsEndItUntilTheButtonIsPressedInAir) {
  Rig rig;
  for (int fault = 0; fault < 3; ++fault) {
    rig.frames(300);
    ASSERT_GT(length(rig.last), 0.01) << fault;
    rig.silent = true;
    rig.frames(50);
    rig.silent = false;
  }
  EXPECT_EQ(rig.frames(100), Vec3{});
  EXPECT_NE(rig.flags & kForceLatchedOff, 0u);
  rig.height = 0.16;
  rig.frames(20);
  rig.engaged = true;
  rig.frames(20);
  EXPECT_EQ(rig.flags & kForceLatchedOff, 0u);
  rig.engaged = false;
  rig.height = 0.147;
  EXPECT_GT(length(rig.frames(500)), 0.05);
}

TEST(ForceStage, AnotherBladeFeelsItsOwnForce) {
  Rig rig;
  rig.frames(500);
  ForceCommand command;
  EXPECT_FALSE(rig.slots[1].read(command)) << "a source that never opened has no force";
}

// Everything together: faults of devices and of the loop while a real contact acts.
TEST(ForceStage, FaultsInContactEndTheForceAndTheRampBeginsIt) {
  int acted = 0;
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    Rig rig;
    for (int episode = 0; episode < 25; ++episode) {
      rig.frames(100 + static_cast<int>(random.below(600)));
      acted += length(rig.last) > 0;
      const std::uint32_t kind = random.below(5);
      std::int64_t allowed_ns = 0, step_ns = kMs, late_ns = 0;
      if (kind == 0) rig.silent = true, allowed_ns = 20 * kMs;
      if (kind == 1) rig.frozen = true, allowed_ns = 250 * kMs;
      if (kind == 2) late_ns = step_ns = 6 * kMs + random.below(40) * kMs;
      if (kind == 3) rig.slots[0].write_failed();
      if (kind == 4) rig.slots[0].device_lost();
      const std::int64_t from = rig.now;
      bool reached = rig.frame(step_ns, late_ns) == Vec3{};
      while (rig.now < from + allowed_ns + step_ns + 11 * kMs) reached = rig.frame() == Vec3{} || reached;
      ASSERT_TRUE(reached) << "episode " << episode << " kind " << kind;
      if (kind < 2) {
        ASSERT_EQ(rig.frames(30), Vec3{});
      }
      rig.silent = rig.frozen = false;
      const bool latched = (rig.flags & kForceLatchedOff) != 0;
      ASSERT_TRUE(latched || kind < 3);
      const std::int64_t zero = rig.zero_ns;
      for (int i = 0; i < 100; ++i) {
        const double ramp = 3.3 * static_cast<double>(rig.now + kMs - zero) * 1e-9 / 2;
        ASSERT_LE(length(rig.frame()), latched ? 0 : ramp + 1e-9)
            << "episode " << episode << " kind " << kind;
      }
      if (latched) {
        // Plugged in again: the source is opened again.
        rig.slots[0].device_came(3);
        rig.stage.opened(0, cut_config().blade);
        rig.height = 0.16;
        rig.frames(20);
        rig.height = 0.146;
      }
    }
  }
  EXPECT_GE(acted, 150);
}

// A loop that hung for seconds: what acted before must not go on acting because nothing has come since.
TEST(ForceStage, AForceThatActsIsNotLeftAloneAfterALongPause) {
  Rig rig;
  ASSERT_GT(length(rig.frames(500)), 0.1);
  rig.silent = true;
  rig.frame(1500 * kMs);  // which checks that the device is told
  EXPECT_EQ(rig.last, Vec3{});
}

TEST(ForceStage, AfterARestartABladeInTheBodyWasPutThere) {
  Rig rig;
  const double pressing = length(rig.frames(500));
  ASSERT_GT(pressing, 0.1);
  rig.stage.restart();
  EXPECT_LT(length(rig.frames(30)), 0.3 * pressing);
  EXPECT_TRUE(rig.told.forces.back().feel.contact->penetrated);
}

TEST(ForceStage, TheButtonRearmsOnlyInAir) {
  Rig rig;
  for (int fault = 0; fault < 3; ++fault) {
    rig.frames(300);
    rig.silent = true;
    rig.frames(50);
    rig.silent = false;
  }
  rig.engaged = true;
  rig.frames(20);
  EXPECT_NE(rig.flags & kForceLatchedOff, 0u) << "pressed in the tissue";
}

// Two poses in one frame, of which the first one jumped.
TEST(ForceStage, AJumpIsNotForgottenByTheNextPose) {
  Rig rig;
  rig.height = 0.16;
  rig.frames(100);
  core::Pose pose = rig.pose;
  pose.position.z = 0.12;
  pose.t_ns = rig.now + 1;
  rig.stage.posed(0, pose, rig.now, true);
  pose.position.z -= 1e-6;
  pose.t_ns = rig.now + 100'000;
  rig.stage.posed(0, pose, rig.now, false);
  rig.stage.frame(rig.now + kMs, 0);
  ASSERT_TRUE(rig.told.forces.back().feel.contact.has_value());
  EXPECT_TRUE(rig.told.forces.back().feel.contact->penetrated) << "it was put there";
}

TEST(ForceStage, CountsTheForcesThatWereCutShort) {
  core::CutConfig config;
  config.blade = {{-0.1, 0.01, 0.01}, {0.4, 0.01, 0.01}};
  ForceStage stage({}, config, std::make_unique<Tissue>(tests::comb(3000)), nullptr, nullptr);
  stage.opened(0, config.blade);
  for (int i = 1; i <= 5; ++i) {
    stage.posed(0, {i * kMs, {}, {}, 0}, i * kMs, false);
    stage.frame(i * kMs, 0);
    EXPECT_EQ(stage.cut_short(), static_cast<std::uint64_t>(i));
  }
}

}  // namespace
}  // namespace incise::haptics
