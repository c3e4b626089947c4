// Volume images: each encoding, type and byte order, where the voxels are, and files that are wrong.
#include "server/mesh_io/volume_image.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <random>
#include <sstream>

#include "server/mesh_io/mesh_error.hpp"
#include "tests/mesh_io/test_meshes.hpp"
#include "tests/mesh_io/volume_image_files.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;

const char* const kTypes[] = {"int8",   "uint8", "int16",  "uint16", "int32",
                              "uint32", "int64", "uint64", "float",  "double"};
constexpr std::int16_t kNiftiTypes[] = {256, 2, 4, 512, 8, 768, 1024, 1280, 16, 64};

// `m` in LPS where it is given in this space.
Matrix in_lps(Matrix m, double x, double y) {
  for (double& value : m[0]) value *= x;
  for (double& value : m[1]) value *= y;
  return m;
}

void expect_ramp(const VolumeImage& image, const Matrix& mm_from_index, double tolerance = 1e-9) {
  ASSERT_EQ(image.size, (std::array<std::uint32_t, 3>{5, 4, 3}));
  std::size_t at = 0;
  for (int k = 0; k < 3; ++k)
    for (int j = 0; j < 4; ++j)
      for (int i = 0; i < 5; ++i, ++at) {
        ASSERT_EQ(image.values[at], ramp(i, j, k)) << i << " " << j << " " << k;
        const core::Vec3 p = apply(image.mm_from_unit, {(i + 0.5) / 5, (j + 0.5) / 4, (k + 0.5) / 3});
        const auto wanted = [&](std::size_t row) {
          const auto& m = mm_from_index[row];
          return m[0] * i + m[1] * j + m[2] * k + m[3];
        };
        ASSERT_NEAR(p.x, wanted(0), tolerance);
        ASSERT_NEAR(p.y, wanted(1), tolerance);
        ASSERT_NEAR(p.z, wanted(2), tolerance);
      }
}

std::string error_of(const std::filesystem::path& path) {
  try {
    read_volume_image(path);
  } catch (const MeshError& error) {
    const std::string text = error.what();
    EXPECT_EQ(text.find('\n'), text.npos) << text;
    EXPECT_TRUE(text.starts_with(path.parent_path().string())) << text;
    return text;
  }
  return "";
}

TEST(VolumeImage, NrrdOfEveryTypeEncodingAndByteOrder) {
  const TestDirectory directory;
  for (const char* type : kTypes)
    for (const bool big : {false, true})
      for (const std::string encoding : {"raw", "gzip", "gz"}) {
        SCOPED_TRACE(std::string(type) + (big ? " big " : " little ") + encoding);
        const std::string data = voxels(type, big);
        const auto path = directory.write(
            "a.nrrd", nrrd_header(type, big, encoding) + (encoding == "raw" ? data : gzipped(data)));
        const VolumeImage image = read_volume_image(path);
        EXPECT_TRUE(image.anatomical);
        expect_ramp(image, kOblique);
      }
}

TEST(VolumeImage, NrrdSpacesBecomeLps) {
  const TestDirectory directory;
  const auto read = [&](const std::string& space) {
    return read_volume_image(
        directory.write("a.nrrd", nrrd_header("int16", false, "raw", space) + voxels("int16", false)));
  };
  for (const std::string space : {"RAS", "right-anterior-superior", "Right-Anterior-Superior"})
    expect_ramp(read(space), in_lps(kOblique, -1, -1));
  expect_ramp(read("LAS"), in_lps(kOblique, 1, -1));
  expect_ramp(read("LPS"), kOblique);
  const VolumeImage scanner = read("scanner-xyz");
  EXPECT_FALSE(scanner.anatomical);
  expect_ramp(scanner, kOblique);
}

