// A motion file: an error that names the file, or poses as promised.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <sstream>
#include <string>

#include "protocol/limits.hpp"
#include "protocol/motion.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise::protocol;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::istringstream in(std::string(reinterpret_cast<const char*>(data), size));
  try {
    const Motion motion = read_motion(in, "motion");
    FUZZ_CHECK(!motion.samples.empty());
    const PoseSample* last = nullptr;
    for (const PoseSample& s : motion.samples) {
      FUZZ_CHECK(last == nullptr || s.source_ns > last->source_ns);
      for (const double x : {s.position.x, s.position.y, s.position.z})
        FUZZ_CHECK(std::abs(x) <= kMaxCoordinate);
      const Quat& q = s.orientation;
      FUZZ_CHECK(std::abs(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z - 1) < 1e-9);
      last = &s;
    }
  } catch (const MotionError& e) {
    FUZZ_CHECK(std::string(e.what()).starts_with("motion:"));
  }
  return 0;
}
