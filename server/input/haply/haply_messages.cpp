#include "server/input/haply/haply_messages.hpp"

#include <cmath>
#include <nlohmann/json.hpp>

namespace incise::input {
namespace {

using Json = nlohmann::json;

// A member, or null.
const Json* member(const Json* json, const char* key) {
  if (!json || !json->is_object()) return nullptr;
  const auto found = json->find(key);
  return found == json->end() ? nullptr : &*found;
}

bool read_number(const Json* json, const char* key, double& value) {
  const Json* const found = member(json, key);
  if (!found || !found->is_number()) return false;
  value = found->get<double>();
  return std::isfinite(value);
}

bool read_vector(const Json* json, core::Vec3& v) {
  return read_number(json, "x", v.x) && read_number(json, "y", v.y) && read_number(json, "z", v.z);
}

std::string id_of(const Json& entry) {
  const Json* const id = member(&entry, "device_id");
  if (!id || !id->is_string()) return "";
  std::string text = id->get<std::string>();
  if (text.size() > 64) text.resize(64);
  for (char& c : text) {
    if (c < 0x20 || c >= 0x7f) c = '_';
  }
  return text;
}

// The first device in a list with this id (any device if it is empty); null if there is none.
const Json* find_device(const Json& root, const char* kind, const std::string& id) {
  const Json* const list = member(&root, kind);
  if (!list || !list->is_array()) return nullptr;
  for (const Json& entry : *list) {
    const std::string found = id_of(entry);
    if (!found.empty() && (id.empty() || found == id)) return &entry;
  }
  return nullptr;
}

std::uint32_t buttons_of(const Json* state) {
  std::uint32_t held = 0;
  const auto add = [&](const Json* json, const char* key, unsigned bit) {
    const Json* const button = member(json, key);
    if (button && button->is_boolean() && button->get<bool>()) held |= 1u << bit;
  };
  add(state, "button", 0);
  const Json* const buttons = member(state, "buttons");
  constexpr const char* kLetters[] = {"a", "b", "c"};
  constexpr const char* kNumbers[] = {"button_0", "button_1", "button_2", "button_3"};
  for (unsigned i = 0; i < 3; ++i) add(buttons, kLetters[i], i);
  for (unsigned i = 0; i < 4; ++i) add(buttons, kNumbers[i], i);
  return held;
}

bool read_grip(const Json& root, const std::string& id, HaplyState& out) {
  const Json* grip = nullptr;
  for (const char* kind : {"wireless_verse_grip", "verse_grip", "custom_verse_grip"}) {
    if (!grip) grip = find_device(root, kind, id);
  }
  const Json* const state = grip ? member(grip, "state") : nullptr;
  if (!state) return true;
  out.buttons = buttons_of(state);
  const Json* const turn = member(state, "orientation");
  core::Quat q;
  if (!turn) return true;
  if (!read_number(turn, "w", q.w) || !read_number(turn, "x", q.x) || !read_number(turn, "y", q.y) ||
      !read_number(turn, "z", q.z)) {
    return false;
  }
  const double n = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  if (!(n > 0.5 && n < 2)) return false;
  out.orientation = {q.w / n, q.x / n, q.y / n, q.z / n};
  return true;
}

}  // namespace

std::optional<HaplyState> read_haply_state(std::string_view text, const std::string& device,
                                           const std::string& grip, std::string& error) {
  const Json root = Json::parse(text, nullptr, false);
  if (!root.is_object()) {
    error = "no JSON object";
    return std::nullopt;
  }
  HaplyState state;
  const Json* const found = find_device(root, "inverse3", device);
  if (!found) return state;
  const Json* const body = member(found, "state");
  if (!read_vector(member(body, "cursor_position"), state.position)) {
    error = "inverse3: no state.cursor_position of x, y and z";
    return std::nullopt;
  }
  read_vector(member(body, "cursor_velocity"), state.velocity);
  if (!read_grip(root, grip, state)) {
    error = "the grip's orientation is not a unit quaternion of w, x, y and z";
    return std::nullopt;
  }
  state.device = id_of(*found);
  return state;
}

std::string haply_force(const std::string& device, const core::Vec3& force, HaplyVersion version,
                        bool first) {
  const char* const field = version == HaplyVersion::k35 ? "vector" : "values";
  const Json vector{{"x", force.x}, {"y", force.y}, {"z", force.z}};
  const Json command{{"device_id", device}, {"commands", {{"set_cursor_force", {{field, vector}}}}}};
  Json message{{"inverse3", Json::array({command})}};
  if (first && version == HaplyVersion::k35) {
    message["session"] = {{"configure", {{"profile", {{"name", "incised"}}}}}};
  }
  return message.dump();
}

std::string haply_query() {
  return R"({"session":{"force_render_full_state":{}}})";
}

}  // namespace incise::input
