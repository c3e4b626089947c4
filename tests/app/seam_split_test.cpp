// A painted sphere, and another mesh of the same sphere whose triangles reach over the seams of its texture.
#include "server/app/offline/seam_split.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "server/app/surface_asset.hpp"
#include "server/mesh_io/surface_check.hpp"

namespace incise::app {
namespace {

using core::Vec3;
using mesh_io::Surface;

constexpr double kRadius_m = 0.1;
constexpr double kTexture_m = 0.4;  // on the sphere, for 1 in the texture

// An octahedron divided so often, turned around z.
Surface sphere(int divisions, double turn) {
  std::vector<std::array<Vec3, 3>> faces;
  for (const double x : {-1.0, 1.0})
    for (const double y : {-1.0, 1.0})
      for (const double z : {-1.0, 1.0})
        faces.push_back(x * y * z > 0 ? std::array{Vec3{x, 0, 0}, Vec3{0, y, 0}, Vec3{0, 0, z}}
                                      : std::array{Vec3{0, y, 0}, Vec3{x, 0, 0}, Vec3{0, 0, z}});
  for (int i = 0; i < divisions; ++i) {
    std::vector<std::array<Vec3, 3>> finer;
    for (const auto& [a, b, c] : faces) {
      const Vec3 ab = normalized(a + b), bc = normalized(b + c), ca = normalized(c + a);
      finer.insert(finer.end(), {{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}});
    }
    faces = std::move(finer);
  }
  Surface surface;
  std::map<std::array<long, 3>, core::VertexId> known;
  for (const auto& face : faces) {
    std::array<core::VertexId, 3> triangle{};
    for (std::size_t k = 0; k < 3; ++k) {
      const Vec3& p = face[k];
      const auto [place, is_new] =
          known.try_emplace({std::lround(1e6 * p.x), std::lround(1e6 * p.y), std::lround(1e6 * p.z)},
                            static_cast<core::VertexId>(known.size()));
      triangle[k] = place->second;
      if (is_new)
        surface.positions.push_back(kRadius_m * Vec3{std::cos(turn) * p.x - std::sin(turn) * p.y,
                                                     std::sin(turn) * p.x + std::cos(turn) * p.y, p.z});
    }
    surface.triangles.push_back(triangle);
  }
  return surface;
}

// Two charts, one around each end of the x axis; the seam between them follows the triangles. Lengths from the axis are kept.
Surface painted(Surface surface) {
  for (const auto& t : surface.triangles) {
    const bool right = (surface.positions[t[0]] + surface.positions[t[1]] + surface.positions[t[2]]).x > 0;
    for (const core::VertexId v : t) {
      const Vec3& p = surface.positions[v];
      const double off = std::hypot(p.y, p.z);
      const double length = kRadius_m * std::atan2(off, right ? p.x : -p.x) / kTexture_m;
      const double scale = off > 0 ? length / off : 0;
      surface.look.uvs.push_back(
          {static_cast<float>((right ? 0.0 : 2.0) + scale * p.y), static_cast<float>(scale * p.z)});
    }
  }
  return surface;
}

class SeamSplit : public ::testing::Test {
 protected:
  // Corners of outside triangles, each with how far its texture coordinates are from any chart, in lengths of the triangle.
  std::vector<double> off_chart(const CutSurface& cut, const std::vector<Vec3>& rest) const {
    std::vector<double> positions;
    std::vector<std::uint32_t> triangles;
    for (const auto& uv : from_.look.uvs) {
      triangles.push_back(static_cast<std::uint32_t>(triangles.size()));
      positions.insert(positions.end(), {kTexture_m * static_cast<double>(uv[0]),
                                         kTexture_m * static_cast<double>(uv[1]), 0.0});
    }
    const protocol::OriginTree charts(positions, triangles);
    std::vector<double> out;
    for (std::size_t t = 0; t < cut.surface.triangles.size(); ++t) {
      if (cut.cut[t] != 0) continue;
      protocol::Corners corners;
      double size = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        const Vec3 &p = rest[cut.surface.triangles[t][k]], &q = rest[cut.surface.triangles[t][(k + 1) % 3]];
        corners[k] = {p.x, p.y, p.z};
        size = std::max(size, length(q - p));
      }
      const auto uvs = lookup_.uvs(cut.origins[t], corners);
      EXPECT_TRUE(uvs);
      for (const auto& uv : *uvs) {
        const protocol::Vec3 at{kTexture_m * static_cast<double>(uv[0]),
                                kTexture_m * static_cast<double>(uv[1]), 0};
        const std::uint32_t nearest = charts.origin_of({at, at, at});
        protocol::Corners chart;
        for (std::size_t k = 0; k < 3; ++k)
          chart[k] = {positions[9 * nearest + 3 * k], positions[9 * nearest + 3 * k + 1], 0};
        const auto weights = protocol::barycentric(chart, at);
        double off = 0;
        for (std::size_t k = 0; k < 3; ++k) {
          const Vec3 a{chart[k].x, chart[k].y, 0}, b{chart[(k + 1) % 3].x, chart[(k + 1) % 3].y, 0},
              c{chart[(k + 2) % 3].x, chart[(k + 2) % 3].y, 0};
          off = std::max(off, -weights[k] * length(cross(b - a, c - a)) / length(c - b));
        }
        out.push_back(off / size);
      }
    }
    return out;
  }

