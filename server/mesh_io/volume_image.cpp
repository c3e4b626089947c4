#include "server/mesh_io/volume_image.hpp"

#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxHeaderBytes = 64 << 10;
constexpr std::uint64_t kMaxFileSide = 32'768;
constexpr std::uint64_t kMaxVoxels = 1ull << 32;

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
  void operator()(gzFile file) const { gzclose_r(file); }
};

// The bytes of a file from some place on, unpacked where they are packed.
class Bytes {
 public:
  Bytes(const fs::path& path, bool gzip, std::int64_t begin) : name_(path.string()) {
    file_.reset(std::fopen(name_.c_str(), "rb"));
    if (!file_) throw MeshError(name_ + ": " + std::generic_category().message(errno));
    if (::fseek(file_.get(), begin, SEEK_SET) != 0) throw MeshError(name_ + ": cannot be read");
    if (!gzip) return;
    // zlib reads on from where the descriptor stands, and closes it.
    const int copy = ::dup(::fileno(file_.get()));
    if (copy < 0 || ::lseek(copy, begin, SEEK_SET) < 0 || !(packed_ = Packed(::gzdopen(copy, "rb"))))
      throw MeshError(name_ + ": cannot be read");
    if (::gzdirect(packed_.get()) != 0)
      throw MeshError(name_ + ": the voxels are not gzip data, as the header says");
  }

  // At most `count`; fewer only at the end.
  std::size_t read_some(void* to, std::size_t count) {
    if (!packed_) return std::fread(to, 1, count, file_.get());
    const int got = ::gzread(packed_.get(), to, static_cast<unsigned>(count));
    if (got < 0) {
      int code = 0;
      const char* const why = ::gzerror(packed_.get(), &code);
      throw MeshError(name_ + ": damaged gzip data: " + (code == Z_ERRNO ? "cannot be read" : why));
    }
    return static_cast<std::size_t>(got);
  }
  void read(void* to, std::size_t count) {
    const std::size_t got = read_some(to, count);
    done_ += got;
    if (got < count)
      throw MeshError(name_ + ": ends after " + std::to_string(done_) +
                      " bytes of voxels; the header says more");
  }
  void skip(std::uint64_t count) {
    char scratch[4096];
    while (count > 0) {
      const std::size_t part = static_cast<std::size_t>(std::min<std::uint64_t>(count, sizeof scratch));
      read(scratch, part);
      count -= part;
    }
    done_ = 0;
  }

 private:
  using Packed = std::unique_ptr<std::remove_pointer_t<gzFile>, CloseFile>;
  std::string name_;
  std::unique_ptr<std::FILE, CloseFile> file_;
  Packed packed_;
  std::uint64_t done_ = 0;
};

std::string head_of(const fs::path& path, bool gzip) {
  std::string head(kMaxHeaderBytes, '\0');
  head.resize(Bytes(path, gzip, 0).read_some(head.data(), head.size()));
  return head;
}

ImageHeader read_header(const fs::path& path, bool nifti) {
  const std::string head = head_of(path, false);
  if (!nifti) return parse_nrrd(head, path);
  const bool gzip = head.starts_with("\x1f\x8b");  // whatever the file's ending is
  ImageHeader header = parse_nifti(gzip ? head_of(path, true) : head, path);
  header.gzip = gzip;
  return header;
}

template <class T>
double number_at(const unsigned char* bytes, bool swapped) {
  unsigned char own[sizeof(T)];
  std::memcpy(own, bytes, sizeof(T));
  if (swapped) std::reverse(own, own + sizeof(T));
  T value;
  std::memcpy(&value, own, sizeof(T));
  return static_cast<double>(value);
}

using NumberAt = double (*)(const unsigned char*, bool);

NumberAt reader_of(VoxelType type) {
  switch (type) {
    case VoxelType::kInt8:
      return number_at<std::int8_t>;
    case VoxelType::kUint8:
      return number_at<std::uint8_t>;
    case VoxelType::kInt16:
      return number_at<std::int16_t>;
    case VoxelType::kUint16:
      return number_at<std::uint16_t>;
    case VoxelType::kInt32:
      return number_at<std::int32_t>;
    case VoxelType::kUint32:
      return number_at<std::uint32_t>;
    case VoxelType::kInt64:
      return number_at<std::int64_t>;
    case VoxelType::kUint64:
      return number_at<std::uint64_t>;
    case VoxelType::kFloat:
      return number_at<float>;
    case VoxelType::kDouble:
      return number_at<double>;
  }
  return nullptr;
}

