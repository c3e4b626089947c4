#include "server/stream/feed.hpp"

#include <boost/asio/post.hpp>

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

void Feed::request_snapshot(protocol::View view, SnapshotKeeper::Ready ready) {
  keeper_.request(view, [&io = io_, ready = std::move(ready)](std::shared_ptr<const Snapshot> snapshot) {
    asio::post(io, [ready, snapshot = std::move(snapshot)] { ready(snapshot); });
  });
}

SharedFrame Feed::coalesced(protocol::View view, std::uint64_t base) {
  const auto [place, is_new] = coalesced_.try_emplace({view, base});
  if (is_new) place->second = coalesce(ring_, view, base, mirror_.revision());
  return place->second;
}

}  // namespace incise::stream
