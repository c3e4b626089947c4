// Client::Impl: sending, from any thread.

#include <boost/asio/post.hpp>

#include "client/client_impl.hpp"
#include "server/base/clock.hpp"

namespace incise::client {

std::uint64_t Client::Impl::send(const protocol::Body& body) {
  std::uint64_t number = 0;
  {
    const std::scoped_lock lock(mutex);
    if (current_status != Status::kConnected) return 0;
    number = append(body);
  }
  wake_writer();
  return number;
}

std::uint64_t Client::Impl::append(const protocol::Body& body) {
  auto frame = std::make_shared<const protocol::Frame>(protocol::encode(body, {++sequence, monotonic_ns()}));
  outbox_bytes += frame->tcp().size();
  outbox.push_back(std::move(frame));
  return sequence;
}

void Client::Impl::wake_writer() {
  asio::post(io, [this] { outbox_wake.cancel(); });
}

std::uint64_t Client::Impl::send_poses(std::span<const protocol::PoseSample> poses) {
  if (poses.empty()) return 0;
  std::uint64_t last = 0;
  {
    const std::scoped_lock lock(mutex);
    if (current_status != Status::kConnected || closing) return 0;
    if (outbox_bytes > 0 && outbox_bytes + poses.size_bytes() > options.max_outbox_bytes) return 0;
    while (!poses.empty()) {
      const std::size_t n = std::min(poses.size(), protocol::kMaxPosesPerBatch);
      last = append(protocol::PoseBatch{poses.first(n)});
      poses = poses.subspan(n);
    }
  }
  wake_writer();
  return last;
}

std::uint64_t Client::Impl::send_positions(const protocol::Positions& positions) {
  std::uint64_t sent = 0;
  {
    const std::scoped_lock lock(mutex);
    if (current_status != Status::kConnected || closing || outbox_bytes > 0) return 0;
    sent = append(positions);
  }
  wake_writer();
  return sent;
}

std::uint64_t Client::Impl::send_model(const protocol::BladeModel& model) {
  std::uint64_t sent = 0;
  {
    const std::scoped_lock lock(mutex);
    if (current_status != Status::kConnected || closing) return 0;
    sent = append(model);
  }
  wake_writer();
  return sent;
}

}  // namespace incise::client
