#include "server/input/hid/json_node.hpp"

#include <algorithm>
#include <charconv>
#include <set>

#include "server/input/hid/device_profile.hpp"

namespace incise::input {
namespace {

std::string listed(std::initializer_list<const char*> keys) {
  std::string list;
  for (const char* key : keys) {
    list += list.empty() ? "" : ", ";
    list += key;
  }
  return list;
}

}  // namespace

nlohmann::ordered_json parse_json(std::string_view text, const std::string& file) {
  using Json = nlohmann::ordered_json;
  std::vector<std::set<std::string>> open;
  std::string twice;
  const auto watch = [&](int, Json::parse_event_t event, Json& parsed) {
    if (event == Json::parse_event_t::object_start) open.emplace_back();
    if (event == Json::parse_event_t::object_end) open.pop_back();
    if (event == Json::parse_event_t::key && !open.back().insert(parsed.get<std::string>()).second &&
        twice.empty()) {
      twice = shown(parsed);
    }
    return true;
  };
  Json root;
  try {
    root = Json::parse(text, watch, true, true);
  } catch (const nlohmann::json::exception& error) {
    // "[json.exception.parse_error.101] parse error at line 3, column 5: ..."
    std::string what = error.what();
    if (const auto at = what.find("] "); at != std::string::npos) what = what.substr(at + 2);
    for (char& c : what) {
      if (static_cast<unsigned char>(c) < ' ') c = ' ';
    }
    throw std::runtime_error(file + ": not JSON: " + what);
  }
  if (!twice.empty()) {
    throw std::runtime_error(file + ": " + twice + ": found twice in one object; accepted is once");
  }
  return root;
}

std::string shown(const nlohmann::ordered_json& value) {
  std::string text = value.dump(-1, ' ', true, nlohmann::ordered_json::error_handler_t::replace);
  if (text.size() > 80) text = text.substr(0, 77) + "...";
  return text;
}

std::string text_of(double number) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, number).ptr};
}

void JsonNode::refuse(const std::string& accepted) const {
  refuse(shown(*json_), accepted);
}

void JsonNode::refuse(const std::string& found, const std::string& accepted) const {
  throw ProfileError(*file_ + ": " + (key_.empty() ? "the file" : key_) + ": found " + found +
                     "; accepted is " + accepted);
}

const JsonNode& JsonNode::only(std::initializer_list<const char*> keys) const {
  if (!json_->is_object()) refuse("an object {...}");
  for (const auto& [key, value] : json_->items()) {
    if (std::find(keys.begin(), keys.end(), key) == keys.end()) {
      throw ProfileError(*file_ + ": " + shown(key_.empty() ? key : key_ + "." + key) +
                         ": found a key that means nothing here; accepted are " + listed(keys));
    }
  }
  return *this;
}

JsonNode JsonNode::at(const char* key) const {
  const std::string place = key_.empty() ? key : key_ + "." + key;
  if (!has(key)) throw ProfileError(*file_ + ": " + place + " is missing; it has no default");
  return {(*json_)[key], place, *file_};
}

std::vector<JsonNode> JsonNode::list(std::size_t least, std::size_t most) const {
  if (!json_->is_array() || json_->size() < least || json_->size() > most) {
    refuse("a list of " + std::to_string(least) + " to " + std::to_string(most) + " entries");
  }
  std::vector<JsonNode> entries;
  for (std::size_t i = 0; i < json_->size(); ++i) {
    entries.emplace_back((*json_)[i], key_ + "[" + std::to_string(i) + "]", *file_);
  }
  return entries;
}

double JsonNode::number(double least, double most) const {
  const double value = json_->is_number() ? json_->get<double>() : NAN;
  if (!(value >= least && value <= most)) refuse("a number from " + text_of(least) + " to " + text_of(most));
  return value;
}

std::int64_t JsonNode::integer(std::int64_t least, std::int64_t most) const {
  const double value = json_->is_number_integer() ? json_->get<double>() : NAN;
  if (!(value >= static_cast<double>(least) && value <= static_cast<double>(most))) {
    refuse("a whole number from " + std::to_string(least) + " to " + std::to_string(most));
  }
  return json_->get<std::int64_t>();
}

std::string JsonNode::text(std::size_t least, std::size_t most) const {
  std::string value = json_->is_string() ? json_->get<std::string>() : std::string();
  if (!json_->is_string() || value.size() < least || value.size() > most) {
    refuse("a text of " + std::to_string(least) + " to " + std::to_string(most) + " characters");
  }
  return value;
}

bool JsonNode::truth() const {
  if (!json_->is_boolean()) refuse("true or false");
  return json_->get<bool>();
}

std::size_t JsonNode::word(std::initializer_list<const char*> words) const {
  std::string list;
  std::size_t i = 0;
  for (const char* word : words) {
    if (*json_ == word) return i;
    list += (i == 0 ? "\"" : i + 1 == words.size() ? " or \"" : ", \"") + std::string(word) + '"';
    ++i;
  }
  refuse(list);
}

}  // namespace incise::input
