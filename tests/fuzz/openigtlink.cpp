// An OpenIGTLink message: an error, or valid poses. The CRC is set to match, or no code behind its check would run.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "server/input/openigtlink/message.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise::input::openigtlink;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < kHeaderBytes || size > kHeaderBytes + kMaxBodyBytes) return 0;
  std::string error;
  auto header = read_header(std::span<const std::uint8_t, kHeaderBytes>(data, kHeaderBytes), error);
  FUZZ_CHECK(header || !error.empty());
  if (!header) return 0;
  FUZZ_CHECK(header->type.size() <= 12 && header->device.size() <= 20 && timestamp_ns(*header) >= 0);
  const std::span<const std::uint8_t> body(data + kHeaderBytes, size - kHeaderBytes);
  FUZZ_CHECK(body.size() != header->body_bytes || decode(*header, body).fault != Fault::kNone ||
             header->crc == crc64(body));
  header->body_bytes = body.size();
  header->crc = crc64(body);
  const Decoded decoded = decode(*header, body);
  FUZZ_CHECK(decoded.message.has_value() == (decoded.fault == Fault::kNone));
  FUZZ_CHECK(decoded.message || !decoded.error.empty());
  if (!decoded.message) return 0;
  FUZZ_CHECK(50 * (decoded.message->tools.size() + decoded.message->bad_tools) <= body.size() ||
             header->type == "TRANSFORM");
  FUZZ_CHECK(decoded.message->text.size() <= body.size());
  for (const ToolPose& tool : decoded.message->tools) {
    const auto& q = tool.orientation;
    FUZZ_CHECK(incise::core::is_finite(tool.position));
    FUZZ_CHECK(std::abs(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z - 1) < 1e-6);
  }
  // What we send, we would read.
  const std::vector<std::uint8_t> again = encode(header->type, header->device, header->timestamp, body);
  const auto same = read_header(std::span(again).first<kHeaderBytes>(), error);
  FUZZ_CHECK(same && same->type == header->type && same->device == header->device &&
             same->crc == header->crc);
  return 0;
}
