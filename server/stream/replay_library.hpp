#pragma once

// What the stream needs to replay captures. server/app implements it with the core.

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "protocol/messages.hpp"
#include "server/stream/published_delta.hpp"

namespace incise::stream {

// What a replay reports, from its own thread.
struct ReplayEvents {
  // A state to start from: when the capture is open, and after a jump back.
  std::function<void(protocol::MeshFacts, std::shared_ptr<const InitialState>)> restarted;
  std::function<void(std::shared_ptr<const PublishedDelta>)> delta;
  std::function<void(protocol::ReplayState)> state;
  // It cannot be played; one line says why. Nothing else follows.
  std::function<void(std::string)> failed;
};

// A capture that is being played in a cut session of its own. Destroying it ends that soon, without waiting.
//
// Thread: one.
class ReplayPlayer {
 public:
  virtual ~ReplayPlayer() = default;
  // Carries out any action but Open and Close; `state` follows.
  virtual void control(const protocol::ReplayControl& control) = 0;
};

// Thread: all calls from the stream thread.
class ReplayLibrary {
 public:
  virtual ~ReplayLibrary() = default;
  // The names of the captures that are there now.
  virtual std::vector<std::string> names() = 0;
  // Null where no capture has that name, or too many are being played.
  virtual std::unique_ptr<ReplayPlayer> open(const std::string& name, ReplayEvents events) = 0;
};

}  // namespace incise::stream
