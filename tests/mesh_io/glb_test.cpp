// Binary glTF: built here byte by byte, as other programs write it. (tests/app/glb_round_trip_test.cpp reads what Incise writes.)

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>
#include <random>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/surface_check.hpp"
#include "tests/mesh_io/test_meshes.hpp"
#include "tests/support/images.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;
using core::Vec3;
using Json = nlohmann::json;

const std::string kPng = tests::tiny_png();

template <class T>
void put(std::string& bytes, std::initializer_list<T> values) {
  for (const T value : values) bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

struct Glb {
  Json json = {{"asset", {{"version", "2.0"}}}, {"scene", 0}};
  std::string data;

  // Adds these bytes as a view, and an accessor of it. Its number.
  std::size_t add(const std::string& bytes, int type, const char* kind, std::size_t count,
                  bool normalized = false) {
    json["accessors"].push_back(
        {{"bufferView", view(bytes)}, {"componentType", type}, {"type", kind}, {"count", count}});
    if (normalized) json["accessors"].back()["normalized"] = true;
    return json["accessors"].size() - 1;
  }
  std::size_t view(const std::string& bytes) {
    data.resize((data.size() + 3) / 4 * 4);
    json["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", data.size()}, {"byteLength", bytes.size()}});
    data += bytes;
    return json["bufferViews"].size() - 1;
  }
  std::string bytes() const {
    Json whole = json;
    if (!whole.contains("buffers")) whole["buffers"] = {{{"byteLength", data.size()}}};
    return of(whole.dump(), data);
  }
  static std::string of(std::string text, std::string data) {
    text.resize((text.size() + 3) / 4 * 4, ' ');
    data.resize((data.size() + 3) / 4 * 4);
    std::string out = "glTF";
    put<std::uint32_t>(out, {2, static_cast<std::uint32_t>(28 + text.size() + data.size()),
                             static_cast<std::uint32_t>(text.size())});
    out += "JSON" + text;
    put<std::uint32_t>(out, {static_cast<std::uint32_t>(data.size())});
    return out + std::string("BIN\0", 4) + data;
  }
};

// Corner k of side `side` of the unit cube, counter-clockwise from outside.
Vec3 place(int side, int k) {
  const double a = k == 1 || k == 2, b = k >= 2;
  const double end = side % 2;
  // Sides at 0 are seen from behind.
  const double u = end > 0 ? a : b, v = end > 0 ? b : a;
  return side / 2 == 0 ? Vec3{end, u, v} : side / 2 == 1 ? Vec3{v, end, u} : Vec3{u, v, end};
}

// The unit cube as six quads, each with vertices and texture coordinates of its own: seams everywhere. v is 0.25 at corners 0 and 1, 0.75 else,
// downwards.
Glb cube_glb() {
  Glb glb;
  std::string positions, normals, uvs, indices;
  for (int side = 0; side < 6; ++side) {
    for (int k = 0; k < 4; ++k) {
      const Vec3 p = place(side, k);
      put<float>(positions, {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)});
      float n[3] = {0, 0, 0};
      n[side / 2] = side % 2 ? 1.0f : -1.0f;
      put<float>(normals, {n[0], n[1], n[2]});
      put<float>(uvs, {static_cast<float>(side), k < 2 ? 0.25f : 0.75f});
    }
    const auto v = static_cast<std::uint16_t>(4 * side);
    for (const int k : {0, 1, 2, 0, 2, 3}) put<std::uint16_t>(indices, {static_cast<std::uint16_t>(v + k)});
  }
  const std::size_t position = glb.add(positions, 5126, "VEC3", 24),
                    normal = glb.add(normals, 5126, "VEC3", 24), uv = glb.add(uvs, 5126, "VEC2", 24),
                    index = glb.add(indices, 5123, "SCALAR", 36);
  glb.json["images"] = {{{"bufferView", glb.view(kPng)}, {"mimeType", "image/png"}}};
  glb.json["textures"] = {{{"source", 0}}};
  glb.json["materials"] = {{{"name", "unused"}},
                           {{"name", "liver"},
                            {"pbrMetallicRoughness",
                             {{"baseColorFactor", {1, 0.5, 0, 1}}, {"baseColorTexture", {{"index", 0}}}}}}};
  glb.json["meshes"] = {{{"primitives",
                          {{{"attributes", {{"POSITION", position}, {"NORMAL", normal}, {"TEXCOORD_0", uv}}},
                            {"indices", index},
                            {"material", 1}}}}}};
  glb.json["nodes"] = {{{"mesh", 0}}};
  glb.json["scenes"] = {{{"nodes", {0}}}};
  return glb;
}

