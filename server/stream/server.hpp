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

// What Welcome says beside what the stream knows itself.
struct ServerFacts {
  protocol::MeshFacts mesh;
  protocol::Vec3 blade_heel, blade_tip;  // of who holds no blade of its own
  std::int32_t engage_button = -1;       // -1: always engaged
  double max_speed_m_s = 0;
  double frame_rate_hz = 0;
  std::string policy;
};

// Whose lines a log keeps apart, so that many of one kind do not crowd out another.
enum class Audit { kRefused, kBlade, kReset };
inline constexpr std::size_t kAudits = 3;

// Whether what is taken is recorded, and where not: why.
struct RecordingNow {
  protocol::Recording state = protocol::Recording::Off;
  std::string trouble;
};

// What the HTTP port and the statistics message show. Called on the stream thread; must not block. An absent
// one makes the address answer 404, and the message is not sent.
struct Providers {
  std::function<std::string()> stats_json;    // GET /stats
  std::function<std::string()> metrics_text;  // GET /metrics; what the stream itself counts is appended
  std::function<protocol::Stats()>
      statistics;  // once a second to every session; sessions, revision and recording are filled in
  // Where the blades are now, for who asked for that; those that were never moved are left out.
  std::function<std::vector<protocol::BladePose>()> blades;
  ReplayLibrary* library =
      nullptr;  // captures to replay and GET /captures; must outlive the server. Null: none
  std::function<std::string()>
      trouble;  // GET /healthz: what keeps the server from its work; "": nothing does
  // One line, for the log, on who was refused, reset the mesh, or took or let go of a blade that somebody held. As often as
  // peers cause it.
  std::function<void(Audit, const std::string&)> audit;
  // Asked at every tick. Absent: nothing is recorded.
  std::function<RecordingNow()> recording;
};

// The network side of incised: a mirror of the mesh, the sessions (TCP, WebSocket) and HTTP.
//
// Thread: publish*() from the loop's thread; everything else from the thread that made it, counters() from
// any. Owns: the stream thread, which runs all sessions and the mirror, and the snapshot thread, which
// encodes whole states.
class Server {
 public:
  // Listens at once; bytes flow from start(). Throws std::runtime_error where an address cannot be had or the
  // configuration is not safe. `input` must outlive the server.
  Server(StreamConfig config, ServerFacts facts, const InitialState& initial, PeerInput& input,
         Providers providers = {});
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  // What was published before is there for the first client.
  void start();
  // Says goodbye to all sessions once what was published has gone out, at most `stop_grace_s`, then ends the
  // threads.
  void stop();

  // Hands a delta on. Never blocks and never fails: a short critical path of two stores and, when the stream
  // thread sleeps, one write to an eventfd. Memory for the queue grows only while the stream thread falls
  // behind.
  void publish(std::shared_ptr<const PublishedDelta> delta) noexcept;
  // The ids start again: every session gets a Welcome with the new session id and a snapshot.
  // The force on a blade, for the operator who holds it. Only the latest is sent where the network is slower.
  void publish_force(const protocol::Force& force) noexcept;
  void publish_reset(std::shared_ptr<const InitialState> initial) noexcept;

  // The whole surface as the frames of a snapshot (begin, chunks, end), for who carries it on in another format: encoded on
  // the snapshot thread, as for those who join, and handed to `ready` on the stream thread, later, or never where the server
  // stops. From any thread.
  using SharedFrames = std::vector<std::shared_ptr<const protocol::Frame>>;
  void request_surface(std::function<void(SharedFrames)> ready);

  // The ports in use, where the configuration asked for 0; 0: that listener is off.
  std::uint16_t tcp_port() const;
  std::uint16_t http_port() const;
  StreamCounters counters() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace incise::stream
