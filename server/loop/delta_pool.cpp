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
  ring_.reserve(2 * warm);
  for (std::size_t i = 0; i < std::clamp<std::size_t>(warm, 1, most_); ++i) ring_.push_back(make_roomy());
  size_.store(ring_.size(), std::memory_order_relaxed);
}

std::shared_ptr<PublishedDelta> DeltaPool::next_free() {
  if (ring_[next_].use_count() > 1) {
    if (ring_.size() >= most_) return nullptr;
    ring_.insert(ring_.begin() + static_cast<std::ptrdiff_t>(next_), std::make_shared<PublishedDelta>());
    size_.store(ring_.size(), std::memory_order_relaxed);
  }
  // use_count() is a relaxed load. Destroying this copy is an acquire-release change of the count, so the last
  // reader's reads happen before our writes.
  { const auto acquire = ring_[next_]; }
  return ring_[next_];
}

}  // namespace incise::loop