Json& primitive(Glb& glb) {
  return glb.json["meshes"][0]["primitives"][0];
}

class GlbFiles : public ::testing::Test {
 protected:
  Surface read(const std::string& bytes) {
    warnings_.clear();
    return read_surface(directory_.write("a.glb", bytes), warnings_);
  }
  Surface read(const Glb& glb) { return read(glb.bytes()); }
  // Reads a file without a warning whose surface is closed, as it is, and encloses this.
  Surface closed(const Glb& glb, double volume) {
    Surface surface = read(glb);
    EXPECT_NEAR(check_surface(surface, "FILE", warnings_).volume, volume, 1e-12);
    EXPECT_TRUE(warnings_.empty()) << warnings_[0];
    return surface;
  }
  std::string error(const std::string& bytes) {
    const std::string text = error_of([&] { read(bytes); });
    EXPECT_NE(text.find("/a.glb: "), std::string::npos) << text;
    EXPECT_TRUE(std::all_of(text.begin(), text.end(), [](char c) { return c >= ' ' && c <= '~'; })) << text;
    return text;
  }

  const TestDirectory directory_;
  std::vector<std::string> warnings_;
};

std::pair<Vec3, Vec3> box(const Surface& surface) {
  Vec3 low = surface.positions.at(0), high = low;
  for (const Vec3& p : surface.positions) core::extend(p, low, high);
  return {low, high};
}

void expect_normals_of_faces(const Surface& surface) {
  ASSERT_EQ(surface.look.normals.size(), 3 * surface.triangles.size());
  for (std::size_t i = 0; i < surface.look.normals.size(); ++i) {
    const auto& t = surface.triangles[i / 3];
    const Vec3 face = normalized(cross(surface.positions[t[1]] - surface.positions[t[0]],
                                       surface.positions[t[2]] - surface.positions[t[0]]));
    const auto& n = surface.look.normals[i];
    EXPECT_NEAR(dot(face, {n[0], n[1], n[2]}), 1, 1e-6) << "corner " << i;
  }
}

TEST_F(GlbFiles, ACubeOfSeparateQuadsIsClosedAndKeepsItsSeams) {
  const Surface surface = closed(cube_glb(), 1);
  EXPECT_EQ(surface.positions.size(), 8u);
  ASSERT_EQ(surface.triangles.size(), 12u);
  ASSERT_EQ(surface.look.uvs.size(), 36u);
  for (std::size_t i = 0; i < 36; ++i) {
    const std::size_t k = std::array{0, 1, 2, 0, 2, 3}[i % 6];
    EXPECT_EQ(surface.look.uvs[i], (std::array<float, 2>{static_cast<float>(i / 6), k < 2 ? 0.75f : 0.25f}));
    const Vec3 p = place(static_cast<int>(i / 6), static_cast<int>(k));
    EXPECT_EQ(surface.positions[surface.triangles[i / 3][i % 3]], (Vec3{p.x, -p.z, p.y})) << "z is up";
  }
  expect_normals_of_faces(surface);
  ASSERT_EQ(surface.look.materials.size(), 1u) << "only what is used";
  const Material& material = surface.look.materials[0];
  EXPECT_EQ(material.name, "liver");
  EXPECT_EQ(material.diffuse[0], 1);
  EXPECT_NEAR(material.diffuse[1], 0.735357, 1e-5) << "sRGB of 0.5";
  EXPECT_EQ(*material.image, kPng);
  EXPECT_EQ(material.image_type, "image/png");
  EXPECT_EQ(surface.look.material_of, std::vector<std::uint32_t>(12, 0));
  EXPECT_TRUE(surface.look.colours.empty());
}

