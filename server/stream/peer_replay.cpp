#include "server/stream/peer_replay.hpp"

#include <boost/asio/post.hpp>
#include <utility>

namespace incise::stream {

using protocol::ErrorCode;
using protocol::ReplayAction;

void PeerReplay::control(const protocol::ReplayControl& control, std::uint64_t sequence) {
  if (!context_.providers.library) {
    outbox_.complain(ErrorCode::NotAvailable, "ReplayControl: this server offers no captures", sequence);
  } else if (control.action == ReplayAction::Open) {
    open(control.capture, sequence);
  } else if (!player_) {
    outbox_.complain(ErrorCode::BadState, "ReplayControl: no capture is open", sequence);
  } else if (control.action == ReplayAction::Close) {
    end();
    outbox_.send(make_frame(protocol::ReplayState{}));
  } else {
    player_->control(control);
  }
}

void PeerReplay::open(const std::string& capture, std::uint64_t sequence) {
  const bool was_open = player_ != nullptr;
  end();
  const std::uint64_t number = ++number_;
  player_ = context_.providers.library->open(capture, events(number, sequence));
  if (player_) return;
  outbox_.complain(ErrorCode::BadRequest,
                   "there is no capture \"" + capture.substr(0, 256) +
                       "\", or too many are being replayed; GET /captures lists them",
                   sequence);
  if (was_open) outbox_.send(make_frame(protocol::ReplayState{}));
}

// The player speaks on its own thread. Its events are handled on this one, unless it has been replaced or stopped by
// then.
ReplayEvents PeerReplay::events(std::uint64_t number, std::uint64_t sequence) {
  const auto post = [this, &io = context_.io, weak = std::weak_ptr<void>(outbox_.keep()), number](auto what) {
    asio::post(io, [this, weak, number, what = std::move(what)]() mutable {
      const auto alive = weak.lock();
      if (alive && player_ && number_ == number) what();
    });
  };
  ReplayEvents events;
  events.restarted = [this, post](protocol::MeshFacts mesh, std::shared_ptr<const InitialState> initial) {
    post([this, mesh = std::move(mesh), initial = std::move(initial)] {
      if (!scratch_) scratch_ = std::make_unique<Scratch>(context_.io, context_.config.ring_bytes);
      scratch_->mesh = mesh;
      scratch_->feed.reset(initial);
      owner_.on_state_replaced();
    });
  };
  events.delta = [this, post](std::shared_ptr<const PublishedDelta> delta) {
    post([this, delta = std::move(delta)] {
      scratch_->feed.apply(delta);
      owner_.on_replay_advanced();
    });
  };
  events.state = [this, post](protocol::ReplayState state) {
    post([this, state = std::move(state)] { outbox_.send(make_frame(state)); });
  };
  events.failed = [this, post, sequence](std::string why) {
    post([this, why = std::move(why), sequence] {
      outbox_.complain(ErrorCode::NotAvailable, why.substr(0, protocol::kMaxTextBytes), sequence);
      end();
      outbox_.send(make_frame(protocol::ReplayState{}));
    });
  };
  return events;
}

void PeerReplay::end() {
  player_.reset();
  if (!scratch_) return;
  const std::unique_ptr<Scratch> last = std::move(scratch_);  // until the peer follows another feed
  owner_.on_state_replaced();
}

}  // namespace incise::stream
