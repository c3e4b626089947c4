#include "server/stream/peer_context.hpp"

#include <utility>

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
