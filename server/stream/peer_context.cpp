#include "server/stream/peer_context.hpp"

#include <utility>

#include "server/base/clock.hpp"

namespace incise::stream {

PeerContext::PeerContext(asio::io_context& io_context, const StreamConfig& stream_config,
                         ServerFacts server_facts, PeerInput& peer_input, Providers given)
    : io(io_context),
      config(stream_config),
      facts(std::move(server_facts)),
      input(peer_input),
      providers(std::move(given)),
      access(config.tokens),
      live(io, config.ring_bytes),
      box_turns(io, config.box_share, *counters) {}

protocol::Welcome PeerContext::welcome_to(const Feed& feed) const {
  const Mirror& mirror = feed.mirror();
  protocol::Welcome welcome;
  welcome.session = mirror.epoch();
  welcome.revision = mirror.revision();
  welcome.state_hash = mirror.volume().state_hash();
  welcome.mesh = facts.mesh;
  welcome.blade_heel = facts.blade_heel;
  welcome.blade_tip = facts.blade_tip;
  welcome.engage_button = facts.engage_button;
  welcome.max_speed_m_s = facts.max_speed_m_s;
  welcome.frame_rate_hz = facts.frame_rate_hz;
  welcome.max_message_bytes = static_cast<std::uint32_t>(protocol::kMaxClientBytes);
  welcome.server_name = "incised";
  welcome.server_version = INCISE_VERSION;
  welcome.server_monotonic_ns = monotonic_ns();
  welcome.server_unix_ns = unix_ns();
  welcome.policy = facts.policy;
  welcome.recording = recording.state;
  // A replay may be of another body.
  if (mirror.surface().finds_origins()) welcome.surface = facts.surface;
  welcome.fields = feed.fields();
  if (&feed == &live) welcome.restart = restart;
  return welcome;
}

void PeerContext::note_refusal(const Access::Answer& answer, const asio::ip::address& address,
                               const std::string& what, const std::string& peer) {
  using Verdict = Access::Verdict;
  std::string why = "no token";
  if (answer.verdict == Verdict::kOtherRole) why = "its token does not open that";
  if (answer.verdict == Verdict::kWrong) {
    ++counters->wrong_tokens;
    why = "a wrong token";
  }
  if (answer.verdict == Verdict::kNotLookedAt) {
    ++counters->tokens_not_looked_at;
    why = "too many wrong tokens from this address";
  }
  audit(Audit::kRefused, address, what + " refused to " + peer + ": " + why);
}

}  // namespace incise::stream
