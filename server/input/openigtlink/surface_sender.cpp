#include "server/input/openigtlink/surface_sender.hpp"

#include <spdlog/spdlog.h>

#include <boost/asio/post.hpp>
#include <string>
#include <utility>

#include "server/base/clock.hpp"
#include "server/input/openigtlink/surface_message.hpp"

namespace incise::input::openigtlink {

namespace asio = boost::asio;

SurfaceSender::SurfaceSender(PeerContext& context, SurfaceFeed feed, const Peers& peers)
    : context_(context), feed_(std::move(feed)), peers_(peers) {
  mailbox_->sender = this;
}

SurfaceSender::~SurfaceSender() {
  stop();
}

void SurfaceSender::stop() {
  {
    const std::scoped_lock lock(mailbox_->mutex);
    mailbox_->sender = nullptr;
  }
  packer_.join();
}

void SurfaceSender::offer(std::int64_t now_ns) {
  const std::uint64_t state = feed_.state();
  const bool current = surface_ && state_ == state;
  bool wanted = false;
  for (const auto& peer : peers_) {
    if (!peer->wants_surface(state, now_ns)) continue;
    if (current) {
      peer->send_surface(surface_, state_, now_ns);
    } else {
      wanted = true;
    }
  }
  // If the mesh changes all the time the packed surface is a little old; it is sent all the same.
  if (!wanted || requested_ || now_ns - requested_ns_ < context_.surface_interval_ns()) return;
  requested_ns_ = now_ns;
  request(state);
}

void SurfaceSender::request(std::uint64_t state) {
  requested_ = true;
  feed_.request([mailbox = mailbox_, state](SurfaceFeed::Frames frames) {
    const std::scoped_lock lock(mailbox->mutex);
    if (!mailbox->sender) return;
    asio::post(mailbox->sender->packer_, [sender = mailbox->sender, frames = std::move(frames), state] {
      sender->pack(frames, state);
    });
  });
}

// Thread: the packer's.
void SurfaceSender::pack(const SurfaceFeed::Frames& frames, std::uint64_t state) {
  std::string error;
  SharedBytes bytes;
  if (const auto whole = surface_of(frames, error)) {
    bytes = std::make_shared<const std::vector<std::uint8_t>>(
        pack_surface(*whole, context_.options.world, kDeviceName));
  }
  asio::post(context_.io, [this, bytes, state, error] {
    requested_ = false;
    if (!bytes) {
      context_.log_fault(spdlog::level::err, "", "no surface: " + error);
      return;
    }
    surface_ = bytes;
    state_ = state;
    const std::int64_t now_ns = monotonic_ns();
    for (const auto& peer : peers_) {
      if (peer->wants_surface(state, now_ns)) peer->send_surface(surface_, state_, now_ns);
    }
  });
}

}  // namespace incise::input::openigtlink
