#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "server/app/config.hpp"

namespace incise::app {

using Json = nlohmann::ordered_json;

// One row of the table of configuration keys: where the key stands in the file ("section.key"), what it accepts, what it
// means, and how it is read and set.
struct ConfigKey {
  std::string name;
  std::string accepted;
  std::string meaning;
  std::function<Json(const Config&)> get;
  std::function<bool(Config&, const Json&)> set;  // false: not accepted, and nothing is set

  std::string section() const { return name.substr(0, name.find('.')); }
  std::string leaf() const { return name.substr(name.find('.') + 1); }
};
using ConfigKeys = std::vector<ConfigKey>;

// The sections of the table, one function each.
ConfigKeys mesh_keys();
ConfigKeys blade_keys();
ConfigKeys cut_keys();
ConfigKeys loop_keys();
ConfigKeys haptics_keys();
ConfigKeys listen_keys();
ConfigKeys stream_keys();
ConfigKeys capture_keys();
ConfigKeys devices_keys();
ConfigKeys openigtlink_keys();
ConfigKeys haply_keys();
ConfigKeys cluster_keys();
ConfigKeys relay_cluster_keys();
ConfigKeys log_keys();
ConfigKeys relay_keys();

// The whole table, in the order in which --print-config prints it.
const ConfigKeys& config_keys(Program program = Program::kServer);

// Throws the ConfigError that all wrong values get.
[[noreturn]] void refuse(const std::string& file, const std::string& key, const std::string& found,
                         const std::string& accepted);

// ------------------------------------------------------------------------------------------------ kinds of keys

// Where a key's value lies in a Config. INCISE_FIELD(loop.rate_hz) makes one.
template <class T>
using Field = T& (*)(Config&);

// NOLINTBEGIN(bugprone-macro-parentheses): a member's name
#define INCISE_FIELD(member) \
  +[](Config & c) -> auto& { \
    return c.member;         \
  }
// NOLINTEND(bugprone-macro-parentheses)

template <class T>
T value_of(const Config& config, Field<T> field) {
  return field(const_cast<Config&>(config));  // the field is only read
}

ConfigKey number(std::string name, Field<double> field, double least, double most, std::string meaning);
ConfigKey boolean(std::string name, Field<bool> field, std::string meaning);
ConfigKey text(std::string name, Field<std::string> field, std::string accepted, std::string meaning);
ConfigKey texts(std::string name, Field<std::vector<std::string>> field, std::string accepted,
                std::string meaning);
// A text that is one of `words`.
ConfigKey word(std::string name, std::vector<std::string> words, Field<std::string> field,
               std::string meaning);
ConfigKey point(std::string name, Field<core::Vec3> field, std::string meaning);
ConfigKey rotation(std::string name, Field<core::Quat> field, std::string meaning);

// The common part of all integer() keys.
ConfigKey integer_key(std::string name, std::int64_t least, std::int64_t most, std::string meaning,
                      std::function<std::int64_t(const Config&)> get,
                      std::function<void(Config&, std::int64_t)> set);
template <class T>
ConfigKey integer(std::string name, Field<T> field, std::int64_t least, std::int64_t most,
                  std::string meaning) {
  return integer_key(
      std::move(name), least, most, std::move(meaning),
      [field](const Config& c) { return static_cast<std::int64_t>(value_of(c, field)); },
      [field](Config& c, std::int64_t value) { field(c) = static_cast<T>(value); });
}

// The common part of all choice() keys: `get` and `set` convert between the field and an index into `words`.
ConfigKey choice_key(std::string name, std::vector<std::string> words, std::string meaning,
                     std::function<std::size_t(const Config&)> get,
                     std::function<void(Config&, std::size_t)> set);
// A word for each value of an enum (or a bool), in the order of the values.
template <class T>
ConfigKey choice(std::string name, std::vector<std::string> words, Field<T> field, std::string meaning) {
  return choice_key(
      std::move(name), std::move(words), std::move(meaning),
      [field](const Config& c) { return static_cast<std::size_t>(value_of(c, field)); },
      [field](Config& c, std::size_t i) { field(c) = static_cast<T>(i); });
}

// What a key of these kinds accepts, and its value in JSON. read_...: false if the JSON value is not accepted.
inline constexpr const char* kPointAccepted = "[x, y, z], three numbers from -10000 to 10000";
Json point_json(const core::Vec3& p);
bool read_point(const Json& value, core::Vec3& point);
Json quaternion_json(const core::Quat& q);
bool read_quaternion(const Json& value, core::Quat& q);

// ------------------------------------------------------------------------------------------------ lists

// The two sections that are lists instead of objects: blades by the name of their source, tissue by region.
struct ConfigList {
  const char* name;
  const char* accepted;
  const char* meaning;
  void (*read)(Config&, const Json&, const std::string& file);
  Json (*json)(const Config&);
};
extern const ConfigList kSourcesList, kMaterialsList;

// ------------------------------------------------------------------------------------------------ checks

// What involves several keys. Throws ConfigError.
void check_together(const Config& config, const std::string& file);

}  // namespace incise::app
