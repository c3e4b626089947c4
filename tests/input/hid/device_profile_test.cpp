#include "server/input/hid/device_profile.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "server/input/hid/hid_system.hpp"

namespace incise::input {
namespace {

// A good profile, with one text in it replaced by another.
std::string with(const std::string& from, const std::string& to) {
  std::string text = R"({
    // all kinds of keys
    "name": "Test", "vendor": "12ab", "product": "0x0002", "interface": 1, "report": 1, "rate_hz": 500,
    "counter": {"at": 1, "type": "u16", "step": 2},
    "clock": {"at": 3, "type": "u32", "tick_s": 1e-6},
    "tools": [
      {"name": "left",
       "position": {"mode": "rate", "x": {"at": 7, "type": "i16", "scale": 0.01}, "full_m_s": 0.2, "curve": 1.5},
       "rotation": {"mode": "quaternion", "w": {"at": 9, "type": "f32"}, "x": {"at": 13, "type": "f32"},
                    "y": {"at": 17, "type": "f32"}, "z": {"at": 21, "type": "f32"}},
       "buttons": [{"at": 25, "bit": 3, "type": "u1"}, {"report": 2, "at": 1, "type": "u8", "from": 40, "button": 4}],
       "valid": {"at": 26, "type": "u8", "from": 2}},
      {"name": "right", "position": {"z": {"at": 27, "type": "u24be", "zero": 100}}}
    ],
    "world": {"x": "-y", "y": "x", "z": "z", "scale": 0.5},
    "start": [{"feature": "05 00*3 ff", "interface": 0}, {"output": "06 01"}],
    "force": {"max_newtons": 2, "bytes": "03 00*6", "x": {"at": 1, "type": "i16"}, "magnitude": [{"at": 5, "type": "u8"}]}
  })";
  if (const auto at = text.find(from); !from.empty() && at != std::string::npos)
    text.replace(at, from.size(), to);
  return text;
}

std::string error_of(const std::string& text) {
  try {
    parse_profile(text, "folder/test.json");
  } catch (const ProfileError& error) {
    return error.what();
  }
  return "";
}

TEST(DeviceProfile, ReadsEveryKey) {
  const DeviceProfile p = parse_profile(with("", ""), "folder/test.json");
  EXPECT_EQ(p.id, "test");
  EXPECT_EQ(p.vendor, 0x12ab);
  EXPECT_EQ(p.product, 2);
  EXPECT_EQ(p.interface, 1);
  EXPECT_EQ(p.counter_step, 2);
  EXPECT_EQ(p.clock->scale, 1e-6);
  ASSERT_EQ(p.tools.size(), 2u);
  EXPECT_EQ(p.tools[0].position, ToolProfile::Position::kRate);
  EXPECT_EQ(p.tools[0].position_rate, (RateShape{0.2, 0, 1.5}));
  EXPECT_EQ(p.tools[0].position_fields[0],
            (ReportField{1, 56, 16, ReportField::Kind::kSigned, false, 0.01, 0}));
  EXPECT_EQ(p.tools[0].buttons[0].field.bit, 8u * 25 + 3);
  EXPECT_EQ(p.tools[0].buttons[0].button, 0u);
  EXPECT_EQ(p.tools[0].buttons[1].button, 4u);
  EXPECT_EQ(p.tools[0].buttons[1].field.report, 2);
  EXPECT_EQ(p.tools[1].position_fields[2],
            (ReportField{1, 216, 24, ReportField::Kind::kUnsigned, true, 1, 100}));
  EXPECT_EQ(p.axes, (std::array<std::uint8_t, 3>{1, 0, 2}));
  EXPECT_EQ(p.signs, (std::array<std::int8_t, 3>{-1, 1, 1}));
  EXPECT_EQ(p.start[0].bytes, (std::vector<std::uint8_t>{5, 0, 0, 0, 0xff}));
  EXPECT_EQ(p.start[0].interface, 0);
  EXPECT_FALSE(p.start[1].feature);
  EXPECT_EQ(p.force->bytes.size(), 7u);
}