  static std::size_t over_a_tenth(const std::vector<double>& off) {
    return static_cast<std::size_t>(std::count_if(off.begin(), off.end(), [](double x) { return x > 0.1; }));
  }

  // `opened`: triangles below are cut faces, which have no texture.
  void split(bool opened) {
    cut_.surface = sphere(4, 0.3);
    rest_ = cut_.surface.positions;
    faces_.assign(cut_.surface.triangles.size(), 0);
    for (std::size_t t = 0; t < faces_.size(); ++t) {
      faces_[t] = static_cast<core::HalfFace>(t);
      protocol::Corners corners;
      Vec3 middle;
      for (std::size_t k = 0; k < 3; ++k) {
        const Vec3& p = rest_[cut_.surface.triangles[t][k]];
        corners[k] = {p.x, p.y, p.z};
        middle = middle + p;
      }
      cut_.cut.push_back(opened && middle.z < 0 ? 1 : 0);
      cut_.pieces.push_back(middle.y > 0 ? 1 : 0);
      cut_.origins.push_back(cut_.cut.back() != 0 ? core::kNone : tree_->origin_of(corners));
    }
    before_ = cut_;
    split_at_seams(lookup_, *tree_, rest_, faces_, cut_);
  }

  const Surface from_ = painted(sphere(5, 0));
  const protocol::SurfaceAsset asset_ = asset_of(from_);
  const protocol::SurfaceLookup lookup_{asset_};
  const std::shared_ptr<const protocol::OriginTree> tree_ = origin_tree(&from_);
  CutSurface cut_, before_;
  std::vector<Vec3> rest_;
  std::vector<core::HalfFace> faces_;
};

TEST_F(SeamSplit, NoCornerTakesItsTextureFromBeyondTheChart) {
  for (const bool opened : {false, true}) {
    cut_ = {};
    split(opened);
    EXPECT_GT(over_a_tenth(off_chart(before_, rest_)), 20u) << "the case is one";
    EXPECT_EQ(over_a_tenth(off_chart(cut_, rest_)), 0u);
    EXPECT_GT(cut_.surface.triangles.size(), before_.surface.triangles.size());
    EXPECT_LT(cut_.surface.triangles.size(), 2 * before_.surface.triangles.size())
        << "only what is at the seam";

    // The same shape, still closed, each part with what its triangle had.
    std::vector<std::string> warnings;
    EXPECT_NEAR(mesh_io::check_surface(cut_.surface, "it", warnings).volume,
                mesh_io::signed_volume(before_.surface), 1e-12);
    EXPECT_TRUE(warnings.empty()) << warnings[0];
    ASSERT_EQ(rest_.size(), cut_.surface.positions.size());
    ASSERT_EQ(faces_.size(), cut_.surface.triangles.size());
    ASSERT_EQ(cut_.origins.size(), faces_.size());
    for (std::size_t t = 0; t < faces_.size(); ++t) {
      EXPECT_EQ(cut_.cut[t], before_.cut[faces_[t]]);
      EXPECT_EQ(cut_.pieces[t], before_.pieces[faces_[t]]);
      EXPECT_EQ(cut_.origins[t] == core::kNone, cut_.cut[t] != 0);
    }
  }
}

// What has been split has nothing to split.
TEST_F(SeamSplit, TwiceIsAsOnce) {
  split(false);
  const std::size_t once = cut_.surface.triangles.size();
  split_at_seams(lookup_, *tree_, rest_, faces_, cut_);
  EXPECT_LE(cut_.surface.triangles.size(), once + once / 50);
}

}  // namespace
}  // namespace incise::app
