#include "server/app/offline/cut_surface.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "protocol/surface_asset.hpp"
#include "server/app/surface_asset.hpp"
#include "server/core/mesh/measure.hpp"
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

void add_materials(const mesh_io::Surface* from, CutSurface& out) {
  mesh_io::SurfaceLook& look = out.surface.look;
  if (from != nullptr) look.materials = from->look.materials;
  if (look.materials.empty()) {
    look.materials.push_back({"outside", kSkinColour, nullptr, {}});
    // Colours stand for themselves.
    if (from != nullptr && !from->look.colours.empty()) look.materials.back().diffuse = {1, 1, 1};
  }
  const auto inside = static_cast<std::uint32_t>(look.materials.size());
  look.materials.push_back({"inside", kInsideColour, nullptr, {}});
  for (std::size_t i = 0; i < out.cut.size(); ++i) {
    const bool has_material =
        from != nullptr && !from->look.material_of.empty() && out.origins[i] != core::kNone;
    look.material_of.push_back(out.cut[i] != 0 ? inside
                               : has_material  ? from->look.material_of[out.origins[i]]
                                               : 0);
  }
}

}  // namespace

CutSurface cut_surface(const core::TetMesh& mesh, const mesh_io::Surface* from) {
  CutSurface out;
  const core::MeshData data = mesh.export_data();
  std::vector<core::HalfFace> faces;  // of the exported tetrahedra, then of the mesh's
  out.surface = mesh_io::boundary_surface(data.positions, data.tets, &faces);
  std::vector<core::TetId> ids;
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t)) ids.push_back(t);
  }
  const std::vector<std::uint32_t> pieces = core::label_pieces(mesh);
  for (core::HalfFace& face : faces) {
    const core::TetId tet = ids[core::tet_of(face)];
    face = 4 * tet + static_cast<std::uint32_t>(core::face_of(face));
    out.cut.push_back(is_cut(mesh, face) ? 1 : 0);
    out.pieces.push_back(pieces[tet]);
  }
  out.origins.assign(faces.size(), core::kNone);
  if (from != nullptr) {
    const auto tree = origin_tree(from);
    const protocol::SurfaceAsset asset = asset_of(*from);
    const protocol::SurfaceLookup lookup(asset);
    mesh_io::SurfaceLook& look = out.surface.look;
    if (!asset.uvs.empty()) look.uvs.resize(3 * faces.size());
    if (!asset.colours.empty()) look.colours.resize(3 * faces.size(), {255, 255, 255, 255});
    for (std::size_t i = 0; i < faces.size(); ++i) {
      if (out.cut[i] != 0) continue;
      const protocol::Corners rest = rest_corners(mesh, faces[i]);
      out.origins[i] = tree->origin_of(rest);
      if (const auto uvs = lookup.uvs(out.origins[i], rest))
        std::copy(uvs->begin(), uvs->end(), look.uvs.begin() + static_cast<std::ptrdiff_t>(3 * i));
      if (const auto colours = lookup.at<4>(asset.colours, out.origins[i], rest)) {
        for (std::size_t k = 0; k < 3; ++k) {
          for (std::size_t n = 0; n < 4; ++n)
            look.colours[3 * i + k][n] =
                static_cast<std::uint8_t>(std::lround(std::clamp((*colours)[k][n], 0.0f, 255.0f)));
        }
      }
    }
  }
  add_materials(from, out);
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
