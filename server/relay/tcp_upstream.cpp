#include "server/relay/tcp_upstream.hpp"

#include <algorithm>
#include <numeric>
#include <utility>

#include "server/base/clock.hpp"
#include "server/stream/subscription.hpp"

namespace incise::relay {
namespace {

constexpr std::chrono::milliseconds kFirstPause{100}, kLongestPause{2000};
// For one that refuses us: it counts wrong tokens.
constexpr std::chrono::milliseconds kRefusedPause{10'000};
constexpr std::int64_t kLasted_ns = 5'000'000'000;     // a connection that did its work
constexpr std::int64_t kSoonAgain_ns = 1'000'000'000;  // a snapshot that did not help
constexpr float kBladeRate_hz = 60;                    // a screen's

}  // namespace

TcpUpstream::TcpUpstream(asio::io_context& io, Origin server, std::string name)
    : io_(io), server_(std::move(server)), name_(std::move(name)), retry_(io), pause_(kFirstPause) {}

TcpUpstream::~TcpUpstream() {
  stop();
}

void TcpUpstream::start(Sink& sink) {
  sink_ = &sink;
  connect();
}

void TcpUpstream::stop() {
  sink_ = nullptr;
  retry_.cancel();
  if (const auto connection = std::exchange(connection_, nullptr)) connection->close();
}

void TcpUpstream::connect() {
  protocol::Hello hello;
  hello.view = protocol::View::Volume;
  hello.client_name = "incise-relay";
  hello.client_version = INCISE_VERSION;
  hello.token = server_.options.token;
  hello.fields = {"*"};
  hello.blade_rate_hz = kBladeRate_hz;
  const Held held = sink_->held();
  if (held.epoch != 0) {
    hello.resume_session = stream::session_name(held.epoch, hello.view, false, held.fields);
    hello.resume_revision = held.revision;
    hello.resume_hash = held.state_hash;
  }
  connection_ = std::make_shared<Connection>(io_, server_, static_cast<Connection::Owner&>(*this));
  connection_->open(std::move(hello));
}

void TcpUpstream::on_message(const protocol::Message& message) {
  const client::ClockEstimate& clock = connection_->clock();
  const auto* welcome = std::get_if<protocol::Welcome>(&message.body);
  if (!welcome) {
    sink_->on_message(message, clock.round_trip_ns() > 0 ? clock.offset_ns() : ahead_ns_);
    return;
  }
  welcomed_ns_ = monotonic_ns();
  ahead_ns_ = welcome->server_monotonic_ns - welcomed_ns_;
  std::vector<std::uint32_t> all(welcome->fields.size());
  std::iota(all.begin(), all.end(), 0);
  protocol::Welcome plain = *welcome;
  plain.session = stream::session_name(welcome->session, protocol::View::Volume, false, all);
  sink_->on_message({message.envelope, std::move(plain), nullptr}, ahead_ns_);
}

void TcpUpstream::on_end(const Connection::End& end, bool welcomed) {
  connection_ = nullptr;
  if (!sink_) return;
  const bool refused = end.code != protocol::ErrorCode::Unknown && !welcomed;
  if (welcomed && monotonic_ns() - welcomed_ns_ > kLasted_ns) pause_ = kFirstPause;
  retry_.expires_after(refused ? kRefusedPause : pause_);
  pause_ = std::min(2 * pause_, kLongestPause);
  retry_.async_wait([this](boost::system::error_code error) {
    if (!error && sink_) connect();
  });
  const bool tokenless = end.code == protocol::ErrorCode::Unauthorized && server_.options.token.empty();
  sink_->on_lost(tokenless
                     ? end.text + "; give one as relay.token_file, with --token-file FILE or in INCISE_TOKEN"
                     : end.text);
}

void TcpUpstream::resync(const std::string& reason) {
  if (!connection_) return;
  const std::int64_t now = monotonic_ns();
  if (now - std::exchange(resynced_ns_, now) < kSoonAgain_ns) {
    // Perhaps a fresh start helps; in any case it comes with a pause.
    connection_->close();
    on_end({{}, {}, "what it sends is wrong: " + reason}, true);
    return;
  }
  const Held held = sink_->held();
  connection_->send(
      protocol::Resync{held.revision, held.state_hash, reason.substr(0, protocol::kMaxTextBytes)});
}

void TcpUpstream::leave(const std::string& why) {
  if (!connection_) return;
  connection_->close();
  on_end({protocol::ErrorCode::NotAvailable, {}, why}, false);
}

std::chrono::nanoseconds TcpUpstream::round_trip() const {
  return std::chrono::nanoseconds(connection_ ? connection_->clock().round_trip_ns() : 0);
}

}  // namespace incise::relay
