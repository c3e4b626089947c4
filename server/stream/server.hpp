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
#include "server/stream/peer_input.hpp"
#include "server/stream/published_delta.hpp"
#include "server/stream/replay_library.hpp"
#include "server/stream/stream_config.hpp"

namespace incise::stream {

// What Welcome says and the stream does not know itself.
struct ServerFacts {
  protocol::MeshFacts mesh;
  protocol::Vec3 blade_heel, blade_tip;  // for peers that hold no blade
  std::int32_t engage_button = -1;       // -1: always engaged
  double max_speed_m_s = 0;
  double frame_rate_hz = 0;
  std::string policy;
};

// Kinds of audit lines. A log limits each apart, so that many of one kind do not hide another.
enum class Audit { kRefused, kBlade, kReset };
inline constexpr std::size_t kAudits = 3;

// Whether poses are recorded; `trouble` says why not.
struct RecordingNow {
  protocol::Recording state = protocol::Recording::Off;
  std::string trouble;
};

// What the HTTP port and the statistics message show. Called on the stream thread; must not block. Without a function
// its path answers 404 and its message is not sent.
struct Providers {
  std::function<std::string()> stats_json;    // GET /stats
  std::function<std::string()> metrics_text;  // GET /metrics; what the stream itself counts is appended
  std::function<protocol::Stats()>
      statistics;  // once a second to every peer; sessions, revision, live_tets and recording are filled in here
  // Where the blades are now, for peers that asked; blades that never moved are left out.
  std::function<std::vector<protocol::BladePose>()> blades;
  ReplayLibrary* library =
      nullptr;  // for replays and GET /captures; must outlive the server. Null: no captures
  std::function<std::string()> trouble;  // GET /healthz: why the server does not work; "": it does
  // One line for the log: who was refused, reset the mesh, or took or handed over a blade. `address` is what to limit
  // lines by, since peers can cause any number of them.
  std::function<void(Audit, const std::string& address, const std::string& line)> audit;
  // Asked at every tick. Absent: nothing is recorded.
  std::function<RecordingNow()> recording;
};

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
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  // The first client finds everything published before.
  void start();
  // Sends out what was published and says goodbye to all peers, for at most `stop_grace_s`, then ends the threads.
  void stop();

  // Hands a delta on. Never blocks and never fails: two stores and, where the stream thread sleeps, one write to an
  // eventfd. Memory for the queue grows only while the stream thread falls behind.
  void publish(std::shared_ptr<const PublishedDelta> delta) noexcept;
  // The force on a blade, for the operator who holds it. Only the newest is sent where the network is slower.
  void publish_force(const protocol::Force& force) noexcept;
  // The ids start again: every peer gets a Welcome with the new epoch, and a snapshot.
  void publish_reset(std::shared_ptr<const InitialState> initial) noexcept;

  // Requests the whole surface as the frames of a snapshot (begin, chunks, end), for output in another format. It is
  // encoded on the snapshot thread, as for a peer that joins; `ready` is called on the stream thread, later, or never
  // if the server stops. From any thread.
  using SharedFrames = std::vector<std::shared_ptr<const protocol::Frame>>;
  void request_surface(std::function<void(SharedFrames)> ready);

  // The ports in use, also where the configuration says 0; 0: that listener is off.
  std::uint16_t tcp_port() const;
  std::uint16_t http_port() const;
  StreamCounters counters() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace incise::stream
