#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "server/core/session/vertex_positions.hpp"
#include "server/input/spsc_queue.hpp"

namespace incise::input {

// A host simulation's positions on their way to the loop. The loop wants only the newest: older ones that wait are skipped,
// and so are those for which no buffer is free because journal or checkpoints still hold them all. The capture has only
// those that the loop used, so skipped ones do not matter to a replay.
//
// Thread: buffer() and offer() from one, pop_newest() from the loop's, which neither allocates nor frees; figures from any.
class PositionsSlot {
 public:
  // `most_bytes`: of all buffers; there may be four in any case.
  explicit PositionsSlot(std::size_t most_bytes = 64u << 20) : most_bytes_(most_bytes), queue_(8) {}

  // A buffer to fill and offer; null if all are in use: skip the message.
  std::shared_ptr<core::VertexPositions> buffer();
  // False if it was skipped.
  bool offer(std::shared_ptr<core::VertexPositions> positions);

  // Empties the queue and returns its newest entry; null if it was empty.
  std::shared_ptr<const core::VertexPositions> pop_newest();

  std::uint64_t skipped() const {
    return refused_.load(std::memory_order_relaxed) + replaced_.load(std::memory_order_relaxed);
  }

 private:
  using Buffer = std::shared_ptr<core::VertexPositions>;
  const std::size_t most_bytes_;
  std::vector<Buffer> buffers_;  // held here too, so that no other thread frees one
  std::size_t next_ = 0;         // the least recently used
  std::size_t last_bytes_ = 0;   // of the last one that was filled; all are about that size
  SpscQueue<Buffer> queue_;
  std::atomic<std::uint64_t> refused_{0}, replaced_{0};
};

}  // namespace incise::input
