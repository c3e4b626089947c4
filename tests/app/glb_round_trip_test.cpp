// What write_glb writes is what read_surface reads: places, seams, colours, materials and images.

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <memory>

#include "server/app/offline/cut_surface.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/surface_check.hpp"
#include "tests/support/images.hpp"

namespace incise::app {
namespace {

using mesh_io::Surface;

// Two cubes, pieces of their own, 0.1 m wide: the first with material 0 below and 1 above, the second with "inside".
CutSurface two_cubes() {
  constexpr std::array<core::VertexId, 3> kTriangles[] = {{0, 2, 3}, {0, 3, 1}, {4, 5, 7}, {4, 7, 6},
                                                          {0, 1, 5}, {0, 5, 4}, {2, 6, 7}, {2, 7, 3},
                                                          {0, 4, 6}, {0, 6, 2}, {1, 3, 7}, {1, 7, 5}};
  CutSurface cut;
  Surface& surface = cut.surface;
  auto png = std::make_shared<const std::string>(tests::tiny_png());
  auto webp = std::make_shared<const std::string>(tests::tiny_webp());
  surface.look.materials = {{"painted", {1, 1, 1}, png, "image/png"},
                            {"painted again", {1, 1, 1}, png, "image/png"},
                            {"lid, \"shut\"", {1, 1, 1}, webp, "image/webp"},
                            {"inside", {0.9f, 0.8f, 0.1f}, nullptr, {}}};
  for (std::uint32_t piece = 0; piece < 2; ++piece) {
    const auto base = static_cast<core::VertexId>(surface.positions.size());
    for (int i = 0; i < 8; ++i) {
      const auto at = [&](int axis) { return static_cast<double>(0.1f * static_cast<float>(i >> axis & 1)); };
      surface.positions.push_back({at(0) + piece, at(1), at(2)});
    }
    for (std::uint32_t t = 0; t < 12; ++t) {
      surface.triangles.push_back(
          {base + kTriangles[t][0], base + kTriangles[t][1], base + kTriangles[t][2]});
      for (std::uint32_t k = 0; k < 3; ++k) {
        const auto side = static_cast<float>(t / 2);  // each has its own strip of the texture
        surface.look.uvs.push_back({side / 8 + static_cast<float>(k) / 32, piece == 0 ? 0.25f : 0.875f});
        const auto shade = static_cast<std::uint8_t>(20 * t + k);
        surface.look.colours.push_back({shade, 255, 0, static_cast<std::uint8_t>(255 - shade)});
      }
      surface.look.material_of.push_back(piece == 1 ? 3 : t / 4);
      cut.cut.push_back(0);
      cut.pieces.push_back(piece);
      cut.origins.push_back(t);
    }
  }
  return cut;
}

TEST(GlbRoundTrip, EverythingComesBackWhereItWas) {
  const CutSurface cut = two_cubes();
  const auto path =
      std::filesystem::temp_directory_path() / ("incise-" + std::to_string(::getpid()) + ".glb");
  write_glb(path, cut);
  std::vector<std::string> warnings;
  const Surface read = mesh_io::read_surface(path, warnings);
  std::filesystem::remove(path);
  EXPECT_EQ(read.positions.size(), 16u);
  ASSERT_EQ(read.triangles.size(), 24u);
  ASSERT_EQ(read.look.uvs.size(), 72u);
  ASSERT_EQ(read.look.colours.size(), 72u);
  EXPECT_NEAR(mesh_io::check_surface(read, "FILE", warnings).volume, 2e-3, 1e-9);
  EXPECT_TRUE(warnings.empty()) << warnings[0];

  // Triangles by what is at their corners, since those of one material come together.
  const auto described = [](const Surface& surface) {
    std::map<std::vector<double>, std::string> out;
    for (std::size_t t = 0; t < surface.triangles.size(); ++t) {
      std::vector<double> facts;
      for (std::size_t k = 0; k < 3; ++k) {
        const core::Vec3& p = surface.positions[surface.triangles[t][k]];
        for (const double x : {p.x, p.y, p.z}) facts.push_back(static_cast<double>(static_cast<float>(x)));
        for (const float x : surface.look.uvs[3 * t + k]) facts.push_back(static_cast<double>(x));
        for (const auto x : surface.look.colours[3 * t + k]) facts.push_back(x);
      }
      out[facts] = surface.look.materials[surface.look.material_of[t]].name;
    }
    return out;
  };
  EXPECT_EQ(described(read), described(cut.surface));

  ASSERT_EQ(read.look.materials.size(), 4u);
  for (const mesh_io::Material& material : cut.surface.look.materials) {
    const auto same = std::find_if(read.look.materials.begin(), read.look.materials.end(),
                                   [&](const mesh_io::Material& m) { return m.name == material.name; });
    ASSERT_NE(same, read.look.materials.end()) << material.name;
    EXPECT_EQ(same->image_type, material.image_type);
    ASSERT_EQ(same->image == nullptr, material.image == nullptr) << material.name;
    if (material.image) {
      EXPECT_EQ(*same->image, *material.image);
    }
    for (std::size_t k = 0; k < 3; ++k)
      EXPECT_NEAR(same->diffuse[k], material.diffuse[k], 1e-6) << material.name;
  }
  EXPECT_EQ(read.look.materials[0].image, read.look.materials[1].image) << "one image, not two alike";
}

}  // namespace
}  // namespace incise::app