TEST(VolumeImage, NrrdUnitsSpacingsAndAxesThatAreNoSpace) {
  const TestDirectory directory;
  const std::string data = voxels("uint8", false);
  Matrix metres = kOblique;
  for (auto& row : metres)
    for (double& x : row) x *= 1000;
  expect_ramp(
      read_volume_image(directory.write(
          "a.nrrd", nrrd_header("uint8", false, "raw", "LPS", "space units: \"m\" \"m\" \"m\"\n") + data)),
      metres, 1e-6);
  // Without a space: spacings, and the origin in the first voxel.
  const Matrix straight = {{{0.5, 0, 0, 0}, {0, 2, 0, 0}, {0, 0, -3, 0}}};
  const VolumeImage plain =
      read_volume_image(directory.write("b.nrrd",
                                        "NRRD0001\r\ntype: unsigned char\r\ndimension: 3\r\nsizes: 5 4 "
                                        "3\r\nspacings: 0.5 2 -3\r\nencoding: raw\r\n\r\n" +
                                            data));
  EXPECT_FALSE(plain.anatomical);
  expect_ramp(plain, straight);
  // One number a voxel in an axis of its own, and one moment.
  const std::string directions = nrrd_directions(kOblique),
                    origin = "\nspace origin: " + nrrd_origin(kOblique) + "\n\n";
  expect_ramp(read_volume_image(directory.write("c.nrrd",
                                                "NRRD0005\ntype: uchar\ndimension: 4\nspace: LPS\nsizes: 1 5 "
                                                "4 3\nkinds: vector domain domain domain\nspace "
                                                "directions: none " +
                                                    directions + "\nencoding: raw" + origin + data)),
              kOblique);
  expect_ramp(
      read_volume_image(directory.write(
          "d.nrrd", "NRRD0005\ntype: uint8_t\ndimension: 4\nspace: LPS\nsizes: 5 4 3 1\nspace directions: " +
                        directions + " none\nencoding: raw" + origin + data)),
      kOblique);
}

TEST(VolumeImage, NrrdWithTheVoxelsInAnotherFile) {
  const TestDirectory directory;
  const std::string data = voxels("float", true);
  const auto header = [&](const std::string& encoding, const std::string& more) {
    return directory.write("a.nhdr", nrrd_header("float", true, encoding, "LPS", more));
  };
  directory.write("a.raw", data);
  expect_ramp(read_volume_image(header("raw", "data file: a.raw\n")), kOblique);
  directory.write("a.raw.gz", gzipped("skipped" + data));
  expect_ramp(read_volume_image(header("gzip", "datafile: a.raw.gz\nbyteskip: 7\n")), kOblique);
  directory.write("b.raw", "any header" + data);
  expect_ramp(read_volume_image(header("raw", "data file: b.raw\nbyte skip: 10\n")), kOblique);
  expect_ramp(read_volume_image(header("raw", "data file: b.raw\nbyte skip: -1\n")), kOblique);
  EXPECT_NE(error_of(header("raw", "data file: ../a.raw\n")).find("data file"), std::string::npos);
  EXPECT_NE(error_of(header("raw", "data file: /etc/passwd\n")).find("is not a name relative"),
            std::string::npos);
  EXPECT_NE(error_of(header("raw", "data file: LIST\n")).find("the name of one file"), std::string::npos);
  EXPECT_NE(error_of(header("raw", "data file: s%03d.raw 1 3 1\n")).find("the name of one file"),
            std::string::npos);
  EXPECT_NE(error_of(header("gzip", "data file: a.raw\n")).find("not gzip data"), std::string::npos);
}

