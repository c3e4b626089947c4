#include "server/wasm/local_replay.hpp"

#include <algorithm>
#include <utility>

#include "server/replay/session_view.hpp"

namespace incise::wasm {

using protocol::ReplayAction;

LocalReplay::LocalReplay(std::string name, replay::Replay replay, std::uint64_t epoch,
                         std::shared_ptr<const protocol::OriginTree> origins, Events events)
    : name_(std::move(name)),
      replay_(std::move(replay)),
      epoch_(epoch),
      origins_(std::move(origins)),
      events_(std::move(events)) {
  show();
}

void LocalReplay::show() {
  stream::InitialState state = replay::initial_state(replay_.session(), epoch_);
  state.origins = origins_;
  mirror_.reset(state);
}

protocol::ReplayState LocalReplay::state(bool first) const {
  protocol::ReplayState state{name_, playing_, speed_, replay_.revision(), replay_.last_revision(), {},
                              {},    {},       {}};
  if (first) replay_.describe(state);
  return state;
}

void LocalReplay::control(const protocol::ReplayControl& wish, std::int64_t now_ns) {
  switch (wish.action) {
    case ReplayAction::Play:
      if (replay_.at_end()) seek(0);  // from the end it starts again
      playing_ = true;
      speed_ = std::clamp(wish.speed, replay::kLeastSpeed, replay::kMostSpeed);
      break;
    case ReplayAction::Pause:
      playing_ = false;
      break;
    case ReplayAction::Step:
      playing_ = false;
      while (!replay_.at_end() && !advance(true)) {
      }
      break;
    case ReplayAction::Seek:
      seek(wish.revision);
      break;
    case ReplayAction::Open:
    case ReplayAction::Close:
      break;
  }
  from_ns_ = replay_.clock_ns();
  since_ns_ = now_ns;
}

std::optional<std::int64_t> LocalReplay::due_ns() const {
  if (!playing_) return std::nullopt;
  return since_ns_ + static_cast<std::int64_t>(static_cast<double>(replay_.due_ns() - from_ns_) /
                                               static_cast<double>(speed_));
}

bool LocalReplay::work(std::int64_t now_ns) {
  const auto due = due_ns();
  if (!due || *due > now_ns) return false;
  advance(true);
  if (replay_.at_end()) playing_ = false;
  return true;
}

bool LocalReplay::advance(bool tell) {
  if (!replay_.advance(delta_.delta)) return false;
  const stream::Mirror::Applied step = mirror_.apply(delta_);
  if (tell) events_.stepped(step);
  return true;
}

void LocalReplay::seek(std::uint64_t revision) {
  const bool back = revision < replay_.revision();
  if (back) {
    replay_.restart();
    ++epoch_;
    show();
  }
  while (replay_.revision() < revision && !replay_.at_end()) advance(!back);
  if (back) events_.restarted();
}

}  // namespace incise::wasm
