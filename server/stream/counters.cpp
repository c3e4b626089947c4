#include "server/stream/counters.hpp"

namespace incise::stream {

StreamCounters SharedCounters::read() const {
  StreamCounters out;
  out.revision = revision;
  out.state_hash = state_hash;
  out.pieces = pieces;
  out.peers = peers;
  out.connections = connections;
  out.accepted = accepted;
  out.refused = refused;
  out.wrong_tokens = wrong_tokens;
  out.tokens_not_looked_at = tokens_not_looked_at;
  out.resets = resets;
  out.undos = undos;
  out.takeovers = takeovers;
  out.handovers = handovers;
  out.deltas = deltas;
  out.bytes_out = bytes_out;
  out.bytes_in = bytes_in;
  out.messages_in = messages_in;
  out.bad_messages = bad_messages;
  out.coalesced = coalesced;
  out.snapshots = snapshots;
  out.slow_snapshots = slow_snapshots;
  out.slow_disconnects = slow_disconnects;
  out.resumed = resumed;
  out.ring_bytes = ring_bytes;
  out.ring_deltas = ring_deltas;
  out.half_open_closed = half_open_closed;
  out.part_bytes = part_bytes;
  out.box_turns = box_turns;
  out.box_turns_ns = box_turns_ns;
  out.box_coalesced = box_coalesced;
  out.boxes_refused = boxes_refused;
  return out;
}

}  // namespace incise::stream
