#include "server/loop/delta_pool.hpp"

#include <algorithm>

namespace incise::loop {
namespace {

// Room for the delta of a batch through some thousand tetrahedra.
constexpr std::size_t kRoom = 4096;

std::shared_ptr<PublishedDelta> make_roomy() {
  auto made = std::make_shared<PublishedDelta>();
  core::Delta& delta = made->delta;
  delta.moved.reserve(kRoom);
  delta.moved_positions.reserve(kRoom);
  delta.added_positions.reserve(kRoom);
  delta.provenance.reserve(kRoom);
  delta.blends.reserve(kRoom);
  delta.upserted.reserve(4 * kRoom);
  delta.removed.reserve(kRoom);
  delta.elders.reserve(4 * kRoom);
  delta.boundary_upserted.reserve(kRoom);
  delta.boundary_removed.reserve(kRoom);
  return made;
}

}  // namespace

DeltaPool::DeltaPool(std::size_t warm, std::size_t most) : most_(std::max<std::size_t>(most, 1)) {
  deltas_.reserve(2 * warm);
  for (std::size_t i = 0; i < std::clamp<std::size_t>(warm, 1, most_); ++i) deltas_.push_back(make_roomy());
  size_.store(deltas_.size(), std::memory_order_relaxed);
}

std::shared_ptr<PublishedDelta> DeltaPool::next_free() {
  const auto is_free = [](const auto& delta) { return delta.use_count() == 1; };
  const auto first = deltas_.begin();
  const auto few = first + static_cast<std::ptrdiff_t>(std::min(kFew, deltas_.size()));
  chosen_ = static_cast<std::size_t>(std::find_if(first, few, is_free) - first);
  if (chosen_ == kFew) chosen_ = next_;
  if (chosen_ == deltas_.size() || !is_free(deltas_[chosen_])) {
    if (deltas_.size() >= most_) return nullptr;
    deltas_.insert(first + static_cast<std::ptrdiff_t>(chosen_), std::make_shared<PublishedDelta>());
    size_.store(deltas_.size(), std::memory_order_relaxed);
  }
  // use_count() is a relaxed load. Destroying this copy is an acquire-release change of the count, so the last
  // reader's reads happen before our writes.
  { const auto acquire = deltas_[chosen_]; }
  return deltas_[chosen_];
}

}  // namespace incise::loop
