#include "server/input/hid/report_descriptor.hpp"

#include <gtest/gtest.h>

#include <fstream>
#include <iterator>

namespace incise::input {
namespace {

using Kind = DescribedField::Kind;

std::string error_of(std::initializer_list<std::uint8_t> bytes) {
  std::string error;
  const std::vector<std::uint8_t> all(bytes);
  EXPECT_FALSE(parse_report_descriptor(all, error));
  return error;
}

ReportDescriptor parsed(const std::vector<std::uint8_t>& bytes) {
  std::string error;
  const auto made = parse_report_descriptor(bytes, error);
  EXPECT_TRUE(made) << error;
  return made.value_or(ReportDescriptor{});
}

// Two axes with their unit, one opaque byte of padding, buttons from a range, another report with pushed globals.
TEST(ReportDescriptor, ReadsFieldsInOrder) {
  const ReportDescriptor d = parsed(
      {0x05, 0x01, 0x09, 0x04, 0xa1, 0x01, 0x85, 0x01,              // Generic Desktop, Joystick, report 1
       0x16, 0x00, 0xfe, 0x26, 0xff, 0x01, 0x75, 0x0a, 0x95, 0x02,  // -512 ... 511, 2 of 10 bits
       0x65, 0x11, 0x55, 0x0e, 0x09, 0x30, 0x09, 0x31, 0x81, 0x02,  // cm, 10^-2: X, Y
       0x75, 0x04, 0x95, 0x01, 0x81, 0x03,                          // padding
       0xa4, 0x05, 0x09, 0x19, 0x01, 0x29, 0x03, 0x15, 0x00, 0x25, 0x01, 0x75, 0x01, 0x95, 0x08,
       0x81, 0x02, 0x85, 0x02, 0x25, 0xff, 0x75, 0x08, 0x95, 0x01, 0x09, 0x01, 0x91, 0x02,  // report 2, output, 0 ... 255 as a byte
       0xb4, 0x09, 0x32, 0x75, 0x10, 0x95, 0x01, 0x81, 0x06,  // popped: report 1 again, relative Z
       0xc0});
  ASSERT_EQ(d.fields.size(), 12u);
  EXPECT_TRUE(d.numbered());
  const DescribedField& y = d.fields[1];
  EXPECT_EQ(y.usage, 0x10031u);
  EXPECT_EQ(y.application, 0x10004u);
  EXPECT_EQ(y.bit, 18u);
  EXPECT_EQ(y.bits, 10);
  EXPECT_EQ(y.logical_min, -512);
  EXPECT_EQ(y.logical_max, 511);
  EXPECT_EQ(y.unit, 0x11u);
  EXPECT_EQ(y.unit_exponent, -2);
  EXPECT_FALSE(y.relative);
  EXPECT_EQ(d.fields[2].usage, 0x90001u);
  EXPECT_EQ(d.fields[2].bit, 32u);
  EXPECT_EQ(d.fields[9].usage, 0x90003u);  // the last usage stands for the rest
  EXPECT_EQ(d.fields[10].kind, Kind::kOutput);
  EXPECT_EQ(d.fields[10].logical_max, 255);
  EXPECT_EQ(d.fields[10].bit, 8u);
  EXPECT_EQ(d.fields[11].usage, 0x10032u);
  EXPECT_EQ(d.fields[11].bit, 40u);
  EXPECT_EQ(d.fields[11].report_id, 1);
  EXPECT_TRUE(d.fields[11].relative);
  EXPECT_EQ(d.bytes_of(Kind::kInput, 1), 7u);
  EXPECT_EQ(d.bytes_of(Kind::kOutput, 2), 2u);
  EXPECT_EQ(d.bytes_of(Kind::kInput, 2), 0u);
}

TEST(ReportDescriptor, SaysWhatIsWrong) {
  EXPECT_EQ(error_of({}), "describes no report");
  EXPECT_EQ(error_of({0x06, 0x00}), "ends within an item");
  EXPECT_EQ(error_of({0xfe}), "ends within an item");
  EXPECT_EQ(error_of({0xfe, 0x05, 0x00, 0x00}), "ends within an item");
  EXPECT_EQ(error_of({0xa1, 0x01}), "ends within a collection");
  EXPECT_EQ(error_of({0xc0}), "ends a collection that was not begun");
  EXPECT_EQ(error_of({0xb4}), "pops what was not pushed");
  EXPECT_EQ(error_of({0x85, 0x00}), "has a report number that is not 1 to 255");
  EXPECT_EQ(error_of({0x19, 0x05, 0x29, 0x01}), "has a usage range that ends before it begins");
  // A gigabyte of a report must be refused before anything is made of it.
  EXPECT_EQ(error_of({0x09, 0x01, 0x75, 0x20, 0x97, 0xff, 0xff, 0xff, 0xff, 0x81, 0x02}),
            "has a report longer than 16384 bytes");
  EXPECT_EQ(error_of({0x75, 0x08, 0x95, 0x01, 0x81, 0x02, 0x85, 0x01, 0x81, 0x02}),
            "numbers some of its reports and not others");
  std::string error;
  EXPECT_FALSE(parse_report_descriptor(std::vector<std::uint8_t>(4097, 0), error));
}

TEST(ReportDescriptor, ReadsRealOnes) {
  const char* const data = std::getenv("INCISE_DATA");
  if (!data) GTEST_SKIP() << "INCISE_DATA is not set";
  const auto read = [&](const char* name) {
    std::ifstream in(std::string(data) + "/hid/" + name, std::ios::binary);
    return std::vector<std::uint8_t>((std::istreambuf_iterator<char>(in)), {});
  };
  const ReportDescriptor navigator = parsed(read("spacenavigator.rdesc.bin"));
  EXPECT_EQ(navigator.bytes_of(Kind::kInput, 1), 7u);
  EXPECT_EQ(navigator.bytes_of(Kind::kInput, 2), 7u);
  EXPECT_EQ(navigator.bytes_of(Kind::kOutput, 4), 2u);
  int axes = 0;
  for (const DescribedField& field : navigator.fields) {
    if (field.kind != Kind::kInput || field.usage < 0x10030 || field.usage > 0x10035) continue;
    ++axes;
    EXPECT_EQ(field.logical_min, -350);
    EXPECT_EQ(field.logical_max, 350);
    EXPECT_EQ(field.report_id, field.usage < 0x10033 ? 1 : 2);
    EXPECT_EQ(field.bit, 8 + 16 * ((field.usage - 0x10030) % 3));
    EXPECT_TRUE(field.relative);
  }
  EXPECT_EQ(axes, 6);
  const ReportDescriptor wireless = parsed(read("spacemousewireless.rdesc.bin"));
  EXPECT_EQ(wireless.bytes_of(Kind::kInput, 1), 13u);
}

// One input field of 8 bits with these global items.
DescribedField field_with(std::vector<std::uint8_t> items) {
  std::vector<std::uint8_t> bytes{0x05, 0x01, 0x09, 0x04, 0xa1, 0x01};
  bytes.insert(bytes.end(), items.begin(), items.end());
  bytes.insert(bytes.end(), {0x75, 0x08, 0x95, 0x01, 0x09, 0x30, 0x81, 0x02, 0xc0});
  const ReportDescriptor d = parsed(bytes);
  return d.fields.empty() ? DescribedField{} : d.fields[0];
}

TEST(ReportDescriptor, AnExponentIsANibbleInTwosComplement) {
  const std::pair<std::uint8_t, int> nibbles[] = {{0x0, 0}, {0x7, 7}, {0x8, -8}, {0xf, -1}};
  for (const auto& [nibble, exponent] : nibbles)
    EXPECT_EQ(field_with({0x55, nibble}).unit_exponent, exponent);
}

TEST(ReportDescriptor, AMaximumIsSignedWhereItsMinimumIs) {
  EXPECT_EQ(field_with({0x15, 0x81, 0x25, 0xff}).logical_max, -1);
  EXPECT_EQ(field_with({0x25, 0xff, 0x15, 0x81}).logical_max, -1) << "whichever comes first";
  EXPECT_EQ(field_with({0x15, 0x00, 0x25, 0xff}).logical_max, 255);
  EXPECT_EQ(field_with({0x35, 0x81, 0x45, 0xff}).physical_max, -1);
}

TEST(ReportDescriptor, UsagesEndWithTheirCollection) {
  const ReportDescriptor d =
      parsed({0x05, 0x01, 0x09, 0x04, 0xa1, 0x01, 0xa1, 0x00, 0x09, 0x33, 0xc0,  // unused
              0x09, 0x30, 0x75, 0x08, 0x95, 0x01, 0x81, 0x02, 0xc0});
  ASSERT_EQ(d.fields.size(), 1u);
  EXPECT_EQ(d.fields[0].usage, 0x10030u);
}

// Some devices say 0 to 65535 where they mean any: as many are kept as one item may have.
TEST(ReportDescriptor, ALongRangeOfUsagesIsCutOff) {
  EXPECT_EQ(error_of({0x19, 0x00, 0x2a, 0xff, 0xff, 0x09, 0x01}), "has more than 1024 usages for one item");
}

}  // namespace
}  // namespace incise::input
