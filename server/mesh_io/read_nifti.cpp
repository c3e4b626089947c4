// NIfTI-1 (https://nifti.nimh.nih.gov/nifti-1: nifti1.h, 2007): a header of 348 bytes, then voxels.
#include <bit>
#include <cmath>
#include <cstring>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/volume_image.hpp"

namespace incise::mesh_io {
namespace {

constexpr std::size_t kHeaderBytes = 348;

// Numbers of the header, by the offsets that nifti1.h gives.
class Header {
 public:
  Header(const std::string& bytes, bool swapped) : bytes_(bytes), swapped_(swapped) {}
  std::int16_t int16(std::size_t at) const { return number<std::int16_t>(at); }
  double real(std::size_t at) const { return static_cast<double>(number<float>(at)); }
  bool swapped() const { return swapped_; }

 private:
  template <class T>
  T number(std::size_t at) const {
    char own[sizeof(T)];
    for (std::size_t i = 0; i < sizeof(T); ++i) own[i] = bytes_[at + (swapped_ ? sizeof(T) - 1 - i : i)];
    T value;
    std::memcpy(&value, own, sizeof(T));
    return value;
  }
  const std::string& bytes_;
  bool swapped_;
};

constexpr std::size_t kDim = 40, kDatatype = 70, kPixdim = 76, kVoxOffset = 108, kSlope = 112,
                      kIntercept = 116, kUnits = 123, kQformCode = 252, kSformCode = 254, kQuatern = 256,
                      kQoffset = 268, kSrow = 280, kMagic = 344;

VoxelType type_of(int code, const std::string& name) {
  switch (code) {
    case 2:
      return VoxelType::kUint8;
    case 4:
      return VoxelType::kInt16;
    case 8:
      return VoxelType::kInt32;
    case 16:
      return VoxelType::kFloat;
    case 64:
      return VoxelType::kDouble;
    case 256:
      return VoxelType::kInt8;
    case 512:
      return VoxelType::kUint16;
    case 768:
      return VoxelType::kUint32;
    case 1024:
      return VoxelType::kInt64;
    case 1280:
      return VoxelType::kUint64;
    default:
      throw MeshError(name + ": datatype " + std::to_string(code) +
                      "; accepted are whole numbers of 8 to 64 bits and floats of 32 and 64 (one number a "
                      "voxel, no colours, no complex ones)");
  }
}

double millimetres(int units) {
  switch (units & 7) {
    case 1:
      return 1000;
    case 3:
      return 1e-3;
    default:
      return 1;  // NIFTI_UNITS_MM, or unknown
  }
}

// Method 2: a rotation by the quaternion (a, b, c, d), whose a is the positive one that makes it a unit.
Affine by_quaternion(const Header& h) {
  double b = h.real(kQuatern), c = h.real(kQuatern + 4), d = h.real(kQuatern + 8);
  double a = 1 - (b * b + c * c + d * d);
  if (a < 1e-7) {
    // By half a turn, and rounding.
    const double length = std::sqrt(b * b + c * c + d * d);
    b /= length, c /= length, d /= length;
    a = 0;
  } else {
    a = std::sqrt(a);
  }
  const double rotation[3][3] = {
      {a * a + b * b - c * c - d * d, 2 * b * c - 2 * a * d, 2 * b * d + 2 * a * c},
      {2 * b * c + 2 * a * d, a * a + c * c - b * b - d * d, 2 * c * d - 2 * a * b},
      {2 * b * d - 2 * a * c, 2 * c * d + 2 * a * b, a * a + d * d - c * c - b * b}};
  Affine m{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      double spacing = h.real(kPixdim + 4 * (j + 1));
      if (!(spacing > 0)) spacing = 1;
      if (j == 2 && h.real(kPixdim) < 0) spacing = -spacing;  // qfac
      m[i][j] = rotation[i][j] * spacing;
    }
    m[i][3] = h.real(kQoffset + 4 * i);
  }
  return m;
}

Affine by_rows(const Header& h) {
  Affine m{};
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 4; ++j) m[i][j] = h.real(kSrow + 16 * i + 4 * j);
  return m;
}

