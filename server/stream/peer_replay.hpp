#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "server/stream/feed.hpp"
#include "server/stream/outbox.hpp"
#include "server/stream/peer_context.hpp"
#include "server/stream/replay_library.hpp"

namespace incise::stream {

// A capture that is replayed for one peer, which then follows the replay's state instead of the live mesh.
//
// Thread: the stream thread; the player's events are posted to it. Owns: the player, the feed of its state.
class PeerReplay {
 public:
  class Owner {
   public:
    // The peer's state starts again: at feed(), or at the live mesh where that is null by now.
    virtual void on_state_replaced() = 0;
    // feed() has moved on.
    virtual void on_replay_advanced() = 0;

   protected:
    ~Owner() = default;
  };

  PeerReplay(PeerContext& context, Outbox& outbox, Owner& owner)
      : context_(context), outbox_(outbox), owner_(owner) {}

  // Does what the message says; answers and complaints go to the outbox.
  void control(const protocol::ReplayControl& control, std::uint64_t sequence);
  // Ends the player. The state stays until this is destroyed, since others may refer to it.
  void stop() { player_.reset(); }

  // Null: the peer follows the live mesh.
  Feed* feed() const { return scratch_ ? &scratch_->feed : nullptr; }
  const protocol::MeshFacts& mesh() const { return scratch_->mesh; }

 private:
  void open(const std::string& capture, std::uint64_t sequence);
  ReplayEvents events(std::uint64_t number, std::uint64_t sequence);
  void end();

  // The replay's state.
  struct Scratch {
    Scratch(asio::io_context& io, std::size_t ring_bytes) : feed(io, ring_bytes) {}
    protocol::MeshFacts mesh;
    Feed feed;
  };
  PeerContext& context_;
  Outbox& outbox_;
  Owner& owner_;
  std::unique_ptr<ReplayPlayer> player_;
  std::unique_ptr<Scratch> scratch_;
  std::uint64_t number_ = 0;  // of the capture that was opened last
};

}  // namespace incise::stream
