#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "server/stream/mirror.hpp"
#include "server/stream/peer_input.hpp"
#include "server/stream/refusal.hpp"

namespace incise::stream {

// A simulator's hold on the body's positions, from its first Positions message on.
//
// Thread: the stream thread. Owns: the right to set them, until release().
class SimulatorPositions {
 public:
  // Passes positions on to the loop, or says why not. `mirror` is the live mesh's.
  std::optional<Refusal> offer(const protocol::Positions& positions, const Mirror& mirror, PeerInput& input,
                               std::int64_t arrival_ns);
  void release() { input_.reset(); }
  // The report on a message of this peer that the loop has used; nothing where it sets no positions.
  std::optional<protocol::PositionsReport> report(const PublishedDelta& step);

 private:
  std::unique_ptr<PositionsInput> input_;
  std::uint64_t taken_ = 0;  // messages that the loop has used
};

}  // namespace incise::stream
