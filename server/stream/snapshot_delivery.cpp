#include "server/stream/snapshot_delivery.hpp"

#include <utility>

namespace incise::stream {

void SnapshotDelivery::request(Feed& feed, const Subscription& wanted, protocol::SnapshotCause cause,
                               Ready ready) {
  requested_ = true;
  cause_ = cause;
  const std::uint64_t request = ++request_;
  feed.request_snapshot(wanted.view, wanted.box, !wanted.fields.empty() && !wanted.box,
                        [this, weak = std::weak_ptr<void>(outbox_.keep()), request,
                         ready = std::move(ready)](std::shared_ptr<const Snapshot> snapshot) {
                          const auto alive = weak.lock();
                          if (!alive || request != request_ || !requested_) return;
                          requested_ = false;
                          ready(std::move(snapshot));
                        });
}

void SnapshotDelivery::begin(std::shared_ptr<const Snapshot> snapshot, std::vector<std::uint32_t> fields) {
  snapshot_ = std::move(snapshot);
  fields_ = std::move(fields);
  next_chunk_ = next_field_ = next_part_ = 0;
  protocol::SnapshotBegin begin = snapshot_->begin;
  begin.cause = cause_;
  begin.fields = fields_;
  outbox_.send_state(make_frame(begin));
}

std::shared_ptr<const Snapshot> SnapshotDelivery::send_chunks(std::size_t max_bytes) {
  while (next_chunk_ < snapshot_->chunks.size()) {
    if (outbox_.state_bytes() > max_bytes) return nullptr;
    outbox_.send_state(snapshot_->chunks[next_chunk_++]);
  }
  for (; next_field_ < fields_.size(); ++next_field_, next_part_ = 0) {
    const std::vector<SharedFrame>& parts = *snapshot_->fields[fields_[next_field_]];
    while (next_part_ < parts.size()) {
      if (outbox_.state_bytes() > max_bytes) return nullptr;
      outbox_.send_state(parts[next_part_++]);
    }
  }
  outbox_.send_state(snapshot_->end);
  return std::exchange(snapshot_, nullptr);
}

void SnapshotDelivery::forget() {
  snapshot_.reset();
  requested_ = false;
}

}  // namespace incise::stream
