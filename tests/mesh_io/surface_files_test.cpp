#include "server/mesh_io/surface_files.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/read_materials.hpp"
#include "server/mesh_io/surface_check.hpp"
#include "tests/mesh_io/test_meshes.hpp"
#include "tests/support/images.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;

Surface read(const std::filesystem::path& path) {
  std::vector<std::string> warnings;
  Surface surface = read_surface(path, warnings);
  EXPECT_TRUE(warnings.empty()) << warnings[0];
  return surface;
}

// Volume 1, 8 vertices, 12 triangles, closed: the unit cube, whatever the order.
void expect_unit_cube(const Surface& surface) {
  EXPECT_EQ(surface.positions.size(), 8u);
  EXPECT_EQ(surface.triangles.size(), 12u);
  std::vector<std::string> warnings;
  EXPECT_NEAR(check_surface(surface, "FILE", warnings).volume, 1, 1e-12);
  EXPECT_TRUE(warnings.empty()) << warnings[0];
}

constexpr const char* kObjCube = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\nv 1 1 1\n";

TEST(SurfaceFiles, EachFormatReadsBackWhatWasWritten) {
  const TestDirectory directory;
  for (const char* name : {"a.stl", "a.ply", "a.off", "a.obj", "A.STL", "A.Obj"}) {
    SCOPED_TRACE(name);
    write_surface(directory / name, cube());
    expect_unit_cube(read(directory / name));
  }
}

TEST(SurfaceFiles, TextFormatsKeepEveryBit) {
  const TestDirectory directory;
  Surface surface = cube({0.1, 1.0 / 3.0, -1e-7}, 1.0 / 7.0);
  for (const char* name : {"a.ply", "a.off", "a.obj"}) {
    write_surface(directory / name, surface);
    EXPECT_EQ(read(directory / name).positions, surface.positions) << name;
    EXPECT_EQ(read(directory / name).triangles, surface.triangles) << name;
  }
}

TEST(SurfaceFiles, UnknownEndings) {
  const TestDirectory directory;
  EXPECT_NE(error_of([&] { write_surface(directory / "a.xyz", cube()); }).find(".stl, .ply"),
            std::string::npos);
  directory.write("a.xyz", "1");
  EXPECT_NE(error_of([&] { load_mesh(directory / "a.xyz"); }).find(".node and .ele"), std::string::npos);
  EXPECT_NE(error_of([&] { load_mesh(directory / "b.off"); }).find("no such file"), std::string::npos);
}

TEST(SurfaceFiles, AsciiStlWithSeveralSolidsInAnyCase) {
  const TestDirectory directory;
  std::string text = "SOLID first part\n";
  const Surface surface = cube();
  for (std::size_t i = 0; i < surface.triangles.size(); ++i) {
    if (i == 6) text += "endsolid first part\r\n\r\nsolid second\n";
    text += " facet normal 0 0 0\n  OUTER loop\n";
    for (const auto v : surface.triangles[i]) {
      const core::Vec3& p = surface.positions[v];
      text +=
          "   Vertex " + std::to_string(p.x) + " " + std::to_string(p.y) + "\t" + std::to_string(p.z) + "\n";
    }
    text += "  endloop\n endfacet\n";
  }
  expect_unit_cube(read(directory.write("a.stl", text + "endsolid\n")));
}

TEST(SurfaceFiles, BinaryStlThatBeginsWithSolid) {
  const TestDirectory directory;
  write_surface(directory / "a.stl", cube());
  std::string bytes(84 + 50 * 12, ' ');
  {
    FILE* file = std::fopen((directory / "a.stl").c_str(), "rb");
    ASSERT_EQ(std::fread(bytes.data(), 1, bytes.size(), file), bytes.size());
    std::fclose(file);
  }
  std::memcpy(bytes.data(), "solid binary", 12);
  expect_unit_cube(read(directory.write("b.stl", bytes)));
  // Bytes after the last triangle are left alone, with a warning.
  std::memcpy(bytes.data(), "header      ", 12);
  std::vector<std::string> warnings;
  expect_unit_cube(read_surface(directory.write("c.stl", bytes + "xyz"), warnings));
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("3 bytes after the last of 12 triangles"), std::string::npos) << warnings[0];
}

template <class Number>
void append_number(std::string& bytes, Number value, bool big) {
  char raw[sizeof value];
  std::memcpy(raw, &value, sizeof value);
  if (big) std::reverse(raw, raw + sizeof value);
  bytes.append(raw, sizeof value);
}

