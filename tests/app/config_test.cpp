#include "server/app/config.hpp"

#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <string>

namespace incise::app {
namespace {

std::string error_of(const std::string& text) {
  try {
    parse_config(text, "test.json");
  } catch (const ConfigError& error) {
    return error.what();
  }
  return "";
}

TEST(Config, AnEmptyObjectIsAllDefaults) {
  const Config config = parse_config("{}", "test.json");
  EXPECT_EQ(config.loop.rate_hz, 1000);
  EXPECT_EQ(config.loop.budget_fraction, 0.6);
  EXPECT_EQ(config.listen.tcp_port, 7450);
  EXPECT_EQ(config.listen.http_port, 7480);
  EXPECT_EQ(config.cut.policy, core::Policy::kConforming);
  EXPECT_FALSE(config.cut.always_engaged);
}

TEST(Config, ReadsWhatItPrints) {
  Config config = parse_config(R"({
    "mesh": {"phantom": "liver", "target_tets": 60000, "image": "ct.nrrd", "image_window": [-100, 200.5],
             "image_space": "RAS", "image_origin": [0, 0, 0.1]},
    "blade": {"heel": [0, 0, 0.01], "tip": [0, 0, -0.08]},
    "cut": {"policy": "croll", "prefer": "no-growth", "engage": "always", "engage_buttons": 6, "batch_h": 0.5},
    "loop": {"rate_hz": 250, "cpu": 1},
    "listen": {"tcp_port": 0, "allowed_origins": ["https://a.example"]},
    "log": {"format": "json"},
    "materials": [{"region": 2, "tissue": "fat", "puncture_n": 1},
                  {"region": -1, "surface": {"colour": [0.1, 0.2, 0.3], "texture": "a.png"},
                   "inside": {"roughness": 0.5, "vessels": 0, "fat_rim": 2}}],
    "sources": [{"name": "left"}, {"name": "right", "tip": [0, 0, 0.03]}]
  })",
                               "test.json");
  EXPECT_EQ(config.cut.policy, core::Policy::kCroll);
  EXPECT_EQ(config.cut.prefer, core::Preference::kNoGrowth);
  EXPECT_TRUE(config.cut.always_engaged);
  EXPECT_EQ(config.cut.engage_buttons, 6u);
  ASSERT_EQ(config.sources.size(), 2u);
  EXPECT_EQ(config.sources[0].blade, config.cut.blade);
  EXPECT_EQ(config.sources[1].blade.tip, (core::Vec3{0, 0, 0.03}));
  EXPECT_EQ(config.mesh.image_window, (std::vector<double>{-100, 200.5}));
  ASSERT_EQ(config.looks.size(), 2u);
  EXPECT_EQ(config.looks[0].tissue, "fat");
  EXPECT_EQ(config.looks[1].region, -1);
  EXPECT_EQ(config.looks[1].surface.texture, "a.png");
  EXPECT_EQ(config.looks[1].fat_rim, 2);
  EXPECT_FALSE(config.looks[1].inside.colour);
  for (const std::string& text : {commented(config), compact(config)}) {
    EXPECT_EQ(compact(parse_config(text, "printed")), compact(config));
  }
}

TEST(Config, EveryPrintedKeyHasAComment) {
  std::istringstream lines(commented({}));
  std::string line, before;
  int keys = 0;
  while (std::getline(lines, line)) {
    const bool key = line.starts_with("    \"");
    if (key) {
      EXPECT_NE(before.find("//"), std::string::npos) << line;
      ++keys;
    }
    before = line;
  }
  EXPECT_GE(keys, 45);
}

// `incise convert` suits the limit to bodies that are given in millimetres, and a replay reads it from the capture.
TEST(Config, ABladeMayBeFastInABodyOfMillimetres) {
  EXPECT_EQ(parse_config(R"({"cut": {"speed_limit_m_s": 1224.7}})", "test.json").cut.speed_limit_m_s, 1224.7);
}

TEST(Config, PathsAreRelativeToTheFile) {
  Config config;
  config.directory = "/etc/incise";
  EXPECT_EQ(config.resolve("liver.node"), "/etc/incise/liver.node");
  EXPECT_EQ(config.resolve("/data/liver.node"), "/data/liver.node");
  EXPECT_EQ(config.resolve(""), "");
}

