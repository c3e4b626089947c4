#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>

#include "server/stream/feed.hpp"
#include "server/stream/outbox.hpp"

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
  void request(Feed& feed, protocol::View view, const std::optional<protocol::Box>& box,
               protocol::SnapshotCause cause, Ready ready);
  void begin(std::shared_ptr<const Snapshot> snapshot);
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
  std::size_t next_chunk_ = 0;
};

}  // namespace incise::stream