std::string ply_cube(bool big) {
  const Surface surface = cube();
  std::string bytes =
      std::string("ply\nformat binary_") + (big ? "big" : "little") +
      "_endian 1.0\ncomment made by hand\nelement material 2\nproperty uchar red\nproperty list uchar "
      "short codes\nelement vertex 8\nproperty uchar flag\nproperty double z\nproperty double x\n"
      "property double y\nobj_info none\nelement face 12\nproperty list int uint vertex_index\n"
      "property float quality\nend_header\n";
  const auto append = [&bytes, big](auto value) { append_number(bytes, value, big); };
  for (const int codes : {0, 3}) {
    append(std::uint8_t{7});
    append(static_cast<std::uint8_t>(codes));
    for (int i = 0; i < codes; ++i) append(std::int16_t{-2});
  }
  for (const core::Vec3& p : surface.positions) {
    append(std::uint8_t{1});
    append(p.z);
    append(p.x);
    append(p.y);
  }
  for (const auto& t : surface.triangles) {
    append(std::int32_t{3});
    for (const auto v : t) append(v);
    append(0.5f);
  }
  return bytes;
}

TEST(SurfaceFiles, PlyOfEitherByteOrderWithOtherElements) {
  const TestDirectory directory;
  expect_unit_cube(read(directory.write("l.ply", ply_cube(false))));
  expect_unit_cube(read(directory.write("b.ply", ply_cube(true))));
}