TEST(Config, AMaterialHasTheTissuesValuesWhereItNamesNone) {
  const Config config = parse_config(
      R"({"materials": [{"region": 7, "toughness_j_m2": 2500}], "haptics": {"puncture_n": 2}})", "test.json");
  const haptics::Materials& materials = config.haptics.force.materials;
  EXPECT_EQ(materials.of(7).toughness_j_m2, 2500);
  EXPECT_EQ(materials.of(7).puncture_n, 2);
  EXPECT_EQ(materials.of(7).stiffness_pa, haptics::Material().stiffness_pa);
  EXPECT_EQ(materials.of(8), materials.tissue);
  EXPECT_EQ(materials.of(8).toughness_j_m2, 164);
  const Config again = parse_config(compact(config), "compact");
  EXPECT_EQ(again.haptics.force.materials.by_region, materials.by_region);
}

TEST(Config, TheShippedFilesAreGood) {
  for (const char* name : {"incised.json", "demo.json"}) {
    const std::filesystem::path file = std::filesystem::path(INCISE_SOURCE_DIR) / "config" / name;
    EXPECT_NO_THROW(load_config(file)) << file;
  }
}

// The file with all keys is what --print-config prints, apart from the phantom: when a key changes, write it again.
TEST(Config, TheShippedFileWithAllKeysIsUpToDate) {
  Config config;
  config.mesh.phantom = "liver";
  std::ifstream file(std::filesystem::path(INCISE_SOURCE_DIR) / "config" / "incised.json");
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  EXPECT_EQ(text, commented(config));
}

// Each malformed configuration, and what its error must name: the key, what was found or what is accepted.
struct Malformed {
  const char* text;
  std::vector<const char*> named;
};

class MalformedConfigs : public ::testing::TestWithParam<Malformed> {};

TEST_P(MalformedConfigs, GetOneLineThatNamesFileKeyAndWhatIsAccepted) {
  const std::string error = error_of(GetParam().text);
  ASSERT_NE(error, "") << GetParam().text << " was accepted";
  EXPECT_EQ(error.rfind("test.json: ", 0), 0u) << error;
  EXPECT_EQ(error.find('\n'), std::string::npos) << error;
  EXPECT_LT(error.size(), 600u) << error;
  for (const char* part : GetParam().named)
    EXPECT_NE(error.find(part), std::string::npos) << error << "\nlacks " << part;
}

