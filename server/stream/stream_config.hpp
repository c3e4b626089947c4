#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "protocol/messages.hpp"

namespace incise::stream {

// A secret that admits its holder, in one of the roles. Any token opens /stats and /metrics.
struct AccessToken {
  std::string token;
  std::vector<protocol::Role> roles;  // empty: it opens only those
};

struct StreamConfig {
  std::string address = "127.0.0.1";         // to listen at
  int tcp_port = 7450;                       // 0: any free one; -1: off
  int http_port = 7480;                      // HTTP and WebSocket; likewise
  std::string viewer_directory;              // static files; empty: none
  std::vector<std::string> allowed_origins;  // of WebSockets, beside our own; "*": any
  // Without tokens everybody may do everything, which is for loopback only.
  std::vector<AccessToken> tokens;
  // TLS for both ports: PEM files. Empty: none.
  std::string certificate_file, private_key_file;
  // Listen beyond loopback without tokens and TLS.
  bool insecure = false;

  std::uint32_t max_sessions = 300;  // peers welcomed at once
  // Connections before Hello. One more, and the oldest of them is closed, so that silent connections keep nobody out.
  std::uint32_t max_handshakes = 64;
  double handshake_timeout_s = 5;
  double idle_timeout_s = 30;   // for a peer that sends nothing; it is pinged after a third of this
  double write_timeout_s = 10;  // for one frame to go out
  double stop_grace_s = 2;
  // A relay's: a client that comes back may have seen more than has come here. It is welcomed once that is here, or after so long.
  double catch_up_s = 0;
  // Messages a second from one peer, beside pose batches; beyond that it is disconnected.
  std::uint32_t max_messages_per_s = 500;

  // The outbox policy. While more than `outbox_bytes` wait for a peer it gets no deltas; when half has gone out it
  // gets what it missed as one coalesced delta or, where the ring no longer has that, as a snapshot. A peer that
  // needs more than `max_slow_snapshots` in a row without catching up, or lets a write time out, is disconnected.
  std::size_t outbox_bytes = 4u << 20;
  std::uint32_t max_slow_snapshots = 3;
  // Encoded deltas kept for peers that return or fall behind.
  std::size_t ring_bytes = 64u << 20;
  // What the server keeps for peers with a box of interest. A peer that comes beyond that gets everything.
  std::size_t max_part_bytes = 512u << 20;
  // The share of the stream thread's time for deltas of boxes of interest.
  double box_share = 0.2;
  double max_report_rate_hz = 20;  // pose reports to an operator
};

}  // namespace incise::stream
