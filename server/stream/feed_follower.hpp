#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "server/stream/box_turns.hpp"
#include "server/stream/delta_pace.hpp"
#include "server/stream/feed.hpp"
#include "server/stream/field_updates.hpp"
#include "server/stream/held_part.hpp"
#include "server/stream/outbox.hpp"
#include "server/stream/peer_context.hpp"
#include "server/stream/snapshot_delivery.hpp"
#include "server/stream/subscription.hpp"

namespace incise::stream {

// Keeps one peer in step with a feed: a snapshot, then deltas. It knows which revision the peer holds, counting what
// the outbox has, and decides what comes next; StreamConfig gives the policy for peers that read slowly.
//
// Thread: the stream thread. Owns: the snapshot on its way, what the peer holds with a box.
class FeedFollower final : public BoxHolder {
 public:
  FeedFollower(PeerContext& context, Outbox& outbox);

  // Begins; then resume() or send_snapshot().
  void start(const Subscription& subscription) { set(subscription); }
  // Another feed, or the same one with other ids. What waits of the old one is dropped; send_snapshot() follows.
  void switch_to(Feed& feed);
  void resubscribe(const Subscription& subscription);
  // Adds nothing more; what waits in the outbox is the caller's to drop.
  void stop();

  // Whether the peer can go on without a snapshot from the state that its Hello names.
  bool can_resume(const protocol::Hello& hello) const;
  // Whether that is a later state of the feed's epoch than the feed has. Also before start().
  bool is_behind(const protocol::Hello& hello) const;
  void resume(std::uint64_t revision);
  void send_snapshot(protocol::SnapshotCause cause);
  // The peer says that its state is wrong.
  void resync();
  // Sends what the peer should have and has room for. Called when the feed has moved and when something was written.
  void advance();

  const Feed& feed() const { return *feed_; }
  protocol::View view() const { return want_.view; }
  // Why the peer gets not all the fields that it asked for; empty: it does.
  std::string missing_fields() const;
  // What the peer knows the feed's epoch as. Each view, each choice of fields, and each box, has another name, so that a peer cannot
  // resume one with another's state.
  std::uint64_t epoch_name() const;

  // BoxHolder
  bool wants_box_turn() const override;
  void skip_box_turn() override { box_turn_asked_ = false; }
  bool make_box_delta() override;
  void lose_box() override;

 private:
  void set(const Subscription& subscription);
  // Places of the fields that the peer gets, in the feed's list.
  std::vector<std::uint32_t> fields() const;
  void drop_state();
  void on_snapshot(std::shared_ptr<const Snapshot> snapshot);
  void on_snapshot_sent(const Snapshot& snapshot);
  void refuse_box(const std::string& why, protocol::SnapshotCause cause);
  bool has_room();
  void send_deltas(std::uint64_t head);
  void bring_fields();
  std::shared_ptr<FeedFollower> self() { return {outbox_.keep(), this}; }

  PeerContext& context_;
  Outbox& outbox_;
  Feed* feed_;
  Subscription want_;
  std::uint64_t revision_ = 0;  // the peer's, once it has read what the outbox holds
  bool behind_ = false;         // the outbox was full: it must half empty first
  SnapshotDelivery snapshot_;
  FieldUpdates field_updates_;
  bool resync_again_ = false;         // asked for while a snapshot was being sent
  std::uint32_t slow_snapshots_ = 0;  // in a row
  HeldPart part_;                     // with a box: what the peer holds at revision_
  bool box_turn_asked_ = false;
  DeltaPace pace_;
};

}  // namespace incise::stream
