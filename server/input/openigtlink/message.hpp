#pragma once

// OpenIGTLink messages as bytes. https://github.com/openigtlink/OpenIGTLink/tree/master/Documents/Protocol: a header of
// 58 bytes, a body; all numbers big endian. With header version 2 an extended header precedes the body's content and
// metadata follows it. No length is trusted.

#include <bit>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "server/core/stroke/blade.hpp"

namespace incise::input::openigtlink {

inline constexpr std::size_t kHeaderBytes = 58;
// Longest body of a message that is decoded: 900 tools, with room for metadata.
inline constexpr std::size_t kMaxBodyBytes = 64 * 1024;

struct Header {
  std::uint16_t version = 1;
  std::string type;
  std::string device;           // anything but printable ASCII, and quotes and backslashes, became '_'
  std::uint64_t timestamp = 0;  // seconds since 1970 in the upper 32 bits, 2^-32 s in the lower; 0: none
  std::uint64_t body_bytes = 0;
  std::uint64_t crc = 0;  // of the body
};

// Nothing, and the reason, if these bytes are not a header: the stream of messages is then out of step for good.
std::optional<Header> read_header(std::span<const std::uint8_t, kHeaderBytes> bytes, std::string& error);

// ns since 1970; 0: none was given.
std::int64_t timestamp_ns(const Header& header);

struct ToolPose {
  std::string name;     // of the element; if that is empty, of the message's device
  core::Vec3 position;  // as sent
  core::Quat orientation;
};

enum class Kind : std::uint8_t { kOther, kPoses, kText, kStatus, kGetSurface, kStartSurface, kStopSurface };

// Of a type's name alone: kOther is not read.
Kind kind_of(std::string_view type);

struct Message {
  Kind kind = Kind::kOther;
  std::vector<ToolPose> tools;    // kPoses
  std::uint32_t bad_tools = 0;    // kPoses: left out, because their numbers are not a pose
  std::uint32_t stretched = 0;    // kPoses: whose matrix was not a rotation and was replaced
  std::string text;               // kText
  std::uint16_t status = 0;       // kStatus: 1 is good
  std::uint32_t interval_ms = 0;  // kStartSurface: the shortest time between two
};

enum class Fault : std::uint8_t { kNone, kCrc, kShape, kValues };

struct Decoded {
  std::optional<Message> message;
  Fault fault = Fault::kNone;
  std::string error;
};

// Checks the CRC, then reads a TRANSFORM, TDATA, QTDATA, STRING, STATUS, GET_POLYDATA, STT_POLYDATA or STP_POLYDATA.
// `body` has header.body_bytes bytes. O(body).
Decoded decode(const Header& header, std::span<const std::uint8_t> body);

// ECMA-182, as OpenIGTLink uses it: not reflected, starts at 0.
std::uint64_t crc64(std::span<const std::uint8_t> bytes);

// A message with a header of version 1, which every peer reads: the header, then room for the body.
class Writer {
 public:
  Writer(std::string_view type, std::string_view device, std::uint64_t timestamp, std::size_t body_bytes);
  // Unsigned, signed or float, big endian.
  template <class Number>
  void number(Number value);
  void text(std::string_view text, std::size_t bytes);  // cut or filled with zeros
  // The message, with the body's length and CRC.
  std::vector<std::uint8_t> done();

 private:
  std::vector<std::uint8_t> bytes_;
};

std::vector<std::uint8_t> encode(std::string_view type, std::string_view device, std::uint64_t timestamp,
                                 std::span<const std::uint8_t> body);

// CLOCK_REALTIME now, as headers have it.
std::uint64_t timestamp_now();

template <class Number>
void Writer::number(Number value) {
  static_assert(sizeof value <= 8);
  std::uint64_t bits = 0;
  if constexpr (std::is_same_v<Number, float>) {
    bits = std::bit_cast<std::uint32_t>(value);
  } else {
    bits = static_cast<std::uint64_t>(value);
  }
  for (int shift = 8 * static_cast<int>(sizeof value) - 8; shift >= 0; shift -= 8) {
    bytes_.push_back(static_cast<std::uint8_t>(bits >> shift));
  }
}

}  // namespace incise::input::openigtlink