TEST(VolumeImage, NiftiOfEveryTypeAndByteOrder) {
  const TestDirectory directory;
  for (std::size_t t = 0; t < std::size(kTypes); ++t)
    for (const bool big : {false, true}) {
      SCOPED_TRACE(std::string(kTypes[t]) + (big ? " big" : " little"));
      NiftiHeader header;
      header.datatype = kNiftiTypes[t];
      header.sform_code = 1;
      header.srow = kOblique;
      const std::string bytes = header.bytes(big) + voxels(kTypes[t], big);
      const VolumeImage image = read_volume_image(directory.write("a.nii", bytes));
      EXPECT_TRUE(image.anatomical);
      expect_ramp(image, in_lps(kOblique, -1, -1), 1e-5);  // NIfTI is RAS, in floats
      expect_ramp(read_volume_image(directory.write("a.nii.gz", gzipped(bytes))), in_lps(kOblique, -1, -1),
                  1e-5);
      // What the first bytes say counts, not the ending.
      expect_ramp(read_volume_image(directory.write("b.nii", gzipped(bytes))), in_lps(kOblique, -1, -1),
                  1e-5);
    }
}

TEST(VolumeImage, NiftiPlacesVoxelsByRowsBeforeQuaternionBeforeSpacing) {
  const TestDirectory directory;
  const auto read = [&](const NiftiHeader& header) {
    return read_volume_image(directory.write("a.nii", header.bytes(false) + voxels("int16", false)));
  };
  NiftiHeader header;
  header.pixdim = {-1, 2, 3, 4, 0, 0, 0, 0};  // qfac -1: the third axis turned around
  header.qform_code = 1;
  // A third of a turn about (1, 1, 1): x to y, y to z, z to x.
  header.quatern = {0.5f, 0.5f, 0.5f};
  header.qoffset = {7, 8, 9};
  const Matrix turned = {{{0, 0, -4, 7}, {2, 0, 0, 8}, {0, 3, 0, 9}}};
  expect_ramp(read(header), in_lps(turned, -1, -1), 1e-5);
  header.pixdim[0] = 0;  // as 1
  expect_ramp(read(header), in_lps({{{0, 0, 4, 7}, {2, 0, 0, 8}, {0, 3, 0, 9}}}, -1, -1), 1e-5);
  header.pixdim[0] = 1;
  header.quatern = {1, 0, 0};  // half a turn about x: a is 0
  expect_ramp(read(header), in_lps({{{2, 0, 0, 7}, {0, -3, 0, 8}, {0, 0, -4, 9}}}, -1, -1), 1e-5);
  header.sform_code = 2;
  header.srow = kOblique;
  expect_ramp(read(header), in_lps(kOblique, -1, -1), 1e-5);
  header.qform_code = header.sform_code = 0;
  const VolumeImage bare = read(header);
  EXPECT_FALSE(bare.anatomical);
  expect_ramp(bare, {{{2, 0, 0, 0}, {0, 3, 0, 0}, {0, 0, 4, 0}}});
  header.units = 1;  // metres
  expect_ramp(read(header), {{{2000, 0, 0, 0}, {0, 3000, 0, 0}, {0, 0, 4000, 0}}});
}

TEST(VolumeImage, NiftiScalesItsNumbers) {
  const TestDirectory directory;
  NiftiHeader header;
  header.slope = 0.5f;
  header.intercept = -1024;
  const auto doubled = [](int i, int j, int k) { return 2 * (ramp(i, j, k) + 1024); };
  expect_ramp(read_volume_image(directory.write(
                  "a.nii", header.bytes(false) + voxels("int16", false, kImageSize, doubled))),
              {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}});
  header.slope = 0;  // says that there is no scaling
  expect_ramp(read_volume_image(directory.write("a.nii", header.bytes(false) + voxels("int16", false))),
              {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}});
}