// Every error names the file, the key, what was found and what is accepted.
TEST(DeviceProfile, SaysWhatIsWrongAndWhatIsAccepted) {
  struct Case {
    const char *from, *to, *key, *found, *accepted;
  };
  const Case cases[] = {
      {"\"rate_hz\": 500", "\"rate\": 500", "\"rate\"", "means nothing here", "rate_hz"},
      {"\"rate_hz\": 500", "\"rate_hz\": 0", "rate_hz", "0", "from 1 to 8000"},
      {"\"rate_hz\": 500", "\"name\": \"B\"", "\"name\"", "twice", "once"},
      {"\"12ab\"", "12", "vendor", "12", "hexadecimal"},
      {"\"12ab\"", "\"12abc\"", "vendor", "12abc", "hexadecimal"},
      {"\"u16\"", "\"u33\"", "counter.type", "u33", "u32"},
      {"\"u16\"", "\"f32\"", "counter.type", "f32", "integer"},
      {"\"at\": 3", "\"at\": -3", "clock.at", "-3", "from 0 to"},
      {"\"at\": 3", "\"at\": 0", "clock.at", "0", "1 or more"},
      {"\"tick_s\": 1e-6", "\"tick_s\": 0", "clock.tick_s", "0", "1e-09"},
      {"\"scale\": 0.01", "\"scale\": 0", "tools[0].position.x.scale", "0", "not 0"},
      {"\"mode\": \"rate\"", "\"mode\": \"speed\"", "tools[0].position.mode", "speed",
       "\"absolute\", \"rate\" or \"relative\""},
      {"\"mode\": \"rate\"", "\"mode\": \"absolute\"", "tools[0].position.full_m_s", "0.2", "only if mode"},
      {"\"curve\": 1.5", "\"curve\": 50", "tools[0].position.curve", "50", "0.2 to 5"},
      {"\"quaternion\"", "\"euler\"", "tools[0].rotation.w", "9", "only if mode"},
      {"\"name\": \"right\"", "\"name\": \"left\"", "tools[1].name", "left", "no other tool"},
      {"\"name\": \"right\"", "\"name\": \"Right Hand\"", "tools[1].name", "Right Hand", "a-z"},
      {"\"position\": {\"z\"",
       "\"buttons\": [], \"valid\": {\"at\": 1, \"type\": \"u1\"}, \"position\": {\"q\"",
       "\"tools[1].position.q\"", "means nothing", "accepted are"},
      {"\"u24be\"", "\"u20be\"", "tools[1].position.z.type", "u20be", "whole bytes"},
      {"\"bit\": 3", "\"bit\": 8", "tools[0].buttons[0].bit", "8", "0 to 7"},
      {"\"button\": 4", "\"button\": 40", "tools[0].buttons[1].button", "40", "0 to 31"},
      {"\"x\": \"-y\"", "\"x\": \"y up\"", "world.x", "y up", "\"-z\""},
      {"\"x\": \"-y\"", "\"x\": \"-x\"", "world", "x", "once"},
      {"05 00*3 ff", "5 0", "start[0].feature", "5 0", "hexadecimal"},
      {"05 00*3 ff", "05 00*0", "start[0].feature", "00*0", "hexadecimal"},
      {"05 00*3 ff", "05 00*99999", "start[0].feature", "99999", "hexadecimal"},
      {"\"output\": \"06 01\"", "\"feature\": \"06 01\", \"output\": \"06 01\"", "start[1]", "06", "either"},
      {"\"max_newtons\": 2", "\"max_newtons\": 0", "force.max_newtons", "0", "0.001 to 1000"},
      {"\"at\": 1, \"type\": \"i16\"", "\"at\": 6, \"type\": \"i16\"", "force.x.at", "6", "which has 7"},
      {"\"x\": {\"at\": 1, \"type\": \"i16\"}", "\"x\": {\"at\": 0, \"type\": \"i16\"}", "force.x.at", "0",
       "1 or more"},
      {"\"report\": 1, ", "", "tools", "fields with a report number", "or none"},
      {"\"tools\": [", "\"tools\": 3, \"x\": [", "\"x\"", "means nothing here", "tools"},
      {"\"tools\": [", "\"tools\": [3,", "tools[0]", "3", "object"},
  };
  for (const Case& c : cases) {
    const std::string text = with(c.from, c.to);
    ASSERT_NE(text, with("", "")) << c.from;
    const std::string error = error_of(text);
    EXPECT_EQ(error.find("folder/test.json: " + std::string(c.key) + ": found"), 0u) << c.to << "\n" << error;
    EXPECT_NE(error.find(c.found), std::string::npos) << error;
    EXPECT_NE(error.find("accepted"), std::string::npos) << error;
    EXPECT_NE(error.find(c.accepted), std::string::npos) << error;
  }
  EXPECT_NE(error_of("{").find("folder/test.json: not JSON"), std::string::npos);
  EXPECT_NE(error_of("[]").find("folder/test.json: the file: found []"), std::string::npos);
}

