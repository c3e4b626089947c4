// A HID report descriptor: an error, or fields that lie within their reports; and what is made of it reads any report.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "server/input/hid/pose_decoder.hpp"
#include "server/input/hid/report_descriptor.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string why;
  const auto descriptor = input::parse_report_descriptor({data, size}, why);
  if (!descriptor) {
    FUZZ_CHECK(!why.empty());
    return 0;
  }
  FUZZ_CHECK(!descriptor->reports.empty());
  for (const auto& report : descriptor->reports) FUZZ_CHECK(report.bytes <= input::kMaxReportBytes);
  for (const auto& field : descriptor->fields) {
    FUZZ_CHECK(field.bits >= 1 && field.bits <= 32);
    FUZZ_CHECK(field.bit + field.bits <= 8 * descriptor->bytes_of(field.kind, field.report_id));
  }
  const auto profile = input::profile_from(*descriptor, why);
  if (!profile) return 0;
  FUZZ_CHECK(input::mismatch(*profile, *descriptor).empty());
  // The descriptor's own bytes stand in for reports, too.
  input::PoseDecoder decoder(*profile, {});
  for (std::size_t at = 0; at < size && at < 64; ++at) {
    const std::size_t bytes = std::min<std::size_t>(size - at, 1 + data[at]);
    for (const auto& sample :
         decoder.decode({data + at, bytes}, static_cast<std::int64_t>(1'000'000 * (at + 1)))) {
      FUZZ_CHECK(core::is_finite(sample.pose.position));
      FUZZ_CHECK(std::isfinite(sample.pose.orientation.w));
    }
  }
  return 0;
}