const Malformed kMalformed[] = {
    // Not JSON, or not an object.
    {"", {"not JSON"}},
    {"{", {"not JSON"}},
    {"}", {"not JSON", "line 1"}},
    {"{\"loop\": {\"rate_hz\": 1000,}}", {"not JSON"}},
    {"{\"loop\": {\"rate_hz\": 1e999}}", {"not JSON"}},
    {"{\"loop\": {\"rate_hz\": NaN}}", {"not JSON"}},
    {"{'loop': {}}", {"not JSON"}},
    {"{\"loop\": {\"rate_hz\" 1000}}", {"not JSON"}},
    {"{\"log\": {\"level\": \"info}}", {"not JSON"}},
    {"\xff\xfe{}", {"not JSON"}},
    {"{\"log\": {\"level\": \"\xc3\x28\"}}", {"not JSON"}},
    {"[]", {"object"}},
    {"null", {"object"}},
    {"42", {"42", "object"}},
    {"\"mesh\"", {"object"}},
    {"{} {}", {"not JSON"}},
    // Tissue.
    {"{\"haptics\": {\"toughness_j_m2\": -1}}", {"haptics.toughness_j_m2", "-1", "from 0"}},
    {"{\"haptics\": {\"max_force_n\": 10}}", {"haptics.slew_n_s", "500", "100 times haptics.max_force_n"}},
    {"{\"materials\": {}}", {"materials", "a list of at most 64"}},
    {"{\"materials\": [{\"toughness_j_m2\": 1}]}", {"materials[0].region", "nothing"}},
    {"{\"materials\": [{\"region\": 1.5}]}", {"materials[0].region", "1.5", "whole number"}},
    {"{\"materials\": [{\"region\": 3e9}]}", {"materials[0].region", "whole number"}},
    {"{\"materials\": [{\"region\": 1}, {\"region\": 1}]}", {"materials[1].region", "no other entry"}},
    {"{\"materials\": [{\"region\": 1, \"softness\": 1}]}",
     {"softness", "accepted are region, toughness_j_m2"}},
    {"{\"materials\": [{\"region\": 1, \"puncture_n\": \"hard\"}]}",
     {"materials[0].puncture_n", "hard", "number"}},
    // How it looks.
    {"{\"materials\": [{\"region\": 1, \"tissue\": \"cheese\"}]}",
     {"materials[0].tissue", "cheese", "\"liver\", \"capsule\", \"skin\""}},
    {"{\"materials\": [{\"region\": 1, \"inside\": 3}]}", {"materials[0].inside", "3", "an object"}},
    {"{\"materials\": [{\"region\": 1, \"inside\": {\"color\": [1, 0, 0]}}]}",
     {"materials[0].inside", "unknown key \"color\"", "colour, fat_rim"}},
    {"{\"materials\": [{\"region\": 1, \"surface\": {\"colour\": [1, 0]}}]}",
     {"materials[0].surface.colour", "[1,0]", "from 0 to 1"}},
    {"{\"materials\": [{\"region\": 1, \"surface\": {\"colour\": [1, 0, 255]}}]}",
     {"materials[0].surface.colour", "255", "from 0 to 1"}},
    {"{\"materials\": [{\"region\": 1, \"surface\": {\"vessels\": 1}}]}",
     {"unknown key \"vessels\"", "colour, roughness, texture"}},
    {"{\"materials\": [{\"region\": 1, \"inside\": {\"vessels\": 3}}]}",
     {"materials[0].inside.vessels", "3", "from 0 (none) to 2"}},
    {"{\"materials\": [{\"region\": 1, \"inside\": {\"roughness\": -1}}]}",
     {"materials[0].inside.roughness", "-1", "from 0 (wet)"}},
    {"{\"materials\": [{\"region\": 1, \"inside\": {\"texture\": 1}}]}",
     {"materials[0].inside.texture", "1", "a path"}},
    {"{\"mesh\": {\"image\": 1}}", {"mesh.image", "1", "a path"}},
    {"{\"mesh\": {\"image_window\": [1]}}", {"mesh.image_window", "[1]", "two numbers"}},
    {"{\"mesh\": {\"image_window\": [2, 1]}}", {"mesh.image_window", "[2,1]", "the first the smaller"}},
    {"{\"mesh\": {\"image_space\": \"ras\"}}", {"mesh.image_space", "ras", "\"LPS\" or \"RAS\""}},
    {"{\"mesh\": {\"image_scale_to_metres\": 0}}", {"mesh.image_scale_to_metres", "0"}},
    // Unknown or doubled keys.
    {"{\"mash\": {}}", {"unknown key \"mash\"", "mesh", "loop"}},
    {"{\"loop\": {\"rate\": 1000}}", {"unknown key \"loop.rate\"", "rate_hz"}},
    {"{\"Loop\": {}}", {"unknown key \"Loop\""}},
    {"{\"\": {}}", {"unknown key \"\""}},
    {"{\"mesh\": {\"pha\\ntom\": 1}}", {"unknown key \"mesh.pha\\ntom\""}},
    {"{\"loop.rate_hz\": 1000}", {"unknown key \"loop.rate_hz\""}},
    {"{\"blade\": {\"heel\": [0,0,0], \"point\": [0,0,1]}}", {"unknown key \"blade.point\"", "tip"}},
    {"{\"loop\": {\"cpu\": 0, \"cpu\": 1}}", {"\"cpu\": found", "twice"}},
    {"{\"log\": {}, \"log\": {}}", {"\"log\": found", "twice"}},
    // A section that is not an object.
    {"{\"loop\": 1000}", {"loop", "1000", "object"}},
    {"{\"mesh\": \"liver.node\"}", {"mesh", "liver.node", "object"}},
    {"{\"cut\": null}", {"cut", "null", "object"}},
    {"{\"listen\": []}", {"listen", "object"}},
    // Numbers.
    {"{\"loop\": {\"rate_hz\": 249.9}}", {"loop.rate_hz", "249.9", "from 250", "to 4000"}},
    {"{\"loop\": {\"rate_hz\": 4001}}", {"loop.rate_hz", "4001"}},
    {"{\"loop\": {\"rate_hz\": \"1000\"}}", {"loop.rate_hz", "\"1000\"", "number"}},
    {"{\"loop\": {\"rate_hz\": null}}", {"loop.rate_hz", "null"}},
    {"{\"loop\": {\"rate_hz\": true}}", {"loop.rate_hz", "true"}},
    {"{\"loop\": {\"rate_hz\": [1000]}}", {"loop.rate_hz"}},
    {"{\"loop\": {\"budget_fraction\": 0}}", {"loop.budget_fraction", "0.01"}},
    {"{\"loop\": {\"budget_fraction\": 1}}", {"loop.budget_fraction", "0.95"}},
    {"{\"loop\": {\"budget_fraction\": -0.5}}", {"loop.budget_fraction", "-0.5"}},
    {"{\"mesh\": {\"scale_to_metres\": 0}}", {"mesh.scale_to_metres"}},
    {"{\"mesh\": {\"fill_time_limit_s\": 0}}", {"mesh.fill_time_limit_s"}},
    {"{\"mesh\": {\"fields\": [\"\"]}}", {"mesh.fields", "\"\"", "a name"}},
    {"{\"mesh\": {\"fields\": [\"a\", \"a:3\"]}}", {"mesh.fields", "a:3", "no other"}},
    {"{\"mesh\": {\"fields\": [\"a:10\"]}}", {"mesh.fields", "a:10", "2 to 9"}},
    {"{\"mesh\": {\"fields\": [\"a:tet\"]}}", {"mesh.fields", "a:tet"}},
    {"{\"mesh\": {\"fields\": \"a\"}}", {"mesh.fields", "list"}},
    {"{\"cut\": {\"batch_h\": 1e300}}", {"cut.batch_h", "to 100"}},
    {"{\"cut\": {\"chord_tolerance_h\": 0}}", {"cut.chord_tolerance_h"}},
    {"{\"cut\": {\"speed_limit_m_s\": -2}}", {"cut.speed_limit_m_s", "-2"}},
    {"{\"cut\": {\"gap_limit_s\": {}}}", {"cut.gap_limit_s"}},
    {"{\"capture\": {\"sync_interval_ms\": 0}}", {"capture.sync_interval_ms"}},
    {"{\"listen\": {\"idle_timeout_s\": 0.5}}", {"listen.idle_timeout_s"}},
    // Whole numbers.
    {"{\"listen\": {\"tcp_port\": 65536}}", {"listen.tcp_port", "65536", "65535"}},
    {"{\"listen\": {\"tcp_port\": -2}}", {"listen.tcp_port", "-2"}},
    {"{\"listen\": {\"tcp_port\": 7450.5}}", {"listen.tcp_port", "7450.5", "whole number"}},
    {"{\"listen\": {\"http_port\": 18446744073709551615}}", {"listen.http_port", "18446744073709551615"}},
    {"{\"listen\": {\"max_sessions\": 0}}", {"listen.max_sessions"}},
    {"{\"loop\": {\"realtime_priority\": 100}}", {"loop.realtime_priority", "99"}},
    {"{\"loop\": {\"cpu\": -2}}", {"loop.cpu", "-2"}},
    {"{\"mesh\": {\"target_tets\": 60000.0}}", {"mesh.target_tets", "whole number"}},
    {"{\"mesh\": {\"target_tets\": 30000000}}", {"mesh.target_tets"}},
    {"{\"mesh\": {\"fill_memory_limit_mb\": 1}}", {"mesh.fill_memory_limit_mb"}},
    {"{\"cut\": {\"engage_buttons\": 0}}", {"cut.engage_buttons"}},
    {"{\"cut\": {\"engage_buttons\": 4294967296}}", {"cut.engage_buttons"}},
    {"{\"stream\": {\"ring_bytes\": 10}}", {"stream.ring_bytes"}},
    {"{\"stream\": {\"outbox_bytes\": \"4 MB\"}}", {"stream.outbox_bytes", "4 MB"}},
    // Words.
    {"{\"cut\": {\"policy\": \"Croll\"}}", {"cut.policy", "\"Croll\"", "\"conforming\" or \"croll\""}},
    {"{\"cut\": {\"policy\": 1}}", {"cut.policy"}},
    {"{\"cut\": {\"prefer\": \"fast\"}}", {"cut.prefer", "balanced"}},
    {"{\"cut\": {\"engage\": true}}", {"cut.engage", "buttons"}},
    {"{\"cut\": {\"engage\": \"resistance\"}, \"haptics\": {\"forces\": false}}",
     {"cut.engage", "decide when tissue yields"}},
    {"{\"haptics\": {\"max_torque_n_m\": -1}}", {"haptics.max_torque_n_m", "0 to 10"}},
    {"{\"mesh\": {\"phantom\": \"kidney\"}}", {"mesh.phantom", "kidney", "liver"}},
    {"{\"capture\": {\"sync\": \"sometimes\"}}", {"capture.sync", "group"}},
    {"{\"log\": {\"level\": \"loud\"}}", {"log.level", "loud", "warning"}},
    {"{\"log\": {\"format\": \"xml\"}}", {"log.format", "text"}},
    // Texts, booleans and points.
    {"{\"mesh\": {\"path\": 7}}", {"mesh.path", "7", "path"}},
    {"{\"mesh\": {\"path\": \"a\\u0000b\"}}", {"mesh.path"}},
    {"{\"loop\": {\"lock_memory\": 1}}", {"loop.lock_memory", "true or false"}},
    {"{\"listen\": {\"insecure\": \"yes\"}}", {"listen.insecure"}},
    {"{\"listen\": {\"allowed_origins\": \"*\"}}", {"listen.allowed_origins", "list"}},
    {"{\"listen\": {\"allowed_origins\": [1]}}", {"listen.allowed_origins"}},
    {"{\"blade\": {\"tip\": [0, 0]}}", {"blade.tip", "[0,0]", "[x, y, z]"}},
    {"{\"blade\": {\"tip\": [0, 0, 0, 1]}}", {"blade.tip"}},
    {"{\"blade\": {\"tip\": [0, 0, \"1\"]}}", {"blade.tip"}},
    {"{\"blade\": {\"heel\": [0, 0, 1e9]}}", {"blade.heel"}},
    {"{\"blade\": {\"heel\": \"0,0,0\"}}", {"blade.heel"}},
    // Values that exclude each other.
    {"{\"blade\": {\"heel\": [0,0,0], \"tip\": [0,0,0]}}", {"blade.tip", "not the heel"}},
    {"{\"mesh\": {\"path\": \"a.node\", \"phantom\": \"liver\"}}", {"mesh.phantom", "mesh.path"}},
    {"{\"mesh\": {\"phantom\": \"liver\", \"target_tets\": 10}}", {"mesh.target_tets", "500"}},
    {"{\"listen\": {\"certificate_file\": \"c.pem\"}}", {"listen.private_key_file"}},
    {"{\"listen\": {\"private_key_file\": \"k.pem\"}}", {"listen.certificate_file"}},
    {"{\"listen\": {\"tcp_port\": 8000, \"http_port\": 8000}}", {"listen.http_port", "8000"}},
    // Peers on the network.
    {"{\"openigtlink\": {\"port\": 70000}}", {"openigtlink.port", "65535"}},
    {"{\"openigtlink\": {\"connect\": [\"tracker\"]}}", {"openigtlink.connect", "tracker", "host:port"}},
    {"{\"openigtlink\": {\"connect\": [\"tracker:0\"]}}", {"openigtlink.connect", "tracker:0"}},
    {"{\"openigtlink\": {\"connect\": [\"tracker:18944x\"]}}", {"openigtlink.connect"}},
    {"{\"openigtlink\": {\"connect\": [\"tracker:65536\"]}}", {"openigtlink.connect", "tracker:65536"}},
    {"{\"openigtlink\": {\"rotation\": [0.9, 0, 0, 0]}}", {"openigtlink.rotation", "unit quaternion"}},
    {"{\"mesh\": {\"path\": \"a.node\\u0000b\"}}", {"mesh.path"}},
    {"{\"openigtlink\": {\"engage\": \"button\"}}", {"openigtlink.engage", "string"}},
    {"{\"openigtlink\": {\"rotation\": [0, 0, 0, 0]}}", {"openigtlink.rotation", "unit quaternion"}},
    {"{\"openigtlink\": {\"scale\": 0}}", {"openigtlink.scale"}},
    {"{\"haply\": {\"url\": \"localhost:10001\"}}", {"haply.url", "ws://host:port"}},
    {"{\"haply\": {\"url\": \"ws://localhost\"}}", {"haply.url"}},
    {"{\"haply\": {\"version\": \"2\"}}", {"haply.version", "3.5"}},
    {"{\"haply\": {\"max_force_n\": 11}}", {"haply.max_force_n", "to 10"}},
    {"{\"haply\": {\"source\": \"\"}}", {"haply.source"}},
    // Sources.
    {"{\"sources\": {}}", {"sources", "list"}},
    {"{\"sources\": [1]}", {"sources[0]", "1"}},
    {"{\"sources\": [{}]}", {"sources[0].name"}},
    {"{\"sources\": [{\"name\": \"\"}]}", {"sources[0].name"}},
    {"{\"sources\": [{\"name\": 5}]}", {"sources[0].name", "5"}},
    {"{\"sources\": [{\"name\": \"a\"}, {\"name\": \"a\"}]}", {"sources[1].name", "\"a\""}},
    {"{\"sources\": [{\"name\": \"a\", \"blade\": 1}]}", {"sources[0]", "unknown key \"blade\"", "heel"}},
    {"{\"sources\": [{\"name\": \"a\", \"tip\": [0]}]}", {"sources[0].tip"}},
    {"{\"sources\": [{\"name\": \"a\", \"heel\": [1,1,1], \"tip\": [1,1,1]}]}", {"sources[0].tip", "heel"}},
    {"{\"sources\": [{\"name\":\"1\"},{\"name\":\"2\"},{\"name\":\"3\"},{\"name\":\"4\"},{\"name\":\"5\"},"
     "{\"name\":\"6\"},{\"name\":\"7\"},{\"name\":\"8\"},{\"name\":\"9\"}]}",
     {"sources", "at most 8"}},
};
static_assert(std::size(kMalformed) >= 60);
INSTANTIATE_TEST_SUITE_P(, MalformedConfigs, ::testing::ValuesIn(kMalformed));

