#include "server/app/config/config_key.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "server/input/hid/json_node.hpp"

namespace incise::app {
namespace {

// A null byte would end a path or an address early for the system, but not for us.
bool read_text(const Json& value, std::string& out) {
  if (!value.is_string()) return false;
  const auto given = value.get<std::string>();
  if (given.size() > 4096 || given.find('\0') != std::string::npos) return false;
  out = given;
  return true;
}

bool read_texts(const Json& value, std::vector<std::string>& out) {
  if (!value.is_array() || value.size() > 256) return false;
  if (!std::all_of(value.begin(), value.end(), [](const Json& entry) { return entry.is_string(); }))
    return false;
  out = value.get<std::vector<std::string>>();
  return true;
}

std::string quoted_list(const std::vector<std::string>& names) {
  std::string list;
  for (std::size_t i = 0; i < names.size(); ++i) {
    list += (i == 0 ? "\"" : i + 1 == names.size() ? " or \"" : ", \"") + names[i] + '"';
  }
  return list;
}

}  // namespace

const ConfigKeys& config_keys(Program program) {
  const auto joined = [](std::initializer_list<ConfigKeys (*)()> sections) {
    ConfigKeys all;
    for (const auto section : sections) {
      for (ConfigKey& key : section()) all.push_back(std::move(key));
    }
    return all;
  };
  static const ConfigKeys server =
      joined({mesh_keys, blade_keys, cut_keys, loop_keys, haptics_keys, listen_keys, stream_keys,
              capture_keys, devices_keys, openigtlink_keys, haply_keys, cluster_keys, log_keys});
  static const ConfigKeys relay =
      joined({relay_keys, listen_keys, stream_keys, relay_cluster_keys, log_keys});
  return program == Program::kRelay ? relay : server;
}

void refuse(const std::string& file, const std::string& key, const std::string& found,
            const std::string& accepted) {
  throw ConfigError(file + ": " + key + ": found " + found + "; accepted is " + accepted);
}

ConfigKey number(std::string name, Field<double> field, double least, double most, std::string meaning) {
  return {std::move(name), "a number from " + input::text_of(least) + " to " + input::text_of(most),
          std::move(meaning), [field](const Config& c) { return Json(value_of(c, field)); },
          [=](Config& c, const Json& value) {
            if (!value.is_number()) return false;
            const double given = value.get<double>();
            if (!(given >= least && given <= most)) return false;
            field(c) = given;
            return true;
          }};
}

ConfigKey integer_key(std::string name, std::int64_t least, std::int64_t most, std::string meaning,
                      std::function<std::int64_t(const Config&)> get,
                      std::function<void(Config&, std::int64_t)> set) {
  return {
      std::move(name), "a whole number from " + std::to_string(least) + " to " + std::to_string(most),
      std::move(meaning), [get = std::move(get)](const Config& c) { return Json(get(c)); },
      [least, most, set = std::move(set)](Config& c, const Json& value) {
        if (!value.is_number_integer()) return false;
        if (value.is_number_unsigned() && value.get<std::uint64_t>() > static_cast<std::uint64_t>(INT64_MAX))
          return false;
        const auto given = value.get<std::int64_t>();
        if (given < least || given > most) return false;
        set(c, given);
        return true;
      }};
}

ConfigKey boolean(std::string name, Field<bool> field, std::string meaning) {
  return {std::move(name), "true or false", std::move(meaning),
          [field](const Config& c) { return Json(value_of(c, field)); },
          [field](Config& c, const Json& value) {
            if (!value.is_boolean()) return false;
            field(c) = value.get<bool>();
            return true;
          }};
}

ConfigKey text(std::string name, Field<std::string> field, std::string accepted, std::string meaning) {
  return {std::move(name), std::move(accepted), std::move(meaning),
          [field](const Config& c) { return Json(value_of(c, field)); },
          [field](Config& c, const Json& value) { return read_text(value, field(c)); }};
}

ConfigKey texts(std::string name, Field<std::vector<std::string>> field, std::string accepted,
                std::string meaning) {
  return {std::move(name), std::move(accepted), std::move(meaning),
          [field](const Config& c) { return Json(value_of(c, field)); },
          [field](Config& c, const Json& value) { return read_texts(value, field(c)); }};
}

ConfigKey choice_key(std::string name, std::vector<std::string> words, std::string meaning,
                     std::function<std::size_t(const Config&)> get,
                     std::function<void(Config&, std::size_t)> set) {
  std::string accepted = quoted_list(words);
  const auto read = [words, get = std::move(get)](const Config& c) { return Json(words[get(c)]); };
  const auto write = [words = std::move(words), set = std::move(set)](Config& c, const Json& value) {
    if (!value.is_string()) return false;
    const auto found = std::find(words.begin(), words.end(), value.get<std::string>());
    if (found == words.end()) return false;
    set(c, static_cast<std::size_t>(found - words.begin()));
    return true;
  };
  return {std::move(name), std::move(accepted), std::move(meaning), read, write};
}

ConfigKey word(std::string name, std::vector<std::string> words, Field<std::string> field,
               std::string meaning) {
  const auto get = [words, field](const Config& c) {
    const auto found = std::find(words.begin(), words.end(), value_of(c, field));
    return static_cast<std::size_t>(found - words.begin());
  };
  const auto set = [words, field](Config& c, std::size_t i) { field(c) = words[i]; };
  return choice_key(std::move(name), std::move(words), std::move(meaning), get, set);
}

ConfigKey point(std::string name, Field<core::Vec3> field, std::string meaning) {
  return {std::move(name), kPointAccepted, std::move(meaning),
          [field](const Config& c) { return point_json(value_of(c, field)); },
          [field](Config& c, const Json& value) { return read_point(value, field(c)); }};
}

ConfigKey rotation(std::string name, Field<core::Quat> field, std::string meaning) {
  return {std::move(name), "[w, x, y, z], a unit quaternion", std::move(meaning),
          [field](const Config& c) { return quaternion_json(value_of(c, field)); },
          [field](Config& c, const Json& value) { return read_quaternion(value, field(c)); }};
}

Json point_json(const core::Vec3& p) {
  return Json::array({p.x, p.y, p.z});
}

bool read_point(const Json& value, core::Vec3& point) {
  if (!value.is_array() || value.size() != 3) return false;
  double xyz[3];
  for (std::size_t i = 0; i < 3; ++i) {
    if (!value[i].is_number()) return false;
    xyz[i] = value[i].get<double>();
    if (!(std::abs(xyz[i]) <= 1e4)) return false;
  }
  point = {xyz[0], xyz[1], xyz[2]};
  return true;
}

Json quaternion_json(const core::Quat& q) {
  return Json::array({q.w, q.x, q.y, q.z});
}

bool read_quaternion(const Json& value, core::Quat& q) {
  if (!value.is_array() || value.size() != 4) return false;
  double wxyz[4], norm2 = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    if (!value[i].is_number()) return false;
    wxyz[i] = value[i].get<double>();
    norm2 += wxyz[i] * wxyz[i];
  }
  if (!(std::abs(norm2 - 1) < 1e-3)) return false;
  const double n = std::abs(norm2 - 1) < 1e-14 ? 1 : std::sqrt(norm2);  // a unit one stays as it was printed
  q = {wxyz[0] / n, wxyz[1] / n, wxyz[2] / n, wxyz[3] / n};
  return true;
}

}  // namespace incise::app
