#include "server/stream/hub.hpp"

#include <boost/asio/post.hpp>
#include <chrono>
#include <stdexcept>
#include <vector>

#include "server/core/check.hpp"
#include "server/stream/session.hpp"

namespace incise::stream {
namespace {

constexpr std::chrono::milliseconds kTick{50};
constexpr std::uint64_t kTicksPerStatistics = 20;

}  // namespace

Hub::Hub(asio::io_context& io, const StreamConfig& config, ServerFacts facts, InputSink& sink,
         Providers providers)
    : io_(io),
      config_(config),
      facts_(std::move(facts)),
      sink_(sink),
      providers_(std::move(providers)),
      ring_(config.ring_bytes),
      clock_(io) {}

Hub::~Hub() = default;

void Hub::reset(std::shared_ptr<const InitialState> initial) {
  mirror_.reset(*initial);
  keeper_.reset(std::move(initial));
  ring_.clear();
  coalesced_.clear();
  counters_->revision = mirror_.revision();
  counters_->state_hash = mirror_.volume().state_hash();
  counters_->ring_bytes = counters_->ring_deltas = 0;
  const auto sessions = sessions_;
  for (const auto& session : sessions) session->restart();
}

void Hub::apply(const std::shared_ptr<const PublishedDelta>& delta) {
  std::optional<EncodedStep> step = mirror_.apply(*delta);
  keeper_.push(delta);
  coalesced_.clear();
  if (step) {
    ring_.push(std::move(*step));
  } else {
    ring_.clear();
  }
  ++counters_->deltas;
  counters_->revision = mirror_.revision();
  counters_->state_hash = mirror_.volume().state_hash();
  counters_->ring_bytes = ring_.bytes();
  counters_->ring_deltas = ring_.size();
}

void Hub::advance_all() {
  // A session that fails meanwhile leaves the set later, from its own coroutine.
  for (const auto& session : sessions_) session->advance();
}

void Hub::send_force(const protocol::Force& force) {
  for (const auto& session : sessions_) session->send_force(force);
}

void Hub::request_snapshot(protocol::View view, const std::optional<protocol::Box>& box,
                           SnapshotKeeper::Ready ready) {
  ++counters_->snapshots;
  keeper_.request(view, box, [&io = io_, ready = std::move(ready)](std::shared_ptr<const Snapshot> snapshot) {
    asio::post(io, [ready, snapshot = std::move(snapshot)] { ready(snapshot); });
  });
}

SharedFrame Hub::coalesced(protocol::View view, std::uint64_t base) {
  const auto [place, is_new] = coalesced_.try_emplace({view, base});
  if (is_new) place->second = coalesce(ring_, view, base, mirror_.revision());
  return place->second;
}

SharedFrame Hub::part_delta(protocol::SurfaceReplica& part, const protocol::Box& box) {
  const std::uint64_t base = part.revision(), head = mirror_.revision();
  const SharedFrame whole =
      head - base == 1 ? ring_.step(head).surface : coalesced(protocol::View::Surface, base);
  if (!whole) return nullptr;
  const protocol::DecodeResult decoded = protocol::decode(whole->body());
  INCISE_CHECK(decoded, decoded.error);
  try {
    return mirror_.follow_part(part, box, std::get<protocol::SurfaceDelta>(decoded.message->body));
  } catch (const std::length_error&) {
    return nullptr;
  }
}

std::optional<Hub::Ticket> Hub::admit() {
  const std::uint32_t connections = counters_->connections.load(std::memory_order_relaxed);
  const std::uint32_t sessions = counters_->sessions.load(std::memory_order_relaxed);
  if (stopping_ || connections - sessions >= config_.max_handshakes) {
    ++counters_->refused;
    return std::nullopt;
  }
  ++counters_->accepted;
  return Ticket(counters_);
}

std::shared_ptr<Session> Hub::holder(const std::string& source_name) const {
  for (const auto& session : sessions_) {
    if (session->holds(source_name)) return session;
  }
  return nullptr;
}

void Hub::start_clock() {
  tick();
}

void Hub::tick() {
  const std::int64_t now = monotonic_ns();
  const std::vector<std::shared_ptr<Session>> sessions(sessions_.begin(), sessions_.end());
  for (const auto& session : sessions) session->tick(now);
  send_statistics();
  clock_.expires_after(kTick);
  clock_.async_wait([this](boost::system::error_code error) {
    if (!error) tick();
  });
}

// To each session once a second, but not to all at once: a thousand writes in a row would hold up the deltas.
void Hub::send_statistics() {
  const std::uint64_t turn = ++ticks_ % kTicksPerStatistics;
  if (!providers_.statistics) return;
  SharedFrame frame;
  for (const auto& session : sessions_) {
    if (!session->open() || session->number() % kTicksPerStatistics != turn) continue;
    if (!frame) {
      protocol::Stats statistics = providers_.statistics();
      statistics.revision = mirror_.revision();
      statistics.live_tets = mirror_.volume().live_tets();
      statistics.sessions = counters_->sessions;
      frame = make_frame(std::move(statistics));
    }
    session->send(frame);
  }
}

void Hub::stop() {
  stopping_ = true;
  const auto sessions = sessions_;
  for (const auto& session : sessions) session->finish(protocol::ByeReason::ServerStops, "the server stops");
}

void Hub::close_all() {
  clock_.cancel();
  const auto sessions = sessions_;
  for (const auto& session : sessions) session->close();
}

}  // namespace incise::stream