// Small integers of either sign for coordinates and for vertices.
TEST(SurfaceFiles, PlyOfSmallIntegersInEitherByteOrder) {
  const TestDirectory directory;
  Surface cuboid = cube();
  for (core::Vec3& p : cuboid.positions) p = {p.x + 40'000, p.y - 300, 127 * p.z - 7};
  for (const bool big : {false, true}) {
    for (const bool sign : {false, true}) {
      const std::string type = sign ? "short" : "ushort";
      std::string bytes =
          std::string("ply\nformat binary_") + (big ? "big" : "little") +
          "_endian 1.0\nelement vertex 8\nproperty ushort x\nproperty short y\nproperty char z\n"
          "element face 12\nproperty list uchar char codes\nproperty list " +
          type + " " + type + " vertex_indices\nend_header\n";
      const auto append = [&](auto value) { append_number(bytes, value, big); };
      for (const core::Vec3& p : cuboid.positions) {
        append(static_cast<std::uint16_t>(p.x));
        append(static_cast<std::int16_t>(p.y));
        append(static_cast<std::int8_t>(p.z));
      }
      for (const auto& t : cuboid.triangles) {
        append(std::uint8_t{200});
        bytes.append(200, 'c');
        append(std::uint16_t{3});
        for (const auto v : t) append(static_cast<std::uint16_t>(v));
      }
      const Surface surface = read(directory.write("a.ply", bytes));
      EXPECT_EQ(surface.positions, cuboid.positions) << type << (big ? ", big" : ", little");
      EXPECT_EQ(surface.triangles, cuboid.triangles) << type << (big ? ", big" : ", little");
    }
  }
}

TEST(SurfaceFiles, AsciiPlyWithQuads) {
  const TestDirectory directory;
  expect_unit_cube(read(directory.write(
      "a.ply",
      "ply\r\nformat ascii 1.0\r\nelement vertex 8\r\nproperty float32 x\r\nproperty float32 y\r\nproperty "
      "float32 z\r\n"
      "property uchar red\r\nelement face 6\r\nproperty list uint8 int32 vertex_indices\r\nend_header\r\n"
      "0 0 0 1\r\n1 0 0 2\r\n0 1 0 3\r\n1 1 0 4\r\n0 0 1 5\r\n1 0 1 6\r\n0 1 1 7\r\n1 1 1 255\r\n"
      "4 0 2 3 1\r\n4 4 5 7 6\r\n4 0 1 5 4\r\n4 2 6 7 3\r\n4 0 4 6 2\r\n4 1 3 7 5\r\n")));
}

TEST(SurfaceFiles, OffVariants) {
  const TestDirectory directory;
  const std::string vertices = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 0 1\n1 0 1\n0 1 1\n1 1 1\n";
  const std::string faces = "4 0 2 3 1\n4 4 5 7 6 255 0 0\n4 0 1 5 4\n4 2 6 7 3\n4 0 4 6 2\n4 1 3 7 5\n";
  expect_unit_cube(read(directory.write("a.off", "OFF 8 6 12\n" + vertices + faces)));
  expect_unit_cube(
      read(directory.write("b.off", "# first\n\nOFF\n# then\n8 6 0\n" + vertices + "# faces\n" + faces)));
  expect_unit_cube(read(directory.write("c.off", "8 6 0\n" + vertices + faces)));
  std::string coloured = "COFF\n8 6 0\n";
  for (const char c : vertices) {
    if (c == '\n') coloured += " 0.5 0.5 0.5 1";
    coloured += c;
  }
  expect_unit_cube(read(directory.write("d.off", coloured + faces)));
}

TEST(SurfaceFiles, ObjPolygonsTextureIndicesNegativesAndContinuedLines) {
  const TestDirectory directory;
  directory.write("x.mtl", "newmtl m\n");
  std::string text = "# a cube\nmtllib x.mtl\no cube\n";
  text += kObjCube;
  text +=
      "vt 0 0\nvn 0 0 1\ns off\nusemtl m\nf 1/1/1 3/1/1 4/1/1 2/1/1\nf 5//1 6//1 8//1 7//1\n"
      "f 1/1 2/1 6/1 5/1\nf -6 -2 -1 -5 # negative\nf 1 5 \\\n7 3\ng group\nf 2 4 8 6\nl 1 2\n";
  expect_unit_cube(read(directory.write("a.obj", text)));
}

TEST(SurfaceFiles, VerticesAtOnePlaceAreWeldedAndUnusedOnesDropped) {
  const TestDirectory directory;
  std::string text;
  const Surface surface = cube();
  for (const auto& t : surface.triangles) {
    text += "v 5 5 5\n";
    for (const auto v : t) {
      const core::Vec3& p = surface.positions[v];
      text += "v " + std::to_string(p.x) + " " + std::to_string(p.y) + " " + std::to_string(p.z) + "\n";
    }
    text += "f -3 -2 -1\n";
  }
  expect_unit_cube(read(directory.write("a.obj", text)));
}

TEST(SurfaceFiles, BoundaryOfAMeshFacesOutward) {
  const core::MeshData mesh = cube_mesh(3);
  std::vector<std::uint32_t> half_faces;
  const Surface surface = boundary_surface(mesh.positions, mesh.tets, &half_faces);
  EXPECT_EQ(surface.triangles.size(), 6u * 9 * 2);
  EXPECT_EQ(half_faces.size(), surface.triangles.size());
  EXPECT_EQ(surface.positions.size(), 64u - 8);
  EXPECT_NEAR(signed_volume(surface), 27, 1e-12);
  std::vector<std::string> warnings;
  check_surface(surface, "FILE", warnings);
  EXPECT_TRUE(warnings.empty());
}

// ------------------------------------------------------------------------------------- what a surface looks like

const std::string kPng = tests::tiny_png();

// The texture coordinates of a triangle's corners, as text.
std::string uvs_of(const Surface& surface, std::size_t triangle) {
  std::string text;
  for (std::size_t k = 0; k < 3; ++k) {
    const auto& uv = surface.look.uvs.at(3 * triangle + k);
    text += to_text(static_cast<double>(uv[0])) + "," + to_text(static_cast<double>(uv[1])) + " ";
  }
  return text;
}

TEST(SurfaceLook, ObjHasTextureCoordinatesNormalsAndMaterialsByCorner) {
  const TestDirectory directory;
  directory.write("a.png", kPng);
  std::filesystem::create_directory(directory / "pictures");
  directory.write("pictures/b c.jpg", tests::tiny_jpeg());
  directory.write("a.mtl",
                  "newmtl unused\nmap_Kd nowhere.png\nnewmtl liver\nKd 0.5 0.25 2\nmap_Kd -s 1 1 1 a.png\n"
                  "newmtl the capsule\nmap_Kd pictures\\b c.jpg\n");
  directory.write("a.obj", std::string("mtllib a.mtl\n") + kObjCube +
                               "vt 0 0\nvt 0.5 0\nvt 0.5 1\nvt 0.25 1\nvn 0 0 1\n"
                               "f 1 2 3\n"
                               "usemtl liver\nf 5/1/1 6/2/1 8/3/-1 7/4/1\n"
                               "usemtl the capsule\nf 1//1 2//1 3//1\nusemtl liver\nf 1/-1 2/-2 3/-3\n");
  const Surface surface = read(directory / "a.obj");
  ASSERT_EQ(surface.triangles.size(), 5u);
  ASSERT_EQ(surface.look.uvs.size(), 15u);
  EXPECT_EQ(uvs_of(surface, 0), "0,0 0,0 0,0 ");
  EXPECT_EQ(uvs_of(surface, 1), "0,0 0.5,0 0.5,1 ") << "a polygon is a fan";
  EXPECT_EQ(uvs_of(surface, 2), "0,0 0.5,1 0.25,1 ");
  EXPECT_EQ(uvs_of(surface, 4), "0.25,1 0.5,1 0.5,0 ");
  ASSERT_EQ(surface.look.normals.size(), 15u);
  EXPECT_EQ(surface.look.normals[3], (std::array<float, 3>{0, 0, 1}));
  EXPECT_EQ(surface.look.normals[14], (std::array<float, 3>{0, 0, 0}));
  EXPECT_EQ(surface.look.material_of, (std::vector<std::uint32_t>{0, 1, 1, 2, 1}));
  ASSERT_EQ(surface.look.materials.size(), 3u);
  EXPECT_EQ(surface.look.materials[0].name, "");
  EXPECT_EQ(surface.look.materials[1].name, "liver");
  EXPECT_EQ(surface.look.materials[1].diffuse, (std::array<float, 3>{0.5f, 0.25f, 1}));
  EXPECT_EQ(*surface.look.materials[1].image, kPng);
  EXPECT_EQ(surface.look.materials[2].name, "the capsule");
  EXPECT_EQ(surface.look.materials[2].image_type, "image/jpeg");
}

TEST(SurfaceLook, ObjWithBadIndicesSaysWhichAndHowManyThereAre) {
  const TestDirectory directory;
  const auto error = [&](const std::string& face) {
    directory.write("a.obj", std::string(kObjCube) + "vt 0 0\nvt 1 0\nvn 0 0 1\n" + face);
    return error_of([&] { read(directory / "a.obj"); });
  };
  EXPECT_NE(error("f 1/1 2/3 3/1\n").find("a.obj:12: texture coordinate 3 does not exist; there are 2"),
            std::string::npos);
  EXPECT_NE(error("f 1/1 2/-3 3/1\n").find("texture coordinate -3 does not exist"), std::string::npos);
  EXPECT_NE(error("f 1/0 2/1 3/1\n").find("texture coordinate 0"), std::string::npos);
  EXPECT_NE(error("f 1/1/1 2/1/2 3/1/1\n").find("normal 2 does not exist; there are 1"), std::string::npos);
  EXPECT_NE(error("f 1/x 2/1 3/1\n").find("the texture coordinate 'x' is not an integer"), std::string::npos);
  EXPECT_NE(error("f 1/1/1/1 2/1 3/1\n").find("the normal '1/1' is not an integer"), std::string::npos);
  EXPECT_NE(error("vt nan 0\nf 1/1 2/1 3/1\n").find("a.obj:12"), std::string::npos);
}

// A file that somebody else made may name anything.
TEST(SurfaceLook, OnlyFilesBesideTheSurfaceAreReadAndOnlyImages) {
  const TestDirectory directory;
  std::filesystem::create_directory(directory / "body");
  directory.write("secret.png", kPng);
  directory.write("secret.mtl", "newmtl m\nKd 1 0 0\n");
  directory.write("body/notes.png", "a diary, not a picture");
  directory.write("body/a.png", kPng);
  std::filesystem::create_symlink(directory / "secret.png", directory / "body/link.png");
  std::filesystem::create_directory_symlink(directory / ".", directory / "body/up");
  std::filesystem::create_symlink("a.png", directory / "body/inside.png");
  std::filesystem::create_directory(directory / "body/folder.png");
  const auto read_with = [&](const std::string& library, std::vector<std::string>& warnings) {
    directory.write("body/a.obj", "mtllib " + library + "\n" + kObjCube + "usemtl m\nf 1 2 3\n");
    return read_surface(directory / "body/a.obj", warnings).look.materials.at(0);
  };
  const std::string outside = (directory / "secret.png").string();
  for (const std::string& name :
       {std::string("../secret.png"), std::string("up/secret.png"), std::string("link.png"), outside,
        std::string("notes.png"), std::string("folder.png"), std::string("missing.png"),
        std::string("..\\secret.png"), std::string("C:\\secret.png"), std::string("file:///etc/passwd")}) {
    directory.write("body/a.mtl", "newmtl m\nmap_Kd " + name + "\n");
    std::vector<std::string> warnings;
    EXPECT_EQ(read_with("a.mtl", warnings).image, nullptr) << name;
    ASSERT_EQ(warnings.size(), 1u) << name;
    EXPECT_NE(warnings[0].find("the texture of material 'm' is not shown: "), std::string::npos)
        << warnings[0];
    EXPECT_EQ(warnings[0].find('\n'), std::string::npos);
  }
  for (const char* library : {"../secret.mtl", "up/secret.mtl", "missing.mtl"}) {
    std::vector<std::string> warnings;
    EXPECT_EQ(read_with(library, warnings).diffuse[1], 0.8f) << library;
    EXPECT_EQ(warnings.size(), 1u) << library;
  }
  directory.write("body/a.mtl", "newmtl m\nmap_Kd inside.png\n");
  std::vector<std::string> warnings;
  EXPECT_NE(read_with("a.mtl", warnings).image, nullptr);
  EXPECT_TRUE(warnings.empty()) << warnings[0];
}

// What can be seen of a damaged image without decoding it: every shorter part of it, and every flipped bit of what a check sum covers.
TEST(SurfaceLook, AnImageThatIsCutOffOrDamagedIsNotShown) {
  const std::string png = tests::tiny_png("text"), jpeg = tests::tiny_jpeg(), webp = tests::tiny_webp();
  for (const std::string& whole : {png, jpeg, webp}) {
    EXPECT_EQ(image_fault(whole), "");
    EXPECT_EQ(image_fault(whole + "more"), "") << "what follows the end is nobody's";
    for (std::size_t size = 0; size < whole.size(); ++size) {
      const std::string fault = image_fault(std::string_view(whole).substr(0, size));
      EXPECT_NE(fault, "") << size << " of " << whole.size();
      EXPECT_EQ(fault.find('\n'), std::string::npos);
    }
  }
  for (std::size_t i = 12; i < 33; ++i) {
    std::string flipped = png;
    flipped[i] = static_cast<char>(flipped[i] ^ 4);
    EXPECT_NE(image_fault(flipped), "") << i;
  }
  const TestDirectory directory;
  directory.write("a.jpg", jpeg.substr(0, jpeg.size() - 10));
  directory.write("a.mtl", "newmtl m\nmap_Kd a.jpg\n");
  directory.write("a.obj", std::string("mtllib a.mtl\n") + kObjCube + "usemtl m\nf 1 2 3\n");
  std::vector<std::string> warnings;
  EXPECT_EQ(read_surface(directory / "a.obj", warnings).look.materials.at(0).image, nullptr);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("the texture of material 'm' is not shown: 'a.jpg' is cut off"),
            std::string::npos)
      << warnings[0];
}

