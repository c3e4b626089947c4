// The HID input with hidapi, udev and threads, on devices that umockdev simulates.

#include "server/input/hid/hid_input.hpp"

#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <random>
#include <sstream>

#include "server/base/clock.hpp"
#include "tests/input/hid/stylus.hpp"

namespace incise::input {
namespace {

using tests::Bytes;
using tests::bytes_of;
using tests::eventually;
using tests::MockDevice;
using tests::MockHid;
using tests::stylus;
using tests::stylus_report;

std::vector<DeviceProfile> shipped() {
  return load_profiles(std::string(INCISE_SOURCE_DIR) + "/config/devices");
}

class HidInputTest : public ::testing::Test {
 protected:
  // What the loop would see of a source.
  struct Seen {
    std::vector<TimedPose> poses;
    int opened = 0, ended = 0;
  };

  void start(std::vector<DeviceOverride> overrides = {}, std::vector<DeviceProfile> profiles = shipped()) {
    input.emplace(sources, forces, HidInput::Options{std::move(profiles), std::move(overrides)});
  }
  void drain() {
    sources.drain([&](std::uint32_t source, const InputEvent& event) {
      Seen& s = seen[sources.name_of(source)];
      s.opened += event.kind == InputEvent::Kind::kOpened;
      s.ended += event.kind == InputEvent::Kind::kEndStroke;
      if (event.kind == InputEvent::Kind::kPose) s.poses.push_back(event.pose);
      return true;
    });
  }
  bool see(const std::string& source, std::size_t poses) {
    return eventually([&] {
      drain();
      return seen[source].poses.size() >= poses;
    });
  }
  ::testing::AssertionResult open(const std::string& source) {
    const bool came = eventually([&] {
      drain();
      return sources.is_open(source);
    });
    if (came) return ::testing::AssertionSuccess();
    auto failure = ::testing::AssertionFailure() << "not opened; there is";
    for (const DeviceStatus& status : input->status()) {
      failure << "\n  " << status.path << ' ' << status.identity << " profile " << status.profile << ": "
              << status.why;
    }
    return failure;
  }
  DeviceStatus status_of(const std::string& path) {
    for (const DeviceStatus& status : input->status()) {
      if (status.path == path) return status;
    }
    return {};
  }
  // Once the figures say so: they are told a little after the poses.
  ::testing::AssertionResult counted(const std::string& path,
                                     const std::function<bool(const ReportCounts&)>& so) {
    if (eventually([&] { return so(status_of(path).figures.reports); })) return ::testing::AssertionSuccess();
    const ReportCounts n = status_of(path).figures.reports;
    return ::testing::AssertionFailure() << n.reports << " reports, " << n.lost << " lost, " << n.short_ones
                                         << " short, " << n.other << " other, " << n.repeated << " repeated, "
                                         << n.bad_values << " bad, " << n.restarts << " restarts";
  }
  // Sends reports with a pause now and then, as the system's queue holds 64.
  static void send(MockDevice& device, const std::function<Bytes(int)>& report, int count) {
    for (int i = 0; i < count; ++i) ASSERT_TRUE(eventually([&] { return device.report(report(i)); })) << i;
  }
  static Bytes stylus_bytes(int i) {
    const auto report = stylus_report(static_cast<std::uint16_t>(i), {1e-6 * i, 0, 0}, 1);
    const auto bytes = bytes_of(report);
    return {bytes.begin(), bytes.end()};
  }