// Which of `m` samples the voxel i of `n` >= m lies in, and which share of a sample it is: in the first, and in the next one.
struct Share {
  std::size_t at;
  float here, next;
};

Share share_of(std::uint64_t i, std::uint64_t n, std::uint64_t m) {
  const std::uint64_t first = i * m / n, last = ((i + 1) * m - 1) / n;
  const auto part = [n](std::uint64_t of_n) {
    return static_cast<float>(static_cast<double>(of_n) / static_cast<double>(n));
  };
  if (first == last) return {first, part(m), 0};
  return {first, part(last * n - i * m), part((i + 1) * m - last * n)};
}

void add(float* to, const float* from, std::size_t count, float weight) {
  if (weight == 0) return;
  for (std::size_t i = 0; i < count; ++i) to[i] += weight * from[i];
}

// Averages over boxes while it reads: separately along the three axes, since the shares of a box are products.
std::vector<float> read_voxels(const ImageHeader& header, const std::array<std::uint32_t, 3>& size) {
  const auto [nx, ny, nz] = header.size;
  const auto [mx, my, mz] = size;
  const std::size_t voxel = size_of(header.type);
  Bytes file(header.data, header.gzip, header.begin);
  file.skip(header.skip);
  const NumberAt number = reader_of(header.type);
  constexpr bool kBigHere = std::endian::native == std::endian::big;
  const bool swapped = header.big_endian != kBigHere;
  std::vector<unsigned char> bytes(nx * voxel);
  std::vector<float> row(mx), plane(std::size_t{mx} * my), volume(std::size_t{mx} * my * mz);
  std::vector<Share> along_x;
  for (std::uint64_t x = 0; x < nx; ++x) along_x.push_back(share_of(x, nx, mx));
  for (std::uint64_t z = 0; z < nz; ++z) {
    std::fill(plane.begin(), plane.end(), 0.0f);
    for (std::uint64_t y = 0; y < ny; ++y) {
      file.read(bytes.data(), bytes.size());
      std::fill(row.begin(), row.end(), 0.0f);
      for (std::uint64_t x = 0; x < nx; ++x) {
        const double raw = header.slope * number(&bytes[x * voxel], swapped) + header.intercept;
        const float value = std::isfinite(static_cast<float>(raw)) ? static_cast<float>(raw) : 0.0f;
        const Share& share = along_x[x];
        row[share.at] += share.here * value;
        if (share.next > 0) row[share.at + 1] += share.next * value;
      }
      const Share share = share_of(y, ny, my);
      add(&plane[share.at * mx], row.data(), mx, share.here);
      if (share.next > 0) add(&plane[(share.at + 1) * mx], row.data(), mx, share.next);
    }
    const Share share = share_of(z, nz, mz);
    add(&volume[share.at * plane.size()], plane.data(), plane.size(), share.here);
    if (share.next > 0) add(&volume[(share.at + 1) * plane.size()], plane.data(), plane.size(), share.next);
  }
  // Sums of the largest floats overflow.
  for (float& value : volume)
    if (!std::isfinite(value)) value = 0;
  return volume;
}

// A raw file's length says before anything is allocated whether the header is right.
void find_raw_voxels(ImageHeader& header, std::uint64_t bytes) {
  std::error_code error;
  const std::uint64_t length = fs::file_size(header.data, error);
  if (error) throw MeshError(header.data.string() + ": " + error.message());
  if (header.begin < 0) {
    header.begin = static_cast<std::int64_t>(length - std::min(length, bytes));
    header.skip = 0;
  }
  const std::uint64_t before = static_cast<std::uint64_t>(header.begin) + header.skip;
  if (before < header.skip || before > length || length - before < bytes)
    throw MeshError(header.data.string() + ": has " + std::to_string(length) + " bytes; the header says " +
                    std::to_string(bytes) + " bytes of voxels from byte " + std::to_string(before) + " on");
}

bool is_finite(const Affine& affine) {
  for (const auto& row : affine)
    for (const double x : row)
      if (!(std::abs(x) < 1e12)) return false;
  return true;
}

std::string lower_ending(const fs::path& path) {
  const std::string name = lowercase(path.filename().string());
  for (const char* ending : {".nrrd", ".nhdr", ".nii", ".nii.gz"})
    if (name.ends_with(ending)) return ending;
  return {};
}

}  // namespace

