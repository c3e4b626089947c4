#pragma once

// A viewer with a replica, by the raw way.

#include <gtest/gtest.h>

#include <atomic>
#include <cstdint>
#include <string>
#include <thread>
#include <vector>

#include "protocol/fields.hpp"
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
      whole = false;
      result = replica.begin(*part);
      if (result) result = fields.begin(*part, welcome.fields);
    } else if (const auto* chunk = std::get_if<protocol::SnapshotChunk>(&body)) {
      result = replica.chunk(*chunk);
    } else if (const auto* end = std::get_if<protocol::SnapshotEnd>(&body)) {
      result = replica.end(*end);
      if (result) result = fields.end(replica);
      whole = static_cast<bool>(result);
    } else if (const auto* values = std::get_if<protocol::FieldValues>(&body)) {
      result = fields.values(*values, replica);
      ++field_messages;
      fields_set += whole && values->last;
    } else if (const auto* error = std::get_if<protocol::Error>(&body)) {
      errors.push_back(error->text);
    } else if (const auto* delta = std::get_if<protocol::Delta>(&body)) {
      result = replica.apply(*delta);
      if (result) result = fields.apply(*delta);
      ++deltas;
      steps += delta->steps.size();
    } else if (const auto* w = std::get_if<protocol::Welcome>(&body)) {
      welcome = *w;
    } else if (const auto* ping = std::get_if<protocol::Ping>(&body)) {
      peer.send(protocol::Pong{ping->nonce, ping->sent_ns, 0});  // or it would be taken for gone
    }
    EXPECT_TRUE(result) << result.text;
    return static_cast<bool>(result);
  }

  RawPeer peer;
  protocol::Replica replica;
  protocol::FieldReplica fields;
  protocol::Welcome welcome;
  bool whole = false;
  std::vector<protocol::SnapshotCause> causes;
  std::size_t deltas = 0, steps = 0, field_messages = 0, fields_set = 0;
  std::vector<std::string> errors;  // that did not end the session
};

// A viewer that reads all the time, in a thread of its own, as a healthy one does.
class ReadingViewer {
 public:
  explicit ReadingViewer(std::uint16_t port) : viewer_(port), thread_([this] { read(); }) {}
  ~ReadingViewer() { stop(); }
  ReadingViewer(const ReadingViewer&) = delete;
  ReadingViewer& operator=(const ReadingViewer&) = delete;

  // Whether it holds a whole state of at least `revision`, now.
  bool at(std::uint64_t revision) const { return whole_ && revision_ >= revision; }
  // Whether the server, or a part that it refused, ended its reading.
  bool ended() const { return ended_; }
  // Ends the reading; then the viewer is the caller's.
  Viewer& stop() {
    viewer_.peer.shut_down();
    if (thread_.joinable()) thread_.join();
    return viewer_;
  }

 private:
  void read() {
    while (auto received = viewer_.peer.receive()) {
      if (!viewer_.take(received->message.body)) break;
      revision_ = viewer_.replica.revision();
      whole_ = viewer_.whole;
    }
    ended_ = true;
  }

  Viewer viewer_;
  std::atomic<std::uint64_t> revision_{0};
  std::atomic<bool> whole_{false}, ended_{false};
  std::thread thread_;
};

}  // namespace incise::stream
