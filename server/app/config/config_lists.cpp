// The sections that are lists: blades by the name of their source, tissue by the mesh's region attribute.
#include <algorithm>
#include <iterator>
#include <numeric>
#include <set>

#include "server/app/config/config_key.hpp"
#include "server/input/hid/json_node.hpp"

namespace incise::app {
namespace {

using input::shown;

// ------------------------------------------------------------------------------------------------ sources

constexpr const char* kSourcesAccepted =
    "a list of at most 8 objects {\"name\": a text of 1 to 64 characters, \"heel\": [x, y, z], \"tip\": [x, "
    "y, z]} with different names";
constexpr const char* kSourceName = "a text of 1 to 64 characters";

void read_source_key(Config::Source& source, const std::string& key, const Json& given, const std::string& at,
                     const std::string& file) {
  if (key == "name") {
    if (!given.is_string() || given.get<std::string>().empty() || given.get<std::string>().size() > 64)
      refuse(file, at + ".name", shown(given), kSourceName);
    source.name = given.get<std::string>();
  } else if (key == "heel" || key == "tip") {
    if (!read_point(given, key == "heel" ? source.blade.heel : source.blade.tip))
      refuse(file, at + "." + key, shown(given), kPointAccepted);
  } else {
    throw ConfigError(file + ": " + at + ": unknown key " + shown(key) + "; accepted are heel, name, tip");
  }
}

void read_sources(Config& config, const Json& value, const std::string& file) {
  if (!value.is_array() || value.size() > core::kMaxSources)
    refuse(file, "sources", shown(value), kSourcesAccepted);
  std::set<std::string> names;
  for (std::size_t i = 0; i < value.size(); ++i) {
    const std::string at = "sources[" + std::to_string(i) + "]";
    const Json& entry = value[i];
    if (!entry.is_object()) refuse(file, at, shown(entry), kSourcesAccepted);
    Config::Source source;
    source.blade = config.cut.blade;
    for (const auto& [key, given] : entry.items()) read_source_key(source, key, given, at, file);
    if (source.name.empty()) refuse(file, at + ".name", "nothing", kSourceName);
    if (!names.insert(source.name).second)
      refuse(file, at + ".name", shown(source.name), "a name that no other source has");
    if (source.blade.heel == source.blade.tip)
      refuse(file, at + ".tip", shown(point_json(source.blade.tip)), "a point that is not the heel");
    config.sources.push_back(std::move(source));
  }
}

Json sources_json(const Config& config) {
  Json list = Json::array();
  for (const Config::Source& source : config.sources) {
    list.push_back({{"name", source.name},
                    {"heel", point_json(source.blade.heel)},
                    {"tip", point_json(source.blade.tip)}});
  }
  return list;
}

// ------------------------------------------------------------------------------------------------ materials

struct MaterialKey {
  const char* name;
  double haptics::Material::*field;
};
constexpr MaterialKey kMaterialKeys[] = {{"toughness_j_m2", &haptics::Material::toughness_j_m2},
                                         {"puncture_n", &haptics::Material::puncture_n},
                                         {"stiffness_n_m", &haptics::Material::stiffness_n_m},
                                         {"stiffness_pa", &haptics::Material::stiffness_pa},
                                         {"friction_n_s_m2", &haptics::Material::friction_n_s_m2}};
constexpr std::size_t kMaxMaterials = 64;
constexpr const char* kMaterialsAccepted =
    "a list of at most 64 objects {\"region\": a whole number, \"toughness_j_m2\", \"puncture_n\", "
    "\"stiffness_n_m\", \"stiffness_pa\", \"friction_n_s_m2\": numbers as in haptics} with different regions";
haptics::Material read_material(const Config& config, const Json& entry, const std::string& at,
                                const std::string& file) {
  Config scratch = config;  // holds the values while the keys of haptics check them
  for (const auto& [key, given] : entry.items()) {
    if (key == "region") continue;
    const auto known = std::find_if(std::begin(kMaterialKeys), std::end(kMaterialKeys),
                                    [&key = key](const MaterialKey& k) { return key == k.name; });
    if (known == std::end(kMaterialKeys)) {
      throw ConfigError(file + ": " + at + ": unknown key " + shown(key) + "; accepted are region" +
                        std::accumulate(std::begin(kMaterialKeys), std::end(kMaterialKeys), std::string(),
                                        [](std::string list, const MaterialKey& k) {
                                          return std::move(list) + ", " + k.name;
                                        }));
    }
    const auto table = std::find_if(config_keys().begin(), config_keys().end(),
                                    [&key = key](const ConfigKey& k) { return k.name == "haptics." + key; });
    if (!table->set(scratch, given)) refuse(file, at + "." + key, shown(given), table->accepted);
  }
  return scratch.haptics.force.materials.tissue;
}

void read_materials(Config& config, const Json& value, const std::string& file) {
  if (!value.is_array() || value.size() > kMaxMaterials)
    refuse(file, "materials", shown(value), kMaterialsAccepted);
  std::set<std::int32_t> regions;
  for (std::size_t i = 0; i < value.size(); ++i) {
    const std::string at = "materials[" + std::to_string(i) + "]";
    const Json& entry = value[i];
    if (!entry.is_object()) refuse(file, at, shown(entry), kMaterialsAccepted);
    const Json region = entry.value("region", Json());
    if (!region.is_number_integer() || region.get<double>() < INT32_MIN || region.get<double>() > INT32_MAX)
      refuse(file, at + ".region", region.is_null() ? "nothing" : shown(region), "a whole number");
    const auto number = region.get<std::int32_t>();
    if (!regions.insert(number).second)
      refuse(file, at + ".region", shown(region), "a region that no other entry has");
    config.haptics.force.materials.by_region.emplace_back(number, read_material(config, entry, at, file));
  }
}

Json materials_json(const Config& config) {
  Json list = Json::array();
  for (const auto& [region, material] : config.haptics.force.materials.by_region) {
    Json entry{{"region", region}};
    for (const MaterialKey& key : kMaterialKeys) entry[key.name] = material.*key.field;
    list.push_back(entry);
  }
  return list;
}

}  // namespace

const ConfigList kSourcesList{"sources", kSourcesAccepted,
                              "Blades for the sources of these names; any other source has the blade above.",
                              read_sources, sources_json};

const ConfigList kMaterialsList{
    "materials", kMaterialsAccepted,
    "What regions of the mesh feel like, by the mesh's region attribute; absent numbers are as in haptics.",
    read_materials, materials_json};

}  // namespace incise::app
