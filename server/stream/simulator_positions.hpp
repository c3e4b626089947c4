#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "server/stream/mirror.hpp"
#include "server/stream/peer_input.hpp"
#include "server/stream/refusal.hpp"

namespace incise::stream {

// The body's positions, which one simulator sets: its from its first Positions on.
//
// Thread: the stream thread. Owns: the right to set them, until release().
class SimulatorPositions {
 public:
  // Passes positions on to the loop, or says why not. `mirror` is the live mesh's.
  std::optional<Refusal> offer(const protocol::Positions& positions, const Mirror& mirror, PeerInput& input,
                               std::int64_t arrival_ns);
  void release() { input_.reset(); }
  // What the loop made of a message of ours; nothing where this peer sets no positions.
  std::optional<protocol::PositionsReport> report(const PublishedDelta& step);

 private:
  std::unique_ptr<PositionsInput> input_;
  std::uint64_t taken_ = 0;  // messages that the loop has used
};

}  // namespace incise::stream
