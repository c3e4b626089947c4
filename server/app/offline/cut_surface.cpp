#include "server/app/offline/cut_surface.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "protocol/surface_asset.hpp"
#include "server/app/look.hpp"
#include "server/app/offline/seam_split.hpp"
#include "server/app/surface_asset.hpp"
#include "server/mesh_io/surface.hpp"

namespace incise::app {
namespace {

// sRGB, between the dark and the bright of the page's tissue.
constexpr std::array<float, 3> kSkinColour{0.4072f, 0.168f, 0.1428f};
constexpr std::array<float, 3> kInsideColour{0.6872f, 0.3687f, 0.3171f};

protocol::Corners rest_corners(const core::TetMesh& mesh, core::HalfFace face) {
  const auto vertices = mesh.face_vertices(face);
  protocol::Corners corners;
  for (std::size_t k = 0; k < 3; ++k) {
    const core::Vec3 p = mesh.deformed() ? mesh.rest_position(vertices[k]) : mesh.position(vertices[k]);
    corners[k] = {p.x, p.y, p.z};
  }
  return corners;
}

bool is_cut(const core::TetMesh& mesh, core::HalfFace face) {
  return (mesh.cut_mask(core::tet_of(face)) >> core::face_of(face) & 1) != 0;
}

// Texture coordinates of an image that is put on by place: from the side that the face is turned to most.
std::array<std::array<float, 2>, 3> uvs_by_place(const protocol::Corners& rest) {
  constexpr double kSquare_m = 0.05;
  const auto at = [&](std::size_t k) { return core::Vec3{rest[k].x, rest[k].y, rest[k].z}; };
  const core::Vec3 normal = core::cross(at(1) - at(0), at(2) - at(0));
  const double x = std::abs(normal.x), y = std::abs(normal.y), z = std::abs(normal.z);
  const bool along_x = x >= y && x >= z, along_y = !along_x && y >= z;
  std::array<std::array<float, 2>, 3> uvs{};
  for (std::size_t k = 0; k < 3; ++k) {
    uvs[k][0] = static_cast<float>((along_x ? rest[k].y : rest[k].x) / kSquare_m);
    uvs[k][1] = static_cast<float>((along_x || along_y ? rest[k].z : rest[k].y) / kSquare_m);
  }
  return uvs;
}

// `faces`: the mesh's, of each triangle. `corners_of`: at rest, of a triangle.
template <class CornersOf>
void add_materials(const core::TetMesh& mesh, const std::vector<core::HalfFace>& faces,
                   const CornersOf& corners_of, const mesh_io::Surface* from,
                   const std::vector<RegionMaterials>& regions, CutSurface& out) {
  mesh_io::SurfaceLook& look = out.surface.look;
  if (from != nullptr) look.materials = from->look.materials;
  if (look.materials.empty()) {
    look.materials.push_back({"outside", kSkinColour, nullptr, {}});
    // Colours stand for themselves.
    if (from != nullptr && !from->look.colours.empty()) look.materials.back().diffuse = {1, 1, 1};
  }
  const auto first = static_cast<std::uint32_t>(look.materials.size());
  if (regions.empty()) look.materials.push_back({"inside", kInsideColour, nullptr, {}, 0.35f});
  std::map<std::int32_t, std::uint32_t> skin_of;  // the inside is the next
  for (const RegionMaterials& region : regions) {
    skin_of[region.region] = static_cast<std::uint32_t>(look.materials.size());
    look.materials.insert(look.materials.end(), {region.surface, region.inside});
  }
  for (std::size_t i = 0; i < faces.size(); ++i) {
    const bool cut = out.cut[i] != 0;
    const bool has_material =
        from != nullptr && !from->look.material_of.empty() && out.origins[i] != core::kNone;
    const std::uint32_t painted = has_material ? from->look.material_of[out.origins[i]] : 0;
    const auto region = skin_of.find(mesh.region(core::tet_of(faces[i])));
    std::uint32_t material = cut ? first : painted;
    if (region != skin_of.end() &&
        (cut || (look.materials[painted].image == nullptr && look.colours.empty()))) {
      material = region->second + (cut ? 1 : 0);
    }
    look.material_of.push_back(material);
    if (material < first || look.materials[material].image == nullptr) continue;
    look.uvs.resize(3 * faces.size());
    const auto uvs = uvs_by_place(corners_of(i));
    std::copy(uvs.begin(), uvs.end(), look.uvs.begin() + static_cast<std::ptrdiff_t>(3 * i));
  }
}

}  // namespace

std::vector<RegionMaterials> region_materials(const Config& config, const core::MeshData& mesh,
                                              const std::string& file) {
  std::vector<RegionMaterials> out;
  std::map<std::string, stream::Document> images;
  const std::vector<ShownRegion> regions = shown_regions(config, mesh);
  for (const ShownRegion& shown : regions) {
    const auto material = [&](bool inside) {
      const SideLook& side = inside ? shown.inside : shown.surface;
      mesh_io::Material made;
      made.name = inside ? "inside" : "outside";
      if (regions.size() > 1) made.name += "_" + std::to_string(shown.region);
      if (regions.size() > 1 && !shown.tissue.empty()) made.name += "_" + shown.tissue;
      for (std::size_t i = 0; i < 3; ++i) made.diffuse[i] = static_cast<float>(side.colour[i]);
      made.roughness = static_cast<float>(side.roughness);
      if (side.texture.empty()) return made;
      const auto [image, is_new] = images.try_emplace(side.texture);
      if (is_new) image->second = read_region_texture(config, shown.region, inside, side.texture, file);
      made.image = image->second.body;
      made.image_type = image->second.type;
      return made;
    };
    out.push_back({shown.region, material(false), material(true)});
  }
  return out;
}

CutSurface cut_surface(const core::TetMesh& mesh, const std::vector<std::uint32_t>& pieces,
                       const mesh_io::Surface* from, const std::vector<RegionMaterials>& regions) {
  CutSurface out;
  const core::MeshData data = mesh.export_data();
  std::vector<core::HalfFace> faces;  // of the exported tetrahedra, then of the mesh's
  out.surface = mesh_io::boundary_surface(data.positions, data.tets, &faces);
  std::vector<core::TetId> ids;
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t)) ids.push_back(t);
  }
  for (core::HalfFace& face : faces) {
    const core::TetId tet = ids[core::tet_of(face)];
    face = 4 * tet + static_cast<std::uint32_t>(core::face_of(face));
    out.cut.push_back(is_cut(mesh, face) ? 1 : 0);
    out.pieces.push_back(pieces[tet]);
  }
  std::vector<core::Vec3> rest(out.surface.positions.size());
  for (std::size_t i = 0; i < faces.size(); ++i) {
    const protocol::Corners corners = rest_corners(mesh, faces[i]);
    for (std::size_t k = 0; k < 3; ++k)
      rest[out.surface.triangles[i][k]] = {corners[k].x, corners[k].y, corners[k].z};
  }
  const auto corners_of = [&](std::size_t i) {
    protocol::Corners corners;
    for (std::size_t k = 0; k < 3; ++k) {
      const core::Vec3& p = rest[out.surface.triangles[i][k]];
      corners[k] = {p.x, p.y, p.z};
    }
    return corners;
  };
  out.origins.assign(faces.size(), core::kNone);
  if (from != nullptr) {
    const auto tree = origin_tree(from);
    const protocol::SurfaceAsset asset = asset_of(*from);
    const protocol::SurfaceLookup lookup(asset);
    for (std::size_t i = 0; i < faces.size(); ++i)
      if (out.cut[i] == 0) out.origins[i] = tree->origin_of(corners_of(i));
    if (!asset.uvs.empty()) split_at_seams(lookup, *tree, rest, faces, out);
    mesh_io::SurfaceLook& look = out.surface.look;
    if (!asset.uvs.empty()) look.uvs.resize(3 * faces.size());
    if (!asset.colours.empty()) look.colours.resize(3 * faces.size(), {255, 255, 255, 255});
    for (std::size_t i = 0; i < faces.size(); ++i) {
      if (out.cut[i] != 0) continue;
      const protocol::Corners corners = corners_of(i);
      if (const auto uvs = lookup.uvs(out.origins[i], corners))
        std::copy(uvs->begin(), uvs->end(), look.uvs.begin() + static_cast<std::ptrdiff_t>(3 * i));
      if (const auto colours = lookup.at<4>(asset.colours, out.origins[i], corners)) {
        for (std::size_t k = 0; k < 3; ++k) {
          for (std::size_t n = 0; n < 4; ++n)
            look.colours[3 * i + k][n] =
                static_cast<std::uint8_t>(std::lround(std::clamp((*colours)[k][n], 0.0f, 255.0f)));
        }
      }
    }
  }
  add_materials(mesh, faces, corners_of, from, regions, out);
  return out;
}

