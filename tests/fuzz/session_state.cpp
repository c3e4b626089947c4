// A saved session: refused with a reason, or restored to a valid mesh that is saved as the same bytes and can be cut on.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "server/core/mesh/validate.hpp"
#include "server/core/session/session_state.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise::core;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::span<const std::byte> bytes(reinterpret_cast<const std::byte*>(data), size);
  for (const Policy policy : {Policy::kConforming, Policy::kCroll}) {
    CutConfig config;
    config.policy = policy;
    std::string error;
    const auto session = restore_session(bytes, config, error);
    FUZZ_CHECK((session == nullptr) == !error.empty());
    if (!session) continue;
    FUZZ_CHECK(validate(session->mesh(), false).empty());
    const auto again = save_session(*session);
    FUZZ_CHECK(std::equal(again.begin(), again.end(), bytes.begin(), bytes.end()));
  }
  return 0;
}
