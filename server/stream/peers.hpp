#pragma once

#include <boost/asio/steady_timer.hpp>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <set>
#include <string>

#include "server/stream/peer.hpp"
#include "server/stream/peer_context.hpp"

namespace incise::stream {

// All connected peers: passes on to them what the loop publishes, and runs the clock for deadlines, statistics and
// blade poses.
//
// Thread: the stream thread. Owns: the peers, together with the coroutines that serve them.
class Peers final : public PeerDirectory {
 public:
  explicit Peers(PeerContext& context);

  // A new state for all; at the start and after a reset. A later one of the same epoch is only another snapshot.
  void reset(std::shared_ptr<const InitialState> initial);
  // Applies a delta to the live feed; advance_all() then sends it. Applying many first gives a thread that is behind
  // fewer, larger writes.
  void apply(const std::shared_ptr<const PublishedDelta>& delta);
  void apply(const std::shared_ptr<const ReceivedDelta>& delta);
  void advance_all() override;
  void send_force(const protocol::Force& force);

  // Starts the clock, which then runs until close_all().
  void start_clock();
  // Says goodbye to all. None is left when their connections have ended.
  void finish_all();
  // Ends what is left.
  void close_all();
  bool empty() const { return peers_.empty(); }

  // PeerDirectory
  void add(const std::shared_ptr<Peer>& peer) override { peers_.insert(peer); }
  void remove(const std::shared_ptr<Peer>& peer) override { peers_.erase(peer); }
  std::shared_ptr<Peer> holder(const std::string& source_name) const override;
  // Where too many linger, the first is closed.
  void linger(const std::shared_ptr<Peer>& peer) override;

 private:
  void note_applied();
  void tick();
  void poll_recording();
  void send_statistics();
  void tick_blades();
  void send_blades();
  void tick_loads();

  PeerContext& context_;
  std::set<std::shared_ptr<Peer>> peers_;
  std::deque<std::weak_ptr<Peer>> lingering_;
  asio::steady_timer clock_, blade_clock_, load_clock_;
  std::map<std::uint32_t, protocol::BladePose> blades_sent_;  // the last of each source
  std::uint64_t ticks_ = 0;
};

}  // namespace incise::stream
