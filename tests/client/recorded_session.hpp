#pragma once

#include <cstdint>
#include <utility>
#include <variant>
#include <vector>

#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/stream/viewer.hpp"

namespace incise::client {

// What a server sent to a viewer: a Welcome, a snapshot of the mesh as loaded, and the steps of a stroke.
struct Recording {
  Recording() {
    stream::TestServer test(4);
    stream::RawPeer peer(test.server.tcp_port());
    peer.send(stream::hello(protocol::Role::Viewer, protocol::View::Volume));
    while (snapshot.empty() || !std::holds_alternative<protocol::SnapshotEnd>(snapshot.back().message.body)) {
      auto received = peer.receive();
      if (!received) return;
      const bool is_welcome = std::holds_alternative<protocol::Welcome>(received->message.body);
      (is_welcome ? welcome : snapshot).push_back(std::move(*received));
    }
    test.cut();
    hash = test.loop.state_hash();
    while (steps.size() < test.loop.revision()) {
      auto received = peer.receive_until<protocol::Delta>();
      if (!received) return;
      steps.push_back(std::move(*received));
    }
  }
  std::vector<stream::RawPeer::Message> welcome, snapshot, steps;
  std::uint64_t hash = 0;
};

inline void play(stream::RawPeer& to, const std::vector<stream::RawPeer::Message>& messages) {
  for (const auto& one : messages) to.send(one.message.body, one.message.envelope.sequence);
}

}  // namespace incise::client
