#include "server/input/positions_slot.hpp"

#include <utility>

namespace incise::input {
namespace {

constexpr std::size_t kFew = 4;
constexpr std::size_t kGaveWay =
    1024;  // vertices for which there is room, so that the loop does not allocate

void bump(std::atomic<std::uint64_t>& counter) {  // that one thread writes
  counter.store(counter.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
}

}  // namespace

std::shared_ptr<core::VertexPositions> PositionsSlot::buffer() {
  if (next_ == buffers_.size()) next_ = 0;
  if (buffers_.empty() || buffers_[next_].use_count() > 1) {
    if (buffers_.size() >= kFew && (buffers_.size() + 1) * last_bytes_ > most_bytes_) {
      bump(refused_);
      return nullptr;
    }
    buffers_.insert(buffers_.begin() + static_cast<std::ptrdiff_t>(next_),
                    std::make_shared<core::VertexPositions>());
    buffers_[next_]->outcome = std::make_shared<std::vector<core::GaveWay>>();
    buffers_[next_]->outcome->reserve(kGaveWay);
  }
  // use_count() alone orders nothing: this copy's end is a read-modify-write with acquire on the count that the last
  // reader released.
  { const Buffer acquire = buffers_[next_]; }
  return buffers_[next_];
}

bool PositionsSlot::offer(std::shared_ptr<core::VertexPositions> positions) {
  ++next_;
  last_bytes_ = positions->positions.capacity() * sizeof(core::Vec3) +
                positions->ids.capacity() * sizeof(core::VertexId);
  if (queue_.push(std::move(positions))) return true;
  bump(refused_);
  return false;
}

std::shared_ptr<const core::VertexPositions> PositionsSlot::pop_newest() {
  Buffer newest, one;
  while (queue_.pop(one)) {
    if (newest) bump(replaced_);
    newest = std::move(one);
  }
  return newest;
}

}  // namespace incise::input
