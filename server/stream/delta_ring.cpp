#include "server/stream/delta_ring.hpp"

#include <stdexcept>
#include <vector>

#include "protocol/coalesce.hpp"
#include "server/base/check.hpp"

namespace incise::stream {

SharedFrame coalesce(const DeltaRing& ring, protocol::View view, std::uint64_t base, std::uint64_t head) {
  INCISE_CHECK(base < head && ring.covers(base, head), base, head);
  if (head - base > protocol::kMaxStepsPerDelta) return nullptr;
  std::vector<protocol::Message> messages;  // their arrays point into the ring's bytes
  std::vector<protocol::Delta> deltas;
  std::vector<protocol::SurfaceDelta> surface_deltas;
  for (std::uint64_t r = base; r < head;) {
    const EncodedStep& step = ring.after(r);
    r = step.revision;
    protocol::DecodeResult decoded =
        protocol::decode((view == protocol::View::Surface ? step.surface : step.volume)->body());
    INCISE_CHECK(decoded, decoded.error);
    messages.push_back(std::move(*decoded.message));
    if (view == protocol::View::Surface) {
      surface_deltas.push_back(std::get<protocol::SurfaceDelta>(std::move(messages.back().body)));
    } else {
      deltas.push_back(std::get<protocol::Delta>(std::move(messages.back().body)));
    }
  }
  try {
    return view == protocol::View::Surface ? make_frame(protocol::coalesce(surface_deltas).view())
                                           : make_frame(protocol::coalesce(deltas).view());
  } catch (const std::length_error&) {
    return nullptr;
  }
}

}  // namespace incise::stream
