#include "server/input/openigtlink/message.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <ctime>

namespace incise::input::openigtlink {
namespace {

constexpr std::size_t kTypeBytes = 12, kNameBytes = 20;
constexpr std::size_t kTransformBytes = 48, kTdataBytes = 70, kQtdataBytes = 50;
constexpr std::size_t kExtendedBytes = 12;

using Bytes = std::span<const std::uint8_t>;

// Reads from its position; the caller has checked that enough is left.
class Reader {
 public:
  explicit Reader(Bytes bytes) : left_(bytes) {}
  std::size_t left() const { return left_.size(); }
  Bytes read_bytes(std::size_t count) {
    const Bytes taken = left_.first(count);
    left_ = left_.subspan(count);
    return taken;
  }
  template <class Unsigned>
  Unsigned number() {
    std::uint64_t value = 0;
    for (const std::uint8_t byte : read_bytes(sizeof(Unsigned))) value = value << 8 | byte;
    return static_cast<Unsigned>(value);
  }
  double real() { return std::bit_cast<float>(number<std::uint32_t>()); }
  core::Vec3 vector() {
    const double x = real(), y = real(), z = real();
    return {x, y, z};
  }

 private:
  Bytes left_;
};

std::string name_of(Bytes bytes) {
  std::string name;
  for (const std::uint8_t byte : bytes) {
    if (byte == 0) break;
    const bool plain = byte >= 0x20 && byte < 0x7f && byte != '"' && byte != '\\';
    name += plain ? static_cast<char>(byte) : '_';
  }
  return name;
}

constexpr std::array<std::uint64_t, 256> crc_table() {
  constexpr std::uint64_t kPolynomial = 0x42f0e1eba9ea3693;
  std::array<std::uint64_t, 256> table{};
  for (std::uint64_t byte = 0; byte < 256; ++byte) {
    std::uint64_t crc = byte << 56;
    for (int bit = 0; bit < 8; ++bit) crc = crc << 1 ^ (crc >> 63 ? kPolynomial : 0);
    table[byte] = crc;
  }
  return table;
}

// A body without its extended header and metadata; nothing, and the reason, if their lengths do not fit.
std::optional<Bytes> content_of(const Header& header, Bytes body, std::string& error) {
  if (header.version < 2) return body;
  if (body.size() < kExtendedBytes) {
    error = "no room for the extended header";
    return std::nullopt;
  }
  Reader reader(body);
  const std::size_t extended = reader.number<std::uint16_t>();
  const std::size_t metadata =
      std::size_t{reader.number<std::uint16_t>()} + std::size_t{reader.number<std::uint32_t>()};
  if (extended < kExtendedBytes || extended > body.size() || metadata > body.size() - extended) {
    error = "extended header and metadata do not fit into the body";
    return std::nullopt;
  }
  return body.subspan(extended, body.size() - extended - metadata);
}

core::Quat quaternion_of(const core::Vec3& x, const core::Vec3& y, const core::Vec3& z) {
  // Shepperd 1978: divides by the largest of the four.
  const double trace = x.x + y.y + z.z;
  core::Quat q;
  if (trace >= x.x && trace >= y.y && trace >= z.z) {
    q = {1 + trace, y.z - z.y, z.x - x.z, x.y - y.x};
  } else if (x.x >= y.y && x.x >= z.z) {
    q = {y.z - z.y, 1 + x.x - y.y - z.z, y.x + x.y, z.x + x.z};
  } else if (y.y >= z.z) {
    q = {z.x - x.z, y.x + x.y, 1 + y.y - x.x - z.z, z.y + y.z};
  } else {
    q = {x.y - y.x, z.x + x.z, z.y + y.z, 1 + z.z - x.x - y.y};
  }
  const double n = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  return {q.w / n, q.x / n, q.y / n, q.z / n};
}

// The three columns of a matrix, then its translation. If the matrix is not a rotation (some peers make theirs from
// quaternions that do not have unit length) the x axis is kept, and y in its plane. False if that is impossible: NaN or
// infinite numbers, a flat or mirroring matrix.
bool read_matrix(Reader& reader, ToolPose& tool, std::uint32_t& stretched) {
  const core::Vec3 x = reader.vector(), y = reader.vector(), z = reader.vector();
  tool.position = reader.vector();
  if (!core::is_finite(x) || !core::is_finite(y) || !core::is_finite(z) || !core::is_finite(tool.position))
    return false;
  const double lx = core::length(x), ly = core::length(y), lz = core::length(z);
  constexpr double kLeast = 1e-3, kMost = 1e3, kFlat = 0.1, kRotation = 0.01;
  if (std::min({lx, ly, lz}) < kLeast || std::max({lx, ly, lz}) > kMost) return false;
  const core::Vec3 ux = (1 / lx) * x;
  const core::Vec3 across = (1 / ly) * y - (core::dot(y, ux) / ly) * ux;
  const double flat = core::length(across);
  if (flat < kFlat) return false;
  const core::Vec3 uy = (1 / flat) * across, uz = core::cross(ux, uy);
  if (core::dot(uz, z) / lz < kFlat) return false;
  if (std::abs(lx - 1) > kRotation || core::length(y - uy) > kRotation || core::length(z - uz) > kRotation) {
    ++stretched;
  }
  tool.orientation = quaternion_of(ux, uy, uz);
  return true;
}

bool read_quaternion(Reader& reader, ToolPose& tool) {
  tool.position = reader.vector();
  const double x = reader.real(), y = reader.real(), z = reader.real(), w = reader.real();
  const double n = std::sqrt(x * x + y * y + z * z + w * w);
  if (!core::is_finite(tool.position) || !(n >= 0.5 && n <= 2)) return false;
  tool.orientation = {w / n, x / n, y / n, z / n};
  return true;
}

// Elements: a name, a type, a spare byte and a pose.
void read_tools(Reader reader, std::size_t element_bytes, Message& message, const std::string& device) {
  while (reader.left() > 0) {
    Reader element(reader.read_bytes(element_bytes));
    ToolPose tool;
    tool.name = name_of(element.read_bytes(kNameBytes));
    if (tool.name.empty()) tool.name = device;
    element.read_bytes(2);
    const bool good = element_bytes == kTdataBytes ? read_matrix(element, tool, message.stretched)
                                                   : read_quaternion(element, tool);
    if (good) {
      message.tools.push_back(std::move(tool));
    } else {
      ++message.bad_tools;
    }
  }
}

Decoded fault(Fault what, std::string error) {
  Decoded decoded;
  decoded.fault = what;
  decoded.error = std::move(error);
  return decoded;
}

// The names and the kinds that are read.
struct Type {
  std::string_view name;
  Kind kind;
};
constexpr Type kTypes[] = {{"TRANSFORM", Kind::kPoses},
                           {"TDATA", Kind::kPoses},
                           {"QTDATA", Kind::kPoses},
                           {"STRING", Kind::kText},
                           {"STATUS", Kind::kStatus},
                           {"GET_POLYDATA", Kind::kGetSurface},
                           {"STT_POLYDATA", Kind::kStartSurface},
                           {"STP_POLYDATA", Kind::kStopSurface}};

// What is wrong with the length; empty: nothing.
std::string wrong_length(const std::string& type, std::size_t bytes) {
  const auto found = ": found " + std::to_string(bytes) + " bytes, ";
  if (type == "TRANSFORM" && bytes != kTransformBytes) return type + found + "it has 48";
  if (type == "TDATA" && bytes % kTdataBytes != 0) return type + found + "it has 70 for each tool";
  if (type == "QTDATA" && bytes % kQtdataBytes != 0) return type + found + "it has 50 for each tool";
  if (type == "STRING" && bytes < 4) return type + found + "it has at least 4";
  if (type == "STATUS" && bytes < 30) return type + found + "it has at least 30";
  return "";
}

}  // namespace

std::uint64_t crc64(std::span<const std::uint8_t> bytes) {
  static constexpr std::array<std::uint64_t, 256> kTable = crc_table();
  std::uint64_t crc = 0;
  for (const std::uint8_t byte : bytes) crc = crc << 8 ^ kTable[crc >> 56 ^ byte];
  return crc;
}

std::optional<Header> read_header(std::span<const std::uint8_t, kHeaderBytes> bytes, std::string& error) {
  constexpr std::uint16_t kNewest =
      16;  // versions 1 and 2 exist; a later one may add fields, but not move them
  Reader reader(bytes);
  Header header;
  header.version = reader.number<std::uint16_t>();
  const Bytes type = reader.read_bytes(kTypeBytes);
  header.type = name_of(type);
  header.device = name_of(reader.read_bytes(kNameBytes));
  header.timestamp = reader.number<std::uint64_t>();
  header.body_bytes = reader.number<std::uint64_t>();
  header.crc = reader.number<std::uint64_t>();
  if (header.version < 1 || header.version > kNewest) {
    error = "found header version " + std::to_string(header.version) + ", accepted are 1 to " +
            std::to_string(kNewest) + ": is this OpenIGTLink?";
    return std::nullopt;
  }
  if (header.type.empty() || header.type.find('_') == 0 || type[0] <= 0x20) {
    error = "found no message type";
    return std::nullopt;
  }
  return header;
}

std::int64_t timestamp_ns(const Header& header) {
  const auto seconds = static_cast<std::int64_t>(header.timestamp >> 32);
  const auto fraction = static_cast<std::int64_t>((header.timestamp & 0xffffffff) * 1'000'000'000 >> 32);
  return seconds * 1'000'000'000 + fraction;
}

Kind kind_of(std::string_view type) {
  const auto* const found =
      std::find_if(std::begin(kTypes), std::end(kTypes), [&](const Type& t) { return t.name == type; });
  return found == std::end(kTypes) ? Kind::kOther : found->kind;
}

Decoded decode(const Header& header, std::span<const std::uint8_t> body) {
  if (body.size() != header.body_bytes) return fault(Fault::kShape, header.type + ": the body is not whole");
  if (crc64(body) != header.crc) return fault(Fault::kCrc, header.type + ": the CRC does not fit");
  std::string error;
  const std::optional<Bytes> content = content_of(header, body, error);
  if (!content) return fault(Fault::kShape, header.type + ": " + error);
  if (std::string wrong = wrong_length(header.type, content->size()); !wrong.empty()) {
    return fault(Fault::kShape, std::move(wrong));
  }
  Decoded decoded;
  Message& message = decoded.message.emplace();
  message.kind = kind_of(header.type);
  Reader reader(*content);
  if (header.type == "TRANSFORM") {
    ToolPose tool{header.device, {}, {}};
    if (!read_matrix(reader, tool, message.stretched)) {
      return fault(Fault::kValues, "TRANSFORM: its numbers are not a pose");
    }
    message.tools.push_back(std::move(tool));
  } else if (message.kind == Kind::kPoses) {
    read_tools(reader, header.type == "TDATA" ? kTdataBytes : kQtdataBytes, message, header.device);
  } else if (message.kind == Kind::kText) {
    reader.read_bytes(2);  // the encoding: we look for ASCII only
    const std::size_t length = reader.number<std::uint16_t>();
    if (length > reader.left()) return fault(Fault::kShape, "STRING: it is longer than its body");
    message.text = name_of(reader.read_bytes(length));
  } else if (message.kind == Kind::kStatus) {
    message.status = reader.number<std::uint16_t>();
  } else if (message.kind == Kind::kStartSurface && reader.left() >= 4) {
    message.interval_ms = reader.number<std::uint32_t>();
  }
  return decoded;
}

Writer::Writer(std::string_view type, std::string_view device, std::uint64_t timestamp,
               std::size_t body_bytes) {
  bytes_.reserve(kHeaderBytes + body_bytes);
  number(std::uint16_t{1});
  text(type, kTypeBytes);
  text(device, kNameBytes);
  number(timestamp);
  bytes_.resize(kHeaderBytes);
}

void Writer::text(std::string_view text, std::size_t bytes) {
  for (std::size_t i = 0; i < bytes; ++i)
    bytes_.push_back(i < text.size() ? static_cast<std::uint8_t>(text[i]) : 0);
}

std::vector<std::uint8_t> Writer::done() {
  const Bytes body = Bytes(bytes_).subspan(kHeaderBytes);
  const std::uint64_t last[] = {body.size(), crc64(body)};
  for (std::size_t i = 0; i < 16; ++i) {
    bytes_[kHeaderBytes - 16 + i] = static_cast<std::uint8_t>(last[i / 8] >> (56 - 8 * (i % 8)));
  }
  return std::move(bytes_);
}

std::vector<std::uint8_t> encode(std::string_view type, std::string_view device, std::uint64_t timestamp,
                                 std::span<const std::uint8_t> body) {
  Writer writer(type, device, timestamp, body.size());
  for (const std::uint8_t byte : body) writer.number(byte);
  return writer.done();
}

std::uint64_t timestamp_now() {
  timespec now{};
  clock_gettime(CLOCK_REALTIME, &now);
  const auto fraction = (static_cast<std::uint64_t>(now.tv_nsec) << 32) / 1'000'000'000;
  return static_cast<std::uint64_t>(now.tv_sec) << 32 | fraction;
}

}  // namespace incise::input::openigtlink
