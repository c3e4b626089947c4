#pragma once

#include <atomic>
#include <cstdint>

namespace incise::stream {

// What the stream has done since it started.
struct StreamCounters {
  std::uint64_t revision = 0;  // the mirror's: what clients can see
  std::uint64_t state_hash = 0;
  std::uint32_t pieces = 1;       // likewise
  std::uint32_t peers = 0;        // connected and welcomed
  std::uint32_t connections = 0;  // open, including those before Hello
  std::uint64_t accepted = 0;     // connections
  // Connections that the server refused before Welcome, and HTTP requests without the token they need.
  std::uint64_t refused = 0;
  std::uint64_t wrong_tokens = 0,
                tokens_not_looked_at = 0;      // among the refused; the latter from addresses that guess
  std::uint64_t resets = 0;                    // of the mesh
  std::uint64_t undos = 0;                     // that were done; a relay passes them on, and counts none
  std::uint64_t takeovers = 0, handovers = 0;  // of blades
  std::uint64_t deltas = 0;                    // applied to the mirror
  std::uint64_t queued = 0;                    // published, not yet applied
  std::uint64_t bytes_out = 0, bytes_in = 0;
  std::uint64_t messages_in = 0, bad_messages = 0;
  std::uint64_t coalesced = 0, snapshots = 0, slow_snapshots = 0, slow_disconnects = 0, resumed = 0;
  std::uint64_t ring_bytes = 0, ring_deltas = 0;
  std::uint64_t half_open_closed = 0;  // connections closed before Hello to make room for new ones
  std::uint64_t part_bytes = 0;        // held for peers with a box
  std::uint64_t box_turns = 0;         // deltas made for one peer's box
  std::uint64_t box_turns_ns = 0;      // processor time they took
  std::uint64_t box_coalesced = 0;     // those that cover several steps
  std::uint64_t boxes_refused = 0;     // for lack of memory or time
};

// The same, as they are counted. Thread: any reads them; the stream thread writes.
struct SharedCounters {
  std::atomic<std::uint64_t> revision{0}, state_hash{0}, accepted{0}, refused{0}, deltas{0}, bytes_out{0},
      bytes_in{0}, messages_in{0}, bad_messages{0}, coalesced{0}, snapshots{0}, slow_snapshots{0},
      slow_disconnects{0}, resumed{0}, ring_bytes{0}, ring_deltas{0}, half_open_closed{0}, part_bytes{0},
      box_turns{0}, box_turns_ns{0}, box_coalesced{0}, boxes_refused{0}, wrong_tokens{0},
      tokens_not_looked_at{0}, resets{0}, undos{0}, takeovers{0}, handovers{0};
  std::atomic<std::uint32_t> peers{0}, connections{0}, pieces{1};

  // All but `queued`.
  StreamCounters read() const;
};

}  // namespace incise::stream