TEST(VolumeImage, ALargeOneIsAveragedAndStaysWhereItIs) {
  const TestDirectory directory;
  // 600 voxels of 0.5 mm along x, a ramp along x: 3 p.
  NiftiHeader header;
  header.dim = {3, 600, 2, 300, 1, 1, 1, 1};
  header.datatype = 64;
  header.pixdim = {1, 0.5f, 1, 1, 1, 1, 1, 1};
  const std::string data = voxels("double", false, {600, 2, 300},
                                  [](int i, int j, int k) { return 3 * 0.5 * i + 100 * j - 7 * k; });
  const VolumeImage image =
      read_volume_image(directory.write("a.nii.gz", gzipped(header.bytes(false) + data)));
  ASSERT_EQ(image.size, (std::array<std::uint32_t, 3>{256, 2, 256}));
  EXPECT_EQ(image.file_size, (std::array<std::uint32_t, 3>{600, 2, 300}));
  std::size_t at = 0;
  for (int k = 0; k < 256; ++k)
    for (int j = 0; j < 2; ++j)
      for (int i = 0; i < 256; ++i, ++at) {
        const core::Vec3 p = apply(image.mm_from_unit, {(i + 0.5) / 256, (j + 0.5) / 2, (k + 0.5) / 256});
        // A voxel's number holds for the whole voxel, so a sample at its side is off by less than half of a step.
        ASSERT_NEAR(image.values[at], 3 * p.x + 100 * p.y - 7 * p.z, 0.25 * 1.5 + 0.25 * 7);
      }
}

TEST(VolumeImage, NumbersThatAreNotFiniteBecomeZero) {
  const TestDirectory directory;
  const auto path = directory.write("a.nrrd", nrrd_header("double", false, "raw") +
                                                  voxels("double", false, kImageSize, [](int i, int j, int) {
                                                    return i == 0 ? NAN : j == 0 ? INFINITY : 1e300;
                                                  }));
  for (const float value : read_volume_image(path).values) EXPECT_EQ(value, 0);
}

TEST(VolumeImage, WrongNrrdFilesGetOneLineThatSaysWhatIsWrong) {
  const TestDirectory directory;
  const std::string good = nrrd_header("int16", false, "raw"), data = voxels("int16", false);
  const auto replaced = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    const std::size_t at = text.find(from);
    EXPECT_NE(at, text.npos) << from;
    return text.replace(at, from.size(), to) + data;
  };
  const std::pair<std::string, const char*> cases[] = {
      {"", "is not NRRD"},
      {"GIF89a", "is not NRRD"},
      {replaced("NRRD0004", "NRRD0009"), "accepted are NRRD0001 to NRRD0005"},
      {replaced("NRRD0004", "NRRD00.01"), "accepted are NRRD0001 to NRRD0005"},
      {replaced("type: int16", "type: block"), "type: found \"block\""},
      {replaced("type: int16\n", ""), "no field \"type\""},
      {replaced("dimension: 3", "dimension: 0"), "dimension: found \"0\""},
      {replaced("dimension: 3", "dimension: 2"), "a number for each of the 2 dimensions"},
      {replaced("sizes: 5 4 3", "sizes: 5 4 x"), "sizes: found"},
      {replaced("sizes: 5 4 3", "sizes: 5 4 0"), "whole numbers from 1"},
      {replaced("sizes: 5 4 3", "sizes: 5 4 -3"), "whole numbers from 1"},
      {replaced("sizes: 5 4 3", "sizes: 5 4 99999"), "accepted are 1 to 32768 a side"},
      {replaced("sizes: 5 4 3", "sizes: 30000 30000 30000"), "at most 4294967296"},
      {replaced("sizes: 5 4 3", "sizes: 18446744073709551617 4 3"), "whole numbers from 1"},
      {replaced("sizes: 5 4 3", "sizes: 5 4 4"), "the header says 160 bytes of voxels"},
      {replaced("kinds: domain domain domain", "kinds: RGB-color domain domain"),
       "accepted are three dimensions with one number"},
      {replaced("kinds: domain domain domain", "kinds: domain"), "a word for each"},
      {replaced("endian: little", "endian: middle"), "little or big"},
      {replaced("endian: little\n", ""), "no field \"endian\""},
      {replaced("encoding: raw", "encoding: bzip2"), "raw or gzip"},
      {replaced("encoding: raw", "encoding: gzip"), "not gzip data"},
      {replaced("space origin: (", "space origin: ["), "a vector (x,y,z)"},
      {replaced("space origin: (10", "space origin: (inf"), "not finite"},
      {replaced("space directions: (1.2", "space directions: (nan"), "not finite"},
      {replaced("space directions: ", "space directions: (1,2) "), "a vector (x,y,z) or none"},
      {replaced("space directions: ", "space directions: none "), "a vector (x,y,z) or none"},
      {replaced("space: left-posterior-superior", "space: left-posterior-superior-time"), "one without time"},
      {replaced("modality:=test", "modality"), "accepted is \"field: value\""},
      {replaced("modality:=test", "byte skip: -2"), "byte skip: found"},
      {replaced("modality:=test", "byte skip: 99999999999"), "bytes of voxels from byte"},
      {replaced("modality:=test", "line skip: 3"), "skip bytes instead"},
      {replaced("modality:=test", "type: float"), "twice"},
      {good.substr(0, good.size() - 1), "no empty line ends the header"},
      {good, "has "},
      {good + data.substr(1), "has "},
  };
  int n = 0;
  for (const auto& [bytes, wanted] : cases) {
    SCOPED_TRACE(std::to_string(n++) + ": " + wanted);
    const std::string error = error_of(directory.write("bad.nrrd", bytes));
    EXPECT_NE(error.find(wanted), error.npos) << error;
  }
  // Axes that do not span space.
  const std::string flat =
      "NRRD0004\ntype: uchar\ndimension: 3\nspace: LPS\nsizes: 5 4 3\nspace directions: (1,0,0) (2,0,0) "
      "(0,0,1)\nencoding: raw\n\n";
  EXPECT_NE(error_of(directory.write("bad.nrrd", flat + std::string(60, 'a'))).find("do not span space"),
            std::string::npos);
  EXPECT_NE(error_of(directory / "none.nrrd").find("No such file"), std::string::npos);
  EXPECT_NE(error_of(directory.write("a.png", "x")).find("accepted are .nrrd, .nhdr, .nii and .nii.gz"),
            std::string::npos);
  std::filesystem::create_directory(directory / "folder.nrrd");
  EXPECT_NE(error_of(directory / "folder.nrrd").find("is a directory"), std::string::npos);
}

