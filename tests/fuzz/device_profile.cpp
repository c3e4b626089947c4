// A device profile: an error that names the file, or a profile whose decoder and force report stay within their bytes.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "server/input/hid/hid_device.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const input::DeviceProfile profile =
        input::parse_profile({reinterpret_cast<const char*>(data), size}, "folder/profile.json");
    FUZZ_CHECK(!profile.tools.empty() && profile.tools.size() <= input::kMaxTools);
    input::PoseDecoder decoder(profile, {});
    for (std::size_t at = 0; at < size && at < 64; ++at) {
      for (const auto& sample :
           decoder.decode({data + at, size - at}, static_cast<std::int64_t>(1'000'000 * (at + 1)))) {
        FUZZ_CHECK(sample.tool < profile.tools.size());
        FUZZ_CHECK(!std::isnan(sample.pose.position.x) && !std::isnan(sample.pose.orientation.w));
      }
    }
    if (profile.force) {
      input::ForceReport report(*profile.force, decoder);
      FUZZ_CHECK(report.make({{1, -2, 3e9}, 1, 0}, 2).size() == profile.force->bytes.size());
      FUZZ_CHECK(report.zero()[0] == profile.force->bytes[0]);
    }
  } catch (const input::ProfileError& error) {
    const std::string message = error.what();
    FUZZ_CHECK(message.starts_with("folder/profile.json: ") && message.find('\n') == message.npos);
  }
  return 0;
}
