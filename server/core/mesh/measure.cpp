#include "server/core/mesh/measure.hpp"

#include <algorithm>
#include <cmath>

#include "server/base/check.hpp"
#include "server/core/geometry/predicates.hpp"
#include "server/core/geometry/quality.hpp"

namespace incise::core {
namespace {

bool is_cut(const TetMesh& mesh, TetId t, int face) {
  return (mesh.cut_mask(t) >> face & 1) != 0;
}

// The smallest dihedral angle of a tetrahedron whichever way it is oriented; 0 where it is flat.
double min_dihedral_deg(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  const double measure = worst_dihedral(a, b, c, d);
  return measure_to_degrees(measure < kInverted ? measure : worst_dihedral(a, b, d, c));
}

}  // namespace

std::vector<std::uint32_t> label_pieces(const TetMesh& mesh, std::uint32_t* count) {
  std::vector<std::uint32_t> piece(mesh.tet_slots(), kNone);
  std::vector<TetId> open;
  std::uint32_t pieces = 0;
  for (TetId seed = 0; seed < mesh.tet_slots(); ++seed) {
    if (!mesh.alive(seed) || piece[seed] != kNone) continue;
    piece[seed] = pieces;
    open.push_back(seed);
    while (!open.empty()) {
      const TetId t = open.back();
      open.pop_back();
      for (int f = 0; f < 4; ++f) {
        const TetId other = mesh.neighbor(t, f);
        if (other == kNone || piece[other] != kNone) continue;
        piece[other] = pieces;
        open.push_back(other);
      }
    }
    ++pieces;
  }
  if (count != nullptr) *count = pieces;
  return piece;
}

CutReport measure(const TetMesh& mesh) {
  CutReport report;
  report.min_dihedral_deg = mesh.live_tets() > 0 ? 180 : 0;
  std::vector<bool> used(mesh.vertex_slots(), false);
  const std::vector<std::uint32_t> piece = label_pieces(mesh, &report.pieces);
  std::vector<std::uint32_t> size(report.pieces, 0);
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    ++report.tets;
    ++size[piece[t]];
    const auto& v = mesh.vertices(t);
    const Vec3 &a = mesh.position(v[0]), &b = mesh.position(v[1]), &c = mesh.position(v[2]),
               &d = mesh.position(v[3]);
    report.volume += signed_volume(a, b, c, d);
    report.inverted += orient3d(a, b, c, d) <= 0 ? 1 : 0;
    const double angle = min_dihedral_deg(a, b, c, d);
    report.min_dihedral_deg = std::min(report.min_dihedral_deg, angle);
    const auto bin = static_cast<std::size_t>(angle / kHistogramBin_deg);
    ++report.dihedral_histogram[std::min(bin, report.dihedral_histogram.size() - 1)];
    for (int f = 0; f < 4; ++f) {
      if (!used[v[f]]) {
        used[v[f]] = true;
        ++report.vertices;
      }
      if (mesh.opposite(half_face(t, f)) == kNone) ++report.boundary_faces;
      if (!is_cut(mesh, t, f)) continue;
      ++report.cut_sides;
      // Half of the triangle's area: the other half is the other side's.
      report.cut_area += 0.25 * length(mesh.twice_area(half_face(t, f)));
    }
  }
  report.cut_faces = (report.cut_sides + 1) / 2;
  for (std::uint32_t tets : size) {
    report.islands += tets <= kLargestIsland ? 1 : 0;
    report.largest_piece = std::max(report.largest_piece, tets);
  }
  return report;
}

void add_sweep(SweptSurface& surface, std::span<const BladeLine> lines, double tolerance_m) {
  for (std::size_t i = 1; i < lines.size(); ++i) {
    const BladeLine &a = lines[i - 1], &b = lines[i];
    // Two triangles leave a ruled quad by up to a quarter of its twist, n x n pairs by that over n^2.
    const double error = 0.25 * length((b.tip - b.heel) - (a.tip - a.heel));
    const int n = static_cast<int>(std::clamp(std::ceil(std::sqrt(error / tolerance_m)), 1.0, 256.0));
    surface.add_quad(a, b, n, n, 0, false);
  }
}

SweptSurface cut_surface(const TetMesh& mesh) {
  SweptSurface surface;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (int f = 0; f < 4; ++f) {
      if (!mesh.alive(t) || !is_cut(mesh, t, f)) continue;
      const auto v = mesh.face_vertices(half_face(t, f));
      surface.add_strip(mesh.position(v[0]), mesh.position(v[1]), mesh.position(v[2]), mesh.position(v[2]), 0,
                        false);
    }
  }
  surface.build();
  return surface;
}

Deviation deviation(const TetMesh& mesh, const SweptSurface& surface, const SweptSurface& older) {
  constexpr double kSame_h = 0.01;  // cuts move the vertices of older ones a little
  Deviation result;
  const double h = mesh.mean_edge_length();
  if (surface.size() == 0 || !(h > 0)) return result;
  double sum_m = 0;
  const auto sample = [&](const Vec3& p) {
    INCISE_CHECK(is_finite(p), p.x, p.y, p.z);
    Vec3 closest;
    std::uint32_t triangle = 0;
    // Most are near: a small reach spares the search the rest of the surface.
    double reach = 0.1 * h;
    while (!surface.closest(p, reach, closest, triangle)) reach *= 8;
    const double d = distance(p, closest);
    ++result.samples;
    sum_m += d;
    result.max_m = std::max(result.max_m, d);
  };
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    for (int f = 0; f < 4; ++f) {
      if (!is_cut(mesh, t, f) || older.is_within(mesh.face_middle(half_face(t, f)), kSame_h * h)) continue;
      const auto face = mesh.face_vertices(half_face(t, f));
      // 28 points: where cuts cross, the farthest point of a face need not be a vertex.
      constexpr int kRows = 6;
      const Vec3 &a = mesh.position(face[0]), &b = mesh.position(face[1]), &c = mesh.position(face[2]);
      for (int i = 0; i <= kRows; ++i) {
        for (int j = 0; i + j <= kRows; ++j)
          sample(a + (static_cast<double>(i) / kRows) * (b - a) + (static_cast<double>(j) / kRows) * (c - a));
      }
    }
  }
  result.max_h = result.max_m / h;
  if (result.samples > 0) result.mean_h = sum_m / result.samples / h;
  return result;
}

}  // namespace incise::core
