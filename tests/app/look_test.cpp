// What the HTTP port says of how the body looks: the volume image in the body's coordinates, regions with their materials.
#include "server/app/look.hpp"

#include <gtest/gtest.h>
#include <zlib.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "server/mesh_io/phantom.hpp"
#include "tests/mesh_io/test_meshes.hpp"
#include "tests/mesh_io/volume_image_files.hpp"
#include "tests/support/images.hpp"

namespace incise::app {
namespace {

using namespace mesh_io::testing;
using Json = nlohmann::json;

// A cube of 10 cm at the origin, of n x n x n cells.
core::MeshData cube(int n) {
  core::MeshData mesh = cube_mesh(n);
  core::Vec3 high = mesh.positions.front();
  for (const core::Vec3& p : mesh.positions)
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  for (core::Vec3& p : mesh.positions) p = (0.1 / high.x) * p;
  return mesh;
}

std::string gunzipped(const std::string& packed, std::size_t size) {
  std::string out(size + 1, '\0');
  z_stream z{};
  EXPECT_EQ(inflateInit2(&z, 16 + MAX_WBITS), Z_OK);
  z.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(packed.data()));
  z.avail_in = static_cast<uInt>(packed.size());
  z.next_out = reinterpret_cast<Bytef*>(out.data());
  z.avail_out = static_cast<uInt>(out.size());
  EXPECT_EQ(inflate(&z, Z_FINISH), Z_STREAM_END);
  EXPECT_EQ(z.total_out, size);
  inflateEnd(&z);
  out.resize(size);
  return out;
}

// An image of a byte a sample as a client reads it: by what look.json says, and nothing else.
struct Samples {
  Samples(const Json& json, const stream::Documents& documents)
      : size(json.at("size").get<std::array<std::size_t, 3>>()),
        m(json.at("texture_from_rest").get<std::array<double, 12>>()),
        bytes(
            gunzipped(*documents.at(json.at("path").get<std::string>()).body, size[0] * size[1] * size[2])) {}

  std::array<double, 3> unit(const core::Vec3& p) const {
    const auto row = [&](std::size_t r) {
      return m[4 * r] * p.x + m[4 * r + 1] * p.y + m[4 * r + 2] * p.z + m[4 * r + 3];
    };
    return {row(0), row(1), row(2)};
  }
  // Between the eight samples around a place, as a graphics card does. NaN outside of the image.
  double linear(const core::Vec3& p) const {
    const auto t = unit(p);
    std::array<double, 3> at{};
    for (std::size_t i = 0; i < 3; ++i) {
      if (t[i] < 0 || t[i] > 1) return NAN;
      at[i] = std::clamp(t[i] * static_cast<double>(size[i]) - 0.5, 0.0, static_cast<double>(size[i]) - 1);
    }
    double sum = 0;
    for (int corner = 0; corner < 8; ++corner) {
      double weight = 1;
      std::array<std::size_t, 3> index{};
      for (std::size_t i = 0; i < 3; ++i) {
        const std::size_t low = std::min(static_cast<std::size_t>(at[i]), size[i] - 1);
        const double part = at[i] - static_cast<double>(low);
        const bool up = (corner >> i) & 1;
        index[i] = std::min(low + (up ? 1 : 0), size[i] - 1);
        weight *= up ? part : 1 - part;
      }
      sum += weight * byte(index);
    }
    return sum;
  }
  int nearest(const core::Vec3& p) const {
    const auto t = unit(p);
    std::array<std::size_t, 3> index{};
    for (std::size_t i = 0; i < 3; ++i)
      index[i] = static_cast<std::size_t>(std::clamp(t[i], 0.0, 0.9999999) * static_cast<double>(size[i]));
    return byte(index);
  }
  int byte(const std::array<std::size_t, 3>& i) const {
    return static_cast<unsigned char>(bytes[i[0] + size[0] * (i[1] + size[1] * i[2])]);
  }