std::vector<std::array<std::uint32_t, 4>> face_origins(const core::TetMesh& mesh,
                                                       const mesh_io::Surface& from) {
  const auto tree = origin_tree(&from);
  std::vector<std::array<std::uint32_t, 4>> out;
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    auto& origins = out.emplace_back();
    for (std::uint32_t f = 0; f < 4; ++f) {
      const bool outside = (mesh.boundary_mask(t) >> f & 1) != 0 && !is_cut(mesh, 4 * t + f);
      origins[f] = outside ? tree->origin_of(rest_corners(mesh, 4 * t + f)) : core::kNone;
    }
  }
  return out;
}

std::vector<std::array<std::array<float, 2>, 3>> face_uvs(const core::TetMesh& mesh,
                                                          const mesh_io::Surface& from) {
  constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
  const protocol::SurfaceAsset asset = asset_of(from);
  const protocol::SurfaceLookup lookup(asset);
  std::vector<std::array<std::array<float, 2>, 3>> out;
  std::size_t row = 0;
  const auto origins = face_origins(mesh, from);
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    for (std::uint32_t f = 0; f < 4; ++f) {
      if ((mesh.boundary_mask(t) >> f & 1) == 0) continue;
      const auto uvs = lookup.uvs(origins[row][f], rest_corners(mesh, 4 * t + f));
      out.push_back(uvs.value_or(
          std::array<std::array<float, 2>, 3>{{{kNone, kNone}, {kNone, kNone}, {kNone, kNone}}}));
    }
    ++row;
  }
  return out;
}

}  // namespace incise::app
