#pragma once

#include <array>
#include <string>
#include <vector>

#include "server/app/config.hpp"
#include "server/core/mesh/mesh_data.hpp"
#include "server/stream/providers.hpp"

namespace incise::app {

// How a tissue looks where the configuration does not say it.
struct Tissue {
  const char* name;
  std::array<double, 3> surface, inside;  // colours, sRGB, as in even light
  double surface_roughness, inside_roughness;
  const char* pattern;      // of the inside: "lobules", "fibres", "globules", "pores" or "plain"
  double vessels, fat_rim;  // 1: many; a broad rim
};
inline constexpr Tissue kTissues[] = {
    {"liver", {0.61, 0.27, 0.23}, {0.64, 0.25, 0.20}, 0.35, 0.3, "lobules", 1, 0.5},
    {"capsule", {0.66, 0.31, 0.27}, {0.86, 0.70, 0.64}, 0.3, 0.35, "plain", 0, 0},
    {"skin", {0.88, 0.69, 0.60}, {0.87, 0.69, 0.62}, 0.6, 0.5, "plain", 0, 0},
    {"fat", {0.91, 0.75, 0.45}, {0.93, 0.78, 0.47}, 0.3, 0.3, "globules", 0.15, 0},
    {"muscle", {0.69, 0.20, 0.17}, {0.77, 0.21, 0.18}, 0.4, 0.3, "fibres", 0.25, 0},
    {"vessel", {0.80, 0.52, 0.46}, {0.88, 0.66, 0.58}, 0.3, 0.35, "plain", 0, 0},
    {"bone", {0.90, 0.85, 0.74}, {0.80, 0.60, 0.50}, 0.6, 0.55, "pores", 0, 0},
    {"tumour", {0.80, 0.68, 0.58}, {0.84, 0.75, 0.64}, 0.4, 0.45, "plain", 0.4, 0},
};

// One side of a region, the configuration and the defaults together.
struct SideLook {
  std::array<double, 3> colour{};  // sRGB
  double roughness = 0;
  std::string texture;  // as the configuration names it; "": none
};
struct ShownRegion {
  std::int32_t region = 0;
  std::string tissue;  // "": the configuration names none
  SideLook surface, inside;
  const char* pattern = "plain";
  double vessels = 0, fat_rim = 0;
};
// How each region of the mesh looks, ascending. Empty for a body of one tissue that the configuration does not mention: each viewer shows it as it
// thinks best. O(n log regions).
std::vector<ShownRegion> shown_regions(const Config& config, const core::MeshData& mesh);

// The image of one side of a region. `file`: the configuration in messages. Throws ConfigError where it cannot be used.
stream::Document read_region_texture(const Config& config, std::int32_t region, bool inside,
                                     const std::string& texture, const std::string& file);

// Leaves out the image and the textures, whose paths begin in a folder that is not known, as in a capture's configuration. False: there were none.
bool drop_look_files(Config& config);
inline constexpr const char* kLookFilesLeftOut =
    "the image and textures of the capture's configuration are left out: name its file with --config";

// What the HTTP port serves of how the body looks (PROTOCOL.md, section 5): "/look.json", and what it names: the volume image, the regions as an
// image, textures. `file`: the configuration in messages. Lines in `warnings` for what will not be seen.
// Throws ConfigError where the configuration names an image or a texture that cannot be used.
stream::Documents served_look(const Config& config, const core::MeshData& mesh, const std::string& file,
                              std::vector<std::string>& warnings);

// Throws ConfigError and warns as served_look() does; of the mesh only vertices and regions are looked at.
void check_look(const Config& config, const core::MeshData& mesh, const std::string& file,
                std::vector<std::string>& warnings);

}  // namespace incise::app