TEST(Config, FilesThatCannotBeReadSayWhy) {
  const auto error = [](const std::filesystem::path& file) -> std::string {
    try {
      load_config(file);
    } catch (const ConfigError& refused) {
      return refused.what();
    }
    return "";
  };
  const auto dir = std::filesystem::path(::testing::TempDir());
  EXPECT_NE(error(dir / "none.json").find("none.json: cannot be opened"), std::string::npos);
  EXPECT_NE(error(dir).find("is a directory"), std::string::npos);
  const auto long_file = dir / "long.json";
  std::ofstream(long_file) << std::string((1 << 20) + 1, ' ');
  EXPECT_NE(error(long_file).find("longer than"), std::string::npos);
}

TEST(Config, CheckAsksForWhatAServerNeeds) {
  const auto error = [](const std::string& text) -> std::string {
    try {
      check_config(parse_config(text, "test.json"), "test.json");
    } catch (const ConfigError& refused) {
      return refused.what();
    }
    return "";
  };
  EXPECT_EQ(error(R"({"mesh": {"phantom": "slab"}})"), "");
  EXPECT_NE(error("{}").find("mesh.path"), std::string::npos);
  EXPECT_NE(error(R"({"mesh": {"path": "/nowhere/a.node"}})").find("mesh.path"), std::string::npos);
  EXPECT_NE(
      error(R"({"mesh": {"phantom": "slab"}, "listen": {"address": "0.0.0.0"}})").find("listen.insecure"),
      std::string::npos);
  EXPECT_EQ(error(R"({"mesh": {"phantom": "slab"}, "listen": {"address": "0.0.0.0", "insecure": true}})"),
            "");
  // Beyond loopback tokens alone are not enough.
  const std::filesystem::path tokens =
      std::filesystem::path(::testing::TempDir()) / "config_test_tokens.json";
  std::ofstream(tokens) << R"([{"token": "sixteen letters or more", "roles": ["viewer"]}])";
  EXPECT_NE(error(R"({"mesh": {"phantom": "slab"}, "listen": {"address": "0.0.0.0", "token_file": ")" +
                  tokens.string() + R"("}})")
                .find("listen.insecure"),
            std::string::npos);
  const std::string peers =
      R"({"mesh": {"phantom": "slab"}, "openigtlink": {"port": 18944, "address": "0.0.0.0"})";
#ifdef INCISE_OPENIGTLINK
  EXPECT_NE(error(peers + "}").find("openigtlink.address"), std::string::npos);
  EXPECT_EQ(error(peers + R"(, "listen": {"insecure": true}})"), "");
#else
  EXPECT_NE(error(peers + "}").find("built without OpenIGTLink"), std::string::npos);
#endif
}

}  // namespace
}  // namespace incise::app
