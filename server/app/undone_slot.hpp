#pragma once

#include <atomic>
#include <memory>
#include <utility>

#include "server/loop/undo_history.hpp"
#include "server/stream/published_delta.hpp"

namespace incise::app {

// Where the checkpoints' thread leaves what a stroke is undone with, and the loop takes it. A newer one replaces one that was not taken.
//
// Thread: offer() from one, the rest from the loop's.
class UndoneSlot {
 public:
  // `origins`: InitialState::origins.
  explicit UndoneSlot(std::shared_ptr<const protocol::OriginTree> origins = nullptr)
      : origins_(std::move(origins)) {}
  UndoneSlot(const UndoneSlot&) = delete;
  UndoneSlot& operator=(const UndoneSlot&) = delete;
  ~UndoneSlot() { delete waiting_.load(); }

  // Makes what viewers are shown of it. O(mesh).
  void offer(loop::Undone undone);
  // Null: nothing waits.
  std::unique_ptr<loop::Undone> take();
  // Of the one taken last; once.
  std::shared_ptr<stream::InitialState> shown() { return std::move(shown_); }

 private:
  struct Waiting {
    loop::Undone undone;
    std::shared_ptr<stream::InitialState> shown;
  };
  const std::shared_ptr<const protocol::OriginTree> origins_;
  std::atomic<Waiting*> waiting_{nullptr};
  std::shared_ptr<stream::InitialState> shown_;
};

}  // namespace incise::app