Affine by_spacing(const Header& h) {
  Affine m{};
  for (std::size_t i = 0; i < 3; ++i) {
    const double spacing = std::abs(h.real(kPixdim + 4 * (i + 1)));
    m[i][i] = spacing > 0 ? spacing : 1;
  }
  return m;
}

}  // namespace

ImageHeader parse_nifti(const std::string& head, const std::filesystem::path& path) {
  const std::string name = path.string();
  std::int32_t length = 0;
  if (head.size() >= 4) std::memcpy(&length, head.data(), 4);
  const bool swapped = length == 0x5c010000;  // 348 of the other byte order
  if (length == 540 || length == 0x1c020000) throw MeshError(name + ": is NIfTI-2; accepted is NIfTI-1");
  if (head.size() < kHeaderBytes || (length != static_cast<std::int32_t>(kHeaderBytes) && !swapped))
    throw MeshError(name + ": is not NIfTI-1: it does not begin with a header of 348 bytes");
  if (head.compare(kMagic, 4, std::string("ni1\0", 4)) == 0)
    throw MeshError(name + ": is one of a pair of files (.hdr, .img); accepted is a single file");
  if (head.compare(kMagic, 4, std::string("n+1\0", 4)) != 0)
    throw MeshError(
        name +
        ": is not NIfTI-1: the magic \"n+1\" is missing (Analyze 7.5 does not say where its voxels are)");

  const Header h(head, swapped);
  ImageHeader image;
  const int dimensions = h.int16(kDim);
  if (dimensions < 1 || dimensions > 7)
    throw MeshError(name + ": dim[0] is " + std::to_string(dimensions) + "; accepted are 1 to 7");
  for (int i = 1; i <= 7; ++i) {
    const int size = i <= dimensions ? h.int16(kDim + 2 * static_cast<std::size_t>(i)) : 1;
    if (size < 1)
      throw MeshError(name + ": dim[" + std::to_string(i) + "] is " + std::to_string(size) +
                      "; accepted are 1 and more");
    if (i > 3 && size != 1)
      throw MeshError(name + ": dim[" + std::to_string(i) + "] is " + std::to_string(size) +
                      "; accepted are images of three dimensions, at one time");
    if (i <= 3) image.size[static_cast<std::size_t>(i - 1)] = static_cast<std::uint64_t>(size);
  }
  image.type = type_of(h.int16(kDatatype), name);
  image.big_endian = swapped != (std::endian::native == std::endian::big);
  const double offset = h.real(kVoxOffset);
  if (offset != 0 && !(offset >= 352 && offset <= 1e9))
    throw MeshError(name + ": vox_offset is " + to_text(offset) + "; accepted are 352 and more");
  image.data = path;
  image.skip = offset == 0 ? 352 : static_cast<std::uint64_t>(offset);
  const double slope = h.real(kSlope), intercept = h.real(kIntercept);
  if (std::isfinite(slope) && std::isfinite(intercept) && slope != 0) {
    image.slope = slope;
    image.intercept = intercept;
  }
  image.anatomical = h.int16(kSformCode) > 0 || h.int16(kQformCode) > 0;
  Affine m = h.int16(kSformCode) > 0   ? by_rows(h)
             : h.int16(kQformCode) > 0 ? by_quaternion(h)
                                       : by_spacing(h);
  // From RAS, x to the right and y to the front, to LPS.
  const double mm = millimetres(head[kUnits]);
  for (std::size_t i = 0; i < 3; ++i)
    for (double& x : m[i]) x *= image.anatomical && i < 2 ? -mm : mm;
  image.mm_from_index = m;
  return image;
}

}  // namespace incise::mesh_io
