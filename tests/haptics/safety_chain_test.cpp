#include "server/haptics/safety_chain.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/haptics/random.hpp"

namespace incise::haptics {
namespace {

using core::Vec3;
using tests::Random;

constexpr std::int64_t kMs = 1'000'000;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

// A chain in a loop of 1 kHz, with a source that sends a pose for each frame.
class Loop {
 public:
  explicit Loop(const SafetyLimits& with = {}) : limits(with), chain(with) { chain.arm(0, 0); }

  // One frame with this force computed; checks what must hold in every frame.
  Vec3 frame(const Vec3& wanted, std::int64_t step_ns = kMs) {
    now += step_ns;
    SafetyInput in;
    in.now_ns = now;
    in.wanted = wanted;
    in.contact = true;
    if (!silent) pose_ns = now;
    if (!silent && !frozen) moved_ns = now;
    in.pose_ns = pose_ns;
    in.moved_ns = moved_ns;
    in.late_ns = late_ns;
    in.losses = losses;
    in.failed_writes = failed_writes;
    in.device_most_n = device_most_n;
    const Vec3 force = chain.update(in);
    EXPECT_TRUE(is_finite(force)) << "at " << now;
    EXPECT_LE(length(force), limits.most_n + 1e-9) << "at " << now;
    EXPECT_LE(distance(force, last), limits.slew_n_s * 1e-9 * static_cast<double>(step_ns) + 1e-9)
        << "at " << now << " from " << length(last) << " to " << length(force);
    last = force;
    if (force == Vec3{}) zero_ns = now;
    return force;
  }
  Vec3 frames(int n, const Vec3& wanted) {
    for (int i = 0; i < n; ++i) frame(wanted);
    return last;
  }

