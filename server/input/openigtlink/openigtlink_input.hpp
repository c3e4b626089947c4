#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "protocol/framing.hpp"
#include "server/input/network_status.hpp"
#include "server/input/placement.hpp"
#include "server/input/pose_sources.hpp"

namespace incise::input {

struct OpenIgtLinkOptions {
  std::string address = "127.0.0.1";  // to listen on
  std::int64_t port = -1;             // 0: any free one, -1: do not listen
  std::vector<std::string> connect;   // "host:port" of servers to connect to, and to reconnect to
  std::string ask_for = "nothing";    // "TDATA", "QTDATA": what to ask those servers to stream
  std::vector<std::string> devices;   // names that are used; empty: all
  std::string engage = "always";      // while poses come; "string": as a STRING says
  double silence_s = 0.5;             // without a pose, after which a device releases its blade
  Placement world{{}, {}, 0.001};     // of the peers' space, in their units
  std::string surface = "asked";      // "always": to all that connect; "never"
  double surface_hz = 2;              // at most
  std::uint32_t engage_buttons = 1;   // that a pose holds while its device is engaged

  // Time limit once a message has begun: for the rest of its header, for its body, for each 64 KiB of one that is skipped.
  // Between messages a peer may be silent for any time.
  double message_time_s = 10;

  bool wanted() const { return port >= 0 || !connect.empty(); }
};

// Where surfaces come from. Thread: any may call.
struct SurfaceFeed {
  using Frames = std::vector<std::shared_ptr<const protocol::Frame>>;
  // Changes with the surface.
  std::function<std::uint64_t()> state;
  // Later calls `ready` with a snapshot of view Surface, on another thread; at the end perhaps never.
  std::function<void(std::function<void(Frames)> ready)> request;
};

// OpenIGTLink peers, such as 3D Slicer or PLUS, as pose sources and viewers: those that connect, and servers that this
// connects to. Each device name with poses is a source of that name. It has a blade from its first pose until it falls
// silent, reports a bad STATUS, or its connection ends. A peer may ask for the surface (GET_, STT_, STP_POLYDATA).
//
// A wrong message is counted and ignored; if the stream of messages is out of step, its connection ends.
//
// Thread: made and destroyed by one; status() by any. Owns: a thread with all sockets, and one that packs surfaces.
class OpenIgtLinkInput {
 public:
  // Takes its port. Throws std::runtime_error if the address is not available. `sources` must outlive this.
  OpenIgtLinkInput(PoseSources& sources, OpenIgtLinkOptions options, SurfaceFeed surfaces);
  ~OpenIgtLinkInput();
  // Listens and connects, once.
  void start();
  // Releases all blades and closes all connections, for good.
  void stop();

  std::uint16_t port() const;  // 0: does not listen
  NetworkStatus status() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace incise::input
