#include "server/relay/upstream_says.hpp"

#include <algorithm>
#include <cstdint>
#include <nlohmann/json.hpp>

namespace incise::relay {
namespace {

constexpr std::size_t kMaxTrouble = 512;  // characters that are passed on
const std::string kAt = "at ";            // begins what is passed on: the relay's address follows

std::string plain(std::string text) {
  text.resize(std::min(text.size(), kMaxTrouble));
  for (char& c : text) {
    if (c < ' ' || c > '~' || c == '"' || c == '\\') c = '?';
  }
  return text;
}

}  // namespace

// What is nested deep is passed over, since reading it takes as deep a stack.
UpstreamSays read_upstream(const std::string& stats) {
  using Json = nlohmann::json;
  const auto shallow = [](int depth, Json::parse_event_t, Json&) { return depth < 3; };
  const Json json = Json::parse(stats, shallow, false);
  if (!json.is_object() || !json.contains("relay") || !json["relay"].is_object()) return {};
  UpstreamSays says;
  const Json hops = json["relay"].value("hops", Json()), trouble = json["relay"].value("trouble", Json());
  if (hops.is_number_integer())
    says.hops = static_cast<int>(std::clamp<std::int64_t>(hops.get<std::int64_t>(), 0, kMaxHops));
  if (trouble.is_string()) says.trouble = plain(trouble.get<std::string>());
  return says;
}

std::string trouble_at(const std::string& upstream, const UpstreamSays& says) {
  if (says.trouble.empty() || says.trouble.starts_with(kAt)) return says.trouble;
  return kAt + upstream + ": " + says.trouble;
}

}  // namespace incise::relay
