// PNG (W3C, https://www.w3.org/TR/png-3/), JPEG (ITU-T T.81), WebP (RFC 9649).
#include <zlib.h>

#include <cstdint>
#include <string>
#include <string_view>

#include "server/mesh_io/read_materials.hpp"

namespace incise::mesh_io {
namespace {

std::uint32_t byte_at(std::string_view bytes, std::size_t i) {
  return static_cast<unsigned char>(bytes[i]);
}

std::uint32_t big_endian(std::string_view bytes, std::size_t at) {
  return byte_at(bytes, at) << 24 | byte_at(bytes, at + 1) << 16 | byte_at(bytes, at + 2) << 8 |
         byte_at(bytes, at + 3);
}

std::uint32_t little_endian(std::string_view bytes, std::size_t at) {
  return byte_at(bytes, at) | byte_at(bytes, at + 1) << 8 | byte_at(bytes, at + 2) << 16 |
         byte_at(bytes, at + 3) << 24;
}

std::string cut_off(std::string_view bytes, const std::string& what) {
  return "is cut off: its " + std::to_string(bytes.size()) + " bytes end before " + what;
}

std::string png_fault(std::string_view bytes) {
  std::size_t at = 8;
  bool data = false;
  while (at + 12 <= bytes.size()) {
    const std::size_t size = big_endian(bytes, at);
    const std::string_view type = bytes.substr(at + 4, 4);
    if (at == 8 && (type != "IHDR" || size != 13)) return "is damaged: it begins without a PNG's header";
    if (size > bytes.size() - at - 12) break;
    const bool critical = type[0] >= 'A' && type[0] <= 'Z';
    const auto sum = crc32(0, reinterpret_cast<const Bytef*>(&bytes[at + 4]), static_cast<uInt>(size + 4));
    if (critical && sum != big_endian(bytes, at + 8 + size))
      return "is damaged: the check sum of the part of it that begins at byte " + std::to_string(at) +
             " is wrong";
    if (at == 8 && (big_endian(bytes, 16) == 0 || big_endian(bytes, 20) == 0)) return "has no pixels";
    data = data || type == "IDAT";
    if (type == "IEND") return data ? "" : "has no pixels";
    at += 12 + size;
  }
  return cut_off(bytes, "the end of the PNG");
}

std::string jpeg_fault(std::string_view bytes) {
  std::string early = cut_off(bytes, "the end of the JPEG");
  bool frame = false, scan = false;
  std::size_t at = 2;
  while (at + 1 < bytes.size()) {
    const std::uint32_t marker = byte_at(bytes, at + 1);
    // Within a scan: its data, with stuffed zeros and restarts.
    if (byte_at(bytes, at) != 0xff || (scan && (marker == 0 || (marker >= 0xd0 && marker <= 0xd7)))) {
      if (!scan) return "is damaged: byte " + std::to_string(at) + " is no marker of a JPEG";
      ++at;
      continue;
    }
    if (marker == 0xff || marker == 0x01) {  // a fill byte; TEM
      at += marker == 0xff ? 1 : 2;
      continue;
    }
    if (marker == 0xd9) return scan ? "" : "has no pixels";
    if (at + 4 > bytes.size()) return early;
    const std::size_t size = byte_at(bytes, at + 2) << 8 | byte_at(bytes, at + 3);
    if (size < 2)
      return "is damaged: the part of it that begins at byte " + std::to_string(at) + " has no length";
    if (at + 2 + size > bytes.size()) return early;
    frame = frame || (marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc);
    if (marker == 0xda) {
      if (!frame) return "is damaged: its pixels come before their number";
      scan = true;
    }
    at += 2 + size;
  }
  return early;
}

std::string webp_fault(std::string_view bytes) {
  std::string early = cut_off(bytes, "the end of the WebP");
  const std::size_t end = std::size_t{8} + little_endian(bytes, 4);
  if (end > bytes.size()) return early;
  bool pixels = false;
  std::size_t at = 12;
  while (at + 8 <= end) {
    const std::string_view type = bytes.substr(at, 4);
    const std::size_t size = little_endian(bytes, at + 4);
    if (size > end - at - 8) return early;
    pixels = pixels || type == "VP8 " || type == "VP8L" || type == "ANMF";
    at += 8 + size + size % 2;
  }
  return pixels ? "" : "has no pixels";
}

}  // namespace

std::string image_fault(std::string_view bytes) {
  const std::string_view type = image_type(bytes);
  if (type == "image/png") return png_fault(bytes);
  if (type == "image/jpeg") return jpeg_fault(bytes);
  return type == "image/webp" ? webp_fault(bytes) : "is not a PNG, JPEG or WebP image";
}

}  // namespace incise::mesh_io
