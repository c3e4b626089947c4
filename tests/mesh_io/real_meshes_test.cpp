// The meshes and surfaces of other people, found by INCISE_DATA: what is good loads as it is, what is bad is
// refused.

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>

#include "server/core/geometry/quality.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "tests/mesh_io/test_meshes.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;

class RealMeshes : public ::testing::Test {
 protected:
  void SetUp() override {
    if (real_meshes().empty()) GTEST_SKIP() << "set INCISE_DATA to the directory of real meshes";
  }
};

struct TetFile {
  const char* name;
  std::size_t vertices, tets;
  double least_angle_deg, most_least_angle_deg;  // bounds of the smallest dihedral angle
  const char* warning;                           // of the only one; nullptr: none
};

const TetFile kTetFiles[] = {
    {"armadillo_3717", 1180, 3717, 2.4, 2.6, nullptr},
    {"brain_81833", 23737, 81833, 0, 90, "all 81833 tetrahedra are left-handed"},
    {"bunny_27226", 6091, 27226, 0, 90, nullptr},
    {"intestine_52567", 13662, 52567, 0, 90, nullptr},
    {"liver_6564", 2013, 6564, 0.052, 0.054, nullptr},
    {"liver_80298", 13354, 80298, 0, 90, nullptr},
    {"seed_1720", 1721, 7864, 8.3, 8.5, nullptr},
    {"seed_3234", 3236, 15281, 7.9, 8.1, nullptr},
    {"wound_1476", 391, 1476, 0, 90, nullptr},
    {"bullet_ditto.vtk", 2580, 10415, 12.9, 13.1, nullptr},
    {"sofa_liver2.msh", 507, 1493, 13.3, 13.5, nullptr},
    {"sofa_volumetricTongue.vtu", 2238, 10980, 0.9, 1.1, nullptr},
    {"sofahaptic_organs_liver.msh", 2013, 6564, 0.052, 0.054, nullptr},
    {"tetcutter_whitematter.veg", 23737, 81833, 2.4, 2.5, "all 81833 tetrahedra are left-handed"},
};

TEST_F(RealMeshes, TetrahedralMeshesLoad) {
  for (const TetFile& file : kTetFiles) {
    SCOPED_TRACE(file.name);
    const LoadedMesh loaded = load_mesh(real_meshes() / file.name);
    EXPECT_EQ(loaded.mesh.positions.size(), file.vertices);
    EXPECT_EQ(loaded.mesh.tets.size(), file.tets);
    EXPECT_EQ(core::validate(core::TetMesh(loaded.mesh)), "");
    double worst = -core::kInverted;
    for (const auto& t : loaded.mesh.tets) {
      const auto& p = loaded.mesh.positions;
      worst = std::max(worst, core::worst_dihedral(p[t[0]], p[t[1]], p[t[2]], p[t[3]]));
    }
    EXPECT_GE(core::measure_to_degrees(worst), file.least_angle_deg);
    EXPECT_LE(core::measure_to_degrees(worst), file.most_least_angle_deg);
    EXPECT_EQ(loaded.warnings.size(), file.warning ? 1u : 0u);
    if (file.warning && !loaded.warnings.empty()) {
      EXPECT_NE(loaded.warnings[0].find(file.warning), std::string::npos) << loaded.warnings[0];
    }
  }
}

TEST_F(RealMeshes, SurfacesAreFilled) {
  for (const char* name : {"sofahaptic_organs_liver.obj", "ftetwild_bunny.off", "sofa_aneurysm3D_1.off"}) {
    SCOPED_TRACE(name);
    LoadOptions options;
    options.fill.use_cache = false;
    options.fill.target_tets = 60'000;
    LoadedMesh loaded = load_mesh(real_meshes() / name, options);
    EXPECT_NEAR(static_cast<double>(loaded.mesh.tets.size()), 60'000, 0.25 * 60'000);
    // The liver came without its materials, and some triangles are large.
    std::erase_if(loaded.warnings, [](const std::string& w) {
      return w.find("mtllib") != w.npos || w.find(" tetrahedra are split") != w.npos;
    });
    EXPECT_EQ(core::validate(core::TetMesh(loaded.mesh)), "");
    EXPECT_TRUE(loaded.warnings.empty()) << loaded.warnings[0];
  }
}

TEST_F(RealMeshes, SelfIntersectingSurfaceIsRefused) {
  const std::string error = error_of([] { load_mesh(real_meshes() / "sofa_liver-smooth.obj"); });
  // TetGen -d lists 16 lines for the same seven pairs.
  EXPECT_NE(
      error.find("sofa_liver-smooth.obj: the surface intersects itself: 7 pairs of triangles cross or touch "
                 "(triangles 810 and 811 near ("),
      std::string::npos)
      << error;
}

TEST_F(RealMeshes, OpenAndNonManifoldSurfaceIsRefused) {
  const std::string error = error_of([] { load_mesh(real_meshes() / "sofa_dragon.stl"); });
  EXPECT_NE(error.find("sofa_dragon.stl: the surface is open: 26 edges have one triangle only"),
            std::string::npos)
      << error;
  EXPECT_NE(error.find("; and non-manifold: 97 edges have more than two triangles"), std::string::npos)
      << error;
}

// Without Y TetGen refines this surface for ever.
TEST_F(RealMeshes, EndlessFillIsStopped) {
  LoadOptions options;
  options.fill.use_cache = false;
  options.fill.tetgen_switches = "pq1.4";
  options.fill.time_limit = std::chrono::seconds(3);
  const std::string error = error_of([&] { load_mesh(real_meshes() / "sofa_aneurysm3D_1.off", options); });
  EXPECT_NE(error.find("sofa_aneurysm3D_1.off: TetGen (switches pq1.4a"), std::string::npos) << error;
  EXPECT_NE(error.find("was stopped after 3 s"), std::string::npos) << error;
}

}  // namespace
}  // namespace incise::mesh_io
