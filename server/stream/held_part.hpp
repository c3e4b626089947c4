#pragma once

#include <cstddef>
#include <memory>
#include <utility>

#include "server/stream/counters.hpp"
#include "server/stream/mirror.hpp"

namespace incise::stream {

// What one peer with a box of interest holds, kept here so that its deltas can be made. Its bytes are counted among
// those of all peers (SharedCounters::part_bytes).
//
// Thread: the stream thread. Owns: the part.
class HeldPart {
 public:
  explicit HeldPart(SharedCounters& counters) : counters_(counters) {}
  HeldPart(const HeldPart&) = delete;
  HeldPart& operator=(const HeldPart&) = delete;

  // Null: nothing.
  void hold(std::shared_ptr<BoxPart> part) {
    part_ = std::move(part);
    recount();
  }
  // The part has changed.
  void recount() {
    const std::size_t bytes = part_ ? part_->bytes() : 0;
    counters_.part_bytes += bytes - bytes_;
    bytes_ = bytes;
  }
  // Whether `part` in place of this one keeps all peers' within `max_bytes`.
  bool has_room_for(const BoxPart& part, std::size_t max_bytes) const {
    return counters_.part_bytes - bytes_ + part.bytes() <= max_bytes;
  }
  BoxPart* get() const { return part_.get(); }

 private:
  SharedCounters& counters_;
  std::shared_ptr<BoxPart> part_;
  std::size_t bytes_ = 0;  // of it, as counted
};

}  // namespace incise::stream
