#pragma once

// The client library: connects to an incised, holds a replica of its mesh in step, sends poses.
//
//   auto client = incise::client::Client::connect("127.0.0.1", 7450, {.role =
//   incise::protocol::Role::Operator}); client->send_poses(poses); client->wait_for_revision(10, 5.0);
//   client->read([](const incise::protocol::Replica& mesh) { draw(mesh.positions()); });

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>

#include "protocol/blade_name.hpp"
#include "protocol/fields.hpp"
#include "protocol/messages.hpp"
#include "protocol/replica.hpp"
#include "protocol/surface.hpp"
#include "protocol/volume_part.hpp"

namespace incise::client {

// The server could not be reached, or refused us. The message says which server and why; `code` is the reason of a server that
// gave one.
struct ConnectError : std::runtime_error {
  explicit ConnectError(const std::string& what, protocol::ErrorCode why = protocol::ErrorCode::Unknown)
      : std::runtime_error(what), code(why) {}
  protocol::ErrorCode code;
};

enum class TransportKind : std::uint8_t { kTcp, kWebSocket };

struct Options {
  TransportKind transport = TransportKind::kTcp;
  bool tls = false;
  std::string ca_file;  // PEM; empty: the system's
  protocol::Role role = protocol::Role::Viewer;
  protocol::View view = protocol::View::Volume;
  std::string token;
  std::string client_name = "incise_client";
  std::string source_name{protocol::kDefaultBladeName};  // operator: which blade
  bool take_over = false;                                // operator: take it from the operator who holds it
  std::optional<protocol::BladeEdge> blade;              // operator: bring this blade instead of the server's
  float load_rate_hz = 0;  // simulator: BladeLoad at most so often for each blade, 60 to 1000; 0: none
  std::optional<protocol::Box> box;  // of either view only what touches it; for Volume use read_part()
  // Names of the fields to hold ("*": all), with view Volume and no box: read_fields(). What there is, Welcome::fields lists.
  std::vector<std::string> fields = {};
  float max_rate_hz = 0;  // deltas a second at most, coalesced; 0: one for each revision
  double connect_timeout_s = 5;
  // Connects again when the connection is lost, as often as it takes, and resumes the state it holds.
  bool reconnect = false;
  // The hash of each delta is always checked; every so many revisions the whole replica is hashed as well. 0: never.
  std::uint32_t full_check_interval = 0;
  // The client has a thread that does the work; otherwise poll() does.
  bool background = true;
  std::size_t max_outbox_bytes = 8u << 20;  // poses that wait for the network
  // The largest size of the replica.
  std::uint32_t max_vertices = protocol::kDefaultReplicaVertices;
  std::uint32_t max_tets = protocol::kDefaultReplicaTets;
};

// When a message came, and its size.
struct Arrival {
  std::int64_t received_ns = 0;  // CLOCK_MONOTONIC here
  std::int64_t sent_ns = 0;      // the server's clock
  std::size_t bytes = 0;
};

// Called on the client's thread (background) or within poll(), one at a time, after the replica has changed. They may
// call the client's send and accessor functions, but not close(), poll() or the wait functions. Must not throw.
struct Callbacks {
  std::function<void(const protocol::Replica&, const protocol::Delta&, const Arrival&)> on_delta;
  std::function<void(const protocol::SurfaceReplica&, const protocol::SurfaceDelta&, const Arrival&)>
      on_surface_delta;
  // View Volume with a box.
  std::function<void(const protocol::VolumePart&, const protocol::Delta&, const Arrival&)> on_part_delta;
  // A client has set a field, which has this place in Welcome::fields.
  std::function<void(std::uint32_t field, const Arrival&)> on_field;
  std::function<void(const protocol::SnapshotEnd&, protocol::SnapshotCause)> on_snapshot;
  std::function<void(std::uint32_t done, std::uint32_t chunks)> on_snapshot_progress;
  std::function<void(const protocol::Force&)> on_force;  // for ContactRenderer::take
  std::function<void(const protocol::PoseReport&)> on_report;
  std::function<void(const protocol::PositionsReport&)> on_positions_report;
  std::function<void(const protocol::BladeLoad&)> on_blade_load;
  std::function<void(const protocol::Stats&)> on_stats;
  std::function<void(const protocol::Error&)> on_error;
  std::function<void(const std::string& reason)>
      on_resync;  // the replica refused a message; a snapshot was requested
  std::function<void(const std::string& reason)> on_disconnect;
  std::function<void(const protocol::Welcome&)> on_welcome;  // also after a reset and a reconnection
};

enum class Status : std::uint8_t { kConnected, kReconnecting, kClosed };

struct Counters {
  std::uint64_t bytes_in = 0, bytes_out = 0, messages_in = 0, deltas = 0, steps = 0, snapshots = 0,
                resyncs = 0, reconnects = 0;
};

// A connection to an incised, and the replica that it keeps in step.
//
// Thread: any; poll() from one at a time, and only without a background thread. The replica changes on the client's
// thread; read() locks it while its function runs. Owns: the connection, the replica, the background thread.
class Client {
 public:
  // Connects and waits for Welcome. Throws ConnectError: no such host, no answer in time, refused.
  static std::unique_ptr<Client> connect(const std::string& host, std::uint16_t port, Options options = {},
                                         Callbacks callbacks = {});
  // Says goodbye, closes.
  ~Client();
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  // Queues poses in order, in as many messages as needed. Returns the sequence of the last message, which
  // PoseReport::through_sequence will reach. 0 without a connection or room for them: nothing is queued, try again.
  std::uint64_t send_poses(std::span<const protocol::PoseSample> poses);
  // For a tool without a button: engages the blade for all poses sent from here on, until end_stroke(). False without
  // a connection.
  bool engage(std::int64_t source_ns);
  // Ends the running stroke after the poses sent so far. False without a connection.
  bool end_stroke(std::int64_t source_ns);
  // Simulators: where vertices are, computed for revision `positions.revision`. `ids` ascend, each once, and coordinates are finite and within
  // 1e6 m: this is not checked here, and the server ends the connection where it is not so. Returns the message's sequence. 0
  // without a connection or while older ones still wait for the network: nothing is queued, send the next ones.
  std::uint64_t send_positions(const protocol::Positions& positions);
  // Simulators: their own model of the tissue at a blade, in answer to a BladeLoad. One that cannot be used comes back as an Error
  // that is not fatal. Returns the message's sequence; 0 without a connection.
  std::uint64_t send_model(const protocol::BladeModel& model);
  // Simulators and administrators: sets rows of a field of Welcome::fields, for everybody; rows that a cut has made or changed
  // since values.revision stay as they are. A refusal comes as an error. Returns the message's sequence; 0 without a connection.
  std::uint64_t send_field(const protocol::FieldValues& values);
  // Changes view and rate.
  bool subscribe(protocol::View view, float max_rate_hz);
  // Administrators: restores the mesh as it was loaded, for everyone.
  bool reset();
  // Operators with a blade, and administrators: goes back to the state before the last stroke that cut something (an operator: its own), for everyone. A
  // refusal comes as an error, as late as ten seconds after: the server waits while this operator's blade cuts. Refused, too, where a
  // stroke begins before it is done (wait for Callbacks::on_welcome), where another blade is in a stroke, and to operators where other
  // blades have cut since their stroke began: with `others` that is undone as well.
  bool undo(bool others = false);