  MockHid machine;
  PoseSources sources{core::Blade{}};
  haptics::ForceSlots forces;
  std::map<std::string, Seen> seen;
  std::optional<HidInput> input;  // goes first
};

TEST_F(HidInputTest, EveryReportBecomesAPoseInOrder) {
  const auto device = machine.plug(stylus());
  start();
  ASSERT_TRUE(open("incise_stylus"));
  EXPECT_EQ(device->features().at(0).bytes, tests::from_hex("03 01 e8 03"));
  constexpr int kReports = 2000;
  send(*device, stylus_bytes, kReports);
  ASSERT_TRUE(see("incise_stylus", kReports));
  const auto& poses = seen["incise_stylus"].poses;
  ASSERT_EQ(poses.size(), kReports);
  for (int i = 0; i < kReports; ++i) {
    ASSERT_NEAR(poses[i].pose.position.x, 1e-6 * i, 1e-12);
    ASSERT_EQ(poses[i].pose.buttons, 1u);
    ASSERT_TRUE(i == 0 || poses[i].pose.t_ns > poses[i - 1].pose.t_ns);
    ASSERT_TRUE(i == 0 || poses[i].arrival_ns >= poses[i - 1].arrival_ns);
  }
  EXPECT_TRUE(
      counted("/dev/hidraw0", [](const ReportCounts& n) { return n.reports == kReports && n.lost == 0; }));
  const DeviceStatus status = status_of("/dev/hidraw0");
  EXPECT_EQ(status.identity, "1209:0001:S1");
  EXPECT_EQ(status.profile, "incise_stylus");
  EXPECT_EQ(status.sources, std::vector<std::string>{"incise_stylus"});
}

TEST_F(HidInputTest, CountsWhatGotLostAndIgnoresWhatHangs) {
  const auto device = machine.plug(stylus());
  start();
  ASSERT_TRUE(open("incise_stylus"));
  for (const int i : {65534, 65535, 0, 4, 4, 4, 5}) ASSERT_TRUE(device->report(stylus_bytes(i)));
  EXPECT_TRUE(counted("/dev/hidraw0", [](const ReportCounts& n) {
    return n.reports == 7 && n.lost == 3 && n.repeated == 2;
  }));
  ASSERT_TRUE(see("incise_stylus", 5));
  EXPECT_EQ(seen["incise_stylus"].poses.size(), 5u);
}

TEST_F(HidInputTest, GarbageDoesNoHarm) {
  const auto device = machine.plug(stylus());
  start();
  ASSERT_TRUE(open("incise_stylus"));
  std::mt19937 random(7);
  const auto noise = [&](int) {
    Bytes bytes(1 + random() % 64);
    for (auto& byte : bytes) byte = static_cast<std::uint8_t>(random());
    if (random() % 4 != 0) bytes[0] = 1;
    return bytes;
  };
  send(*device, noise, 1000);
  auto no_rotation = stylus_report(1, {0, 0, 0});
  no_rotation.rotation[0] = 0;
  ASSERT_TRUE(eventually([&] { return device->report(bytes_of(no_rotation)); }));
  EXPECT_TRUE(counted("/dev/hidraw0", [](const ReportCounts& n) {
    return n.reports == 1001 && n.short_ones > 100 && n.other > 100 && n.bad_values > 0;
  }));
  drain();
  for (const TimedPose& pose : seen["incise_stylus"].poses) {
    const auto& [w, x, y, z] = pose.pose.orientation;
    ASSERT_TRUE(core::is_finite(pose.pose.position));
    ASSERT_NEAR(w * w + x * x + y * y + z * z, 1, 1e-9);
  }
  // And the next good report is a pose.
  const std::size_t before = seen["incise_stylus"].poses.size();
  const auto good = stylus_report(17, {0.03, 0.04, 0.05});
  ASSERT_TRUE(eventually([&] { return device->report(bytes_of(good)); }));
  ASSERT_TRUE(see("incise_stylus", before + 1));
  EXPECT_NEAR(seen["incise_stylus"].poses.back().pose.position.z, 0.05, 1e-9);
}

TEST_F(HidInputTest, OutOfSightEndsTheStroke) {
  const auto device = machine.plug(stylus());
  start();
  ASSERT_TRUE(open("incise_stylus"));
  for (std::uint16_t i = 0; i < 10; ++i) {
    auto report = stylus_report(i, {0, 0, 0}, 1);
    if (i >= 4 && i < 8) report.flags = 0;
    ASSERT_TRUE(device->report(bytes_of(report)));
  }
  ASSERT_TRUE(see("incise_stylus", 6));
  EXPECT_EQ(seen["incise_stylus"].ended, 1);
}

TEST_F(HidInputTest, UnplugEndsTheStrokeAndAReturnOnAnotherPathIsTheSameSource) {
  auto device = machine.plug(stylus("S1", 0));
  start();
  ASSERT_TRUE(open("incise_stylus"));
  EXPECT_TRUE(eventually([&] { return forces[0].limit() == 3.3; }));
  send(*device, stylus_bytes, 100);
  ASSERT_TRUE(see("incise_stylus", 100));
  device.reset();
  EXPECT_TRUE(eventually([&] {
    drain();
    return forces[0].losses() == 1 && forces[0].limit() == 0 && seen["incise_stylus"].ended > 0 &&
           !sources.is_open("incise_stylus");
  }));
  device = machine.plug(stylus("S1", 5, 2));
  ASSERT_TRUE(open("incise_stylus"));
  send(*device, stylus_bytes, 100);
  ASSERT_TRUE(see("incise_stylus", 200));
  EXPECT_EQ(seen["incise_stylus"].opened, 2);
  EXPECT_TRUE(eventually([&] { return status_of("/dev/hidraw5").connections == 2; }));
}

TEST_F(HidInputTest, EqualDevicesKeepTheirNamesBySerialNumber) {
  auto first = machine.plug(stylus("A", 0, 1));
  start();
  ASSERT_TRUE(open("incise_stylus"));
  auto second = machine.plug(stylus("B", 1, 2));
  ASSERT_TRUE(open("incise_stylus-2"));
  send(*first, stylus_bytes, 20);
  send(*second, stylus_bytes, 30);
  ASSERT_TRUE(see("incise_stylus", 20));
  ASSERT_TRUE(see("incise_stylus-2", 30));
  first.reset();
  second.reset();
  ASSERT_TRUE(eventually([&] {
    drain();
    return sources.open_count() == 0;
  }));
  // The second comes back first, on the path of the first.
  second = machine.plug(stylus("B", 0, 1));
  ASSERT_TRUE(open("incise_stylus-2"));
  EXPECT_FALSE(sources.is_open("incise_stylus"));
  first = machine.plug(stylus("A", 1, 2));
  ASSERT_TRUE(open("incise_stylus"));
}

TEST_F(HidInputTest, EqualDevicesWithoutSerialNumberGetTheNamesThatAreFree) {
  const auto first = machine.plug(stylus("", 0, 1));
  auto second = machine.plug(stylus("", 1, 2));
  start();
  ASSERT_TRUE(open("incise_stylus"));
  ASSERT_TRUE(open("incise_stylus-2"));
  second.reset();
  ASSERT_TRUE(eventually([&] {
    drain();
    return sources.open_count() == 1;
  }));
  second = machine.plug(stylus("", 7, 3));
  EXPECT_TRUE(open("incise_stylus-2"));
}

TEST_F(HidInputTest, ATakenBladeIsWaitedFor) {
  auto other = sources.open("incise_stylus");
  const auto device = machine.plug(stylus());
  start();
  ASSERT_TRUE(eventually(
      [&] { return status_of("/dev/hidraw0").why.find("no blade is free") != std::string::npos; }));
  other.reset();
  EXPECT_TRUE(open("incise_stylus"));
}

TEST_F(HidInputTest, OverridesPlaceRenameAndIgnore) {
  const auto first = machine.plug(stylus("A", 0, 1));
  const auto second = machine.plug(stylus("B", 1, 2));
  const double s = std::sqrt(0.5);
  start({{"1209:0001", DeviceOverride::Use::kIgnore, "", {}},
         {"1209:0001:B", DeviceOverride::Use::kProfile, "scalpel", {{1, 2, 3}, {s, 0, 0, s}, 2}}});
  ASSERT_TRUE(open("scalpel"));
  ASSERT_TRUE(second->report(bytes_of(stylus_report(1, {0.1, 0, 0}))));
  ASSERT_TRUE(see("scalpel", 1));
  const core::Pose pose = seen["scalpel"].poses[0].pose;  // a quarter turn about z, twice as long
  EXPECT_NEAR(core::distance(pose.position, {1, 2.2, 3}), 0, 1e-9);
  EXPECT_NEAR(pose.orientation.z, s, 1e-9);
  EXPECT_NE(status_of("/dev/hidraw0").why.find("ignore"), std::string::npos);
}

// Report 1: Mouse, three buttons, X and Y. Nothing of ours.
constexpr const char* kMouse =
    "05 01 09 02 a1 01 09 01 a1 00 05 09 19 01 29 03 15 00 25 01 95 03 75 01 81 02 95 01 75 05 81 03 05 01 "
    "09 30 09 31 "
    "15 81 25 7f 75 08 95 02 81 06 c0 c0";
// A multi-axis controller without a profile: X ... Rz of 16 bits, -500 ... 500, and two buttons, unnumbered.
constexpr const char* kMultiAxis =
    "05 01 09 08 a1 01 16 0c fe 26 f4 01 75 10 95 06 09 30 09 31 09 32 09 33 09 34 09 35 81 02 05 09 19 01 "
    "29 02 15 00 "
    "25 01 75 01 95 02 81 02 75 06 95 01 81 03 c0";

TEST_F(HidInputTest, AnUnknownMultiAxisControllerIsReadByItsDescriptorAndAMouseIsLeftAlone) {
  MockDevice::Kind mouse{0x1234, 0x0001, "Mouse", "", tests::from_hex(kMouse), 0, 0, 1};
  MockDevice::Kind cap{0x1234, 0x0002, "Cap", "", tests::from_hex(kMultiAxis), 0, 1, 2};
  const auto first = machine.plug(mouse);
  const auto second = machine.plug(cap);
  start();
  ASSERT_TRUE(open("1234:0002"));
  // Pushed all the way along x for a second of reports, button 0 held.
  const Bytes push = tests::from_hex("f4 01 00 00 00 00 00 00 00 00 00 00 01");
  for (int i = 0; i < 50; ++i) {
    ASSERT_TRUE(second->report(push));
    ::usleep(2000);
  }
  ASSERT_TRUE(see("1234:0002", 50));
  const core::Pose last = seen["1234:0002"].poses.back().pose;
  EXPECT_GT(last.position.x, 0.001);
  EXPECT_EQ(last.position.y, 0);
  EXPECT_EQ(last.buttons, 1u);
  EXPECT_EQ(status_of("/dev/hidraw0").profile, "");
}

TEST_F(HidInputTest, ADeviceThatItsProfileDoesNotFitIsNamedWithTheReason) {
  MockDevice::Kind kind{0x1532, 0x0300, "Razer Hydra", "", tests::from_hex(kMouse), 0, 0, 1};
  const auto device = machine.plug(kind);
  start();
  ASSERT_TRUE(eventually([&] { return !status_of("/dev/hidraw0").why.empty(); }));
  EXPECT_EQ(status_of("/dev/hidraw0").why,
            "razer_hydra does not fit: its input report has 3 bytes, and the profile wants 8");
}

// ------------------------------------------------------------------------------------------------ the Hydra

constexpr const char* kHydra = "05 01 09 00 a1 01 09 03 15 00 26 ff 00 35 00 46 ff 00 75 08 95 34 81 02 c0";
constexpr const char* kHydraControl = "06 00 ff 09 01 a1 01 15 00 26 ff 00 75 08 95 5a 09 01 b1 02 c0";

class HydraTest : public HidInputTest {
 protected:
  void plug() {
    control = machine.plug({0x1532, 0x0300, "Razer Hydra", "", tests::from_hex(kHydraControl), 1, 1, 1});
    hands = machine.plug({0x1532, 0x0300, "Razer Hydra", "", tests::from_hex(kHydra), 0, 0, 1});
  }
  std::unique_ptr<MockDevice> control, hands;
};

// Of our own making, in the real layout: the left hand moves along x, the right one turns about z.
Bytes hydra_report(int i) {
  Bytes bytes(52);
  const auto put = [&](std::size_t at, double value) {
    const auto raw = static_cast<std::uint16_t>(static_cast<std::int16_t>(std::lround(value)));
    bytes[at] = static_cast<std::uint8_t>(raw);
    bytes[at + 1] = static_cast<std::uint8_t>(raw >> 8);
  };
  bytes[7] = static_cast<std::uint8_t>(i);
  put(8, i);
  put(14, 32767);
  bytes[27] = i % 100 < 50 ? 255 : 0;
  put(32, 250);
  put(36, 32767 * std::cos(0.005 * i));
  put(42, 32767 * std::sin(0.005 * i));
  bytes[44] = 2;
  return bytes;
}

TEST_F(HydraTest, TwoHandsAreTwoBlades) {
  plug();
  start();
  ASSERT_TRUE(open("razer_hydra.left"));
  ASSERT_TRUE(open("razer_hydra.right"));
  ASSERT_EQ(control->features().size(), 1u);
  const Bytes mode = control->features()[0].bytes;
  ASSERT_EQ(mode.size(), 91u);
  EXPECT_EQ((Bytes{mode[6], mode[8], mode[9], mode[89]}), (Bytes{1, 4, 3, 6}));
  send(*hands, hydra_report, 300);
  ASSERT_TRUE(see("razer_hydra.left", 300));
  ASSERT_TRUE(see("razer_hydra.right", 300));
  for (int i = 0; i < 300; ++i) {
    const core::Pose& left = seen["razer_hydra.left"].poses[i].pose;
    const core::Pose& right = seen["razer_hydra.right"].poses[i].pose;
    ASSERT_NEAR(left.position.x, 0.001 * i, 1e-9);
    ASSERT_EQ(left.buttons, i % 100 < 50 ? 1u : 0u);
    ASSERT_NEAR(right.position.y, 0.25, 1e-9);
    ASSERT_NEAR(right.orientation.z, std::sin(0.005 * i), 1e-4);
    ASSERT_EQ(right.buttons, 1u << 2);
  }
  EXPECT_TRUE(counted("/dev/hidraw0", [](const ReportCounts& n) { return n.reports == 300 && n.lost == 0; }));
}

// A real hand: every report of the capture goes the whole way and comes out as it is written.
TEST_F(HydraTest, ReplaysARealCapture) {
  const char* const data = std::getenv("INCISE_DATA");
  if (!data) GTEST_SKIP() << "INCISE_DATA is not set";
  std::ifstream file(std::string(data) + "/hid/razer_hydra_log.hid");
  if (!file) GTEST_SKIP() << "no hid/razer_hydra_log.hid in INCISE_DATA";
  plug();
  start();
  ASSERT_TRUE(open("razer_hydra.left"));
  std::vector<Bytes> sent;
  std::uint64_t lost = 0;
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with("E:")) continue;
    std::istringstream words(line.substr(2));
    std::string time, count, rest;
    words >> time >> count;
    std::getline(words, rest);
    const Bytes report = tests::from_hex(rest);
    if (!sent.empty() && sent.back()[7] == report[7]) continue;
    if (!sent.empty()) lost += static_cast<std::uint8_t>(report[7] - sent.back()[7]) - 1u;
    ASSERT_TRUE(eventually([&] {
      drain();
      return hands->report(report);
    }));
    sent.push_back(report);
  }
  ASSERT_GT(sent.size(), 4000u);
  ASSERT_TRUE(see("razer_hydra.left", sent.size()));
  const auto& poses = seen["razer_hydra.left"].poses;
  ASSERT_EQ(poses.size(), sent.size());
  for (std::size_t i = 0; i < sent.size(); ++i) {
    const auto x = static_cast<std::int16_t>(sent[i][8] | sent[i][9] << 8);
    ASSERT_NEAR(poses[i].pose.position.x, 0.001 * x, 1e-9) << "report " << i;
  }
  const ReportCounts n = status_of("/dev/hidraw0").figures.reports;
  EXPECT_EQ(n.bad_values + n.short_ones + n.other, 0u);
  EXPECT_LE(n.lost, lost);  // a leap of more than half the counter's turn counts as a restart
}

