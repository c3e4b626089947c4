#include "tests/mesh_io/volume_image_files.hpp"

#include <zlib.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <stdexcept>

namespace incise::mesh_io::testing {
namespace {

template <class T>
void put(std::string& out, T value, bool big_endian) {
  char bytes[sizeof(T)];
  std::memcpy(bytes, &value, sizeof(T));
  if (big_endian != (std::endian::native == std::endian::big)) std::reverse(bytes, bytes + sizeof(T));
  out.append(bytes, sizeof(T));
}

void put_number(std::string& out, const std::string& type, double value, bool big) {
  if (type == "int8") return put(out, static_cast<std::int8_t>(value), big);
  if (type == "uint8") return put(out, static_cast<std::uint8_t>(value), big);
  if (type == "int16") return put(out, static_cast<std::int16_t>(value), big);
  if (type == "uint16") return put(out, static_cast<std::uint16_t>(value), big);
  if (type == "int32") return put(out, static_cast<std::int32_t>(value), big);
  if (type == "uint32") return put(out, static_cast<std::uint32_t>(value), big);
  if (type == "int64") return put(out, static_cast<std::int64_t>(value), big);
  if (type == "uint64") return put(out, static_cast<std::uint64_t>(value), big);
  if (type == "float") return put(out, static_cast<float>(value), big);
  if (type == "double") return put(out, value, big);
  throw std::logic_error(type);
}

std::string vector(double x, double y, double z) {
  char text[100];
  std::snprintf(text, sizeof text, "(%.17g,%.17g,%.17g)", x, y, z);
  return text;
}

}  // namespace

std::string voxels(const std::string& type, bool big_endian, const std::array<int, 3>& size,
                   const std::function<double(int, int, int)>& value) {
  std::string out;
  for (int k = 0; k < size[2]; ++k)
    for (int j = 0; j < size[1]; ++j)
      for (int i = 0; i < size[0]; ++i) put_number(out, type, value(i, j, k), big_endian);
  return out;
}

std::string gzipped(const std::string& bytes) {
  z_stream z{};
  if (deflateInit2(&z, 6, Z_DEFLATED, 16 + MAX_WBITS, 8, Z_DEFAULT_STRATEGY) != Z_OK) throw std::bad_alloc();
  std::string out(deflateBound(&z, bytes.size()) + 32, '\0');
  z.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  z.avail_in = static_cast<uInt>(bytes.size());
  z.next_out = reinterpret_cast<Bytef*>(out.data());
  z.avail_out = static_cast<uInt>(out.size());
  deflate(&z, Z_FINISH);
  out.resize(z.total_out);
  deflateEnd(&z);
  return out;
}

std::string nrrd_directions(const Matrix& m) {
  return vector(m[0][0], m[1][0], m[2][0]) + " " + vector(m[0][1], m[1][1], m[2][1]) + " " +
         vector(m[0][2], m[1][2], m[2][2]);
}

std::string nrrd_origin(const Matrix& m) {
  return vector(m[0][3], m[1][3], m[2][3]);
}

std::string nrrd_header(const std::string& type, bool big_endian, const std::string& encoding,
                        const std::string& space, const std::string& more) {
  return "NRRD0004\n# written by a test\ntype: " + type + "\ndimension: 3\nspace: " + space +
         "\nsizes: 5 4 3\nspace directions: " + nrrd_directions(kOblique) +
         "\nkinds: domain domain domain\nendian: " + (big_endian ? "big" : "little") +
         "\nencoding: " + encoding + "\nspace origin: " + nrrd_origin(kOblique) + "\nmodality:=test\n" +
         more + "\n";
}

// Offsets of nifti1.h.
std::string NiftiHeader::bytes(bool big) const {
  std::string out;
  put(out, std::int32_t{348}, big);
  out.resize(40);
  for (const auto d : dim) put(out, d, big);
  out.resize(70);
  put(out, datatype, big);
  out.resize(76);
  for (const auto p : pixdim) put(out, p, big);
  put(out, vox_offset, big);
  put(out, slope, big);
  put(out, intercept, big);
  out.resize(123);
  out += units;
  out.resize(252);
  put(out, qform_code, big);
  put(out, sform_code, big);
  for (const auto q : quatern) put(out, q, big);
  for (const auto q : qoffset) put(out, q, big);
  for (const auto& row : srow)
    for (const double x : row) put(out, static_cast<float>(x), big);
  out.resize(344);
  out += magic;
  out.resize(352);
  return out;
}

}  // namespace incise::mesh_io::testing
