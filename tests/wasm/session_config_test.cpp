#include "server/wasm/session_config.hpp"

#include <gtest/gtest.h>

#include "server/app/config/config_key.hpp"

namespace incise {
namespace {

// Every key that decides what a cut does differs from its default here.
constexpr const char* kOther = R"({
  "blade": {"heel": [0.01, 0.02, 0.03], "tip": [0.04, 0.05, -0.06]},
  "cut": {"policy": "croll", "prefer": "exact", "engage": "always", "engage_buttons": 6, "batch_h": 1.25,
          "chord_tolerance_h": 0.03, "speed_limit_m_s": 0.7, "gap_limit_s": 0.5},
  "sources": [{"name": "one", "heel": [0, 0, 0], "tip": [0, 0, 0.1]}, {"name": "two", "heel": [0, 0.25, 0], "tip": [1, 0, 0]}]
})";

bool decides_cuts(const app::ConfigKey& key) {
  return key.section() == "cut" || key.section() == "blade";
}

// A key that is new in the server's table fails here until a page's session reads it as well.
TEST(SessionConfig, HasEveryKeyThatDecidesWhatACutDoes) {
  const app::Config config = app::parse_config(kOther, "other");
  const wasm::SessionConfig session = wasm::session_config(app::compact(config), "session");
  app::Config read;
  read.cut = session.cut;
  for (const app::ConfigKey& key : app::config_keys()) {
    if (!decides_cuts(key)) continue;
    EXPECT_NE(key.get(config), key.get(app::Config())) << key.name << ": the test does not change it";
    EXPECT_EQ(key.get(read), key.get(config)) << key.name;
  }
  ASSERT_EQ(session.blades.size(), config.sources.size());
  for (std::size_t i = 0; i < session.blades.size(); ++i)
    EXPECT_EQ(session.blades[i], config.sources[i].blade);
}

TEST(SessionConfig, DefaultsAreTheServers) {
  const wasm::SessionConfig session = wasm::session_config(app::compact(app::Config()), "session");
  app::Config read;
  read.cut = session.cut;
  for (const app::ConfigKey& key : app::config_keys()) {
    if (decides_cuts(key)) {
      EXPECT_EQ(key.get(read), key.get(app::Config())) << key.name;
    }
  }
}

std::string refusal_of(const char* json) {
  try {
    wasm::session_config(json, "x.capture");
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return {};
}

TEST(SessionConfig, RefusesWhatItCannotHold) {
  for (const char* json : {"", "[]", "{\"cut\": {\"policy\": \"other\"}}", "{\"cut\": {\"batch_h\": 0}}",
                           "{\"cut\": {\"batch_h\": \"1\"}}", "{\"cut\": {\"a_new_key\": 1}}",
                           "{\"cut\": {\"engage_buttons\": 0}}", "{\"blade\": {\"heel\": [0, 0, 0]}}",
                           "{\"blade\": {\"heel\": [0, 0], \"tip\": [0, 0, 1]}}",
                           "{\"blade\": {\"heel\": [0, 0, 0], \"tip\": [0, 0, 1e9]}}", "{\"sources\": [1]}",
                           "{\"sources\": 1}"}) {
    const std::string text = refusal_of(json);
    EXPECT_EQ(text.rfind("x.capture: ", 0), 0u) << json << ": " << text;
    EXPECT_EQ(text.find('\n'), std::string::npos) << text;
  }
}

}  // namespace
}  // namespace incise
