#pragma once

#include <boost/asio/io_context.hpp>
#include <memory>
#include <optional>
#include <string>

#include "server/stream/access.hpp"
#include "server/stream/box_turns.hpp"
#include "server/stream/counters.hpp"
#include "server/stream/feed.hpp"
#include "server/stream/network.hpp"
#include "server/stream/peer_input.hpp"
#include "server/stream/providers.hpp"
#include "server/stream/stream_config.hpp"

namespace incise::stream {

// What all peers use. It knows no peer.
//
// Thread: the stream thread; `counters` from any. Owns: the live feed.
struct PeerContext {
  PeerContext(asio::io_context& io_context, const StreamConfig& stream_config, ServerFacts server_facts,
              PeerInput& peer_input, Providers given);

  void audit(Audit kind, const asio::ip::address& address, const std::string& line) const {
    if (providers.audit) providers.audit(kind, network_of(address), line);
  }
  // Counts and logs that `peer`, at that address, was refused `what` for want of a token.
  void note_refusal(const Access::Answer& answer, const asio::ip::address& address, const std::string& what,
                    const std::string& peer);

  // What every Welcome says of that feed at its present revision; the view, the role and the rest are the caller's.
  protocol::Welcome welcome_to(const Feed& feed) const;

  asio::io_context& io;
  const StreamConfig& config;
  const ServerFacts facts;
  PeerInput& input;
  const Providers providers;
  // Shared with connections that never end, which are destroyed with the io_context, after this.
  const std::shared_ptr<SharedCounters> counters = std::make_shared<SharedCounters>();
  Access access;
  Feed live;
  BoxTurns box_turns;
  RecordingNow recording;                    // as of the last tick
  std::string reset_by;                      // the client that has asked for a reset last
  std::optional<protocol::Restart> restart;  // what the live feed's present ids began with
};

}  // namespace incise::stream