TEST(SurfaceLook, PlyHasColoursAndTextureCoordinatesByVertexOrByCorner) {
  const TestDirectory directory;
  directory.write("a.png", kPng);
  directory.write(
      "a.ply",
      "ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 4\nproperty float x\nproperty float "
      "y\n"
      "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty float s\n"
      "property float t\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
      "0 0 0 255 0 0 0 0\n1 0 0 0 255 0 1 0\n1 1 0 0 0 255 1 1\n0 1 0 7 8 9 0 1\n4 0 1 2 3\n");
  const Surface by_vertex = read(directory / "a.ply");
  ASSERT_EQ(by_vertex.triangles.size(), 2u);
  EXPECT_EQ(uvs_of(by_vertex, 1), "0,0 1,1 0,1 ");
  EXPECT_EQ(by_vertex.look.colours.at(5), (std::array<std::uint8_t, 4>{7, 8, 9, 255}));
  EXPECT_EQ(*by_vertex.look.materials.at(0).image, kPng);
  const std::string head =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
      "element face 1\nproperty list uchar int vertex_indices\nproperty list uchar float "
      "texcoord\nend_header\n"
      "0 0 0\n1 0 0\n1 1 0\n3 0 1 2 ";
  directory.write("b.ply", head + "6 0 0 0.5 0 0.5 1\n");
  EXPECT_EQ(uvs_of(read(directory / "b.ply"), 0), "0,0 0.5,0 0.5,1 ");
  directory.write("b.ply", head + "4 0 0 0.5 0\n");
  EXPECT_NE(
      error_of([&] { read(directory / "b.ply"); }).find("a list texcoord for 2 corners; the face has 3"),
      std::string::npos);
}

TEST(SurfaceLook, ATriangleThatIsTurnedOverKeepsItsCorners) {
  const TestDirectory directory;
  Surface inside_out = cube();
  for (auto& t : inside_out.triangles) std::swap(t[0], t[1]);
  for (const auto& t : inside_out.triangles)
    for (const core::VertexId v : t) inside_out.look.uvs.push_back({static_cast<float>(v), 0});
  std::vector<std::string> warnings;
  const ClosedSurface closed = check_surface(inside_out, "FILE", warnings);
  EXPECT_EQ(warnings.size(), 1u);
  for (std::size_t c = 0; c < closed.surface.look.uvs.size(); ++c)
    EXPECT_EQ(closed.surface.look.uvs[c][0], static_cast<float>(closed.surface.triangles[c / 3][c % 3]));
}

}  // namespace
}  // namespace incise::mesh_io