TEST_F(GlbFiles, NodesMoveTheirMeshes) {
  Glb glb = cube_glb();
  const double h = std::sqrt(0.5);
  // Twice as large, a quarter about y, moved; below it once as it is, once by a matrix that mirrors and stretches it.
  glb.json["nodes"] = {
      {{"children", {1, 2}}, {"translation", {1, 2, 3}}, {"rotation", {0, h, 0, h}}, {"scale", {2, 2, 2}}},
      {{"mesh", 0}},
      {{"mesh", 0}, {"matrix", {-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 3, 0, -5, 0, 0, 1}}},
      {{"mesh", 0}}};
  const Surface both = closed(glb, 8 + 24);
  EXPECT_EQ(both.positions.size(), 16u);
  expect_normals_of_faces(both);
  glb.json["nodes"][0]["children"] = {1};
  const Surface one = closed(glb, 8);
  EXPECT_EQ(box(one), (std::pair{Vec3{1, -3, 2}, Vec3{3, -1, 4}}));
  // (1, 0, 0), corner 0 of side 1: twice, turned to (0, 0, -2), moved to (1, 2, 1), upright.
  EXPECT_EQ(one.positions[one.triangles[2][0]], (Vec3{1, -1, 2}));
  glb.json["nodes"][0]["children"] = {2};
  const Surface mirrored = closed(glb, 24);
  expect_normals_of_faces(mirrored);
  // The corners were turned with their texture coordinates: (1, 0, 0) is at (-6, 0, 0) in the parent, z = 3 + 12.
  for (std::size_t i = 0; i < 36; ++i) {
    if (mirrored.look.uvs[i] != std::array<float, 2>{1, 0.75f}) continue;
    EXPECT_EQ(mirrored.positions[mirrored.triangles[i / 3][i % 3]].y, -15);
  }
  // Without a scene every node is shown: here the first's child 2, and 1 and 3, which lie beside it.
  glb.json["nodes"][3]["translation"] = {9, 9, 9};
  glb.json.erase("scenes");
  EXPECT_EQ(closed(glb, 24 + 1 + 1).positions.size(), 24u);
}

TEST_F(GlbFiles, SmallerTypesInterleavedDataAndNoIndices) {
  Glb glb = cube_glb();
  // Colours and texture coordinates side by side, of bytes.
  std::string side_by_side;
  for (int v = 0; v < 24; ++v) put<std::uint8_t>(side_by_side, {0, 188, 255, 51, 255, 0, 7, 7});
  const std::size_t colour = glb.add(side_by_side, 5121, "VEC4", 24, true);
  const std::size_t together = glb.json["bufferViews"].size() - 1;
  glb.json["bufferViews"][together]["byteStride"] = 8;
  glb.json["accessors"].push_back({{"bufferView", together},
                                   {"byteOffset", 4},
                                   {"componentType", 5121},
                                   {"normalized", true},
                                   {"type", "VEC2"},
                                   {"count", 24}});
  primitive(glb)["attributes"]["COLOR_0"] = colour;
  primitive(glb)["attributes"]["TEXCOORD_0"] = colour + 1;
  std::string small, large;
  for (std::uint8_t side = 0; side < 6; ++side)
    for (const int k : {0, 1, 2, 0, 2, 3}) {
      put<std::uint8_t>(small, {static_cast<std::uint8_t>(4 * side + k)});
      put<std::uint32_t>(large, {static_cast<std::uint32_t>(4 * side + k)});
    }
  primitive(glb)["indices"] = glb.add(small, 5121, "SCALAR", 36);
  const Surface surface = closed(glb, 1);
  EXPECT_EQ(surface.look.uvs, (std::vector<std::array<float, 2>>(36, {1, 1})));
  // Linear light of 188 / 255 is 223 in sRGB; alpha stays.
  EXPECT_EQ(surface.look.colours, (std::vector<std::array<std::uint8_t, 4>>(36, {0, 223, 255, 51})));
  primitive(glb)["indices"] = glb.add(large, 5125, "SCALAR", 36);
  EXPECT_EQ(closed(glb, 1).triangles, surface.triangles);

  Glb loose = cube_glb();
  std::string positions, colours, uvs;
  for (int side = 0; side < 6; ++side)
    for (const int k : {0, 1, 2, 0, 2, 3}) {
      const Vec3 p = place(side, k);
      put<float>(positions, {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)});
      put<float>(colours, {1, 0.5f, 0});
      put<std::uint16_t>(uvs, {65535, 0});
    }
  primitive(loose) = {{"attributes",
                       {{"POSITION", loose.add(positions, 5126, "VEC3", 36)},
                        {"COLOR_0", loose.add(colours, 5126, "VEC3", 36)},
                        {"TEXCOORD_0", loose.add(uvs, 5123, "VEC2", 36, true)}}}};
  const Surface plain = closed(loose, 1);
  EXPECT_EQ(plain.look.colours, (std::vector<std::array<std::uint8_t, 4>>(36, {255, 188, 0, 255})));
  EXPECT_EQ(plain.look.uvs, (std::vector<std::array<float, 2>>(36, {1, 1})));
  EXPECT_TRUE(plain.look.normals.empty());
  EXPECT_TRUE(plain.look.materials.empty() && plain.look.material_of.empty());
}

