#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "protocol/framing.hpp"
#include "protocol/messages.hpp"
#include "server/stream/counters.hpp"
#include "server/stream/feed_listener.hpp"
#include "server/stream/peer_input.hpp"
#include "server/stream/providers.hpp"
#include "server/stream/published_delta.hpp"
#include "server/stream/stream_config.hpp"

namespace incise::stream {

struct Ports;
struct ReceivedDelta;

// The network side of incised: a mirror of the mesh, the peers (TCP, WebSocket) and HTTP.
//
// Thread: publish*() from the loop's thread; everything else from the thread that made it, counters() from any. Owns:
// the stream thread, which runs all peers and the mirror, and the snapshot thread, which encodes whole states.
class Server {
 public:
  // Listens at once; serves from start() on. Throws std::runtime_error where it cannot listen at the address or the
  // configuration is not safe. `input` must outlive the server.
  Server(StreamConfig config, ServerFacts facts, const InitialState& initial, PeerInput& input,
         Providers providers = {});
  // The same with ports that were taken before.
  Server(std::unique_ptr<Ports> ports, ServerFacts facts, const InitialState& initial, PeerInput& input,
         Providers providers = {});
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  // The first client finds everything published before.
  void start();
  // Sends out what was published and says goodbye to all peers, for at most `stop_grace_s`, then ends the threads.
  void stop();

  // Hands a delta on; all publish...() from one thread. Never blocks and never fails: two stores and, where the stream thread sleeps, one
  // write to an eventfd. Memory for the queue grows only while the stream thread falls behind.
  void publish(std::shared_ptr<const PublishedDelta> delta) noexcept;
  // The force on a blade, for the operator who holds it. Only the newest is sent where the network is slower.
  void publish_force(const protocol::Force& force) noexcept;
  // The same for a delta that another server made.
  void publish(std::shared_ptr<const ReceivedDelta> delta) noexcept;
  // All values of a field, at the revision that was published last.
  void publish_field(NewFieldValues values) noexcept;
  // The ids start again: every peer gets a Welcome with the new epoch, and a snapshot. A later state of the same epoch, to which no
  // deltas lead, is a snapshot alone.
  void publish_reset(std::shared_ptr<const InitialState> initial) noexcept;

  // Requests the whole surface as the frames of a snapshot (begin, chunks, end), for output in another format. It is
  // encoded on the snapshot thread, as for a peer that joins; `ready` is called on the stream thread, later, or never
  // if the server stops. From any thread.
  using SharedFrames = std::vector<std::shared_ptr<const protocol::Frame>>;
  void request_surface(std::function<void(SharedFrames)> ready);

  // The same for a reader of the whole session: everything that a viewer of that view is sent first, of one epoch and with all
  // fields.
  void request_state(protocol::View view, std::function<void(WholeState)> ready);

  // The ports in use, also where the configuration says 0; 0: that listener is off.
  std::uint16_t tcp_port() const;
  std::uint16_t http_port() const;
  StreamCounters counters() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace incise::stream
