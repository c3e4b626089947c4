#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "server/stream/feed.hpp"
#include "server/stream/outbox.hpp"
#include "server/stream/subscription.hpp"

namespace incise::stream {

// A whole state on its way to one peer: requested from a feed, then moved to the outbox chunk by chunk as there is
// room, so that a peer that does not read holds one chunk of it.
//
// Thread: the stream thread. Owns: its share of the snapshot.
class SnapshotDelivery {
 public:
  explicit SnapshotDelivery(Outbox& outbox) : outbox_(outbox) {}

  bool requested() const { return requested_; }
  bool sending() const { return snapshot_ != nullptr; }
  bool busy() const { return requested() || sending(); }
  // Why the peer gets the one that is requested or being sent.
  protocol::SnapshotCause cause() const { return cause_; }

  // Asks for one; it comes to `ready`, unless forget() was called or the peer has gone.
  using Ready = std::function<void(std::shared_ptr<const Snapshot>)>;
  void request(Feed& feed, const Subscription& wanted, protocol::SnapshotCause cause, Ready ready);
  // `fields`: places of those that go along, in the feed's list.
  void begin(std::shared_ptr<const Snapshot> snapshot, std::vector<std::uint32_t> fields);
  // Sends on while at most `max_bytes` of state wait. Returns the snapshot once all of it is in the outbox, else
  // null.
  std::shared_ptr<const Snapshot> send_chunks(std::size_t max_bytes);
  // Drops the one that is being sent.
  void drop() { snapshot_.reset(); }
  // Drops that, and the request.
  void forget();

 private:
  Outbox& outbox_;
  bool requested_ = false;
  std::uint64_t request_ = 0;  // the last one's number
  protocol::SnapshotCause cause_ = protocol::SnapshotCause::Join;
  std::shared_ptr<const Snapshot> snapshot_;
  std::vector<std::uint32_t> fields_;
  std::size_t next_chunk_ = 0;
  std::size_t next_field_ = 0, next_part_ = 0;  // of fields_, and of that field's frames
};

}  // namespace incise::stream
