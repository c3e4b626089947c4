#include "server/stream/feed_follower.hpp"

#include <utility>

#include "server/stream/quoted.hpp"

namespace incise::stream {

using protocol::SnapshotCause;
using protocol::View;

FeedFollower::FeedFollower(PeerContext& context, Outbox& outbox)
    : context_(context),
      outbox_(outbox),
      feed_(&context.live),
      snapshot_(outbox),
      field_updates_(outbox),
      part_(*context.counters),
      pace_(context.io) {}

std::uint64_t session_name(std::uint64_t epoch, View view, bool box, std::span<const std::uint32_t> fields) {
  std::uint64_t chosen = 0;
  for (const std::uint32_t field : fields) chosen = (chosen ^ (field + 1)) * 0x100000001b3;
  return epoch ^ (view == View::Surface ? 0x9e3779b97f4a7c15 : 0) ^ (box ? 0xc2b2ae3d27d4eb4f : 0) ^ chosen;
}

std::uint64_t FeedFollower::epoch_name() const {
  return session_name(feed_->mirror().epoch(), want_.view, want_.box.has_value(), fields());
}

std::vector<std::uint32_t> FeedFollower::fields() const {
  if (want_.view != View::Volume || want_.box) return {};
  std::vector<std::string> unknown;
  return protocol::fields_named(want_.fields, feed_->fields(), unknown);
}

std::string FeedFollower::missing_fields() const {
  if (want_.fields.empty()) return {};
  if (want_.view != View::Volume || want_.box)
    return "fields: they come with the view Volume, and without a box";
  std::vector<std::string> unknown;
  protocol::fields_named(want_.fields, feed_->fields(), unknown);
  if (unknown.empty()) return {};
  std::string there;
  for (const protocol::FieldFacts& field : feed_->fields()) {
    if (!there.empty()) there += ", ";
    there += quoted(field.name);
  }
  return "fields: the body has none called " + quoted(unknown.front()) + "; " +
         (there.empty() ? "it has no fields" : "it has " + there);
}

// ---- What the peer asks for ----

void FeedFollower::set(const Subscription& subscription) {
  want_ = subscription;
  pace_.set_rate(subscription.max_rate_hz);
}

void FeedFollower::resubscribe(const Subscription& subscription) {
  const std::vector<std::uint32_t> had = fields();
  const View view = want_.view;
  const std::optional<protocol::Box> box = want_.box;
  set(subscription);
  if (view == want_.view && box == want_.box && had == fields()) {
    advance();
    return;
  }
  drop_state();
  snapshot_.forget();
  resync_again_ = false;
  send_snapshot(SnapshotCause::Subscribe);
}

void FeedFollower::switch_to(Feed& feed) {
  drop_state();
  // A feed that ends drops what was requested of it.
  if (&feed == feed_) {
    snapshot_.drop();
  } else {
    snapshot_.forget();
  }
  feed_ = &feed;
  resync_again_ = false;
}

void FeedFollower::stop() {
  want_ = {};
  field_updates_.forget();
  snapshot_.forget();
  part_.hold(nullptr);
  pace_.cancel();
}

void FeedFollower::drop_state() {
  outbox_.drop_state();
  field_updates_.forget();
  behind_ = false;
}

// What a peer with a box held is no longer known, so it cannot resume.
bool FeedFollower::can_resume(const protocol::Hello& hello) const {
  return want_.view != View::None && !want_.box && hello.resume_session == epoch_name() &&
         feed_->can_resume(hello.resume_revision, hello.resume_hash);
}

bool FeedFollower::is_behind(const protocol::Hello& hello) const {
  std::vector<std::uint32_t> chosen;
  std::vector<std::string> unknown;
  if (hello.view == View::Volume && !hello.box)
    chosen = protocol::fields_named(hello.fields, feed_->fields(), unknown);
  return hello.view != View::None && hello.resume_revision > feed_->mirror().revision() &&
         hello.resume_session ==
             session_name(feed_->mirror().epoch(), hello.view, hello.box.has_value(), chosen);
}

void FeedFollower::resume(std::uint64_t revision) {
  ++context_.counters->resumed;
  revision_ = revision;
  field_updates_.note_unknown();
  advance();
}

// One snapshot at a time, however often the peer asks.
void FeedFollower::resync() {
  if (snapshot_.busy()) {
    resync_again_ = snapshot_.sending();
    return;
  }
  drop_state();
  send_snapshot(SnapshotCause::Resync);
}

// ---- Snapshots ----

void FeedFollower::send_snapshot(SnapshotCause cause) {
  if (want_.view == View::None || snapshot_.requested()) return;
  if (cause == SnapshotCause::TooSlow) {
    if (++slow_snapshots_ > context_.config.max_slow_snapshots) {
      outbox_.give_up(std::to_string(slow_snapshots_ - 1) + " snapshots in a row, and never caught up");
      return;
    }
    ++context_.counters->slow_snapshots;
  }
  ++context_.counters->snapshots;
  field_updates_.forget();
  field_updates_.note_requested(*feed_);
  snapshot_.request(*feed_, want_, cause,
                    [this](std::shared_ptr<const Snapshot> snapshot) { on_snapshot(std::move(snapshot)); });
}

void FeedFollower::on_snapshot(std::shared_ptr<const Snapshot> snapshot) {
  if (snapshot->epoch != feed_->mirror().epoch()) {
    send_snapshot(snapshot_.cause());  // encoded before a reset
    return;
  }
  if (snapshot->part) {
    if (!part_.has_room_for(*snapshot->part, context_.config.max_part_bytes)) {
      refuse_box("has no memory for more of them", snapshot_.cause());
      return;
    }
    if (!context_.box_turns.has_room()) {
      refuse_box("has no time for more of them", snapshot_.cause());
      return;
    }
  }
  snapshot_.begin(std::move(snapshot), fields());
  advance();
}

void FeedFollower::on_snapshot_sent(const Snapshot& snapshot) {
  revision_ = snapshot.begin.revision;
  field_updates_.note_held();
  part_.hold(snapshot.part);
  if (std::exchange(resync_again_, false)) send_snapshot(SnapshotCause::Resync);
}

// ---- Deltas ----

void FeedFollower::advance() {
  if (want_.view == View::None || snapshot_.requested() || field_updates_.on_their_way()) return;
  if (snapshot_.sending()) {
    const auto sent = snapshot_.send_chunks(context_.config.outbox_bytes);
    if (!sent) return;
    on_snapshot_sent(*sent);
    if (snapshot_.requested()) return;
  }
  if (!has_room()) return;
  const std::uint64_t head = feed_->mirror().revision();
  if (revision_ == head) {
    if (outbox_.state_bytes() == 0) {
      slow_snapshots_ = 0;
      bring_fields();
    }
    return;
  }
  if (!pace_.allow(outbox_.keep(), [this] { advance(); })) return;
  if (!want_.box) {
    send_deltas(head);
    if (revision_ == head) bring_fields();
  } else if (!std::exchange(box_turn_asked_, true)) {
    context_.box_turns.ask(self());
  }
}

// Values that a client has set come at the revision that the peer holds now.
void FeedFollower::bring_fields() {
  const std::vector<std::uint32_t> chosen = fields();
  if (!chosen.empty() && !snapshot_.busy()) field_updates_.bring(*feed_, chosen, [this] { advance(); });
}

// A full outbox must half empty before it gets more, so that what is missing becomes one delta.
bool FeedFollower::has_room() {
  const std::size_t limit = context_.config.outbox_bytes;
  if (outbox_.state_bytes() > limit) behind_ = true;
  if (behind_ && outbox_.state_bytes() > limit / 2) return false;
  behind_ = false;
  return true;
}

// One delta for each revision if the peer did not ask for fewer and there is room for them; else one for all.
void FeedFollower::send_deltas(std::uint64_t head) {
  if (!feed_->ring().covers(revision_, head)) {
    send_snapshot(SnapshotCause::TooSlow);
    return;
  }
  const DeltaRing& ring = feed_->ring();
  const auto frame_of = [&](const EncodedStep& step) {
    return want_.view == View::Surface ? step.surface : step.volume;
  };
  const std::size_t limit = context_.config.outbox_bytes;
  std::size_t missing = 0;
  for (std::uint64_t r = revision_; r < head && missing <= limit; r = ring.after(r).revision)
    missing += frame_of(ring.after(r))->tcp().size();
  if (ring.after(revision_).revision == head ||
      (!pace_.limited() && outbox_.state_bytes() + missing <= limit)) {
    while (revision_ < head) {
      const EncodedStep& step = ring.after(revision_);
      revision_ = step.revision;
      outbox_.send_state(frame_of(step));
    }
    return;
  }
  const SharedFrame frame = feed_->coalesced(want_.view, revision_);
  if (!frame) {
    send_snapshot(SnapshotCause::TooSlow);
    return;
  }
  ++context_.counters->coalesced;
  revision_ = head;
  outbox_.send_state(frame);
}

// ---- The box ----

bool FeedFollower::wants_box_turn() const {
  return want_.view != View::None && want_.box && part_.get() && !snapshot_.busy() &&
         revision_ != feed_->mirror().revision();
}

bool FeedFollower::make_box_delta() {
  box_turn_asked_ = false;
  const std::uint64_t head = feed_->mirror().revision();
  const SharedFrame frame = feed_->part_delta(*part_.get());
  part_.recount();
  if (!frame) {
    send_snapshot(SnapshotCause::TooSlow);
    return false;
  }
  if (head - revision_ > 1) {
    ++context_.counters->coalesced;
    ++context_.counters->box_coalesced;
  }
  revision_ = head;
  outbox_.send_state(frame);
  return true;
}

void FeedFollower::lose_box() {
  if (!want_.box || snapshot_.busy()) return;
  drop_state();
  refuse_box("has no time for yours", SnapshotCause::Subscribe);
}

void FeedFollower::refuse_box(const std::string& why, SnapshotCause cause) {
  ++context_.counters->boxes_refused;
  outbox_.complain(protocol::ErrorCode::NotAvailable,
                   "box: the server " + why +
                       "; everything is sent. Subscribe again later, with a smaller box or a max_rate_hz",
                   0);
  want_.box.reset();
  part_.hold(nullptr);
  send_snapshot(cause);
}

}  // namespace incise::stream
