#include "server/mesh_io/phantom.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "server/base/check.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/remesh.hpp"
#include "server/mesh_io/tet_repair.hpp"

namespace incise::mesh_io {
namespace {

using core::Vec3;
using core::VertexId;

// Length of the surface edges, in edges of a regular tetrahedron of the mean volume. This value gave the
// best angles.
constexpr double kSurfaceEdge = 1.05;

// The surface edge length for a fill of so many tetrahedra.
double edge_length_for(double volume, std::size_t tets) {
  return kSurfaceEdge * std::cbrt(6 * std::numbers::sqrt2 * volume / static_cast<double>(tets));
}

// ---------------------------------------------------------------------------------------------------- liver

// A polynomial minimum that is smooth over a width k (after Quilez): at most k/4 below the smaller one.
double smooth_min(double a, double b, double k) {
  const double h = std::max(k - std::abs(a - b), 0.0) / k;
  return std::min(a, b) - 0.25 * h * h * k;
}
double smooth_max(double a, double b, double k) {
  return -smooth_min(-a, -b, k);
}

// Approximate distance to an ellipsoid's surface, good near the surface; negative inside.
double ellipsoid(const Vec3& p, const Vec3& centre, const Vec3& radii) {
  const Vec3 d = p - centre;
  const Vec3 u{d.x / radii.x, d.y / radii.y, d.z / radii.z};
  const Vec3 v{u.x / radii.x, u.y / radii.y, u.z / radii.z};
  const double k0 = length(u), k1 = length(v);
  return k1 > 0 ? k0 * (k0 - 1) / k1 : -std::min({radii.x, radii.y, radii.z});
}

// The distance to a segment, less a radius.
double capsule(const Vec3& p, const Vec3& a, const Vec3& b, double radius) {
  const Vec3 ab = b - a;
  const double t = std::clamp(dot(p - a, ab) / dot(ab, ab), 0.0, 1.0);
  return distance(p, lerp(a, b, t)) - radius;
}

// Metres; x to the (viewer's) right, z up. A large right lobe, a flat left one, the caudate lobe below; a
// notch from the front edge between the lobes; a hollow underneath; a tunnel where a large vessel would run.
double liver(const Vec3& p) {
  const double right = ellipsoid(p, {-0.038, 0.002, 0.000}, {0.056, 0.052, 0.043});
  const double left = ellipsoid(p, {0.042, 0.012, 0.010}, {0.058, 0.034, 0.021});
  const double caudate = ellipsoid(p, {0.004, -0.024, -0.012}, {0.024, 0.018, 0.018});
  double body = smooth_min(smooth_min(right, left, 0.030), caudate, 0.015);
  // Flattened along z, so that it goes through from top to bottom.
  const double notch = capsule({p.x, p.y, 0.2 * p.z}, {0.017, 0.070, -0.002}, {0.012, 0.029, -0.003}, 0.006);
  body = smooth_max(body, -notch, 0.010);
  const double hollow = ellipsoid(p, {0.006, 0.006, -0.062}, {0.075, 0.040, 0.042});
  body = smooth_max(body, -hollow, 0.014);
  const double vessel =
      smooth_min(capsule(p, {-0.062, -0.075, 0.012}, {-0.046, -0.010, 0.004}, 0.0075),
                 capsule(p, {-0.046, -0.010, 0.004}, {-0.060, 0.080, 0.010}, 0.0075), 0.004);
  return smooth_max(body, -vessel, 0.005);
}

constexpr double kLiverVolume = 6.6e-4;  // m^3, for the choice of the edge length

Surface liver_surface(std::size_t target_tets) {
  // The tunnel and the notch need triangles of 7 mm or less, however few tetrahedra are wanted.
  const double edge = std::min(edge_length_for(kLiverVolume, target_tets), 0.007);
  const double cell = std::min(0.9 * edge, 0.004);
  Surface surface = isosurface(liver, {-0.105, -0.062, -0.055}, {0.110, 0.065, 0.055}, cell);
  remesh_isotropically(surface, liver, edge, 8);
  return surface;
}

// ------------------------------------------------------------------------------------------------- cylinder

constexpr double kRadius = 0.025, kHeight = 0.100;
// The paper's meshes have more of their vertices on the surface: with this, 1,674 of them for 7,882
// tetrahedra and 3,234 for 15,115, where the paper has 1,720 for 7,844 and 3,234 for 15,272.
constexpr double kCylinderEdge = 0.76;

// Two caps of rings of 6, 12, 18, ... vertices, and a mantle of staggered rows like the outermost ring.
Surface cylinder_surface(std::size_t target_tets) {
  const double edge =
      kCylinderEdge * edge_length_for(std::numbers::pi * kRadius * kRadius * kHeight, target_tets);
  const auto at_least = [](double value, int least) {
    return std::max(static_cast<int>(std::lround(value)), least);
  };
  const int rings = at_least(kRadius / edge, 2);
  const int columns = 6 * rings;
  const int rows =
      at_least(kHeight / (2 * kRadius * std::sin(std::numbers::pi / columns) * std::sqrt(0.75)), 2);
  Surface surface;
  const auto point = [](double radius, double turn, double z) {
    const double angle = 2 * std::numbers::pi * turn;
    return Vec3{radius * std::cos(angle), radius * std::sin(angle), z};
  };
  const auto index = [&surface] { return static_cast<VertexId>(surface.positions.size()); };
  // The first vertex of row r. Odd rows are shifted by half a column.
  std::vector<VertexId> row_begin;
  for (int r = 0; r <= rows; ++r) {
    row_begin.push_back(index());
    for (int c = 0; c < columns; ++c) {
      surface.positions.push_back(point(kRadius, (c + 0.5 * (r % 2)) / columns, kHeight * r / rows));
    }
  }
  for (int r = 0; r < rows; ++r) {
    const auto at = [&](int row, int c) {
      return row_begin[row] + static_cast<VertexId>((c + columns) % columns);
    };
    for (int c = 0; c < columns; ++c) {
      // An odd row's vertex c lies over the middle of the even row's c and c + 1.
      if (r % 2 == 0) {
        surface.triangles.push_back({at(r, c), at(r, c + 1), at(r + 1, c)});
        surface.triangles.push_back({at(r, c + 1), at(r + 1, c + 1), at(r + 1, c)});
      } else {
        surface.triangles.push_back({at(r, c), at(r + 1, c + 1), at(r + 1, c)});
        surface.triangles.push_back({at(r, c), at(r, c + 1), at(r + 1, c + 1)});
      }
    }
  }
  for (const bool top : {false, true}) {
    const double shift = top ? 0.5 * (rows % 2) / columns : 0;
    std::vector<VertexId> ring_begin{index()};
    surface.positions.push_back({0, 0, top ? kHeight : 0});
    for (int k = 1; k < rings; ++k) {
      ring_begin.push_back(index());
      for (int c = 0; c < 6 * k; ++c) {
        surface.positions.push_back(
            point(kRadius * k / rings, static_cast<double>(c) / (6 * k) + shift, top ? kHeight : 0));
      }
    }
    ring_begin.push_back(row_begin[top ? rows : 0]);
    const auto add = [&](VertexId a, VertexId b, VertexId c) {
      surface.triangles.push_back(top ? std::array{a, b, c} : std::array{a, c, b});
    };
    for (int k = 1; k <= rings; ++k) {
      const auto outer = [&](int c) { return ring_begin[k] + static_cast<VertexId>(c % (6 * k)); };
      const auto inner = [&](int c) {
        return k == 1 ? ring_begin[0] : ring_begin[k - 1] + static_cast<VertexId>(c % (6 * (k - 1)));
      };
      // A sixth of the ring at a time: k edges outside, k - 1 inside.
      for (int sixth = 0; sixth < 6; ++sixth) {
        for (int i = 0; i < k; ++i) {
          const int o = sixth * k + i, n = sixth * (k - 1) + i;
          add(outer(o), outer(o + 1), inner(n));
          if (i + 1 < k) add(outer(o + 1), inner(n + 1), inner(n));
        }
      }
    }
  }
  return surface;
}

// ----------------------------------------------------------------------------------------------------- slab

constexpr Vec3 kSlab{0.100, 0.060, 0.020};

// A grid on each side; the diagonals alternate, so that no direction is preferred.
Surface slab_surface(std::size_t target_tets) {
  const double edge = edge_length_for(kSlab.x * kSlab.y * kSlab.z, target_tets);
  const auto cells = [edge](double side) { return std::max(static_cast<int>(std::lround(side / edge)), 1); };
  const std::array<int, 3> n{cells(kSlab.x), cells(kSlab.y), cells(kSlab.z)};
  Surface surface;
  std::map<std::array<int, 3>, VertexId> vertices;
  const auto vertex = [&](const std::array<int, 3>& grid) {
    const auto [it, added] = vertices.try_emplace(grid, static_cast<VertexId>(surface.positions.size()));
    if (added) {
      surface.positions.push_back(
          {kSlab.x * grid[0] / n[0], kSlab.y * grid[1] / n[1], kSlab.z * grid[2] / n[2]});
    }
    return it->second;
  };
  for (int axis = 0; axis < 3; ++axis) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    for (const bool far : {false, true}) {
      for (int i = 0; i < n[u]; ++i) {
        for (int j = 0; j < n[v]; ++j) {
          const auto at = [&](int di, int dj) {
            std::array<int, 3> grid;
            grid[axis] = far ? n[axis] : 0;
            grid[u] = i + di;
            grid[v] = j + dj;
            return vertex(grid);
          };
          const auto add = [&](VertexId a, VertexId b, VertexId c) {
            surface.triangles.push_back(far ? std::array{a, b, c} : std::array{a, c, b});
          };
          // One after the other: compilers differ in the order of a call's arguments, and so would the vertices'.
          if ((i + j) % 2 == 0) {
            const VertexId c = at(1, 1), b = at(1, 0), a = at(0, 0), d = at(0, 1);
            add(a, b, c);
            add(a, c, d);
          } else {
            const VertexId d = at(0, 1), b = at(1, 0), a = at(0, 0), c = at(1, 1);
            add(a, b, d);
            add(b, c, d);
          }
        }
      }
    }
  }
  return surface;
}

}  // namespace