// ------------------------------------------------------------------------------------------------ forces

class ForceTest : public HidInputTest {
 protected:
  void SetUp() override {
    device = machine.plug(stylus());
    start(
        {{"1209:0001", DeviceOverride::Use::kProfile, "", {{}, {std::sqrt(0.5), 0, 0, std::sqrt(0.5)}, 1}}});
    ASSERT_TRUE(open("incise_stylus"));
    ASSERT_TRUE(eventually([&] { return forces[0].limit() > 0; }));
  }
  void command(double x, double y, double z) { forces[0].write({{x, y, z}, monotonic_ns(), 0}); }
  static core::Vec3 force_of(const MockDevice::Sent& sent) {
    incise_stylus_output output;
    EXPECT_EQ(sent.bytes.size(), sizeof output);
    std::memcpy(&output, sent.bytes.data(), sizeof output);
    return {1e-6 * output.force[0], 1e-6 * output.force[1], 1e-6 * output.force[2]};
  }
  // Keeps commanding until the newest report says what is wanted.
  bool becomes(const std::function<void()>& say, const core::Vec3& wanted) {
    return eventually([&] {
      say();
      ::usleep(1000);
      const auto outputs = device->outputs();
      return !outputs.empty() && core::distance(force_of(outputs.back()), wanted) < 1e-5;
    });
  }
  std::unique_ptr<MockDevice> device;
};