  std::array<std::size_t, 3> size;
  std::array<double, 12> m;
  std::string bytes;
};

struct Served {
  Served(const Config& config, const core::MeshData& mesh)
      : documents(served_look(config, mesh, "test.json", warnings)) {
    json = Json::parse(*documents.at("/look.json").body);
  }
  std::vector<std::string> warnings;
  stream::Documents documents;
  Json json;
};

// A linear ramp in LPS millimetres.
double ramp_at(double x, double y, double z) {
  return 3 * x - 2 * y + 5 * z + 40;
}

// 60 x 50 x 40 voxels along oblique axes, around a cube of 100 mm that begins at (0, 0, 0) of LPS.
constexpr Matrix kAround = {{{2.4, -0.9, 0.2, 5}, {0.8, 2.6, -0.3, -35}, {0, 0.1, 3.4, -15}}};
constexpr std::array<int, 3> kAroundSize = {60, 50, 40};

std::string ramp_file(const Matrix& mm_from_index, const std::string& space, double x_sign, double y_sign) {
  Matrix m = mm_from_index;
  for (double& v : m[0]) v *= x_sign;
  for (double& v : m[1]) v *= y_sign;
  const auto value = [&](int i, int j, int k) {
    const auto at = [&](std::size_t r) {
      return mm_from_index[r][0] * i + mm_from_index[r][1] * j + mm_from_index[r][2] * k +
             mm_from_index[r][3];
    };
    return ramp_at(at(0), at(1), at(2));
  };
  return "NRRD0004\ntype: float\ndimension: 3\nspace: " + space +
         "\nsizes: 60 50 40\nspace directions: " + nrrd_directions(m) +
         "\nendian: little\nencoding: gzip\nspace origin: " + nrrd_origin(m) + "\n\n" +
         gzipped(voxels("float", false, kAroundSize, value));
}

Config image_config(const std::string& path, const std::string& more = "") {
  return parse_config(R"({"mesh": {"path": "a", "image": ")" + path + "\"" + more + "}}", "test.json");
}

// Whether the image has the ramp at places of the body, which is `to_mm` in LPS millimetres.
void expect_ramp(const Samples& image, double low, double high,
                 const std::function<core::Vec3(core::Vec3)>& to_mm) {
  int within = 0;
  for (double x = 0.005; x < 0.1; x += 0.013)
    for (double y = 0.005; y < 0.1; y += 0.013)
      for (double z = 0.005; z < 0.1; z += 0.013) {
        const double shown = image.linear({x, y, z});
        if (std::isnan(shown)) continue;
        const core::Vec3 p = to_mm({x, y, z});
        const double wanted = 255 * std::clamp((ramp_at(p.x, p.y, p.z) - low) / (high - low), 0.0, 1.0);
        ++within;
        // Half a step of 255 by rounding; at its ends the window bends the ramp within a voxel.
        ASSERT_NEAR(shown, wanted, wanted < 4 || wanted > 251 ? 3 : 0.6) << x << " " << y << " " << z;
      }
  EXPECT_GT(within, 300);
}

TEST(Look, AnImageIsWhereItsFormulaSays) {
  const TestDirectory directory;
  const core::MeshData mesh = cube(2);
  const auto millimetres = [](const core::Vec3& p) { return 1000.0 * p; };
  const std::string path = directory.write("a.nrrd", ramp_file(kAround, "LPS", 1, 1)).string();
  const Served served(image_config(path, ", \"image_window\": [0, 600]"), mesh);
  EXPECT_TRUE(served.warnings.empty());
  EXPECT_EQ(served.json.at("image").at("window"), Json({0.0, 600.0}));
  EXPECT_FALSE(served.json.contains("regions"));
  expect_ramp(Samples(served.json.at("image"), served.documents), 0, 600, millimetres);

  // The same image written in RAS is at the same place.
  const std::string ras = directory.write("b.nrrd", ramp_file(kAround, "RAS", -1, -1)).string();
  expect_ramp(Samples(Served(image_config(ras, ", \"image_window\": [0, 600]"), mesh).json.at("image"),
                      Served(image_config(ras, ", \"image_window\": [0, 600]"), mesh).documents),
              0, 600, millimetres);
}

