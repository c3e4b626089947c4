#include "client/contact_renderer.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <deque>
#include <limits>
#include <stdexcept>
#include <string>

#include "tests/haptics/random.hpp"

namespace incise::client {
namespace {

using protocol::LocalContact;
using protocol::Vec3;
using tests::Random;

constexpr std::int64_t kMs = 1'000'000;

// The top of a table at z = 0.
protocol::Force table(double stiffness = 800) {
  protocol::Force force;
  force.contact = LocalContact{{0, 0, 0}, {0, 0, 1}, stiffness, 0, 0, 0, 50 * kMs, false, {}};
  return force;
}

double size(const Vec3& v) {
  return std::sqrt(v.x * v.x + v.y * v.y + v.z * v.z);
}

// A device at 1 kHz.
struct Device {
  explicit Device(const ContactLimits& with = {}) : limits(with), renderer(with) {}
  Vec3 at(const Vec3& tool, std::int64_t after_ns = kMs) {
    now += after_ns;
    work -= last.x * (tool.x - place.x) + last.y * (tool.y - place.y) + last.z * (tool.z - place.z);
    const Vec3 force = renderer.force(tool, now);
    EXPECT_TRUE(std::isfinite(size(force)));
    EXPECT_LE(size(force), limits.most_n + 1e-9);
    EXPECT_LE(size({force.x - last.x, force.y - last.y, force.z - last.z}),
              limits.slew_n_s * 1e-9 * static_cast<double>(after_ns) + 1e-9);
    place = tool;
    return last = force;
  }
  // Pressed to that depth from above, for so long, with planes that keep coming.
  Vec3 press(double depth, int frames) {
    for (int i = 0; i < frames; ++i) {
      renderer.take(table(), now);
      at({0, 0, -depth * std::min(1.0, i / 100.0)});
    }
    return last;
  }
  const ContactLimits limits;
  ContactRenderer renderer;
  std::int64_t now = 1'000 * kMs;
  Vec3 place, last;
  double work = 0;
};

// The torque is that of the force at the arm's end, within its limit; it fades with the force.
TEST(ContactRenderer, MakesTheTorqueOfTheForceAtTheBlade) {
  for (const double limit : {0.2, 0.01}) {
    ContactLimits limits;
    limits.most_torque_n_m = limit;
    ContactRenderer renderer(limits);
    std::int64_t now = kMs;
    protocol::Force plane = table();
    plane.contact->arm = Vec3{0.05, 0, -0.02};
    Wrench felt;
    Vec3 last;
    const auto step = [&](bool planes, double depth) {
      now += kMs;
      if (planes) renderer.take(plane, now);
      felt = renderer.wrench({0, 0, -depth}, {}, now);
      EXPECT_LE(size(felt.torque_n_m), limit + 1e-12);
      const Vec3& t = felt.torque_n_m;
      EXPECT_LE(size({t.x - last.x, t.y - last.y, t.z - last.z}), 500 * limit / 3.3 * 1e-3 + 1e-12);
      last = t;
    };
    for (int i = 0; i < 3000; ++i) step(true, 0.002 * std::min(1.0, i / 200.0));
    EXPECT_NEAR(felt.force_n.z, 1.6, 1e-3);
    EXPECT_NEAR(felt.torque_n_m.y, -std::min(limit, 0.05 * 1.6), 1e-3);
    for (int i = 0; i < 70; ++i) step(false, 0.002);
    EXPECT_EQ(size(felt.force_n), 0);
    EXPECT_EQ(size(felt.torque_n_m), 0);
  }
}

// Pushing and turning together, with planes that jump: what comes out is bounded.
TEST(ContactRenderer, IsPassiveWithTorques) {
  const std::uint64_t seed = 41;
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  ContactRenderer renderer;
  std::int64_t now = kMs;
  Vec3 tool, heading, torque, force;
  double angle = 0, rate = 0, work = 0, most = 0, turned = 0, largest = 0;
  for (int i = 0; i < 20'000; ++i) {
    if (i % 70 == 0) {
      heading = {random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
      rate = random.uniform(-3, 3);
    }
    if (i % 20 == 0) {
      protocol::Force plane = table(random.uniform(100, 1500));
      plane.contact->point = {tool.x, tool.y, random.uniform(-0.002, 0.004)};
      plane.contact->arm = Vec3{random.uniform(-0.05, 0.05), random.uniform(-0.05, 0.05), -0.05};
      renderer.take(plane, now);
    }
    const Vec3 step{1e-4 * heading.x - 0.01 * tool.x, 1e-4 * heading.y - 0.01 * tool.y,
                    1e-4 * heading.z - 0.01 * tool.z};
    const double turns = 1e-3 * rate;  // about y
    work -= force.x * step.x + force.y * step.y + force.z * step.z + torque.y * turns;
    turned += std::abs(torque.y * turns);
    largest = std::max(largest, size(force) * size(step) + size(torque) * std::abs(turns));
    tool = {tool.x + step.x, tool.y + step.y, tool.z + step.z};
    angle += turns;
    now += kMs;
    const Wrench felt = renderer.wrench(tool, {std::cos(angle / 2), 0, std::sin(angle / 2), 0}, now);
    force = felt.force_n;
    torque = felt.torque_n_m;
    most = std::max(most, -work - i * 1e-3 * ContactRenderer::kLeak_w);
  }
  EXPECT_GT(turned, 0.05);
  // What the slew limit still lets act for 6.6 ms once the account is empty: 3.3 N at 0.1 m/s, 0.2 N m at 3 rad/s.
  EXPECT_LT(most, ContactRenderer::kReserve_j + 2 * largest + 0.0066 * (3.3 * 0.1 + 0.2 * 3));
}

TEST(ContactRenderer, IsASpringAfterTheRamp) {
  Device device;
  EXPECT_NEAR(device.press(0.002, 1000).z, 0.8, 0.05) << "half way up the ramp";
  for (int i = 0; i < 1100; ++i) {
    device.renderer.take(table(), device.now);
    device.at({0, 0, -0.002});
  }
  EXPECT_NEAR(device.last.z, 1.6, 0.01);
}

TEST(ContactRenderer, FadesWhenThePlaneExpiresAndComesBackWithTheRamp) {
  Device device;
  device.press(0.002, 2200);
  ASSERT_GT(device.last.z, 1.5);
  for (int i = 0; i < 48; ++i) device.at({0, 0, -0.002});
  EXPECT_GT(device.last.z, 1.5) << "50 ms are allowed";
  for (int i = 0; i < 12; ++i) device.at({0, 0, -0.002});
  EXPECT_EQ(size(device.last), 0);
  device.renderer.take(table(), device.now);
  for (int i = 0; i < 20; ++i) device.at({0, 0, -0.002});
  EXPECT_LT(device.last.z, 0.04);
}

TEST(ContactRenderer, ThePlaneGivesWayAtItsResistance) {
  Device device;
  protocol::Force force = table();
  force.contact->cutting_resistance_n = 1;
  force.contact->valid_for_ns = 1000 * kMs;
  for (int i = 0; i < 5; ++i) {  // past the ramp
    device.renderer.take(force, device.now);
    for (int j = 0; j < 500; ++j) device.at({0, 0, 0.001 - 1e-5 * (i == 0 ? j : 500)});
  }
  EXPECT_NEAR(device.last.z, 1, 0.01);
  double least = 10;
  device.renderer.take(force, device.now);
  for (int j = 0; j < 500; ++j) least = std::min(least, device.at({0, 0, -0.004 - 1e-5 * j}).z);
  EXPECT_NEAR(least, 1, 0.05) << "a steady resistance";
  device.at({0, 0, -0.009 + 0.0005});
  device.at({0, 0, -0.009 + 0.002});
  device.at({0, 0, -0.009 + 0.002});
  EXPECT_LT(device.last.z, 0.05) << "behind the plane, which has moved along";
}

TEST(ContactRenderer, NothingUnsoundIsRendered) {
  const double nan = std::numeric_limits<double>::quiet_NaN(),
               infinite = std::numeric_limits<double>::infinity();
  Random random(3);
  Device device;
  for (int i = 0; i < 3000; ++i) {
    protocol::Force force = table(1e9);
    LocalContact& c = *force.contact;
    double* const fields[] = {&c.point.x,
                              &c.normal.z,
                              &c.stiffness_n_per_m,
                              &c.damping_n_s_per_m,
                              &c.cutting_resistance_n,
                              &c.friction_n_s_per_m};
    if (i % 3 != 0)
      *fields[random.below(6)] = (random.below(2) ? nan : infinite) * (random.below(2) ? 1 : -1);
    if (i % 7 == 0) c.valid_for_ns = std::numeric_limits<std::int64_t>::max();
    device.renderer.take(force, device.now);
    const Vec3 tool = random.below(50) ? Vec3{0, 0, -0.001 * random.uniform(-1, 1)} : Vec3{nan, infinite, 0};
    if (std::isfinite(tool.x)) {
      device.at(tool);
    } else {
      device.now += kMs;
      EXPECT_TRUE(std::isfinite(size(device.last = device.renderer.force(tool, device.now))));
    }
  }
}

// Planes that come late by up to 150 ms, out of step, with losses, for random motions: no energy comes of it beyond
// the stated tolerance.
TEST(ContactRenderer, DelayMakesNoEnergy) {
  int felt = 0;
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    Device device;
    const int delay = static_cast<int>(random.below(150));
    const double speed = random.uniform(1, 40), swing = random.uniform(0.001, 0.02);
    const bool cutting = seed % 2 == 0;
    double front = 0, force = 0, farthest = 0;
    std::deque<std::pair<int, protocol::Force>> on_the_way;
    for (int i = 0; i < 6000; ++i) {
      const Vec3 tool{swing * std::sin(0.37 * speed * i * 1e-3), 0,
                      swing * std::sin(speed * i * 1e-3) + random.uniform(-1e-4, 1e-4)};
      // The server: a front at which the tissue gives way.
      front = cutting ? std::min(front, tool.z + 0.001) : 0;
      if (random.below(10) != 0) {
        protocol::Force message = table(random.uniform(200, 3000));
        message.contact->point = {0, 0, front};
        message.contact->cutting_resistance_n = cutting ? 1 : 0;
        message.contact->friction_n_s_per_m = 2;
        message.contact->damping_n_s_per_m = 1;
        message.contact->penetrated = cutting && front < -0.001;
        on_the_way.emplace_back(i + delay + static_cast<int>(random.below(20)), message);
      }
      while (!on_the_way.empty() && on_the_way.front().first <= i) {
        device.renderer.take(on_the_way.front().second, device.now);
        on_the_way.pop_front();
      }
      const Vec3 before = device.place;
      device.at(tool);
      farthest = std::max(farthest, size({tool.x - before.x, tool.y - before.y, tool.z - before.z}));
      force += size(device.last) * 1e-3;
      // The fade holds a force for up to 10 steps after the account is empty.
      const double tolerance = ContactRenderer::kReserve_j + ContactRenderer::kLeak_w * 1e-3 * (i + 1) +
                               10 * device.limits.most_n * farthest;
      ASSERT_GE(device.work, -tolerance) << "step " << i;
    }
    felt += force > 0.1;
  }
  EXPECT_GT(felt, 20);
}

TEST(ContactRenderer, NoPlaneIsValidForMoreThanASecond) {
  Device device;
  device.press(0.002, 2500);
  protocol::Force message = table();
  message.contact->valid_for_ns = 1'000'000 * kMs;
  device.renderer.take(message, device.now);
  for (int i = 0; i < 900; ++i) device.at({0, 0, -0.002});
  EXPECT_NEAR(device.last.z, 1.6, 0.05);
  for (int i = 0; i < 200; ++i) device.at({0, 0, -0.002});
  EXPECT_EQ(size(device.last), 0);
}

TEST(ContactRenderer, WhatHasGivenWayDoesNotComeBack) {
  Device device;
  device.press(0.0005, 2500);
  protocol::Force message = table();
  message.contact->cutting_resistance_n = 0.8;
  message.contact->valid_for_ns = 1000 * kMs;
  device.renderer.take(message, device.now);
  for (int i = 0; i <= 100; ++i) device.at({0, 0, -0.0005 - 4.5e-5 * i});
  EXPECT_NEAR(device.last.z, 0.8, 0.05);
  for (int i = 0; i <= 50; ++i) device.at({0, 0, -0.005 + 4e-5 * i});
  EXPECT_EQ(size(device.last), 0) << "2 mm back, of which the spring was stretched by one";
}

TEST(ContactRenderer, APlaneDoesNotPull) {
  Device device;
  const auto damped = [&](double z) {
    protocol::Force message = table();
    message.contact->damping_n_s_per_m = 50;
    device.renderer.take(message, device.now);
    return device.at({0, 0, z}).z;
  };
  for (int i = 0; i < 2500; ++i) damped(-0.002 * std::min(1.0, i / 500.0));
  ASSERT_GT(device.last.z, 1);
  for (int i = 0; i <= 20; ++i) EXPECT_GE(damped(-0.002 + 1e-4 * i), -1e-9) << i;
}

// Where the server says that the tissue has ended the next contact is felt at once; one that ran out ramps again.
TEST(ContactRenderer, OnlyAPlaneThatRanOutRampsAgain) {
  for (const bool ran_out : {false, true}) {
    Device device;
    device.press(0.002, 2500);
    for (int i = 0; !ran_out && i <= 100; ++i) {
      device.renderer.take(table(), device.now);
      device.at({0, 0, -0.002 + 3e-5 * i});
    }
    if (!ran_out) device.renderer.take(protocol::Force{}, device.now);
    for (int i = 0; i < 100; ++i) device.at(device.place);
    ASSERT_EQ(size(device.last), 0);
    device.press(0.002, 150);
    EXPECT_EQ(device.last.z > 1, !ran_out) << device.last.z;
  }
}

TEST(ContactRenderer, NoPlaneIsStifferThanADeviceCanRender) {
  Device device;
  for (int i = 0; i < 2500; ++i) {
    device.renderer.take(table(1e5), device.now);
    device.at({0, 0, -0.001 * std::min(1.0, i / 500.0)});
  }
  EXPECT_NEAR(device.last.z, 0.001 * device.limits.stiffest_n_m, 0.02);
}

TEST(ContactRenderer, AfterAShortPauseAForceGoesOn) {
  Device device;
  device.press(0.004, 2500);
  const double before = device.last.z;
  ASSERT_GT(before, 3);
  device.now += ContactRenderer::kSilence_ns;
  protocol::Force message = table();
  message.contact->point = {0, 0, -0.1};
  device.renderer.take(message, device.now);
  const Vec3 force = device.renderer.force(device.place, device.now);
  EXPECT_GT(force.z, before - 0.005 * device.limits.slew_n_s);
  EXPECT_LT(force.z, before);
}

// The device's thread was paused. Planes kept coming, and there is one when it goes on; the device may hold the last
// force or none.
TEST(ContactRenderer, AfterASilenceOfItsOwnTheRampBeginsAgain) {
  Device device;
  device.press(0.002, 2500);
  ASSERT_NEAR(device.last.z, 1.6, 0.01);
  for (const std::int64_t pause : {ContactRenderer::kSilence_ns + 1, 10'000 * kMs}) {
    for (int i = 1; i <= 10; ++i) device.renderer.take(table(), device.now + pause * i / 10);
    device.now += pause;
    EXPECT_EQ(size(device.last = device.renderer.force(device.place, device.now)), 0) << pause;
    const auto go_on = [&](int ms) {
      for (int i = 0; i < ms; ++i) {
        device.renderer.take(table(), device.now);
        device.at(device.place);  // checks limit and slew
      }
    };
    go_on(100);
    EXPECT_NEAR(device.last.z, 0.05 * 1.6, 0.005) << pause;
    go_on(900);
    EXPECT_NEAR(device.last.z, 0.5 * 1.6, 0.01) << pause;
    go_on(1100);
    EXPECT_NEAR(device.last.z, 1.6, 0.01) << "the second pause finds full force";
  }
}

TEST(ContactRenderer, AfterASilenceTheTorqueBeginsAgain) {
  ContactRenderer renderer;
  std::int64_t now = kMs;
  protocol::Force plane = table();
  plane.contact->arm = Vec3{0.05, 0, 0};
  const auto step = [&](int i) {
    now += kMs;
    renderer.take(plane, now);
    return renderer.wrench({0, 0, -0.002 * std::min(1.0, i / 200.0)}, {}, now);
  };
  Wrench felt;
  for (int i = 0; i < 3000; ++i) felt = step(i);
  ASSERT_NEAR(felt.torque_n_m.y, -0.08, 1e-3);
  now += 60 * kMs;
  felt = step(3000);
  EXPECT_EQ(size(felt.force_n), 0);
  EXPECT_EQ(size(felt.torque_n_m), 0);
  for (int i = 0; i < 100; ++i) felt = step(3000);
  EXPECT_NEAR(felt.torque_n_m.y, -0.05 * 0.08, 5e-4);
}

// Random motion with silences: what comes out while it is called stays within the account.
TEST(ContactRenderer, SilencesMakeNoEnergy) {
  Random random(17);
  Device device;
  double farthest = 0, least = 0, force = 0, t_s = 0;
  for (int i = 0; i < 40'000; ++i) {
    if (i % 10 == 0) device.renderer.take(table(random.uniform(200, 2000)), device.now);
    const std::int64_t step = (random.below(400) == 0 ? 30 + static_cast<int>(random.below(90)) : 1) * kMs;
    const Vec3 before = device.place;
    device.at({0, 0, 0.004 * std::sin(i * 0.006) + random.uniform(-1e-5, 1e-5)}, step);
    farthest = std::max(farthest, std::abs(device.place.z - before.z));
    force += size(device.last) * 1e-3;
    t_s += static_cast<double>(step) * 1e-9;
    least = std::min(least, device.work + ContactRenderer::kLeak_w * t_s);
  }
  EXPECT_GT(force, 1);
  EXPECT_GT(least, -(ContactRenderer::kReserve_j + 10 * device.limits.most_n * farthest));
}

TEST(ContactRenderer, ImpossibleLimitsAreRefused) {
  const double nan = std::numeric_limits<double>::quiet_NaN(),
               infinite = std::numeric_limits<double>::infinity();
  const auto refused = [](const auto& change) {
    ContactLimits limits;
    change(limits);
    try {
      const ContactRenderer renderer(limits);
    } catch (const std::invalid_argument& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  for (const double bad : {nan, infinite, -1.0}) {
    EXPECT_NE(refused([&](ContactLimits& l) { l.most_n = bad; }).find("most_n is "), std::string::npos);
    EXPECT_NE(refused([&](ContactLimits& l) { l.slew_n_s = bad; }).find("slew_n_s is "), std::string::npos);
    EXPECT_NE(refused([&](ContactLimits& l) { l.ramp_s = bad; }).find("ramp_s is "), std::string::npos);
    EXPECT_NE(refused([&](ContactLimits& l) { l.stiffest_n_m = bad; }), "");
    EXPECT_NE(refused([&](ContactLimits& l) { l.most_torque_n_m = bad; }), "");
  }
  EXPECT_EQ(refused([](ContactLimits& l) { l.slew_n_s = 1; }),
            "ContactLimits: slew_n_s is 1; accepted are finite numbers above most_n / ramp_s");
  EXPECT_EQ(refused([](ContactLimits& l) { l.most_n = 0; }), "");
}

TEST(ContactRenderer, WithoutARampTheForceIsThereAtOnce) {
  ContactLimits limits;
  limits.ramp_s = 0;
  Device device(limits);
  device.press(0.002, 110);
  EXPECT_NEAR(device.last.z, 1.6, 0.01);
}

}  // namespace
}  // namespace incise::client
