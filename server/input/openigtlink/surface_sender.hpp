#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/thread_pool.hpp>
#include <cstdint>
#include <memory>
#include <mutex>
#include <set>

#include "server/input/openigtlink/openigtlink_input.hpp"
#include "server/input/openigtlink/peer.hpp"

namespace incise::input::openigtlink {

// Makes a POLYDATA of the surface when a peer wants it, and sends it to all that do.
//
// Thread: the one that runs the context's `io`; stop() from the one that made this. Owns: a thread that packs.
class SurfaceSender {
 public:
  using Peers = std::set<std::shared_ptr<Peer>>;
  // All must outlive this.
  SurfaceSender(PeerContext& context, SurfaceFeed feed, const Peers& peers);
  ~SurfaceSender();

  // Sends the surface to peers that want it, or requests it for them.
  void offer(std::int64_t now_ns);
  // Waits for the packing thread; what the feed delivers later is dropped.
  void stop();

 private:
  // Outlives this for the feed, which may call back at any time.
  struct Mailbox {
    std::mutex mutex;
    SurfaceSender* sender = nullptr;  // guarded by mutex; null: stopped
  };
  void request(std::uint64_t state);
  void pack(const SurfaceFeed::Frames& frames, std::uint64_t state);

  PeerContext& context_;
  const SurfaceFeed feed_;
  const Peers& peers_;
  // The last surface that was packed: of the state at its request, or a later one.
  SharedBytes surface_;
  std::uint64_t state_ = 0;
  bool requested_ = false;
  std::int64_t requested_ns_ = 0;
  const std::shared_ptr<Mailbox> mailbox_ = std::make_shared<Mailbox>();
  boost::asio::thread_pool packer_{1};
};

}  // namespace incise::input::openigtlink