TEST(Look, ABodyInRasInOtherUnitsOrElsewhereIsSaidInTheConfiguration) {
  const TestDirectory directory;
  const core::MeshData mesh = cube(2);
  // A body whose x is to the right and y to the front sees the image turned around z.
  Matrix turned = kAround;
  for (double& v : turned[0]) v = -v;
  for (double& v : turned[1]) v = -v;
  const std::string path = directory.write("a.nrrd", ramp_file(turned, "LPS", 1, 1)).string();
  const Served ras(image_config(path, ", \"image_window\": [-600, 600], \"image_space\": \"RAS\""), mesh);
  EXPECT_TRUE(ras.warnings.empty());
  expect_ramp(Samples(ras.json.at("image"), ras.documents), -600, 600, [](const core::Vec3& p) {
    return core::Vec3{-1000 * p.x, -1000 * p.y, 1000 * p.z};
  });
  // Moved by 1 m, and an image whose millimetres are a body's centimetres.
  const std::string small = directory.write("b.nrrd", ramp_file(kAround, "LPS", 1, 1)).string();
  core::MeshData moved = mesh;
  for (core::Vec3& p : moved.positions) p = 10.0 * p + core::Vec3{1, 2, 3};
  const Served scaled(
      image_config(
          small,
          ", \"image_window\": [0, 600], \"image_scale_to_metres\": 0.01, \"image_origin\": [1, 2, 3]"),
      moved);
  EXPECT_TRUE(scaled.warnings.empty());
  const Samples image(scaled.json.at("image"), scaled.documents);
  const double shown = image.linear({1.5, 2.5, 3.5});
  EXPECT_NEAR(shown, 255 * ramp_at(50, 50, 50) / 600, 0.6);
}

TEST(Look, TheWindowIsThatOfTheVoxelsAroundTheBody) {
  const TestDirectory directory;
  const std::string path = directory.write("a.nrrd", ramp_file(kAround, "LPS", 1, 1)).string();
  const Served served(image_config(path), cube(2));
  const auto window = served.json.at("image").at("window").get<std::array<double, 2>>();
  // In the cube: from 3 * 0 - 2 * 100 to 3 * 100 + 5 * 100, and 40.
  EXPECT_GT(window[0], -160);
  EXPECT_LT(window[0], 60);
  EXPECT_GT(window[1], 600);
  EXPECT_LT(window[1], 840);
  expect_ramp(Samples(served.json.at("image"), served.documents), window[0], window[1],
              [](const core::Vec3& p) { return 1000.0 * p; });
}

TEST(Look, AnImageBesideTheBodyIsServedWithAWarning) {
  const TestDirectory directory;
  const std::string path = directory.write("a.nrrd", ramp_file(kAround, "LPS", 1, 1)).string();
  const Served served(image_config(path, ", \"image_origin\": [5, 0, 0]"), cube(2));
  ASSERT_EQ(served.warnings.size(), 1u);
  EXPECT_NE(served.warnings[0].find("no voxel of it lies in the body"), std::string::npos);
  EXPECT_NE(served.warnings[0].find("mesh.image_origin"), std::string::npos);
}