TEST_F(GlbFiles, PrimitivesWithAndWithoutAMaterial) {
  Glb glb = cube_glb();
  // Sides 0 to 2 without anything, 3 to 5 with all; texture coordinates of the second set.
  Json& primitives = glb.json["meshes"][0]["primitives"];
  primitives.push_back(primitives[0]);
  for (const std::size_t i : {0u, 1u}) {
    Json half = glb.json["accessors"][3];
    half["count"] = 18;
    half["byteOffset"] = 36 * i;
    primitives[i]["indices"] = glb.json["accessors"].size();
    glb.json["accessors"].push_back(half);
  }
  primitives[0]["attributes"] = {{"POSITION", 0}};
  primitives[0].erase("material");
  primitives[1]["attributes"]["TEXCOORD_1"] = primitives[1]["attributes"]["TEXCOORD_0"];
  primitives[1]["attributes"].erase("TEXCOORD_0");
  glb.json["materials"][1]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = 1;
  const Surface surface = closed(glb, 1);
  ASSERT_EQ(surface.look.materials.size(), 2u);
  EXPECT_EQ(surface.look.materials[0].name, "liver");
  EXPECT_EQ(surface.look.materials[1].name, "");
  EXPECT_EQ(surface.look.material_of, (std::vector<std::uint32_t>{1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0}));
  ASSERT_EQ(surface.look.uvs.size(), 36u);
  EXPECT_EQ(surface.look.uvs[17], (std::array<float, 2>{0, 0}));
  EXPECT_EQ(surface.look.uvs[18], (std::array<float, 2>{3, 0.75f}));
  EXPECT_EQ(surface.look.normals.size(), 36u);
  std::swap(primitives[0], primitives[1]);
  EXPECT_EQ(closed(glb, 1).look.uvs.size(), 36u);
}

// As where a formula makes the sides of a seam: sin(2 pi) is not 0.
TEST_F(GlbFiles, SeamsThatDifferByARoundingAreJoined) {
  Glb glb = cube_glb();
  const auto move = [&](std::size_t number, float by) {
    float x;
    std::memcpy(&x, glb.data.data() + 4 * number, 4);
    x += by;
    std::memcpy(glb.data.data() + 4 * number, &x, 4);
  };
  move(0, 2e-16f);
  move(12 + 1, -1e-7f);
  const Surface surface = read(glb);
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_NE(warnings_[0].find("2 vertices on open edges became one with another"), std::string::npos)
      << warnings_[0];
  EXPECT_EQ(surface.positions.size(), 8u);
  EXPECT_EQ(surface.look.uvs.size(), 36u);
  EXPECT_NEAR(check_surface(surface, "FILE", warnings_).volume, 1, 1e-6);
  move(0, 1e-5f);
  const Surface gap = read(glb);
  EXPECT_NE(error_of([&] { check_surface(gap, "FILE", warnings_); }).find("the surface is open"),
            std::string::npos);
}