TEST(VolumeImage, WrongNiftiFilesGetOneLineThatSaysWhatIsWrong) {
  const TestDirectory directory;
  const auto with = [](auto change) {
    NiftiHeader header;
    change(header);
    return header.bytes(false) + voxels("int16", false);
  };
  const std::string good = NiftiHeader().bytes(false) + voxels("int16", false);
  const std::pair<std::string, const char*> cases[] = {
      {"", "is not NIfTI-1"},
      {good.substr(0, 347), "is not NIfTI-1"},
      {"\x1c\x02" + good.substr(2), "is NIfTI-2"},
      {with([](auto& h) { h.magic = std::string("ni1\0", 4); }), "a pair of files"},
      {with([](auto& h) { h.magic = std::string(4, '\0'); }), "the magic \"n+1\" is missing"},
      {with([](auto& h) { h.dim[0] = 8; }), "dim[0] is 8"},
      {with([](auto& h) { h.dim[2] = -4; }), "dim[2] is -4"},
      {with([](auto& h) { h.dim[2] = 0; }), "dim[2] is 0"},
      {with([](auto& h) { h.dim[0] = 4, h.dim[4] = 2; }), "at one time"},
      {with([](auto& h) { h.datatype = 128; }), "datatype 128"},
      {with([](auto& h) { h.datatype = 32; }), "datatype 32"},
      {with([](auto& h) { h.vox_offset = 100; }), "vox_offset is 100"},
      {with([](auto& h) { h.vox_offset = NAN; }), "vox_offset is"},
      {with([](auto& h) { h.vox_offset = 1e8; }), "bytes of voxels from byte"},
      {with([](auto& h) { h.sform_code = 1; }), "do not span space"},
      {with([](auto& h) { h.sform_code = 1, h.srow = kOblique, h.srow[1][3] = INFINITY; }), "not finite"},
      {with([](auto& h) {
         h.qform_code = 1, h.quatern = {NAN, 0, 0};
       }),
       "not finite"},
      {with([](auto& h) { h.dim[1] = 6; }), "the header says 144 bytes"},
      {good.substr(0, good.size() - 1), "the header says 120 bytes"},
  };
  int n = 0;
  for (const auto& [bytes, wanted] : cases) {
    SCOPED_TRACE(std::to_string(n++) + ": " + wanted);
    const std::string error = error_of(directory.write("bad.nii", bytes));
    EXPECT_NE(error.find(wanted), error.npos) << error;
  }
  const std::string packed = gzipped(good);
  EXPECT_NE(error_of(directory.write("bad.nii.gz", packed.substr(0, packed.size() / 2))), "");
  EXPECT_NE(error_of(directory.write("bad.nii.gz", gzipped(good.substr(0, 400))))
                .find("ends after 48 bytes of voxels"),
            std::string::npos);
}

