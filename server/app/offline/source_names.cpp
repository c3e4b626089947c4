#include "server/app/offline/source_names.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

namespace incise::app {
namespace {

using Json = nlohmann::json;

constexpr std::size_t kMaxNames = 8;  // of a source

}  // namespace

std::map<std::uint32_t, std::vector<std::string>> source_names(const RecordedMotion& motion) {
  std::map<std::uint32_t, std::vector<std::string>> names;
  const auto add = [&](std::uint64_t source, const Json& name) {
    if (source >= core::kMaxSources || !name.is_string()) return;
    std::vector<std::string>& known = names[static_cast<std::uint32_t>(source)];
    const auto text = name.get<std::string>();
    if (known.size() < kMaxNames && std::find(known.begin(), known.end(), text) == known.end())
      known.push_back(text);
  };
  // What a capture says is anybody's.
  for (const std::string& text : motion.notes) {
    const Json note = Json::parse(text, nullptr, false);
    if (!note.is_object() || !note.contains("source") || !note["source"].is_number_unsigned()) continue;
    add(note["source"].get<std::uint64_t>(), note.value("name", Json()));
  }
  if (!motion.header) return names;
  const Json config = Json::parse(motion.header->config_json, nullptr, false);
  const Json declared = config.is_object() ? config.value("sources", Json::array()) : Json::array();
  for (std::size_t i = 0; i < declared.size(); ++i)
    if (declared[i].is_object()) add(i, declared[i].value("name", Json()));
  return names;
}

}  // namespace incise::app
