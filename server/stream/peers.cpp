#include "server/stream/peers.hpp"

#include <algorithm>
#include <chrono>
#include <utility>
#include <vector>

#include "server/base/clock.hpp"
#include "server/stream/feed_listener.hpp"

namespace incise::stream {
namespace {

constexpr std::chrono::milliseconds kTick{50};
constexpr std::chrono::milliseconds kBladeTick{16};  // a screen's
constexpr std::chrono::milliseconds kLoadTick{1};
constexpr std::uint64_t kTicksPerStatistics = 20;
constexpr std::size_t kMaxLingering = 64;

std::uint32_t pieces_of(const Feed& feed) {
  return 1 + static_cast<std::uint32_t>(feed.mirror().volume().piece_names().size());
}

}  // namespace

Peers::Peers(PeerContext& context)
    : context_(context), clock_(context.io), blade_clock_(context.io), load_clock_(context.io) {}

void Peers::reset(std::shared_ptr<const InitialState> initial) {
  Feed& live = context_.live;
  SharedCounters& counters = *context_.counters;
  const std::uint64_t epoch = live.mirror().epoch(), revision = live.mirror().revision();
  const std::shared_ptr<const protocol::Restart> restart = initial->restart;
  live.reset(std::move(initial));
  const bool same_ids = live.mirror().epoch() == epoch && live.mirror().revision() >= revision;
  if (live.mirror().epoch() != epoch) {
    context_.restart = restart ? std::optional(*restart) : std::nullopt;
    if (restart && restart->kind == protocol::RestartKind::Reset && restart->by.empty())
      context_.restart->by = context_.reset_by;
  }
  counters.revision = live.mirror().revision();
  counters.state_hash = live.mirror().volume().state_hash();
  counters.pieces = pieces_of(live);
  counters.ring_bytes = counters.ring_deltas = 0;
  if (FeedListener* listener = context_.providers.listener)
    listener->on_epoch(live.mirror().epoch(), live.mirror().revision());
  const auto peers = peers_;
  for (const auto& peer : peers) peer->on_live_reset(same_ids);
}

void Peers::apply(const std::shared_ptr<const PublishedDelta>& delta) {
  context_.live.apply(delta);
  if (delta->delta.stroke == 0) {
    for (const auto& peer : peers_) peer->report_deformation(*delta);
  }
  note_applied();
}

void Peers::apply(const std::shared_ptr<const ReceivedDelta>& delta) {
  context_.live.apply(delta);
  note_applied();
}

void Peers::note_applied() {
  const Feed& live = context_.live;
  if (FeedListener* listener = context_.providers.listener) {
    const std::uint64_t head = live.mirror().revision();
    if (const EncodedStep* step = live.ring().newest(); step && step->revision == head) {
      listener->on_step(*step);
    } else {
      listener->on_gap(head);
    }
  }
  SharedCounters& counters = *context_.counters;
  ++counters.deltas;
  counters.revision = live.mirror().revision();
  counters.state_hash = live.mirror().volume().state_hash();
  counters.pieces = pieces_of(live);
  counters.ring_bytes = live.ring().bytes();
  counters.ring_deltas = live.ring().size();
}

void Peers::advance_all() {
  // A peer that fails meanwhile leaves the set later, from its own coroutine.
  for (const auto& peer : peers_) peer->advance();
}

void Peers::send_force(const protocol::Force& force) {
  for (const auto& peer : peers_) peer->send_force(force);
}

std::shared_ptr<Peer> Peers::holder(const std::string& source_name) const {
  for (const auto& peer : peers_) {
    if (peer->holds(source_name)) return peer;
  }
  return nullptr;
}

void Peers::linger(const std::shared_ptr<Peer>& peer) {
  std::erase_if(lingering_, [](const auto& other) { return other.expired(); });
  lingering_.push_back(peer);
  if (lingering_.size() <= kMaxLingering) return;
  if (const auto first = lingering_.front().lock()) first->close();
  lingering_.pop_front();
}

void Peers::start_clock() {
  tick();
  if (context_.providers.blades) tick_blades();
  if (context_.providers.loads) tick_loads();
}

void Peers::tick() {
  const std::int64_t now = monotonic_ns();
  poll_recording();
  const std::vector<std::shared_ptr<Peer>> peers(peers_.begin(), peers_.end());
  for (const auto& peer : peers) peer->tick(now);
  send_statistics();
  clock_.expires_after(kTick);
  clock_.async_wait([this](boost::system::error_code error) {
    if (!error) tick();
  });
}

void Peers::poll_recording() {
  if (!context_.providers.recording) return;
  const bool before = context_.recording.state == protocol::Recording::Stopped;
  context_.recording = context_.providers.recording();
  if (before || context_.recording.state != protocol::Recording::Stopped) return;
  const auto peers = peers_;
  for (const auto& peer : peers) peer->warn_not_recorded();
}

// To each peer once a second, but not to all at once: a thousand writes in a row would hold up the deltas.
void Peers::send_statistics() {
  const std::uint64_t turn = ++ticks_ % kTicksPerStatistics;
  if (!context_.providers.statistics) return;
  SharedFrame frame;
  const auto made = [&] {
    if (!frame) {
      protocol::Stats statistics = context_.providers.statistics();
      statistics.revision = context_.live.mirror().revision();
      statistics.live_tets = context_.live.mirror().volume().live_tets();
      statistics.pieces = pieces_of(context_.live);
      statistics.sessions = context_.counters->peers;
      statistics.recording = context_.recording.state;
      frame = make_frame(std::move(statistics));
    }
    return frame;
  };
  for (const auto& peer : peers_) {
    if (peer->open() && peer->number() % kTicksPerStatistics == turn) peer->send(made());
  }
  if (context_.providers.listener && turn == 0) context_.providers.listener->on_live(made());
}

void Peers::tick_blades() {
  const FeedListener* listener = context_.providers.listener;
  const bool wanted =
      (listener && listener->wants_blades()) ||
      std::any_of(peers_.begin(), peers_.end(), [](const auto& peer) { return peer->wants_blades(); });
  if (wanted) send_blades();
  blade_clock_.expires_after(wanted ? kBladeTick : kTick);
  blade_clock_.async_wait([this](boost::system::error_code error) {
    if (!error) tick_blades();
  });
}

void Peers::send_blades() {
  std::vector<SharedFrame> frames;
  for (const protocol::BladePose& blade : context_.providers.blades()) {
    protocol::BladePose& sent = blades_sent_[blade.source];
    if (sent.arrival_ns == blade.arrival_ns && sent.force_n == blade.force_n) continue;
    sent = blade;
    frames.push_back(make_frame(blade));
  }
  if (frames.empty()) return;
  const std::int64_t now = monotonic_ns();
  for (const auto& peer : peers_) peer->send_blades(frames, now);
  if (FeedListener* listener = context_.providers.listener; listener && listener->wants_blades()) {
    for (const SharedFrame& frame : frames) listener->on_live(frame);
  }
}

void Peers::tick_loads() {
  const bool wanted =
      std::any_of(peers_.begin(), peers_.end(), [](const auto& peer) { return peer->wants_loads(); });
  if (wanted) {
    const std::span<const protocol::BladeLoad> loads = context_.providers.loads();
    const std::int64_t now = monotonic_ns();
    for (const auto& peer : peers_) peer->send_loads(loads, now);
  }
  load_clock_.expires_after(wanted ? kLoadTick : kTick);
  load_clock_.async_wait([this](boost::system::error_code error) {
    if (!error) tick_loads();
  });
}

void Peers::finish_all() {
  const auto peers = peers_;
  for (const auto& peer : peers) peer->finish(protocol::ByeReason::ServerStops, "the server stops");
}

void Peers::close_all() {
  clock_.cancel();
  blade_clock_.cancel();
  load_clock_.cancel();
  context_.box_turns.cancel();
  const auto peers = peers_;
  for (const auto& peer : peers) peer->close();
}

}  // namespace incise::stream
