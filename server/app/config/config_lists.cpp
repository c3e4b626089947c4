// The sections that are lists: blades by the name of their source, tissue by the mesh's region attribute.
#include <algorithm>
#include <iterator>
#include <numeric>
#include <set>

#include "server/app/config/config_key.hpp"
#include "server/app/look.hpp"
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
    "\"stiffness_n_m\", \"stiffness_pa\", \"friction_n_s_m2\": numbers as in haptics, \"tissue\": \"liver\", "
    "\"capsule\", \"skin\", \"fat\", \"muscle\", \"vessel\", \"bone\" or \"tumour\", \"surface\" and "
    "\"inside\": objects "
    "{\"colour\": [r, g, b] from 0 to 1, \"roughness\": a number from 0 to 1, \"texture\": the path of a "
    "PNG, JPEG or WebP "
    "image}, in \"inside\" also \"vessels\" and \"fat_rim\": numbers from 0 to 2} with different regions";

// ---- How a region looks

bool read_share(const Json& value, double most, std::optional<double>& to) {
  if (!value.is_number() || !(value.get<double>() >= 0 && value.get<double>() <= most)) return false;
  to = value.get<double>();
  return true;
}

bool read_colour(const Json& value, std::optional<std::array<double, 3>>& to) {
  if (!value.is_array() || value.size() != 3) return false;
  std::array<double, 3> colour{};
  for (std::size_t i = 0; i < 3; ++i) {
    std::optional<double> channel;
    if (!read_share(value[i], 1, channel)) return false;
    colour[i] = *channel;
  }
  to = colour;
  return true;
}

void read_side(RegionLook& look, bool inside, const Json& value, const std::string& at,
               const std::string& file) {
  RegionLook::Side& side = inside ? look.inside : look.surface;
  if (!value.is_object()) refuse(file, at, shown(value), "an object {...}");
  for (const auto& [key, given] : value.items()) {
    const auto check = [&, &key = key, &given = given](bool read, const char* accepted) {
      if (!read) refuse(file, at + "." + key, shown(given), accepted);
    };
    if (key == "colour") {
      check(read_colour(given, side.colour), "[red, green, blue], numbers from 0 to 1");
    } else if (key == "roughness") {
      check(read_share(given, 1, side.roughness), "a number from 0 (wet) to 1 (dry)");
    } else if (key == "texture") {
      check(given.is_string(), "a path, relative to this file; or \"\"");
      side.texture = given.get<std::string>();
    } else if (inside && (key == "vessels" || key == "fat_rim")) {
      check(read_share(given, 2, key == "vessels" ? look.vessels : look.fat_rim),
            "a number from 0 (none) to 2");
    } else {
      throw ConfigError(file + ": " + at + ": unknown key " + shown(key) + "; accepted are colour, " +
                        (inside ? "fat_rim, roughness, texture, vessels" : "roughness, texture"));
    }
  }
}

// False: the key is none of them.
bool read_look(RegionLook& look, const std::string& key, const Json& given, const std::string& at,
               const std::string& file) {
  if (key == "surface" || key == "inside") {
    read_side(look, key == "inside", given, at + "." + key, file);
    return true;
  }
  if (key != "tissue") return false;
  std::string names;
  for (const Tissue& tissue : kTissues) {
    if (given == tissue.name) {
      look.tissue = tissue.name;
      return true;
    }
    names += std::string(names.empty() ? "" : ", ") + '"' + tissue.name + '"';
  }
  refuse(file, at + ".tissue", shown(given), "one of " + names);
}

Json side_json(const RegionLook::Side& side) {
  Json json = Json::object();
  if (side.colour) json["colour"] = *side.colour;
  if (side.roughness) json["roughness"] = *side.roughness;
  if (!side.texture.empty()) json["texture"] = side.texture;
  return json;
}

void append_look(const RegionLook& look, Json& entry) {
  if (!look.tissue.empty()) entry["tissue"] = look.tissue;
  if (const Json surface = side_json(look.surface); !surface.empty()) entry["surface"] = surface;
  Json inside = side_json(look.inside);
  if (look.vessels) inside["vessels"] = *look.vessels;
  if (look.fat_rim) inside["fat_rim"] = *look.fat_rim;
  if (!inside.empty()) entry["inside"] = inside;
}

// ---- How it feels

haptics::Material read_material(const Config& config, const Json& entry, RegionLook& look,
                                const std::string& at, const std::string& file) {
  Config scratch = config;  // holds the values while the keys of haptics check them
  for (const auto& [key, given] : entry.items()) {
    if (key == "region" || read_look(look, key, given, at, file)) continue;
    const auto known = std::find_if(std::begin(kMaterialKeys), std::end(kMaterialKeys),
                                    [&key = key](const MaterialKey& k) { return key == k.name; });
    if (known == std::end(kMaterialKeys)) {
      throw ConfigError(file + ": " + at + ": unknown key " + shown(key) + "; accepted are region" +
                        std::accumulate(std::begin(kMaterialKeys), std::end(kMaterialKeys), std::string(),
                                        [](std::string list, const MaterialKey& k) {
                                          return std::move(list) + ", " + k.name;
                                        }) +
                        ", tissue, surface, inside");
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
    RegionLook look{
        .region = number, .tissue = {}, .surface = {}, .inside = {}, .vessels = {}, .fat_rim = {}};
    config.haptics.force.materials.by_region.emplace_back(number,
                                                          read_material(config, entry, look, at, file));
    config.looks.push_back(std::move(look));
  }
}

Json materials_json(const Config& config) {
  Json list = Json::array();
  for (const auto& [region, material] : config.haptics.force.materials.by_region) {
    Json entry{{"region", region}};
    for (const MaterialKey& key : kMaterialKeys) entry[key.name] = material.*key.field;
    for (const RegionLook& look : config.looks)
      if (look.region == region) append_look(look, entry);
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
    "What regions of the mesh feel like, by the mesh's region attribute; absent numbers are as in haptics. "
    "And what they look like, on the "
    "surface and inside: as their tissue does, but for the colour, texture and so on that are given.",
    read_materials, materials_json};

}  // namespace incise::app
