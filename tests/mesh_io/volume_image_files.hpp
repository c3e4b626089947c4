#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>

namespace incise::mesh_io::testing {

// Small volume images, written as their specifications say and not with the readers' code.

using Matrix = std::array<std::array<double, 4>, 3>;

inline constexpr std::array<int, 3> kImageSize = {5, 4, 3};
// An oblique right-handed box: columns are the axes of the array, then the first voxel's middle. Millimetres.
inline constexpr Matrix kOblique = {{{1.2, -0.8, 0.3, 10}, {0.9, 1.6, -0.45, -20}, {0, 0.0, 2.5, 30}}};

// What voxel (i, j, k) has: a ramp along each axis, which no two share.
inline double ramp(int i, int j, int k) {
  return i + 5 * j + 20 * k;
}

// `type` as in a NRRD header: "uint8", ..., "float", "double".
std::string voxels(const std::string& type, bool big_endian, const std::array<int, 3>& size = kImageSize,
                   const std::function<double(int, int, int)>& value = ramp);
std::string gzipped(const std::string& bytes);
// "(1.2,0.9,0) (-0.8,1.6,0) (0.3,-0.45,2.5)": the axes, each as a vector.
std::string nrrd_directions(const Matrix& m);
std::string nrrd_origin(const Matrix& m);
// An attached header of kOblique in this space, up to and with the empty line. `more`: further lines.
std::string nrrd_header(const std::string& type, bool big_endian, const std::string& encoding,
                        const std::string& space = "left-posterior-superior", const std::string& more = "");

struct NiftiHeader {
  std::array<std::int16_t, 8> dim = {3, 5, 4, 3, 1, 1, 1, 1};
  std::int16_t datatype = 4;
  std::array<float, 8> pixdim = {1, 1, 1, 1, 1, 1, 1, 1};
  float vox_offset = 352, slope = 0, intercept = 0;
  char units = 2;
  std::int16_t qform_code = 0, sform_code = 0;
  std::array<float, 3> quatern = {}, qoffset = {};
  Matrix srow = {};
  std::string magic = std::string("n+1\0", 4);
  // 352 bytes: with the four that say that there are no extensions.
  std::string bytes(bool big_endian) const;
};

}  // namespace incise::mesh_io::testing
