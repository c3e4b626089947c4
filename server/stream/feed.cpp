#include "server/stream/feed.hpp"

#include <boost/asio/post.hpp>
#include <stdexcept>

#include "server/base/check.hpp"

namespace incise::stream {

void Feed::reset(std::shared_ptr<const InitialState> initial) {
  mirror_.reset(*initial);
  keeper_.reset(std::move(initial));
  ring_.clear();
  coalesced_.clear();
}

void Feed::apply(const std::shared_ptr<const PublishedDelta>& delta) {
  std::optional<EncodedStep> step = mirror_.apply(*delta);
  keeper_.push(delta);
  coalesced_.clear();
  if (step) {
    ring_.push(std::move(*step));
  } else {
    ring_.clear();
  }
}

void Feed::request_snapshot(protocol::View view, const std::optional<protocol::Box>& box,
                            SnapshotKeeper::Ready ready) {
  keeper_.request(view, box, [&io = io_, ready = std::move(ready)](std::shared_ptr<const Snapshot> snapshot) {
    asio::post(io, [ready, snapshot = std::move(snapshot)] { ready(snapshot); });
  });
}

SharedFrame Feed::coalesced(protocol::View view, std::uint64_t base) {
  const auto [place, is_new] = coalesced_.try_emplace({view, base});
  if (is_new) place->second = coalesce(ring_, view, base, mirror_.revision());
  return place->second;
}

SharedFrame Feed::part_delta(BoxPart& part) {
  const bool surface = std::holds_alternative<protocol::SurfaceReplica>(part.held);
  const std::uint64_t base = part.revision(), head = mirror_.revision();
  const SharedFrame whole = head - base == 1
                                ? (surface ? ring_.step(head).surface : ring_.step(head).volume)
                                : coalesced(surface ? protocol::View::Surface : protocol::View::Volume, base);
  if (!whole) return nullptr;
  const protocol::DecodeResult decoded = protocol::decode(whole->body());
  INCISE_CHECK(decoded, decoded.error);
  try {
    return mirror_.follow_part(part, decoded.message->body);
  } catch (const std::length_error&) {
    return nullptr;
  }
}

}  // namespace incise::stream
