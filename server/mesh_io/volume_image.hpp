#pragma once

// Volume images: what a CT or MR scanner measured at each place of a body.

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "server/core/geometry/vec3.hpp"

namespace incise::mesh_io {

// p goes to (rows 0 to 2 of three numbers) p + the fourth numbers.
using Affine = std::array<std::array<double, 4>, 3>;

core::Vec3 apply(const Affine& affine, const core::Vec3& p);
// First `b`, then `a`.
Affine after(const Affine& a, const Affine& b);
// Throws MeshError where there is none, or none with finite numbers.
Affine inverse(const Affine& affine, const std::string& name);

// At most so many samples along each axis: larger images are averaged.
inline constexpr std::uint32_t kMaxImageSide = 256;

enum class VoxelType { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kInt64, kUint64, kFloat, kDouble };
std::size_t size_of(VoxelType type);
// As NumPy names it: "int16", "float32".
const char* to_string(VoxelType type);

struct VolumeImage {
  std::array<std::uint32_t, 3> size{};  // of the samples here
  std::vector<float> values;            // x fastest; finite
  // From the image to millimetres: the image's box is 0 to 1 along each axis (sample (i, j, k) is at ((i + 1/2) / size[0], ...)).
  Affine mm_from_unit{};
  bool anatomical =
      false;  // those millimetres are LPS: x to the left, y to the back, z to the head. Else the file does not say
  std::array<std::uint32_t, 3> file_size{};  // before averaging
  VoxelType file_type = VoxelType::kUint8;   // of the numbers in the file
};

// Reads .nrrd, .nhdr (NRRD 1 to 5, encodings raw and gzip), .nii and .nii.gz (NIfTI-1): one number a voxel, of any type, three axes. Numbers that are
// not finite become 0. Memory: 64 MB at most, however large the file. Throws MeshError.
VolumeImage read_volume_image(const std::filesystem::path& path);
bool is_volume_image(const std::filesystem::path& path);

// ------------------------------------------------------------------------------------------------ for the readers of the two formats

// What a header says.
struct ImageHeader {
  std::filesystem::path data;  // the file with the voxels
  std::int64_t begin = 0;      // where they begin in it: in the file as it is, or -1: they are its end
  bool gzip = false;           // from `begin` on
  std::uint64_t skip = 0;      // so many bytes, unpacked
  VoxelType type = VoxelType::kUint8;
  bool big_endian = false;
  std::array<std::uint64_t, 3> size{};
  double slope = 1, intercept = 0;  // a number in the file times slope, plus intercept
  Affine mm_from_index{};           // integers are the middles of voxels
  bool anatomical = false;
};

// `head`: the file's first bytes, at least its header. Throws MeshError.
ImageHeader parse_nrrd(const std::string& head, const std::filesystem::path& path);
ImageHeader parse_nifti(const std::string& head, const std::filesystem::path& path);

}  // namespace incise::mesh_io