TEST(DeviceProfile, NamesTheKeyThatIsMissing) {
  struct Case {
    const char *from, *to, *key;
  };
  const Case cases[] = {
      {"\"name\": \"Test\", ", "", "name"},
      {"\"vendor\": \"12ab\",", "", "vendor"},
      {"\"vendor\": \"12ab\", \"product\": \"0x0002\"", "\"usage_page\": \"ff00\"", "usage"},
      {"\"at\": 3, ", "", "clock.at"},
      {"\"full_m_s\": 0.2, ", "", "tools[0].position.full_m_s"},
      {"\"w\": {\"at\": 9, \"type\": \"f32\"}, ", "", "tools[0].rotation.w"},
  };
  for (const Case& c : cases) {
    const std::string text = with(c.from, c.to);
    ASSERT_NE(text, with("", "")) << c.from;
    EXPECT_EQ(error_of(text), "folder/test.json: " + std::string(c.key) + " is missing; it has no default");
  }
}

TEST(DeviceProfile, TheShippedOnesAreGood) {
  std::vector<std::string> ids;
  for (const DeviceProfile& p : load_profiles(std::string(INCISE_SOURCE_DIR) + "/config/devices"))
    ids.push_back(p.id);
  EXPECT_EQ(ids,
            (std::vector<std::string>{"3dconnexion_spacemouse_wireless", "3dconnexion_spacenavigator",
                                      "incise_stylus", "incise_stylus_6", "razer_hydra", "sony_dualsense"}));
}

// The part of config/devices/DEVICES.md for those who write a profile.
std::string page_on_profiles() {
  std::ifstream in(std::string(INCISE_SOURCE_DIR) + "/config/devices/DEVICES.md");
  const std::string page((std::istreambuf_iterator<char>(in)), {});
  return page.substr(page.find("## Writing a device profile"));
}

TEST(DeviceProfile, TheOneOnThePageIsGood) {
  const std::string page = page_on_profiles();
  const auto begin = page.find("```json\n") + 8;
  const DeviceProfile pen = parse_profile(page.substr(begin, page.find("```", begin) - begin), "my_pen.json");
  EXPECT_EQ(pen.name, "My Pen");
  EXPECT_TRUE(pen.clock && pen.counter && pen.force);
  std::uint32_t end = 0;
  for (const auto& button : pen.tools[0].buttons) end = std::max(end, button.field.end());
  EXPECT_EQ(end, 22u);
}

// The page's tables have a row for each key that is accepted; the error for an unknown key names them all.
TEST(DeviceProfile, ThePageHasEveryKey) {
  const std::string page = page_on_profiles();
  const std::pair<const char*, const char*> wrong[] = {
      {"\"rate_hz\"", "\"?\""},     {"\"step\"", "\"?\""},
      {"\"tick_s\"", "\"?\""},      {"\"buttons\"", "\"?\""},
      {"\"full_m_s\"", "\"?\""},    {"\"mode\": \"quaternion\"", "\"?\": 1"},
      {"\"from\"", "\"?\""},        {"\"interface\": 0", "\"?\": 0"},
      {"\"max_newtons\"", "\"?\""},
  };
  for (const auto& [from, to] : wrong) {
    const std::string error = error_of(with(from, to));
    const auto at = error.find("accepted are ");
    ASSERT_NE(at, std::string::npos) << from << ": " << error;
    std::istringstream keys(error.substr(at + 13));
    for (std::string key; std::getline(keys >> std::ws, key, ',');) {
      EXPECT_NE(page.find("`" + key + "`") == std::string::npos &&
                    page.find("\"" + key + "\"") == std::string::npos,
                true)
          << "DEVICES.md has no " << key;
    }
  }
}

