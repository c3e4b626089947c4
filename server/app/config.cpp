#include "server/app/config.hpp"

#include <cerrno>
#include <fstream>
#include <set>
#include <sstream>
#include <utility>

#include "server/app/config/config_key.hpp"
#include "server/input/hid/json_node.hpp"

namespace incise::app {
namespace {

using input::shown;

constexpr std::size_t kMaxConfigBytes = 1u << 20;
// In the order in which they are read and printed.
std::vector<const ConfigList*> lists(Program program) {
  if (program == Program::kRelay) return {};
  return {&kSourcesList, &kMaterialsList};
}

std::string joined(const std::set<std::string>& names) {
  std::string list;
  for (const std::string& name : names) list += (list.empty() ? "" : ", ") + name;
  return list;
}

void read_section(Config& config, Program program, const std::string& section, const Json& values,
                  const std::string& file) {
  if (!values.is_object()) refuse(file, section, shown(values), "an object {...}");
  for (const auto& [leaf, value] : values.items()) {
    const ConfigKey* found = nullptr;
    std::set<std::string> known;
    for (const ConfigKey& key : config_keys(program)) {
      if (key.section() != section) continue;
      known.insert(key.leaf());
      if (key.leaf() == leaf) found = &key;
    }
    if (!found) {
      throw ConfigError(file + ": unknown key " + shown(section + "." + leaf) + "; accepted in " + section +
                        " are " + joined(known));
    }
    if (!found->set(config, value)) refuse(file, found->name, shown(value), found->accepted);
  }
}

}  // namespace

std::filesystem::path Config::resolve(const std::string& path) const {
  return path.empty() || directory.empty() ? std::filesystem::path(path) : directory / path;
}

Config parse_config(std::string_view text, const std::string& name, Program program) {
  Json root;
  try {
    root = input::parse_json(text, name);
  } catch (const std::runtime_error& error) {
    throw ConfigError(error.what());
  }
  if (!root.is_object()) throw ConfigError(name + ": found " + shown(root) + "; accepted is a JSON object");
  std::set<std::string> sections;
  for (const ConfigKey& key : config_keys(program)) sections.insert(key.section());
  std::set<std::string> known = sections;
  for (const ConfigList* list : lists(program)) known.insert(list->name);

  Config config;
  for (const auto& [section, values] : root.items()) {
    if (!known.contains(section))
      throw ConfigError(name + ": unknown key " + shown(section) + "; accepted are " + joined(known));
    if (sections.contains(section)) read_section(config, program, section, values, name);
  }
  // After the sections, whose values are the defaults of their entries.
  for (const ConfigList* list : lists(program)) {
    if (root.contains(list->name)) list->read(config, root[list->name], name);
  }
  check_together(config, name);
  return config;
}

Config load_config(const std::filesystem::path& file, Program program) {
  std::error_code error;
  if (std::filesystem::is_directory(file, error))
    throw ConfigError(file.string() + ": is a directory; accepted is a file");
  std::ifstream in(file, std::ios::binary);
  if (!in) throw ConfigError(file.string() + ": cannot be opened: " + std::generic_category().message(errno));
  std::string text(kMaxConfigBytes + 1, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(in.gcount()));
  if (text.size() > kMaxConfigBytes) {
    throw ConfigError(file.string() + ": longer than " + std::to_string(kMaxConfigBytes) +
                      " bytes; a configuration is shorter");
  }
  Config config = parse_config(text, file.string(), program);
  config.directory = file.parent_path();
  return config;
}

namespace {

// Appends `text` as comment lines of at most 100 characters.
void append_comment(std::string& out, const std::string& text, const std::string& indent) {
  constexpr std::size_t kWidth = 100;
  std::istringstream words(text);
  std::string line = indent + "//", word;
  while (words >> word) {
    if (line.size() + 1 + word.size() > kWidth) {
      out += line + '\n';
      line = indent + "//";
    }
    line += ' ' + word;
  }
  out += line + '\n';
}

}  // namespace

std::string commented(const Config& config, Program program) {
  std::string out = "{\n", section;
  for (const ConfigKey& key : config_keys(program)) {
    if (key.section() != section) {
      if (!section.empty()) out += "\n  },\n";
      section = key.section();
      out += "  \"" + section + "\": {\n";
    } else {
      out += ",\n";
    }
    append_comment(out, key.meaning + " Accepted: " + key.accepted + '.', "    ");
    out += "    \"" + key.leaf() + "\": " + key.get(config).dump();
  }
  out += "\n  }";
  std::string list_separator = ",\n";
  for (const ConfigList* list : lists(program)) {
    out += list_separator;
    append_comment(out, std::string(list->meaning) + " Accepted: " + list->accepted + '.', "  ");
    out += std::string("  \"") + list->name + "\": " + list->json(config).dump();
  }
  return out + "\n}\n";
}

std::string compact(const Config& config) {
  Json root;
  for (const ConfigKey& key : config_keys()) root[key.section()][key.leaf()] = key.get(config);
  for (const ConfigList* list : lists(Program::kServer)) root[list->name] = list->json(config);
  return root.dump();
}

}  // namespace incise::app