core::Vec3 apply(const Affine& m, const core::Vec3& p) {
  const auto row = [&](const std::array<double, 4>& r) {
    return r[0] * p.x + r[1] * p.y + r[2] * p.z + r[3];
  };
  return {row(m[0]), row(m[1]), row(m[2])};
}

Affine after(const Affine& a, const Affine& b) {
  Affine out{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 4; ++j)
      for (std::size_t k = 0; k < 3; ++k) out[i][j] += a[i][k] * b[k][j];
    out[i][3] += a[i][3];
  }
  return out;
}

// By cofactors.
Affine inverse(const Affine& m, const std::string& name) {
  Affine out{};
  double determinant = 0, lengths = 1;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      const std::size_t a = (j + 1) % 3, b = (j + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
      out[i][j] = m[a][c] * m[b][d] - m[a][d] * m[b][c];
    }
    determinant += m[0][i] * out[i][0];
    lengths *= std::sqrt(m[0][i] * m[0][i] + m[1][i] * m[1][i] + m[2][i] * m[2][i]);
  }
  if (!(std::abs(determinant) > 1e-9 * lengths))
    throw MeshError(name +
                    ": the axes of the image do not span space: two of their directions are the same, or one "
                    "has no length");
  for (auto& row : out)
    for (double& x : row) x /= determinant;
  for (auto& row : out) row[3] = -(row[0] * m[0][3] + row[1] * m[1][3] + row[2] * m[2][3]);
  if (!is_finite(out)) throw MeshError(name + ": the spacing of the voxels is too small");
  return out;
}

std::size_t size_of(VoxelType type) {
  switch (type) {
    case VoxelType::kInt8:
    case VoxelType::kUint8:
      return 1;
    case VoxelType::kInt16:
    case VoxelType::kUint16:
      return 2;
    case VoxelType::kInt32:
    case VoxelType::kUint32:
    case VoxelType::kFloat:
      return 4;
    default:
      return 8;
  }
}

const char* to_string(VoxelType type) {
  switch (type) {
    case VoxelType::kInt8:
      return "int8";
    case VoxelType::kUint8:
      return "uint8";
    case VoxelType::kInt16:
      return "int16";
    case VoxelType::kUint16:
      return "uint16";
    case VoxelType::kInt32:
      return "int32";
    case VoxelType::kUint32:
      return "uint32";
    case VoxelType::kInt64:
      return "int64";
    case VoxelType::kUint64:
      return "uint64";
    case VoxelType::kFloat:
      return "float32";
    case VoxelType::kDouble:
      return "float64";
  }
  return "";
}

bool is_volume_image(const fs::path& path) {
  return !lower_ending(path).empty();
}

VolumeImage read_volume_image(const fs::path& path) {
  const std::string name = path.string(), ending = lower_ending(path);
  if (ending.empty())
    throw MeshError(name + ": not a volume image; accepted are .nrrd, .nhdr, .nii and .nii.gz");
  std::error_code error;
  if (fs::is_directory(path, error)) throw MeshError(name + ": is a directory");
  ImageHeader header = read_header(path, ending.starts_with(".nii"));
  std::uint64_t voxels = 1;
  for (const std::uint64_t side : header.size) {
    if (side == 0 || side > kMaxFileSide || voxels * side > kMaxVoxels)
      throw MeshError(name + ": " + std::to_string(header.size[0]) + " x " + std::to_string(header.size[1]) +
                      " x " + std::to_string(header.size[2]) + " voxels; accepted are 1 to " +
                      std::to_string(kMaxFileSide) + " a side, and at most " + std::to_string(kMaxVoxels));
    voxels *= side;
  }
  if (!is_finite(header.mm_from_index))
    throw MeshError(name + ": where the voxels are is given by numbers that are not finite, or too large");
  inverse(header.mm_from_index, name);
  if (!header.gzip) find_raw_voxels(header, voxels * size_of(header.type));

  VolumeImage image;
  Affine index_from_unit{};
  for (std::size_t i = 0; i < 3; ++i) {
    image.file_size[i] = static_cast<std::uint32_t>(header.size[i]);
    image.size[i] = std::min(image.file_size[i], kMaxImageSide);
    index_from_unit[i][i] = image.file_size[i];
    index_from_unit[i][3] = -0.5;
  }
  image.mm_from_unit = after(header.mm_from_index, index_from_unit);
  image.anatomical = header.anatomical;
  image.file_type = header.type;
  image.values = read_voxels(header, image.size);
  return image;
}

}  // namespace incise::mesh_io