  const SafetyLimits limits;
  SafetyChain chain;
  std::int64_t now = 1'000'000 * kMs, pose_ns = 0, moved_ns = 0, late_ns = 0, zero_ns = 0;
  bool silent = false, frozen = false;
  std::uint32_t losses = 0, failed_writes = 0;
  double device_most_n = 0;
  Vec3 last;
};

const Vec3 kPush{0, 0, 2};

TEST(SafetyChain, WithoutARampTheForceComesAsFastAsItMayChange) {
  SafetyLimits limits;
  limits.ramp_s = 0;
  Loop loop(limits);
  loop.frame({0, 0, 2});
  EXPECT_NEAR(loop.frame({0, 0, 2}).z, limits.slew_n_s * 1e-3, 1e-9);
  EXPECT_EQ(loop.frames(3, {0, 0, 2}), (Vec3{0, 0, 2}));
  EXPECT_FALSE(loop.chain.ramping());
  loop.silent = true;  // after a fault, too
  loop.frames(40, {0, 0, 2});
  EXPECT_EQ(loop.last, Vec3{});
  loop.silent = false;
  EXPECT_EQ(loop.frames(6, {0, 0, 2}), (Vec3{0, 0, 2}));
}

TEST(SafetyChain, TheFirstContactGrowsOverTwoSeconds) {
  Loop loop;
  loop.frame({});
  double before = 0;
  for (int i = 1; i <= 2100; ++i) {
    const double force = loop.frame(kPush).z;
    EXPECT_GE(force, before);
    EXPECT_LE(force, 2.0 * i / 2000 + 1e-9);
    before = force;
    if (i == 1000) {
      EXPECT_NEAR(force, 1, 0.01);
    }
  }
  EXPECT_DOUBLE_EQ(before, 2);
  EXPECT_FALSE(loop.chain.ramping());
  EXPECT_FALSE(loop.chain.limited());
  // Later contacts do not ramp.
  loop.frames(100, {});
  EXPECT_DOUBLE_EQ(loop.frames(5, kPush).z, 2);
}

TEST(SafetyChain, NoContactBeginsNoRamp) {
  SafetyChain chain({});
  chain.arm(0, 0);
  for (std::int64_t t = 1; t < 5000; ++t) {
    SafetyInput in;
    in.now_ns = in.pose_ns = in.moved_ns = t * kMs;
    chain.update(in);
  }
  EXPECT_TRUE(chain.ramping());
}

TEST(SafetyChain, NotANumberBecomesNothingWithinTheDecay) {
  for (const Vec3& poison : {Vec3{kNan, 0, 0}, Vec3{0, kInf, 0}, Vec3{0, 0, -kInf}, Vec3{kNan, kNan, kNan}}) {
    Loop loop;
    loop.frames(2100, kPush);
    loop.frame(poison);
    EXPECT_LT(loop.last.z, 2);
    loop.frames(9, kPush);
    EXPECT_EQ(loop.last, Vec3{});
    EXPECT_EQ(loop.chain.faults(), kNotFinite);
    EXPECT_NEAR(loop.frames(1000, kPush).z, 1, 0.02) << "with the ramp";
  }
}

TEST(SafetyChain, TheMagnitudeIsClamped) {
  Loop loop;
  for (const Vec3& huge : {Vec3{3, 4, 0}, Vec3{1e300, -1e300, 1e300}, Vec3{0, 0, -1e9}}) {
    loop.frames(2200, huge);
    EXPECT_NEAR(length(loop.last), loop.limits.most_n, 1e-9);
    EXPECT_TRUE(loop.chain.limited());
  }
  EXPECT_EQ(loop.chain.faults(), 0u);
  loop.frames(100, kPush);
  loop.device_most_n = 1;
  EXPECT_NEAR(length(loop.frames(100, kPush)), 1, 1e-9) << "a weaker device";
}

TEST(SafetyChain, TheChangeIsLimited) {
  Loop loop;
  loop.frames(2100, kPush);
  EXPECT_LT(length(loop.frame({0, 0, -2}) - kPush), 0.5 + 1e-9);  // 500 N/s for 1 ms
  EXPECT_GT(loop.last.z, 1.4);
  EXPECT_DOUBLE_EQ(loop.frames(20, {0, 0, -2}).z, -2);
}

TEST(SafetyChain, SilenceFadesToNothing) {
  Loop loop;
  loop.frames(2100, kPush);
  loop.silent = true;
  EXPECT_DOUBLE_EQ(loop.frames(20, kPush).z, 2) << "20 ms are allowed";
  loop.frame(kPush);
  EXPECT_LT(loop.last.z, 2);
  EXPECT_EQ(loop.frames(9, kPush), Vec3{});
  loop.frames(3000, kPush);
  EXPECT_EQ(loop.last, Vec3{}) << "as long as it lasts";
  EXPECT_EQ(loop.chain.fault_count(), 1u);
  loop.silent = false;
  loop.frames(2, kPush);
  EXPECT_NEAR(loop.frames(1000, kPush).z, 1, 0.02) << "then the ramp";
}

TEST(SafetyChain, ASilentSourceWithoutAForceIsNoFaultButBeginsAnew) {
  Loop loop;
  loop.frames(2100, kPush);
  loop.frames(20, {});
  loop.silent = true;
  loop.frames(500, {});
  loop.silent = false;
  EXPECT_EQ(loop.chain.fault_count(), 0u);
  loop.frame({});
  EXPECT_LT(loop.frames(10, kPush).z, 0.03);
}

TEST(SafetyChain, AFrozenDeviceFades) {
  Loop loop;
  loop.frames(2100, kPush);
  loop.frozen = true;
  EXPECT_DOUBLE_EQ(loop.frames(250, kPush).z, 2);
  EXPECT_EQ(loop.frames(11, kPush), Vec3{});
  loop.frames(2000, kPush);
  EXPECT_EQ(loop.last, Vec3{}) << "until it moves";
  EXPECT_EQ(loop.chain.fault_count(), 1u);
  loop.frozen = false;
  loop.frame(kPush);
  EXPECT_GT(loop.frames(100, kPush).z, 0.05);
}

TEST(SafetyChain, ALateFrameFades) {
  Loop loop;
  loop.frames(2100, kPush);
  loop.late_ns = 5 * kMs;
  loop.frame(kPush);
  EXPECT_DOUBLE_EQ(loop.last.z, 2) << "5 ms are allowed";
  loop.late_ns = 6 * kMs;
  loop.frame(kPush, 7 * kMs);
  loop.late_ns = 0;
  EXPECT_NEAR(loop.last.z, 0.6, 1e-9) << "7 of the 10 ms have passed";
  EXPECT_EQ(loop.frames(4, kPush), Vec3{});
}

TEST(SafetyChain, ALostDeviceLatchesUntilASourceIsOpened) {
  for (const bool lost : {true, false}) {
    Loop loop;
    loop.frames(2100, kPush);
    ++(lost ? loop.losses : loop.failed_writes);
    loop.frames(10, kPush);
    EXPECT_EQ(loop.last, Vec3{});
    EXPECT_TRUE(loop.chain.latched());
    EXPECT_EQ(loop.frames(5000, kPush), Vec3{});
    loop.chain.rearm_after_faults();
    EXPECT_EQ(loop.frames(5000, kPush), Vec3{}) << "the user's wish is not enough";
    loop.chain.arm(loop.losses, loop.failed_writes);
    loop.frame(kPush);
    EXPECT_NEAR(loop.frames(1000, kPush).z, 1, 0.02) << "with the ramp";
  }
}

TEST(SafetyChain, ThreeFaultsLatchUntilArmed) {
  Loop loop;
  for (int fault = 1; fault <= 3; ++fault) {
    EXPECT_FALSE(loop.chain.latched());
    loop.frames(500, kPush);
    loop.frame({kNan, 0, 0});
    loop.frames(10, kPush);
  }
  EXPECT_TRUE(loop.chain.latched());
  EXPECT_EQ(loop.frames(5000, kPush), Vec3{});
  loop.chain.rearm_after_faults();
  loop.frame(kPush);
  EXPECT_NEAR(loop.frames(1000, kPush).z, 1, 0.02);
}

TEST(SafetyChain, FaultsFarApartDoNotLatch) {
  Loop loop;
  for (int fault = 0; fault < 5; ++fault) {
    loop.frames(500, kPush);
    loop.frame({kNan, 0, 0});
    loop.now += 61'000 * kMs;
    loop.frames(20, {});
  }
  EXPECT_FALSE(loop.chain.latched());
}

// Forces that no model would compute, faults of all kinds at random: in every frame the clamp and the slew hold
// (Loop::frame checks), each fault is followed by 0 within the decay, and what comes after is under the ramp.
TEST(SafetyChain, RandomFaultsNeverGetThrough) {
  int faults = 0, latches = 0, kinds[6] = {};
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    SafetyLimits limits;
    limits.most_n = random.uniform(0.5, 8);
    limits.slew_n_s = limits.most_n / limits.decay_s * random.uniform(1, 3);
    limits.fault_memory_s = random.below(2) ? 60 : 0.5;
    Loop loop(limits);
    Vec3 target;
    for (int episode = 0; episode < 20; ++episode) {
      // A contact, for a while.
      const int touch = 50 + static_cast<int>(random.below(2500));
      for (int i = 0; i < touch; ++i) {
        if (random.below(20) == 0) target = random.in_box({-9, -9, -9}, {9, 9, 9});
        if (random.below(200) == 0) target = 1e6 * target;
        loop.frame(target, kMs + static_cast<std::int64_t>(random.below(200'000)) - 100'000);
      }
      const std::uint32_t kind = random.below(6);
      const bool acted = length(loop.last) > 0;
      Vec3 wanted = target;
      std::int64_t allowed_ns = 0;  // from here until the fault is one
      std::int64_t step_ns = kMs;
      if (kind == 0) wanted = {random.below(2) ? kNan : kInf, 0, 1};
      if (kind == 1) loop.silent = true, allowed_ns = 20 * kMs;
      if (kind == 2) loop.frozen = true, allowed_ns = 250 * kMs;
      if (kind == 3) loop.late_ns = step_ns = 6 * kMs + random.below(30) * kMs;
      if (kind == 4) ++loop.failed_writes;
      if (kind == 5) ++loop.losses;
      const std::int64_t begun = loop.now;
      loop.frame(wanted, step_ns);
      loop.late_ns = 0;
      bool reached = loop.last == Vec3{};
      // At most one frame's time beyond what is allowed; it then stays 0 for as long as the fault does.
      while (loop.now < begun + allowed_ns + step_ns + 10 * kMs + kMs) {
        reached = loop.frame(kind == 0 ? wanted : target) == Vec3{} || reached;
      }
      ASSERT_TRUE(reached) << "episode " << episode << " kind " << kind;
      if (acted) ++faults, ++kinds[kind];
      for (std::uint32_t i = random.below(50); kind < 3 && i > 0; --i) ASSERT_EQ(loop.frame(wanted), Vec3{});
      loop.silent = loop.frozen = false;
      // Afterwards: nothing where it is latched; else never above the ramp.
      const bool latched = loop.chain.latched();
      ASSERT_TRUE(latched || kind < 4);
      latches += latched;
      const std::int64_t from = loop.zero_ns;  // there the ramp begins at the earliest
      for (int i = 0; i < 500; ++i) {
        loop.frame(target);
        const double ramp = limits.most_n * static_cast<double>(loop.now - from) * 1e-9 / limits.ramp_s;
        ASSERT_LE(length(loop.last), latched ? 0 : ramp + 1e-9) << "episode " << episode << " kind " << kind;
      }
      if (latched) {
        loop.chain.arm(loop.losses, loop.failed_writes);
        ASSERT_LE(length(loop.frame(target)), limits.most_n / limits.ramp_s * 1e-3 + 1e-9);
      }
    }
  }
  for (const int kind : kinds) EXPECT_GE(kind, 100);
  EXPECT_GE(faults, 500);
  EXPECT_GE(latches, 100);
}

TEST(SafetyChain, ArmingForgetsTheFaultsBefore) {
  Loop loop;
  const auto fault = [&] {
    loop.frames(500, kPush);
    loop.frame({kNan, 0, 0});
    loop.frames(10, kPush);
  };
  fault();
  fault();
  loop.chain.arm(0, 0);
  EXPECT_EQ(loop.chain.faults(), 0u);
  EXPECT_EQ(loop.chain.fault_count(), 0u);
  fault();
  fault();
  EXPECT_FALSE(loop.chain.latched());
  fault();
  EXPECT_TRUE(loop.chain.latched());
}

TEST(SafetyChain, AfterAPauseAForceChangesAsAfterAShortOne) {
  Loop loop;
  loop.frames(2500, {0, 0, 3});
  ASSERT_DOUBLE_EQ(loop.last.z, 3);
  loop.frame({0, 0, -3}, 100 * kMs);
  EXPECT_GT(loop.last.z, 0.5) << "500 N/s for 5 ms";
  Loop fresh;
  fresh.frame(kPush);
  EXPECT_LT(fresh.frame(kPush, 100 * kMs).z, 0.02) << "nor does the ramp";
}

TEST(SafetyChain, AStrongDeviceGetsNoMoreThanOurLimit) {
  Loop loop;
  loop.device_most_n = 10;
  EXPECT_NEAR(length(loop.frames(2500, {0, 0, 9})), loop.limits.most_n, 1e-9);
}

TEST(SafetyChain, ADeviceThatIsLostWhileItRestsLatches) {
  Loop loop;
  loop.frames(100, {});
  loop.frozen = true;
  loop.frames(300, {});
  EXPECT_EQ(loop.chain.faults(), 0u) << "at rest, without a force";
  ++loop.losses;
  loop.frame({});
  EXPECT_TRUE(loop.chain.latched());
  EXPECT_NE(loop.chain.faults() & kDeviceLost, 0u);
}

}  // namespace
}  // namespace incise::haptics
