#include "server/stream/hub.hpp"

#include <fcntl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <vector>

#include "server/base/clock.hpp"
#include "server/stream/session.hpp"

namespace incise::stream {
namespace {

constexpr std::chrono::milliseconds kTick{50};
constexpr std::chrono::milliseconds kBladeTick{16};  // a screen's
constexpr std::uint64_t kTicksPerStatistics = 20;
constexpr std::size_t kMaxLingering = 64;

}  // namespace

Hub::Hub(asio::io_context& io, const StreamConfig& config, ServerFacts facts, PeerInput& input,
         Providers providers)
    : io_(io),
      config_(config),
      facts_(std::move(facts)),
      input_(input),
      providers_(std::move(providers)),
      access_(config.tokens),
      clock_(io),
      blade_clock_(io),
      live_(io, config.ring_bytes),
      box_turns_(io, config.box_share, *counters_) {}

Hub::~Hub() = default;

void Hub::reset(std::shared_ptr<const InitialState> initial) {
  live_.reset(std::move(initial));
  counters_->revision = live_.mirror().revision();
  counters_->state_hash = live_.mirror().volume().state_hash();
  counters_->ring_bytes = counters_->ring_deltas = 0;
  const auto sessions = sessions_;
  for (const auto& session : sessions) session->live_restarted();
}

void Hub::apply(const std::shared_ptr<const PublishedDelta>& delta) {
  live_.apply(delta);
  if (delta->delta.stroke == 0) {
    for (const auto& session : sessions_) session->report_deformation(*delta);
  }
  ++counters_->deltas;
  counters_->revision = live_.mirror().revision();
  counters_->state_hash = live_.mirror().volume().state_hash();
  counters_->ring_bytes = live_.ring().bytes();
  counters_->ring_deltas = live_.ring().size();
}

void Hub::advance_all() {
  // A session that fails meanwhile leaves the set later, from its own coroutine.
  for (const auto& session : sessions_) session->advance();
}

void Hub::send_force(const protocol::Force& force) {
  for (const auto& session : sessions_) session->send_force(force);
}

Hub::HalfOpen::~HalfOpen() {
  while (!sockets.empty()) close(sockets.begin());
}

void Hub::HalfOpen::close(std::map<std::uint64_t, int>::iterator which) {
  if (which->second >= 0) ::close(which->second);
  sockets.erase(which);
}

void Hub::Ticket::leave_half_open() {
  if (const auto mine = half_open_->sockets.find(number_); mine != half_open_->sockets.end())
    half_open_->close(mine);
}

void Hub::Ticket::welcome() {
  if (std::exchange(welcomed_, true)) return;
  leave_half_open();
  ++counters_->sessions;
}

Hub::Ticket::~Ticket() {
  if (!counters_) return;
  leave_half_open();
  leave();
  --counters_->connections;
}

std::optional<Hub::Ticket> Hub::admit(asio::ip::tcp::socket& socket) {
  if (stopping_) {
    ++counters_->refused;
    return std::nullopt;
  }
  auto& sockets = half_open_->sockets;
  if (!sockets.empty() && sockets.size() >= config_.max_handshakes) {
    // Whoever reads from it finds its end, and lets go of the rest.
    const auto oldest = sockets.begin();
    ::shutdown(oldest->second, SHUT_RDWR);
    half_open_->close(oldest);
    ++counters_->half_open_closed;
  }
  const std::uint64_t number = ++counters_->accepted;
  sockets.emplace(number, ::fcntl(socket.native_handle(), F_DUPFD_CLOEXEC, 0));
  boost::system::error_code gone;  // then its address is 0.0.0.0
  return Ticket(counters_, half_open_, number, socket.remote_endpoint(gone));
}

void Hub::note_refusal(const Access::Answer& answer, const std::string& what, const std::string& peer) {
  using Verdict = Access::Verdict;
  std::string why = "no token";
  if (answer.verdict == Verdict::kOtherRole) why = "its token does not open that";
  if (answer.verdict == Verdict::kWrong) {
    ++counters_->wrong_tokens;
    why = "a wrong token";
  }
  if (answer.verdict == Verdict::kNotLookedAt) {
    ++counters_->tokens_not_looked_at;
    why = "too many wrong tokens from this address";
  }
  audit(Audit::kRefused, what + " refused to " + peer + ": " + why);
}

std::shared_ptr<Session> Hub::holder(const std::string& source_name) const {
  for (const auto& session : sessions_) {
    if (session->holds(source_name)) return session;
  }
  return nullptr;
}

void Hub::linger(const std::shared_ptr<Session>& session) {
  std::erase_if(lingering_, [](const auto& other) { return other.expired(); });
  lingering_.push_back(session);
  if (lingering_.size() <= kMaxLingering) return;
  if (const auto first = lingering_.front().lock()) first->close();
  lingering_.pop_front();
}

void Hub::start_clock() {
  tick();
  if (providers_.blades) send_blades();
}

void Hub::send_blades() {
  const bool wanted =
      std::any_of(sessions_.begin(), sessions_.end(), [](const auto& s) { return s->wants_blades(); });
  if (wanted) {
    const std::int64_t now = monotonic_ns();
    std::vector<SharedFrame> frames;
    for (const protocol::BladePose& blade : providers_.blades()) {
      std::int64_t& sent_ns = blade_sent_ns_[blade.source];
      if (sent_ns == blade.arrival_ns) continue;
      sent_ns = blade.arrival_ns;
      frames.push_back(make_frame(blade));
    }
    if (!frames.empty()) {
      for (const auto& session : sessions_) session->send_blades(frames, now);
    }
  }
  blade_clock_.expires_after(wanted ? kBladeTick : kTick);
  blade_clock_.async_wait([this](boost::system::error_code error) {
    if (!error) send_blades();
  });
}

void Hub::tick() {
  const std::int64_t now = monotonic_ns();
  follow_recording();
  const std::vector<std::shared_ptr<Session>> sessions(sessions_.begin(), sessions_.end());
  for (const auto& session : sessions) session->tick(now);
  send_statistics();
  clock_.expires_after(kTick);
  clock_.async_wait([this](boost::system::error_code error) {
    if (!error) tick();
  });
}

void Hub::follow_recording() {
  if (!providers_.recording) return;
  const bool before = recording_.state == protocol::Recording::Stopped;
  recording_ = providers_.recording();
  if (before || recording_.state != protocol::Recording::Stopped) return;
  const auto sessions = sessions_;
  for (const auto& session : sessions) session->warn_not_recorded();
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
      statistics.revision = live_.mirror().revision();
      statistics.live_tets = live_.mirror().volume().live_tets();
      statistics.sessions = counters_->sessions;
      statistics.recording = recording_.state;
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
  blade_clock_.cancel();
  box_turns_.cancel();
  const auto sessions = sessions_;
  for (const auto& session : sessions) session->close();
}

}  // namespace incise::stream