// Any damage gives an image or one line, and never more memory than an image of the largest size.
TEST(VolumeImage, DamagedFilesAreReadOrRefused) {
  const TestDirectory directory;
  NiftiHeader header;
  header.qform_code = 1;
  const std::pair<const char*, std::string> files[] = {
      {"a.nrrd", nrrd_header("int16", false, "raw") + voxels("int16", false)},
      {"b.nrrd", nrrd_header("int16", false, "gzip") + gzipped(voxels("int16", false))},
      {"c.nii", header.bytes(true) + voxels("int16", true)},
      {"d.nii.gz", gzipped(header.bytes(false) + voxels("int16", false))},
  };
  std::mt19937 random(7);
  for (const auto& [name, bytes] : files) {
    for (std::size_t length = 0; length < bytes.size(); ++length)
      error_of(directory.write(name, bytes.substr(0, length)));
    for (int n = 0; n < 1000; ++n) {
      std::string damaged = bytes;
      for (int k = 0; k <= n % 3; ++k) damaged[random() % damaged.size()] = static_cast<char>(random());
      SCOPED_TRACE(std::string(name) + " " + std::to_string(n));
      error_of(directory.write(name, damaged));
    }
  }
}

// ------------------------------------------------------------------------------------------------ judged by VTK

std::string python(const std::string& script, const std::string& argument) {
  const TestDirectory directory;
  const auto path = directory.write("script.py", script);
  const std::string command = "/usr/bin/python3 " + path.string() + " '" + argument + "' 2>&1";
  FILE* pipe = popen(command.c_str(), "r");
  if (!pipe) return "popen failed";
  std::string output;
  char buffer[4096];
  while (const std::size_t count = std::fread(buffer, 1, sizeof buffer, pipe)) output.append(buffer, count);
  pclose(pipe);
  return output;
}

// The numbers and places (LPS) of all voxels as VTK's reader of NIfTI sees them.
constexpr const char* kVtkNifti = R"(
import sys
from vtkmodules.vtkIOImage import vtkNIFTIImageReader
reader = vtkNIFTIImageReader()
reader.SetFileName(sys.argv[1])
reader.Update()
image = reader.GetOutput()
form = reader.GetSFormMatrix() or reader.GetQFormMatrix()
nx, ny, nz = image.GetDimensions()
for k in range(nz):
    for j in range(ny):
        for i in range(nx):
            p = [0, 0, 0]
            image.TransformIndexToPhysicalPoint((i, j, k), p)
            p = form.MultiplyPoint((*p, 1))
            print(image.GetScalarComponentAsDouble(i, j, k, 0), -p[0], -p[1], p[2])
)";