TEST_F(ForceTest, TheNewestForceGoesOutInTheDevicesAxesAndWithinItsLimit) {
  // World y is the device's x after its quarter turn about z.
  EXPECT_TRUE(becomes([&] { command(0, 1.5, 0.5); }, {1.5, 0, 0.5}));
  EXPECT_TRUE(becomes([&] { command(0, 300, 0); }, {3.3, 0, 0}));
  EXPECT_TRUE(becomes([&] { command(0, NAN, 0); }, {0, 0, 0}));
  EXPECT_TRUE(becomes([&] { command(0, 1, 0); }, {1, 0, 0}));
  EXPECT_TRUE(becomes([] {}, {0, 0, 0})) << "an old command must not last";
  for (const auto& sent : device->outputs()) {
    EXPECT_LE(core::length(force_of(sent)), 3.3 + 1e-5);
    EXPECT_EQ(sent.bytes[1], INCISE_STYLUS_FORCE_ON);
  }
}

TEST_F(ForceTest, AFailedWriteIsToldAndNoForceFollowsUntilTheLoopHasAnswered) {
  EXPECT_TRUE(becomes([&] { command(0, 1, 0); }, {1, 0, 0}));
  device->refuse_outputs(true);
  EXPECT_TRUE(eventually([&] {
    command(0, 1, 0);
    ::usleep(1000);
    return forces[0].failed_writes() > 0;
  }));
  device->refuse_outputs(false);
  const std::size_t before = device->outputs().size();
  EXPECT_TRUE(eventually([&] {
    command(0, 1, 0);
    ::usleep(1000);
    return device->outputs().size() > before + 20;
  }));
  const auto outputs = device->outputs();
  for (std::size_t i = before; i < outputs.size(); ++i) EXPECT_EQ(core::length(force_of(outputs[i])), 0);
  command(0, 0, 0);
  EXPECT_TRUE(becomes([&] { command(0, 0, 0); }, {0, 0, 0}));
  ::usleep(20'000);
  EXPECT_TRUE(becomes([&] { command(0, 1, 0); }, {1, 0, 0}));
}

TEST_F(ForceTest, TheEndLeavesNoForce) {
  EXPECT_TRUE(becomes([&] { command(0, 2, 0); }, {2, 0, 0}));
  input->stop();
  const auto outputs = device->outputs();
  ASSERT_GE(outputs.size(), 2u);
  EXPECT_EQ(outputs.back().bytes, tests::from_hex("02 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00"));
  EXPECT_EQ(core::length(force_of(outputs[outputs.size() - 2])), 0);
  EXPECT_EQ(forces[0].limit(), 0);
}

}  // namespace
}  // namespace incise::input