TEST(DeviceProfile, AFolderThatIsNotThereIsNamed) {
  try {
    load_profiles("/nowhere");
    FAIL();
  } catch (const ProfileError& error) {
    EXPECT_NE(std::string(error.what()).find("/nowhere"), std::string::npos);
  }
}

TEST(DeviceProfile, MatchesByNumbersOrByUsageAndByInterface) {
  std::vector<DeviceProfile> profiles{parse_profile(with("", ""), "numbers.json")};
  profiles.push_back(parse_profile(R"({"name": "U", "usage_page": "ff1c", "usage": "1",
      "tools": [{"position": {"x": {"at": 0, "type": "i8"}}}]})",
                                   "usage.json"));
  HidInterface interface;
  interface.vendor = 0x12ab;
  interface.product = 2;
  interface.interface = 1;
  std::string why;
  EXPECT_EQ(find_profile(profiles, interface, why)->id, "numbers");
  interface.interface = 0;
  EXPECT_EQ(find_profile(profiles, interface, why), nullptr);
  EXPECT_EQ(why, "numbers is for its interface 1");
  interface.interface = -1;  // a bus without interfaces
  EXPECT_EQ(find_profile(profiles, interface, why)->id, "numbers");
  interface.product = 3;
  EXPECT_EQ(find_profile(profiles, interface, why), nullptr);
  EXPECT_EQ(why, "no profile names it");
  interface.usages = {{0x0001, 0x0006}, {0xff1c, 0x0001}};
  EXPECT_EQ(find_profile(profiles, interface, why)->id, "usage");
}

// An unnumbered report's leading zero is not on the wire.
TEST(DeviceProfile, AForceReportFitsTheDevices) {
  const auto device = [](std::uint8_t bytes) {
    std::string error;
    const std::vector<std::uint8_t> all{0x05, 0x01,  0x09, 0x04, 0xa1, 0x01, 0x75, 0x08,
                                        0x95, 0x08,  0x09, 0x30, 0x81, 0x02, 0x75, 0x08,
                                        0x95, bytes, 0x09, 0x31, 0x91, 0x02, 0xc0};
    return parse_report_descriptor(all, error).value_or(ReportDescriptor{});
  };
  const DeviceProfile profile = parse_profile(R"({"name": "F", "vendor": "1", "product": "2",
      "tools": [{"position": {"x": {"at": 0, "type": "i8"}}}],
      "force": {"max_newtons": 1, "bytes": "00*7", "x": {"at": 1, "type": "i16"}}})",
                                              "force.json");
  EXPECT_EQ(mismatch(profile, device(6)), "");
  EXPECT_NE(mismatch(profile, device(5)).find("5 bytes, and the profile wants 6"), std::string::npos)
      << mismatch(profile, device(5));
}

// Its first byte is the report's number, also where that is none.
TEST(DeviceProfile, AForceLeavesTheReportsNumberAlone) {
  for (const char* at : {"0", "6"}) {
    const std::string error = error_of(std::string(R"({"name": "F", "vendor": "1", "product": "2",
        "tools": [{"position": {"x": {"at": 0, "type": "i8"}}}],
        "force": {"max_newtons": 1, "bytes": "00*7", "x": {"at": )") +
                                       at + R"(, "type": "i16"}}})");
    EXPECT_NE(error.find("between byte 1 and the end"), std::string::npos) << error;
  }
}

TEST(DeviceProfile, BeyondFullDeflectionIsFullSpeed) {
  const RateShape shape{0.1, 0.05, 2};
  EXPECT_DOUBLE_EQ(shape.speed(1), 0.1);
  EXPECT_DOUBLE_EQ(shape.speed(-3), -0.1);
  EXPECT_EQ(shape.speed(0.05), 0);
}

}  // namespace
}  // namespace incise::input
