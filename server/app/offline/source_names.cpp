#include "server/app/offline/source_names.hpp"

#include <array>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

namespace incise::app {
namespace {

using Json = nlohmann::json;

constexpr std::size_t kMaxNames = 8;  // of a source

// Who holds each source.
using Holders = std::array<std::optional<std::string>, core::kMaxSources>;

// What a capture says is anybody's.
void follow(const std::string& text, Holders& holders) {
  const Json note = Json::parse(text, nullptr, false);
  if (!note.is_object() || !note.contains("source") || !note["source"].is_number_unsigned()) return;
  const auto source = note["source"].get<std::uint64_t>();
  const Json name = note.value("name", Json());
  if (source < holders.size() && name.is_string()) holders[source] = name.get<std::string>();
}

}  // namespace

std::map<std::uint32_t, SourceNames> source_names(const RecordedMotion& motion) {
  std::map<std::uint32_t, SourceNames> names;
  std::array<std::set<std::string>, core::kMaxSources> known;
  Holders holders;
  const auto add = [&](std::uint32_t source, const std::string& name) {
    if (!known[source].insert(name).second) return;
    SourceNames& of_source = names[source];
    if (of_source.names.size() < kMaxNames) {
      of_source.names.push_back(name);
    } else {
      ++of_source.others;
    }
  };
  auto note = motion.notes.begin();
  for (std::size_t i = 0; i < motion.events.size(); ++i) {
    for (; note != motion.notes.end() && note->events <= i; ++note) follow(note->json, holders);
    const MotionEvent& event = motion.events[i];
    std::optional<std::string>& holder = holders[event.source];
    if (event.kind == MotionEvent::Kind::kOpened) holder.reset();
    if (event.kind != MotionEvent::Kind::kPose || !holder) continue;
    add(event.source, *holder);
    holder.reset();
  }
  if (!motion.header) return names;
  const Json config = Json::parse(motion.header->config_json, nullptr, false);
  const Json declared = config.is_object() ? config.value("sources", Json::array()) : Json::array();
  for (std::uint32_t i = 0; i < declared.size() && i < core::kMaxSources; ++i) {
    const Json name = declared[i].is_object() ? declared[i].value("name", Json()) : Json();
    if (known[i].empty() && name.is_string()) add(i, name.get<std::string>());
  }
  return names;
}

}  // namespace incise::app