TEST_F(GlbFiles, ImagesThatCannotBeShownAreAWarning) {
  const auto warning = [&](const Json& image) {
    Glb glb = cube_glb();
    glb.json["images"][0] = image;
    const Surface surface = read(glb);
    EXPECT_EQ(surface.triangles.size(), 12u);
    EXPECT_EQ(surface.look.materials.at(0).image, nullptr);
    EXPECT_EQ(warnings_.size(), 1u);
    return warnings_.empty() ? "" : warnings_[0];
  };
  EXPECT_NE(warning({{"bufferView", 0}}).find("image 0 is not a PNG, JPEG or WebP image"), std::string::npos);
  EXPECT_NE(warning({{"uri", "data:image/png;base64,iVBORw0KGgo="}}).find("data URI"), std::string::npos);
  EXPECT_NE(warning({{"uri", "none.png"}}).find("none.png"), std::string::npos);
  EXPECT_NE(warning({{"uri", "%2e%2e/secret.png"}}).find("'../secret.png'"), std::string::npos);
  Glb glb = cube_glb();
  directory_.write("a b.png", kPng);
  glb.json["images"][0] = {{"uri", "a%20b.png"}};
  EXPECT_EQ(*closed(glb, 1).look.materials.at(0).image, kPng);
  glb = cube_glb();
  glb.json["textures"][0] = {{"extensions", {{"EXT_texture_webp", {{"source", 0}}}}}};
  glb.json["extensionsRequired"] = {"EXT_texture_webp"};
  EXPECT_EQ(*closed(glb, 1).look.materials.at(0).image, kPng);
}

