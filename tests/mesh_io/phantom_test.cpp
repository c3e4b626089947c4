#include "server/mesh_io/phantom.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>

#include "server/core/geometry/quality.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "tests/mesh_io/test_meshes.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;

struct Kind {
  PhantomKind kind;
  const char* name;
  int euler;      // of the surface: 2 - 2 genus
  double volume;  // m^3
};
const Kind kKinds[] = {{PhantomKind::kLiver, "liver", 0, 6.6e-4},
                       {PhantomKind::kCylinder, "cylinder", 2, std::numbers::pi * 0.025 * 0.025 * 0.1},
                       {PhantomKind::kSlab, "slab", 2, 1.2e-4}};

double smallest_angle_deg(const Surface& surface) {
  double smallest = 180;
  for (const auto& t : surface.triangles) {
    for (std::size_t i = 0; i < 3; ++i) {
      const core::Vec3 a = surface.positions[t[i]];
      const core::Vec3 u = core::normalized(surface.positions[t[(i + 1) % 3]] - a);
      const core::Vec3 v = core::normalized(surface.positions[t[(i + 2) % 3]] - a);
      smallest = std::min(smallest, std::acos(dot(u, v)) * 180 / std::numbers::pi);
    }
  }
  return smallest;
}

TEST(Phantom, NamesAndLimits) {
  for (const Kind& kind : kKinds) EXPECT_EQ(phantom_kind(kind.name), kind.kind);
  EXPECT_EQ(phantom_kind("heart"), std::nullopt);
  EXPECT_NE(error_of([] { make_phantom_surface(PhantomKind::kSlab, 100); }).find("500 to 20000000"),
            std::string::npos);
}

// Whatever compiler built it: a capture of a phantom can be replayed by a program of another.
TEST(Phantom, SurfacesAreTheSameEverywhere) {
  const std::uint64_t expected[] = {14277073622744793700U, 3677476303855278940U, 305669920023417640U};
  for (std::size_t i = 0; i < std::size(kKinds); ++i) {
    SCOPED_TRACE(kKinds[i].name);
    std::uint64_t sum = 0;
    for (const auto& t : make_phantom_surface(kKinds[i].kind, 3000).triangles) {
      for (const core::VertexId v : t) sum = 31 * sum + v;
    }
    EXPECT_EQ(sum, expected[i]);
  }
}

TEST(Phantom, SurfacesAreClosedManifoldAndWellShaped) {
  for (const Kind& kind : kKinds) {
    for (const std::size_t size : {500u, 4000u, 15000u, 60000u, 200000u}) {
      SCOPED_TRACE(std::string(kind.name) + " " + std::to_string(size));
      const Surface surface = make_phantom_surface(kind.kind, size);
      std::vector<std::string> warnings;
      const ClosedSurface closed = check_surface(surface, "phantom", warnings);
      EXPECT_TRUE(warnings.empty()) << warnings[0];
      EXPECT_NEAR(closed.volume / kind.volume, 1, 0.05);
      EXPECT_GT(smallest_angle_deg(surface), 30);
      const auto triangles = static_cast<long>(surface.triangles.size());
      EXPECT_EQ(static_cast<long>(surface.positions.size()) - triangles / 2, kind.euler);
    }
  }
}

TEST(Phantom, SameArgumentsGiveTheSameBits) {
  for (const Kind& kind : kKinds) {
    const Surface a = make_phantom_surface(kind.kind, 20000), b = make_phantom_surface(kind.kind, 20000);
    EXPECT_EQ(a.positions, b.positions);
    EXPECT_EQ(a.triangles, b.triangles);
  }
}

TEST(Phantom, LiverIsAsymmetrical) {
  const Surface surface = make_phantom_surface(PhantomKind::kLiver, 20000);
  core::Vec3 low = surface.positions[0], high = low, sum;
  for (const core::Vec3& p : surface.positions) {
    extend(p, low, high);
    sum += p;
  }
  EXPECT_GT(high.x - low.x, 0.15);
  EXPECT_LT(high.x - low.x, 0.20);
  const core::Vec3 middle = 0.5 * (low + high);
  const core::Vec3 mean = (1.0 / static_cast<double>(surface.positions.size())) * sum;
  EXPECT_GT(std::abs(mean.x - middle.x), 0.005);
}

TEST(Phantom, FilledToTheSizeWanted) {
  for (const Kind& kind : kKinds) {
    SCOPED_TRACE(kind.name);
    FillOptions options;
    options.use_cache = false;
    options.target_tets = 15'000;
    std::vector<std::string> warnings;
    const core::MeshData mesh = make_phantom(kind.kind, options, warnings);
    EXPECT_TRUE(warnings.empty()) << warnings[0];
    EXPECT_NEAR(static_cast<double>(mesh.tets.size()), 15'000, 0.05 * 15'000);
    EXPECT_EQ(core::validate(core::TetMesh(mesh)), "");
    double worst = -2;
    for (const auto& t : mesh.tets) {
      const auto& p = mesh.positions;
      worst = std::max(worst, core::worst_dihedral(p[t[0]], p[t[1]], p[t[2]], p[t[3]]));
    }
    EXPECT_GT(core::measure_to_degrees(worst), 6);
    EXPECT_EQ(mesh_hash(make_phantom(kind.kind, options, warnings)), mesh_hash(mesh));
  }
}

}  // namespace
}  // namespace incise::mesh_io
