#include "server/stream/snapshot_delivery.hpp"

#include <utility>

namespace incise::stream {

void SnapshotDelivery::request(Feed& feed, protocol::View view, const std::optional<protocol::Box>& box,
                               protocol::SnapshotCause cause, Ready ready) {
  requested_ = true;
  cause_ = cause;
  const std::uint64_t request = ++request_;
  feed.request_snapshot(view, box,
                        [this, weak = std::weak_ptr<void>(outbox_.keep()), request,
                         ready = std::move(ready)](std::shared_ptr<const Snapshot> snapshot) {
                          const auto alive = weak.lock();
                          if (!alive || request != request_ || !requested_) return;
                          requested_ = false;
                          ready(std::move(snapshot));
                        });
}

void SnapshotDelivery::begin(std::shared_ptr<const Snapshot> snapshot) {
  snapshot_ = std::move(snapshot);
  next_chunk_ = 0;
  protocol::SnapshotBegin begin = snapshot_->begin;
  begin.cause = cause_;
  outbox_.send_state(make_frame(begin));
}

std::shared_ptr<const Snapshot> SnapshotDelivery::send_chunks(std::size_t max_bytes) {
  while (next_chunk_ < snapshot_->chunks.size()) {
    if (outbox_.state_bytes() > max_bytes) return nullptr;
    outbox_.send_state(snapshot_->chunks[next_chunk_++]);
  }
  outbox_.send_state(snapshot_->end);
  return std::exchange(snapshot_, nullptr);
}

void SnapshotDelivery::forget() {
  snapshot_.reset();
  requested_ = false;
}

}  // namespace incise::stream