std::optional<PhantomKind> phantom_kind(std::string_view name) {
  if (name == "liver") return PhantomKind::kLiver;
  if (name == "cylinder") return PhantomKind::kCylinder;
  if (name == "slab") return PhantomKind::kSlab;
  return std::nullopt;
}

Surface make_phantom_surface(PhantomKind kind, std::size_t target_tets) {
  if (target_tets < kMinPhantomTets || target_tets > kMaxPhantomTets) {
    throw MeshError("a phantom of " + std::to_string(target_tets) + " tetrahedra cannot be made; " +
                    std::to_string(kMinPhantomTets) + " to " + std::to_string(kMaxPhantomTets) +
                    " are accepted");
  }
  switch (kind) {
    case PhantomKind::kLiver:
      return liver_surface(target_tets);
    case PhantomKind::kCylinder:
      return cylinder_surface(target_tets);
    case PhantomKind::kSlab:
      return slab_surface(target_tets);
  }
  INCISE_CHECK(false, static_cast<int>(kind));
  return {};
}

core::MeshData make_phantom(PhantomKind kind, const FillOptions& options,
                            std::vector<std::string>& warnings) {
  const std::string name = "phantom";
  const ClosedSurface closed = check_surface(make_phantom_surface(kind, options.target_tets), name, warnings);
  FillOptions tuned = options;
  tuned.target_tolerance = std::min(options.target_tolerance, 0.04);
  core::MeshData mesh = fill_surface(closed, name, tuned, warnings).mesh;
  repair_tets(mesh, name, 0, warnings);
  return mesh;
}

void add_capsule(core::MeshData& mesh, std::int32_t region) {
  mesh.regions.resize(mesh.tets.size(), 0);
  const core::TetMesh whole(mesh);
  for (core::TetId t = 0; t < mesh.tets.size(); ++t) {
    for (int face = 0; face < 4; ++face) {
      if (whole.neighbor(t, face) == core::kNone) mesh.regions[t] = region;
    }
  }
}

}  // namespace incise::mesh_io
