#include "server/stream/outbox.hpp"

#include <utility>

#include "server/base/clock.hpp"

namespace incise::stream {
namespace {

constexpr std::size_t kMaxControlBytes = 1u << 20;  // beyond this a peer does not read what it asked for
constexpr std::size_t kMaxWriteBytes = 1u
                                       << 20;  // in one write, so that the write timeout is about this much
constexpr std::size_t kMaxWriteFrames = 32;

}  // namespace

void Outbox::send(SharedFrame frame) {
  if (ending_ || closed_) return;
  control_bytes_ += frame->tcp().size();
  control_.push_back(std::move(frame));
  if (control_bytes_ > kMaxControlBytes) {
    give_up("answers and statistics were not read");
    return;
  }
  write();
}

void Outbox::complain(protocol::ErrorCode code, const std::string& text, std::uint64_t in_reply_to) {
  send(make_frame(protocol::Error{code, text, false, in_reply_to}));
}

void Outbox::send_state(SharedFrame frame) {
  if (ending_ || closed_) return;
  state_bytes_ += frame->tcp().size();
  state_.push_back(std::move(frame));
  write();
}

void Outbox::send_force(const protocol::Force& force) {
  if (ending_ || closed_) return;
  force_ = force;
  write();
}

void Outbox::send_last(SharedFrame frame) {
  force_.reset();
  send_state(std::move(frame));
  ending_ = true;
}

void Outbox::drop_control() {
  control_.clear();
  control_bytes_ = writing_control_;
}

void Outbox::drop_state() {
  state_.clear();
  state_bytes_ = writing_state_;
}

void Outbox::gather(std::deque<SharedFrame>& from, std::size_t& writing, std::size_t& total) {
  while (!from.empty() && writing_.size() < kMaxWriteFrames && total < kMaxWriteBytes) {
    const std::size_t bytes = from.front()->tcp().size();
    total += bytes;
    writing += bytes;
    writing_.push_back(std::move(from.front()));
    from.pop_front();
  }
}

void Outbox::write() {
  if (!writing_.empty() || closed_) return;
  std::size_t total = 0;
  if (force_) {
    writing_.push_back(make_frame(*std::exchange(force_, std::nullopt)));
    total += writing_.back()->tcp().size();
    control_bytes_ += total;
    writing_control_ += total;
  }
  gather(control_, writing_control_, total);
  gather(state_, writing_state_, total);
  if (writing_.empty()) return;
  write_began_ns_ = monotonic_ns();
  transport_.write(writing_, [this, keep = keep()](boost::system::error_code error) { on_written(error); });
}

void Outbox::on_written(boost::system::error_code error) {
  counters_.bytes_out += writing_control_ + writing_state_;
  control_bytes_ -= writing_control_;
  state_bytes_ -= writing_state_;
  writing_control_ = writing_state_ = 0;
  writing_.clear();
  write_began_ns_ = 0;
  if (error) {
    owner_.on_write_failed();
    return;
  }
  if (ending_ && control_.empty() && state_.empty()) {
    if (!closed_) owner_.on_last_written();
    return;
  }
  write();
  owner_.on_written();
}

}  // namespace incise::stream
