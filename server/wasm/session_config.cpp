#include "server/wasm/session_config.hpp"

#include <cmath>
#include <nlohmann/json.hpp>
#include <stdexcept>

namespace incise::wasm {
namespace {

using Json = nlohmann::json;

core::Vec3 point(const Json& json) {
  const core::Vec3 p{json.at(0).get<double>(), json.at(1).get<double>(), json.at(2).get<double>()};
  if (!(std::abs(p.x) <= 1e4 && std::abs(p.y) <= 1e4 && std::abs(p.z) <= 1e4))
    throw std::runtime_error("a point is farther than 10000 m");
  return p;
}

core::Blade blade(const Json& json) {
  return {point(json.at("heel")), point(json.at("tip"))};
}

// `words` in the order of the enumeration's values.
template <class Enum>
Enum choice(const Json& value, std::initializer_list<const char*> words) {
  int i = 0;
  for (const char* word : words) {
    if (value == word) return static_cast<Enum>(i);
    ++i;
  }
  throw std::runtime_error("unknown value " + value.dump());
}

double positive(const Json& value) {
  const double number = value.get<double>();
  if (!(number > 0 && std::isfinite(number)))
    throw std::runtime_error("found " + value.dump() + ", accepted are positive numbers");
  return number;
}

std::uint32_t buttons(const Json& value) {
  if (!value.is_number_unsigned() || value > 0xffffffffu || value == 0)
    throw std::runtime_error("found " + value.dump() + ", accepted are whole numbers from 1");
  return value.get<std::uint32_t>();
}

void read_cut(const Json& json, core::CutConfig& cut) {
  for (const auto& [key, value] : json.items()) {
    if (key == "policy")
      cut.policy = choice<core::Policy>(value, {"conforming", "croll"});
    else if (key == "prefer")
      cut.prefer = choice<core::Preference>(value, {"no-growth", "balanced", "exact"});
    else if (key == "engage")
      cut.always_engaged = choice<int>(value, {"buttons", "always", "resistance"}) == 1;
    else if (key == "engage_buttons")
      cut.engage_buttons = buttons(value);
    else if (key == "batch_h")
      cut.batch_h = positive(value);
    else if (key == "chord_tolerance_h")
      cut.chord_tolerance_h = positive(value);
    else if (key == "speed_limit_m_s")
      cut.speed_limit_m_s = positive(value);
    else if (key == "gap_limit_s")
      cut.gap_limit_s = positive(value);
    else
      throw std::runtime_error("unknown key cut." + key);  // it may decide what a cut does
  }
}

}  // namespace

SessionConfig session_config(const std::string& json, const std::string& name) {
  try {
    const Json root = Json::parse(json);
    if (!root.is_object()) throw std::runtime_error("it is no JSON object");
    SessionConfig config;
    if (root.contains("blade")) config.cut.blade = blade(root.at("blade"));
    if (root.contains("cut")) read_cut(root.at("cut"), config.cut);
    const Json sources = root.value("sources", Json::array());
    if (!sources.is_array() || sources.size() > core::kMaxSources)
      throw std::runtime_error("sources is no list of at most 8");
    for (const Json& source : sources) config.blades.push_back(blade(source));
    return config;
  } catch (const std::exception& error) {
    throw std::runtime_error(name + ": the configuration in its header: " + error.what());
  }
}

}  // namespace incise::wasm
