#include "server/stream/feed.hpp"

#include <boost/asio/post.hpp>
#include <stdexcept>

#include "server/base/check.hpp"

namespace incise::stream {

void Feed::reset(std::shared_ptr<const InitialState> initial) {
  mirror_.reset(*initial);
  fields_.clear();
  if (initial->fields) {
    for (const core::Field& field : *initial->fields) fields_.push_back(facts_of(field));
  }
  keeper_.reset(std::move(initial));
  ring_.clear();
  changes_.clear();
  coalesced_.clear();
}

void Feed::apply(const std::shared_ptr<const PublishedDelta>& delta) {
  Mirror::Applied applied = mirror_.apply(*delta);
  keeper_.apply(delta);
  coalesced_.clear();
  changes_.append(std::move(applied.change));
  if (applied.step) {
    ring_.append(std::move(*applied.step));
  } else {
    ring_.clear();
  }
}

bool Feed::can_resume(std::uint64_t revision, std::uint64_t hash) const {
  const std::uint64_t head = mirror_.revision();
  if (!ring_.covers(revision, head)) return false;
  if (hash == 0) return true;
  return hash == (revision == head ? mirror_.volume().state_hash() : ring_.step(revision + 1).base_hash);
}

void Feed::request_snapshot(protocol::View view, const std::optional<protocol::Box>& box, bool fields,
                            SnapshotKeeper::Ready ready) {
  keeper_.request(view, box, fields,
                  [&io = io_, ready = std::move(ready)](std::shared_ptr<const Snapshot> snapshot) {
                    asio::post(io, [ready, snapshot = std::move(snapshot)] { ready(snapshot); });
                  });
}

SharedFrame Feed::coalesced(protocol::View view, std::uint64_t base) {
  const auto [place, is_new] = coalesced_.try_emplace({view, base});
  if (is_new) place->second = coalesce(ring_, view, base, mirror_.revision());
  return place->second;
}

SharedFrame Feed::part_delta(BoxPart& part) {
  const std::uint64_t base = part.revision(), head = mirror_.revision();
  if (!changes_.covers(base, head) || head - base > protocol::kMaxStepsPerDelta) return nullptr;
  protocol::MeshChange change = changes_.step(base + 1);
  for (std::uint64_t r = base + 2; r <= head; ++r) change.append(changes_.step(r));
  try {
    return mirror_.follow_part(part, change);
  } catch (const std::length_error&) {
    return nullptr;
  }
}

}  // namespace incise::stream