TEST_F(GlbFiles, WhatIsWrongIsNamed) {
  const auto broken = [&](const auto& alter) {
    Glb glb = cube_glb();
    alter(glb);
    return error(glb.bytes());
  };
  using Alter = void (*)(Glb&);
  const std::pair<Alter, const char*> kCases[] = {
      {[](Glb& g) { g.json["extensionsRequired"] = {"KHR_draco_mesh_compression"}; },
       "needs the extension 'KHR_draco_mesh_compression', a compression: save it as binary glTF 2.0 (.glb) "
       "without it"},
      {[](Glb& g) { g.json["extensionsRequired"] = {"X_any"}; }, "needs the extension 'X_any': save it"},
      {[](Glb& g) { g.json["asset"]["version"] = "1.0"; }, "asset.version is not 2.0"},
      {[](Glb& g) { g.json.erase("asset"); }, "asset.version is not 2.0"},
      {[](Glb& g) {
         g.json["accessors"][0]["sparse"] = {{"count", 1}};
       },
       "accessor 0 is sparse: save it"},
      {[](Glb& g) { g.json["accessors"][0].erase("bufferView"); }, "accessor 0 (POSITION) has no data"},
      {[](Glb& g) { g.json["accessors"][0]["count"] = 25; }, "accessor 0 has 25 elements; its 288 bytes"},
      {[](Glb& g) { g.json["accessors"][0]["count"] = std::uint64_t{1} << 63; }, "cannot hold them"},
      {[](Glb& g) { g.json["accessors"][0]["count"] = -1; }, "accessor 0: count is not a whole number"},
      {[](Glb& g) { g.json["accessors"][1]["count"] = 23; }, "(NORMAL) has 23 elements for 24 vertices"},
      {[](Glb& g) { g.json["accessors"][0]["byteOffset"] = 4; }, "cannot hold them"},
      {[](Glb& g) { g.json["accessors"][0]["byteOffset"] = ~std::uint64_t{0}; }, "cannot hold them"},
      {[](Glb& g) { g.json["accessors"][0]["componentType"] = 5122; }, "accessor 0 (POSITION) is of a type"},
      {[](Glb& g) { g.json["accessors"][0]["type"] = "MAT4"; }, "accessor 0 (POSITION) is of a type"},
      {[](Glb& g) { g.json["accessors"][0]["type"] = "VEC2"; }, "accessor 0 (POSITION) is of a type"},
      {[](Glb& g) { g.json["accessors"][2]["componentType"] = 5123; },
       "accessor 2 (TEXCOORD_0) is of a type"},
      {[](Glb& g) { g.json["accessors"][3]["componentType"] = 5126; }, "has 36 elements; its 72 bytes"},
      {[](Glb& g) { g.json["accessors"][3]["count"] = 35; }, "has 35 corners, which are no whole triangles"},
      {[](Glb& g) { g.json["bufferViews"][0]["byteStride"] = 8; }, "accessor 0: a byteStride of 8"},
      {[](Glb& g) { g.json["bufferViews"][0]["byteLength"] = 100'000; },
       "bufferView 0 has 100000 bytes from byte 0"},
      {[](Glb& g) { g.json["bufferViews"][0]["byteOffset"] = ~std::uint64_t{0}; },
       "bufferView 0 has 288 bytes from"},
      {[](Glb& g) { g.json["bufferViews"][0]["buffer"] = 1; },
       "bufferView 0 refers to buffers 1, which does not"},
      {[](Glb& g) {
         g.json["buffers"] = {{{"byteLength", 9}, {"uri", "a.bin"}}};
       },
       "are not in the file itself"},
      {[](Glb& g) { g.json["bufferViews"].back()["byteOffset"] = 5000; },
       "bufferView 4 has 67 bytes from byte 5000"},
      {[](Glb& g) { primitive(g)["mode"] = 5; },
       "primitive 0 is a strip or fan of triangles: save it as single"},
      {[](Glb& g) { primitive(g)["mode"] = 1; }, "there is no triangle"},
      {[](Glb& g) { primitive(g)["attributes"].erase("POSITION"); }, "primitive 0 has no POSITION"},
      {[](Glb& g) { primitive(g)["attributes"]["POSITION"] = "0"; }, "POSITION refers to accessors"},
      {[](Glb& g) { primitive(g)["attributes"]["COLOR_0"] = 99; }, "COLOR_0 refers to accessors 99"},
      {[](Glb& g) { primitive(g)["indices"] = 4; },
       "indices refers to accessors 4, which does not exist; there are 4"},
      {[](Glb& g) { primitive(g)["material"] = 2; }, "primitive 0 refers to materials 2"},
      {[](Glb& g) { g.json["textures"][0]["source"] = 1; }, "material 1 refers to images 1"},
      {[](Glb& g) { g.json["nodes"][0]["mesh"] = 1; }, "node 0 refers to meshes 1"},
      {[](Glb& g) { g.json["nodes"][0]["skin"] = 0; }, "node 0 is posed by a skeleton"},
      {[](Glb& g) { g.json["nodes"][0]["children"] = {0}; }, "node 0 is in the scene twice"},
      {[](Glb& g) { g.json["nodes"][0]["children"] = {7}; }, "the scene refers to nodes 7"},
      {[](Glb& g) {
         g.json["nodes"][0]["scale"] = {1, 1};
       },
       "node 0: scale is not 3 finite numbers"},
      {[](Glb& g) {
         g.json["nodes"][0]["rotation"] = {0, 0, 0, 0};
       },
       "its rotation is not a quaternion"},
      {[](Glb& g) { g.json["nodes"][0]["matrix"] = std::vector<int>(16, 1); }, "the last row of its matrix"},
      {[](Glb& g) {
         g.json["nodes"][0]["scale"] = {1e308, 1e308, 1e308};
         g.json["nodes"].push_back(g.json["nodes"][0]);
         g.json["nodes"][0]["children"] = {1};
       },
       "a coordinate is not finite"},
      {[](Glb& g) { g.json["scene"] = 3; }, "the document refers to scenes 3"},
      {[](Glb& g) { g.json["meshes"] = "none"; },
       "node 0 refers to meshes 0, which does not exist; there are 0"},
      {[](Glb& g) {
         const float nan = std::numeric_limits<float>::quiet_NaN();
         std::memcpy(g.data.data() + 40, &nan, 4);
       },
       "primitive 0, vertex 3: a coordinate is not finite"},
      {[](Glb& g) {
         const float inf = std::numeric_limits<float>::infinity();
         std::memcpy(g.data.data() + 2 * 288, &inf, 4);
       },
       "accessor 2: element 0 is not finite"},
      {[](Glb& g) { g.data[2 * 288 + 192] = 24; }, "primitive 0: vertex 24 does not exist; there are 24"},
  };
  for (const auto& [alter, expected] : kCases) {
    const std::string text = broken(alter);
    EXPECT_NE(text.find(expected), std::string::npos) << "got:      " << text << "\nexpected: " << expected;
  }
  EXPECT_NE(error("{\"asset\": {\"version\": \"2.0\"}}").find("save it as binary glTF 2.0 (.glb)"),
            std::string::npos);
  EXPECT_NE(error("solid").find("is not binary glTF"), std::string::npos);
  EXPECT_NE(error(Glb::of("{", "")).find("its JSON cannot be read"), std::string::npos);
  EXPECT_NE(error(Glb::of("[1]", "")).find("its JSON cannot be read"), std::string::npos);
  EXPECT_NE(error(Glb::of(std::string(100'000, '['), "")).find("its JSON cannot be read"), std::string::npos);
  std::string old = cube_glb().bytes();
  old[4] = 1;
  EXPECT_NE(error(old).find("is glTF 1: save it as glTF 2.0"), std::string::npos);
  old[7] = '\xd8';
  EXPECT_NE(error(old).find("says in its header that it is of version 3623878657: it is damaged"),
            std::string::npos)
      << error(old);
  directory_.write("b.gltf", "{\"asset\": {\"version\": \"2.0\"}}");
  EXPECT_NE(error_of([&] { load_mesh(directory_ / "b.gltf"); }).find("save it as binary glTF 2.0 (.glb)"),
            std::string::npos);
  EXPECT_FALSE(read(cube_glb().bytes() + "xyz").positions.empty());
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_NE(warnings_[0].find("3 bytes after the end"), std::string::npos);
}

// A small file must not become a large surface.
TEST_F(GlbFiles, RepeatedDataIsBounded) {
  Glb glb = cube_glb();
  for (int i = 0; i < 300; ++i) {
    glb.json["nodes"].push_back({{"mesh", 0}, {"translation", {2 * i + 2, 0, 0}}});
    glb.json["scenes"][0]["nodes"].push_back(i + 1);
  }
  EXPECT_EQ(closed(glb, 301).triangles.size(), 301u * 12);
  Json& primitives = glb.json["meshes"][0]["primitives"];
  while (primitives.size() < 100) primitives.push_back(primitives[0]);
  EXPECT_NE(error(glb.bytes()).find("repeat the same data too often"), std::string::npos);
}

// Cut short anywhere, the file's own length corrected or not, is an error; a byte that is another one is an error or a surface that holds together.
TEST_F(GlbFiles, CutShortAndAlteredFiles) {
  const std::string good = cube_glb().bytes();
  const std::size_t data = 20 + cube_glb().json.dump().size();  // where its part begins, but for a few bytes
  std::vector<std::size_t> lengths;
  for (std::size_t n = 1; n < good.size(); ++n)
    if (n < 40 || n % 50 == 0 || (n + 10 > data && n < data + 100) || n + 20 > good.size())
      lengths.push_back(n);
  for (const std::size_t n : lengths) {
    std::string cut = good.substr(0, n);
    error(cut);
    if (n < 12) continue;
    const auto length = static_cast<std::uint32_t>(n);
    std::memcpy(cut.data() + 8, &length, 4);
    error(cut);
  }
  std::mt19937 random(1);
  for (int i = 0; i < 500; ++i) {
    std::string bad = good;
    bad[random() % bad.size()] = static_cast<char>(random());
    try {
      const Surface surface = read(bad);
      const std::size_t corners = 3 * surface.triangles.size();
      for (const auto& t : surface.triangles)
        for (const auto v : t) ASSERT_LT(v, surface.positions.size());
      for (const Vec3& p : surface.positions) ASSERT_TRUE(core::is_finite(p));
      ASSERT_TRUE(surface.look.uvs.empty() || surface.look.uvs.size() == corners);
      ASSERT_TRUE(surface.look.normals.empty() || surface.look.normals.size() == corners);
      for (const auto m : surface.look.material_of) ASSERT_LT(m, surface.look.materials.size());
    } catch (const MeshError&) {
    }
  }
}

}  // namespace
}  // namespace incise::mesh_io
