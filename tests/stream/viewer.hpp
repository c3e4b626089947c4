#pragma once

// A viewer with a replica, by the raw way.

#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

#include "protocol/replica.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::stream {

inline protocol::Hello hello(protocol::Role role, protocol::View view) {
  protocol::Hello h;
  h.role = role;
  h.view = view;
  h.source_name = "blade";
  return h;
}

struct Viewer {
  explicit Viewer(std::uint16_t port,
                  protocol::Hello h = hello(protocol::Role::Viewer, protocol::View::Volume),
                  int receive_buffer = 0)
      : peer(port, receive_buffer) {
    peer.send(h);
  }
  // Takes messages until the replica is at `revision`. False at the end of the stream, or where a part is
  // refused.
  bool follow(std::uint64_t revision) {
    while (!whole || replica.revision() < revision) {
      auto received = peer.receive();
      if (!received || !take(received->message.body)) return false;
    }
    return true;
  }
  bool take(const protocol::Body& body) {
    protocol::ApplyResult result;
    if (const auto* part = std::get_if<protocol::SnapshotBegin>(&body)) {
      causes.push_back(part->cause);
      result = replica.begin(*part);
    } else if (const auto* chunk = std::get_if<protocol::SnapshotChunk>(&body)) {
      result = replica.chunk(*chunk);
    } else if (const auto* end = std::get_if<protocol::SnapshotEnd>(&body)) {
      result = replica.end(*end);
      whole = static_cast<bool>(result);
    } else if (const auto* delta = std::get_if<protocol::Delta>(&body)) {
      result = replica.apply(*delta);
      ++deltas;
      steps += delta->steps.size();
    } else if (const auto* w = std::get_if<protocol::Welcome>(&body)) {
      welcome = *w;
    }
    EXPECT_TRUE(result) << result.text;
    return static_cast<bool>(result);
  }

  RawPeer peer;
  protocol::Replica replica;
  protocol::Welcome welcome;
  bool whole = false;
  std::vector<protocol::SnapshotCause> causes;
  std::size_t deltas = 0, steps = 0;
};

}  // namespace incise::stream
