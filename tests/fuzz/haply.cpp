// A state of Haply's Inverse Service: an error, a valid pose, or no device.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>

#include "server/input/haply/haply_messages.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  for (const char* id : {"", "049D"}) {
    std::string error;
    const auto state = input::read_haply_state(text, id, id, error);
    FUZZ_CHECK(state || !error.empty());
    if (!state || state->device.empty()) continue;
    const core::Quat& q = state->orientation;
    FUZZ_CHECK(core::is_finite(state->position));
    FUZZ_CHECK(std::abs(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z - 1) < 1e-6);
    // Its id comes back in what we send, whatever it is.
    FUZZ_CHECK(!input::haply_force(state->device, {1, 2, 3}, input::HaplyVersion::k35, true).empty());
  }
  return 0;
}