// The same for NRRD, as far as VTK 9.1's reader goes: it takes the first axis for components, does not swap bytes, has no oblique axes, and knows the spacing of an axis by the
// length of its direction. So: all numbers in their order, the two other spacings, the origin.
constexpr const char* kVtkNrrd = R"(
import sys
from vtkmodules.vtkIOImage import vtkNrrdReader
reader = vtkNrrdReader()
reader.SetFileName(sys.argv[1])
reader.Update()
image = reader.GetOutput()
values = image.GetPointData().GetScalars()
print(*[values.GetComponent(t, c) for t in range(values.GetNumberOfTuples()) for c in range(values.GetNumberOfComponents())])
print(*image.GetSpacing()[:2], *image.GetOrigin())
)";

void expect_nifti_as_vtk(const std::filesystem::path& path) {
  std::istringstream vtk(python(kVtkNifti, path.string()));
  const VolumeImage image = read_volume_image(path);
  const auto [nx, ny, nz] = image.size;
  std::size_t at = 0;
  for (std::uint32_t k = 0; k < nz; ++k)
    for (std::uint32_t j = 0; j < ny; ++j)
      for (std::uint32_t i = 0; i < nx; ++i, ++at) {
        double value = NAN;
        core::Vec3 p;
        ASSERT_TRUE(vtk >> value >> p.x >> p.y >> p.z) << vtk.str().substr(0, 300);
        ASSERT_EQ(image.values[at], value);
        const core::Vec3 own = apply(image.mm_from_unit, {(i + 0.5) / nx, (j + 0.5) / ny, (k + 0.5) / nz});
        ASSERT_NEAR(length(own - p), 0, 1e-4) << i << " " << j << " " << k;
      }
}

void expect_nrrd_as_vtk(const std::filesystem::path& path) {
  std::istringstream vtk(python(kVtkNrrd, path.string()));
  const VolumeImage image = read_volume_image(path);
  double number = NAN;
  for (const float value : image.values) {
    ASSERT_TRUE(vtk >> number) << vtk.str().substr(0, 300);
    ASSERT_EQ(value, number);
  }
  const auto middle = [&](double i, double j, double k) {
    return apply(image.mm_from_unit,
                 {(i + 0.5) / image.size[0], (j + 0.5) / image.size[1], (k + 0.5) / image.size[2]});
  };
  const core::Vec3 first = middle(0, 0, 0);
  for (const double own :
       {length(middle(0, 1, 0) - first), length(middle(0, 0, 1) - first), first.x, first.y, first.z}) {
    ASSERT_TRUE(vtk >> number);
    ASSERT_NEAR(own, number, 1e-9);
  }
}

TEST(VolumeImage, VtkReadsTheSameVoxelsInTheSamePlaces) {
  if (python("import vtk\nprint('yes')", "") != "yes\n")
    GTEST_SKIP() << "needs /usr/bin/python3 with the module vtk (Debian: python3-vtk9)";
  const TestDirectory directory;
  NiftiHeader header;
  header.sform_code = 1;
  header.srow = kOblique;
  expect_nifti_as_vtk(directory.write("rows.nii.gz", gzipped(header.bytes(true) + voxels("int16", true))));
  NiftiHeader turned;
  turned.qform_code = 1;
  turned.pixdim = {1, 2, 3, 4, 1, 1, 1, 1};
  turned.quatern = {0.1f, -0.2f, 0.3f};
  turned.qoffset = {7, 8, 9};
  turned.datatype = 16;
  expect_nifti_as_vtk(directory.write("turned.nii", turned.bytes(false) + voxels("float", false)));
  const std::string data = voxels("float", false);
  expect_nrrd_as_vtk(directory.write("raw.nrrd", nrrd_header("float", false, "raw") + data));
  expect_nrrd_as_vtk(directory.write("packed.nrrd", nrrd_header("float", false, "gzip") + gzipped(data)));
  directory.write("beside.raw", data);
  expect_nrrd_as_vtk(
      directory.write("beside.nhdr", nrrd_header("float", false, "raw", "LPS", "data file: beside.raw\n")));
}

}  // namespace
}  // namespace incise::mesh_io