TEST(Look, RegionsHaveTheirTissuesAndWhatTheConfigurationSays) {
  core::MeshData mesh = cube(6);
  mesh.regions.clear();
  for (const auto& tet : mesh.tets) {
    core::Vec3 middle;
    for (const auto v : tet) middle += 0.25 * mesh.positions[v];
    mesh.regions.push_back(middle.z > 0.05 ? 7 : middle.x > 0.05 ? -2 : 3);
  }
  const Config config = parse_config(
      R"({"materials": [{"region": 7, "tissue": "fat", "inside": {"colour": [0.1, 0.2, 0.3], "vessels": 0}}]})",
      "test.json");
  const Served served(config, mesh);
  const Json& regions = served.json.at("regions");
  ASSERT_EQ(regions.size(), 3u);
  EXPECT_EQ(regions[0].at("region"), -2);
  EXPECT_EQ(regions[2].at("region"), 7);
  EXPECT_EQ(regions[2].at("inside").at("colour"), Json({0.1, 0.2, 0.3}));
  EXPECT_EQ(regions[2].at("inside").at("pattern"), "globules");
  EXPECT_EQ(regions[2].at("inside").at("vessels"), 0);
  // Those that nobody names look like a liver, but one of them has another colour.
  EXPECT_EQ(regions[0].at("inside").at("pattern"), "lobules");
  EXPECT_NE(regions[0].at("inside").at("colour"), regions[1].at("inside").at("colour"));
  // Each place's region, but at their borders, and nothing outside.
  const Samples image(served.json.at("region_image"), served.documents);
  for (double x = 0.005; x < 0.1; x += 0.01)
    for (double y = 0.005; y < 0.1; y += 0.01)
      for (double z = 0.005; z < 0.1; z += 0.01)
        ASSERT_EQ(image.nearest({x, y, z}), z > 0.05 ? 2 : x > 0.05 ? 0 : 1) << x << " " << y << " " << z;
  // One region, of which nothing is said: clients decide.
  EXPECT_EQ(*Served(Config(), cube(2)).documents.at("/look.json").body, "{}");
}

TEST(Look, TexturesAreServedOnceAndCheckedBefore) {
  const TestDirectory directory;
  const std::string png = tests::tiny_png();
  directory.write("a.png", png);
  directory.write("b.png", "no image");
  directory.write("cut.png", png.substr(0, png.size() - 3));
  const std::string jpeg = tests::tiny_jpeg();
  directory.write("cut.jpg", jpeg.substr(0, jpeg.size() / 2));
  const auto config = [&](const std::string& inside, const std::string& surface) {
    Config c = parse_config(R"({"materials": [{"region": 0, "inside": {"texture": ")" + inside +
                                R"("}, "surface": {"texture": ")" + surface + "\"}}]}",
                            "test.json");
    c.directory = (directory / "x").parent_path();
    return c;
  };
  const Served served(config("a.png", "a.png"), cube(2));
  EXPECT_EQ(served.json.at("regions")[0].at("inside").at("texture"), "/look/0.png");
  EXPECT_EQ(served.json.at("regions")[0].at("surface").at("texture"), "/look/0.png");
  EXPECT_EQ(*served.documents.at("/look/0.png").body, png);
  EXPECT_EQ(served.documents.at("/look/0.png").type, "image/png");
  for (const auto& [name, wanted] : {std::pair{"b.png", "not a PNG, JPEG or WebP image"},
                                     {"c.png", "No such file"},
                                     {"cut.png", "cut.png is cut off: its "},
                                     {"cut.jpg", "cut.jpg is cut off: its "}}) {
    try {
      std::vector<std::string> warnings;
      check_look(config(name, "a.png"), cube(2), "test.json", warnings);
      ADD_FAILURE() << name;
    } catch (const ConfigError& error) {
      EXPECT_NE(std::string(error.what()).find(wanted), std::string::npos) << error.what();
      EXPECT_NE(std::string(error.what()).find("test.json: materials, region 0, inside.texture"),
                std::string::npos);
    }
  }
  std::vector<std::string> warnings;
  EXPECT_THROW(check_look(image_config((directory / "a.png").string()), cube(2), "test.json", warnings),
               ConfigError);
}

TEST(Look, AMaterialOfARegionThatIsNotThereIsSaid) {
  core::MeshData mesh = cube(2);
  const Config config =
      parse_config(R"({"materials": [{"region": 0}, {"region": 5, "tissue": "fat"}]})", "test.json");
  const auto warnings = [&] {
    std::vector<std::string> of_check;
    check_look(config, mesh, "test.json", of_check);
    EXPECT_EQ(of_check, Served(config, mesh).warnings) << "the check says what the start says";
    return of_check;
  };
  ASSERT_EQ(warnings().size(), 1u);
  EXPECT_NE(warnings()[0].find("no region 5, so that entry changes nothing; it has 0"), std::string::npos)
      << warnings()[0];
  mesh.regions.assign(mesh.tets.size(), 5);
  mesh.regions[0] = 0;
  EXPECT_TRUE(warnings().empty());
}

}  // namespace
}  // namespace incise::app
