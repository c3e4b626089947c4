#include "server/input/force_guard.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace incise::input {
namespace {

constexpr std::int64_t kNow_ns = 1'000'000'000;

haptics::ForceCommand command(double x, double y, double z, std::int64_t time_ns = kNow_ns) {
  haptics::ForceCommand made;
  made.newtons = {x, y, z};
  made.time_ns = time_ns;
  return made;
}

TEST(ForceGuard, PassesWhatTheDeviceCanBear) {
  ForceGuard guard(3);
  EXPECT_EQ(guard.pass(command(1, -2, 2), kNow_ns), (core::Vec3{1, -2, 2}));
}

TEST(ForceGuard, AStrongerForceKeepsItsDirection) {
  ForceGuard guard(1.5);
  EXPECT_EQ(guard.pass(command(1, -2, 2), kNow_ns), (core::Vec3{0.5, -1, 1}));
}

TEST(ForceGuard, ATorqueHasALimitOfItsOwnAndEndsWithTheForce) {
  haptics::ForceCommand newest = command(1, 0, 0);
  newest.newton_metres = {0, 0.3, 0.4};
  EXPECT_EQ(ForceGuard(3).pass_torque(newest, kNow_ns), core::Vec3{}) << "a device that makes none";
  ForceGuard guard(3, 0.25);
  EXPECT_EQ(guard.pass_torque(newest, kNow_ns), (core::Vec3{0, 0.15, 0.2}));
  EXPECT_EQ(guard.pass_torque(newest, kNow_ns + kForceLife_ns + 1), core::Vec3{});
  guard.failed();
  EXPECT_EQ(guard.pass_torque(newest, kNow_ns), core::Vec3{});
  newest.newton_metres[1] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(ForceGuard(3, 0.25).pass_torque(newest, kNow_ns), core::Vec3{});
}

TEST(ForceGuard, WhatIsNotFiniteIsNoForce) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  ForceGuard guard(3);
  EXPECT_EQ(guard.pass(command(kNan, 0, 0), kNow_ns), core::Vec3{});
  EXPECT_EQ(guard.pass(command(0, kInfinity, 0), kNow_ns), core::Vec3{});
  EXPECT_EQ(guard.pass(command(0, 0, -kInfinity), kNow_ns), core::Vec3{});
  EXPECT_EQ(guard.pass(command(1e200, 1e200, 0), kNow_ns), core::Vec3{}) << "its length overflows";
  EXPECT_EQ(guard.pass(command(0, 0, 1), kNow_ns), (core::Vec3{0, 0, 1}));
}

TEST(ForceGuard, AnOldCommandIsNoForce) {
  ForceGuard guard(3);
  const haptics::ForceCommand newest = command(0, 0, 1);
  EXPECT_EQ(guard.pass(newest, kNow_ns + kForceLife_ns), (core::Vec3{0, 0, 1}));
  EXPECT_EQ(guard.pass(newest, kNow_ns + kForceLife_ns + 1), core::Vec3{});
}

TEST(ForceGuard, AfterAFailedWriteNoForceUntilTheLoopHasSaidNone) {
  ForceGuard guard(3);
  guard.failed();
  EXPECT_EQ(guard.pass(command(0, 0, 1), kNow_ns), core::Vec3{});
  EXPECT_EQ(guard.pass(command(0, 0, 0.5), kNow_ns), core::Vec3{}) << "the loop does not know yet";
  EXPECT_EQ(guard.pass(command(0, 0, 0), kNow_ns), core::Vec3{});
  EXPECT_EQ(guard.pass(command(0, 0, 1), kNow_ns), (core::Vec3{0, 0, 1}));
}

}  // namespace
}  // namespace incise::input
