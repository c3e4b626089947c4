#include "server/app/undone_slot.hpp"

#include "server/app/stream_setup.hpp"

namespace incise::app {

void UndoneSlot::offer(loop::Undone undone) {
  auto waiting = std::make_unique<Waiting>();
  if (undone.session) {
    auto fields = replay::shared_fields(undone.session->fields());
    undone.session->drop_fields();  // the loop's session has none: the stream carries them
    waiting->shown = shown_again(mirror_of(*undone.session, origins_), std::move(fields));
  }
  waiting->undone = std::move(undone);
  delete waiting_.exchange(waiting.release());
}

std::unique_ptr<loop::Undone> UndoneSlot::take() {
  const std::unique_ptr<Waiting> taken(waiting_.exchange(nullptr));
  if (!taken) return nullptr;
  shown_ = std::move(taken->shown);
  return std::make_unique<loop::Undone>(std::move(taken->undone));
}

}  // namespace incise::app
