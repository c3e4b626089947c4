// The Reference Stylus: header, report descriptor and shipped profile say the same.

#include <gtest/gtest.h>

#include <cstring>
#include <filesystem>

#include "protocol/hid/incise_stylus.h"
#include "server/input/hid/device_profile.hpp"

extern "C" {
extern const unsigned char kStylusDescriptor[];
extern const unsigned kStylusDescriptorSize;
extern const unsigned char kStylus6Descriptor[];
extern const unsigned kStylus6DescriptorSize;
}

namespace incise::input {
namespace {

ReportDescriptor described() {
  std::string error;
  const auto made = parse_report_descriptor({kStylusDescriptor, kStylusDescriptorSize}, error);
  EXPECT_TRUE(made) << error;
  return made.value_or(ReportDescriptor{});
}

TEST(StylusLayout, TheDescriptorHasTheHeadersReports) {
  const ReportDescriptor descriptor = described();
  using Kind = DescribedField::Kind;
  EXPECT_EQ(descriptor.bytes_of(Kind::kInput, INCISE_STYLUS_INPUT), sizeof(incise_stylus_input));
  EXPECT_EQ(descriptor.bytes_of(Kind::kOutput, INCISE_STYLUS_OUTPUT), sizeof(incise_stylus_output));
  EXPECT_EQ(descriptor.bytes_of(Kind::kFeature, INCISE_STYLUS_SETTINGS), sizeof(incise_stylus_settings));
  EXPECT_EQ(descriptor.reports.size(), 3u);
  EXPECT_EQ(descriptor.applications,
            std::vector<std::uint32_t>{INCISE_STYLUS_USAGE_PAGE << 16 | INCISE_STYLUS_USAGE});
  const auto at = [&](std::uint32_t usage) {
    for (const DescribedField& field : descriptor.fields) {
      if (field.usage == (INCISE_STYLUS_USAGE_PAGE << 16 | usage)) return field;
    }
    ADD_FAILURE() << "no usage " << usage;
    return DescribedField{};
  };
  EXPECT_EQ(at(0x11).bit, 8 * offsetof(incise_stylus_input, counter));
  EXPECT_EQ(at(0x12).bit, 8 * offsetof(incise_stylus_input, time_us));
  EXPECT_EQ(at(0x20).bit, 8 * offsetof(incise_stylus_input, position));
  EXPECT_EQ(at(0x20).unit_exponent, -7);
  EXPECT_EQ(at(0x26).bit, 8 * (offsetof(incise_stylus_input, rotation) + 12));
  EXPECT_EQ(at(0x28).bit, 8 * offsetof(incise_stylus_input, grip));
  EXPECT_EQ(at(0x32).bit, 8 * offsetof(incise_stylus_output, force));
  EXPECT_EQ(at(0x41).bit, 8 * offsetof(incise_stylus_settings, rate_hz));
}

TEST(StylusLayout, TheShippedProfileFitsAndReadsTheHeadersFields) {
  const DeviceProfile profile =
      load_profile(std::filesystem::path(INCISE_SOURCE_DIR) / "config/devices/incise_stylus.json");
  EXPECT_EQ(mismatch(profile, described()), "");
  EXPECT_EQ(profile.usage_page, INCISE_STYLUS_USAGE_PAGE);
  EXPECT_EQ(profile.usage, INCISE_STYLUS_USAGE);
  incise_stylus_input report{};
  report.report = 1;
  report.counter = 0x1234;
  report.time_us = 0x89abcdef;
  report.position[0] = -1'000'000;
  report.position[2] = 70'000'000;
  report.rotation[3] = -(1 << 29);
  report.buttons = 4;
  report.flags = INCISE_STYLUS_VALID;
  const std::span bytes(reinterpret_cast<const std::uint8_t*>(&report), sizeof report);
  EXPECT_EQ(profile.counter->bits_of(bytes), 0x1234u);
  EXPECT_EQ(profile.clock->bits_of(bytes), 0x89abcdefu);
  const ToolProfile& tool = profile.tools[0];
  EXPECT_NEAR(tool.position_fields[0]->value(bytes), -0.001, 1e-12);
  EXPECT_NEAR(tool.position_fields[2]->value(bytes), 0.07, 1e-12);
  EXPECT_NEAR(tool.rotation_fields[3]->value(bytes), -0.5, 1e-12);
  EXPECT_EQ(tool.buttons[2].field.value(bytes), 1);
  EXPECT_EQ(tool.valid->field.value(bytes), 1);
  EXPECT_EQ(profile.force->bytes.size(), sizeof(incise_stylus_output));
  EXPECT_EQ(profile.start[0].bytes.size(), sizeof(incise_stylus_settings));
}

// Whoever makes torques as well has one report more; all others are as they were.
TEST(StylusLayout, TheSixAxisStylusHasOneReportMore) {
  std::string error;
  const auto six = parse_report_descriptor({kStylus6Descriptor, kStylus6DescriptorSize}, error);
  ASSERT_TRUE(six) << error;
  using Kind = DescribedField::Kind;
  EXPECT_EQ(six->bytes_of(Kind::kOutput, INCISE_STYLUS_6_OUTPUT), sizeof(incise_stylus_6_output));
  EXPECT_EQ(six->reports.size(), 4u);
  EXPECT_EQ(six->applications,
            std::vector<std::uint32_t>{INCISE_STYLUS_USAGE_PAGE << 16 | INCISE_STYLUS_6_USAGE});
  const ReportDescriptor plain = described();
  ASSERT_GT(six->fields.size(), plain.fields.size());
  for (std::size_t i = 0; i < plain.fields.size(); ++i) {
    EXPECT_EQ(six->fields[i].bit, plain.fields[i].bit) << i;
    EXPECT_EQ(six->fields[i].usage, plain.fields[i].usage) << i;
  }
  const std::filesystem::path folder = std::filesystem::path(INCISE_SOURCE_DIR) / "config/devices";
  const DeviceProfile profile = load_profile(folder / "incise_stylus_6.json");
  EXPECT_EQ(mismatch(profile, *six), "");
  EXPECT_EQ(profile.usage, INCISE_STYLUS_6_USAGE);
  ASSERT_TRUE(profile.force);
  EXPECT_EQ(profile.force->bytes.size(), sizeof(incise_stylus_6_output));
  EXPECT_EQ(profile.force->bytes[0], INCISE_STYLUS_6_OUTPUT);
  std::vector<std::uint8_t> bytes = profile.force->bytes;
  profile.force->torque[2]->write(bytes, -0.05);
  incise_stylus_6_output report{};
  std::memcpy(&report, bytes.data(), sizeof report);
  EXPECT_EQ(report.torque[2], -50'000);
  EXPECT_EQ(report.force[2], 0);
  // And otherwise it is the same device.
  DeviceProfile same = load_profile(folder / "incise_stylus.json");
  EXPECT_EQ(profile.tools, same.tools);
  EXPECT_EQ(profile.force->components[0]->bit, same.force->components[0]->bit);
}

}  // namespace
}  // namespace incise::input