  Status status() const;
  // Why it is not connected; empty while connected.
  std::string last_error() const;
  // The reason of the server's last goodbye on this connection; Unknown: it has said none, as where the connection was lost.
  protocol::ByeReason goodbye() const;
  protocol::Welcome welcome() const;
  protocol::PoseReport report() const;  // the last
  Counters counters() const;
  // The replica's, in the current view.
  std::uint64_t revision() const;
  // The server's monotonic clock minus ours, from the ping with the shortest round trip, and that round trip.
  std::int64_t clock_offset_ns() const;
  std::int64_t round_trip_ns() const;

  // Runs function(const Replica&), or with the surface replica of view Surface, while nothing changes it.
  template <class F>
  auto read(F&& function) const {
    const std::scoped_lock lock(state_mutex());
    return function(volume());
  }
  template <class F>
  auto read_surface(F&& function) const {
    const std::scoped_lock lock(state_mutex());
    return function(surface());
  }
  // With the fields at the replica's revision (protocol/fields.hpp).
  template <class F>
  auto read_fields(F&& function) const {
    const std::scoped_lock lock(state_mutex());
    return function(fields());
  }
  // With the part of view Volume that touches Options::box.
  template <class F>
  auto read_part(F&& function) const {
    const std::scoped_lock lock(state_mutex());
    return function(part());
  }

  // Wait until the replica holds a state of this session (a reset or an undo begins another), at `revision` or later, or until the server
  // has dealt with all poses up to a message. False when the time is over or the client is closed.
  bool wait_for_revision(std::uint64_t revision, double timeout_s);
  bool wait_for_report(std::uint64_t sequence, double timeout_s);

  // Without a background thread: handles what has arrived, waiting for it at most `timeout_s`. Returns whether the
  // client is still open.
  bool poll(double timeout_s = 0);

  // Says goodbye and waits, for half a second at most, until everything queued has been sent.
  void close();
  // Drops the connection without a goodbye, as a lost network does. With Options::reconnect it comes back.
  void drop_connection();

 private:
  struct Impl;
  explicit Client(std::unique_ptr<Impl> impl);
  std::mutex& state_mutex() const;
  const protocol::Replica& volume() const;
  const protocol::SurfaceReplica& surface() const;
  const protocol::VolumePart& part() const;
  const protocol::FieldReplica& fields() const;
  std::unique_ptr<Impl> impl_;
};

}  // namespace incise::client
