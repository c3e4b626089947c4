#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "server/core/session/vertex_positions.hpp"
#include "server/input/spsc_queue.hpp"

namespace incise::input {

// A host simulation's positions on their way to the loop. The loop wants the newest only: those that it has not taken by
// then are skipped, and so are those for which there is no buffer, because the journal or the checkpoints still hold them
// all. Skipped ones were never there: the capture has those that the loop has taken.
//
// Thread: buffer() and offer() from one, take() from the loop's, which neither allocates nor frees; figures from any.
class PositionsSlot {
 public:
  // `most_bytes`: of all buffers; there may be four in any case.
  explicit PositionsSlot(std::size_t most_bytes = 64u << 20) : most_bytes_(most_bytes), queue_(8) {}

  // A buffer to fill and offer; null where all are in use: the message is skipped.
  std::shared_ptr<core::VertexPositions> buffer();
  // False where it is skipped.
  bool offer(std::shared_ptr<core::VertexPositions> positions);

  // The newest one that waits; null where none does.
  std::shared_ptr<const core::VertexPositions> take();

  std::uint64_t skipped() const {
    return refused_.load(std::memory_order_relaxed) + replaced_.load(std::memory_order_relaxed);
  }

 private:
  using Buffer = std::shared_ptr<core::VertexPositions>;
  const std::size_t most_bytes_;
  std::vector<Buffer> buffers_;  // each is held here too, so that nobody else frees it
  std::size_t next_ = 0;         // the one that was given out longest ago
  std::size_t last_bytes_ = 0;   // of the last one that was filled: they are of about one size
  SpscQueue<Buffer> queue_;
  std::atomic<std::uint64_t> refused_{0}, replaced_{0};
};

}  // namespace incise::input
