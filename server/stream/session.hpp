#pragma once

#include <boost/asio/awaitable.hpp>
#include <boost/asio/steady_timer.hpp>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "server/stream/hub.hpp"
#include "server/stream/replay_library.hpp"
#include "server/stream/transport.hpp"

namespace incise::stream {

// One peer, from Hello to Bye. Reads with a coroutine; writes from a bounded outbox, whose policy
// StreamConfig gives.
//
// Thread: the stream thread. Owns: the transport, an operator's blade.
class Session : public std::enable_shared_from_this<Session> {
 public:
  Session(Hub& hub, std::unique_ptr<Transport> transport, Hub::Ticket ticket);
  ~Session();

  // Serves the peer until the connection has ended.
  asio::awaitable<void> run();

  // The mirror has moved on, or the outbox has room again: sends what the peer should have.
  void advance();
  // The live mesh's ids start anew: Welcome again, and a snapshot.
  void live_restarted();
  // Deadlines, pings, pose reports. About 20 times a second.
  void tick(std::int64_t now_ns);
  // Tells an operator that recording has stopped; nobody else.
  void warn_not_recorded();
  // A frame beside the state, e.g. statistics. Only to who has been welcomed.
  void send(SharedFrame frame);
  // To the operator who holds that blade: the latest, when the one before is out.
  // To the simulator that sets positions: the loop has made a step of one of its messages.
  void report_deformation(const PublishedDelta& step);
  void send_force(const protocol::Force& force);
  // Whether it asked for the blades' poses, and follows the mesh that they cut.
  bool wants_blades() const { return stage_ == Stage::kOpen && blade_rate_hz_ > 0 && !scratch_; }
  // Leaves them out while more is on its way to the peer already, or the last ones went out too short a time ago.
  void send_blades(const std::vector<SharedFrame>& frames, std::int64_t now_ns);
  // Whether there is a delta of its box to be made, after it has asked for its turn.
  bool wants_box_turn() const;
  // There is none: it asks again.
  void skip_box_turn() { box_turn_asked_ = false; }
  // Sends that delta. False where it can no longer be made.
  bool take_box_turn();
  // There is no time for its box: it gets everything.
  void lose_box();
  // What its last turn took.
  std::int64_t box_cost_ns() const { return box_cost_ns_; }
  void set_box_cost(std::int64_t ns) { box_cost_ns_ = ns; }
  // Says goodbye and ends the connection once that is written.
  void finish(protocol::ByeReason reason, const std::string& text);
  void close();

  // Counted over all connections.
  std::uint64_t number() const { return number_; }
  bool open() const { return stage_ == Stage::kOpen; }
  bool holds(const std::string& source_name) const { return source_ && source_name_ == source_name; }

 private:
  enum class Stage { kHandshake, kOpen, kClosing, kClosed };

  asio::awaitable<bool> receive();
  asio::awaitable<void> handle(protocol::Message message);
  asio::awaitable<void> on_hello(const protocol::Hello& hello, std::uint64_t sequence);
  asio::awaitable<bool> check_token(const protocol::Hello& hello, std::uint64_t sequence);
  asio::awaitable<bool> take_blade(const protocol::Hello& hello, std::uint64_t sequence);
  asio::awaitable<void> on_poses(const protocol::PoseBatch& batch, std::uint64_t sequence);
  asio::awaitable<void> on_stroke(const protocol::StrokeControl& control, std::uint64_t sequence);
  void on_positions(const protocol::Positions& positions, std::uint64_t sequence);
  void on_subscribe(const protocol::Subscribe& subscribe);
  void on_resync();
  void on_reset(std::uint64_t sequence);
  void on_replay(const protocol::ReplayControl& control, std::uint64_t sequence);
  ReplayEvents replay_events(std::uint64_t number, std::uint64_t sequence);
  void end_replay();
  // What this session follows.
  Feed& feed() const;
  void restart();
  bool within_rate();
  asio::awaitable<void> pause(std::chrono::milliseconds time);

  void refuse(protocol::ErrorCode code, const std::string& text, std::uint64_t sequence = 0);  // fatal
  void complain(protocol::ErrorCode code, const std::string& text, std::uint64_t sequence);
  void send_welcome(bool resumed);
  std::string described() const;  // in the log
  void report_poses();

  void request_snapshot(protocol::SnapshotCause cause);
  void on_snapshot(std::shared_ptr<const Snapshot> snapshot, std::uint64_t request);
  void feed_snapshot();
  // What the peer holds with a box, or null; counted over all sessions.
  void set_part(std::shared_ptr<BoxPart> part);
  void refuse_box(const std::string& why, protocol::SnapshotCause cause);
  void drop_state();  // what waits of the state, and has not begun to go out
  void push_control(SharedFrame frame);
  void push_state(SharedFrame frame);
  void write();
  void on_written(boost::system::error_code error);

  Hub& hub_;
  std::unique_ptr<Transport> transport_;
  Hub::Ticket ticket_;
  const std::uint64_t number_;
  Stage stage_ = Stage::kHandshake;
  std::string peer_, client_name_;

  protocol::Role role_ = protocol::Role::Viewer;
  protocol::View view_ = protocol::View::None;
  std::optional<protocol::Box> box_;
  float max_rate_hz_ = 0;
  float blade_rate_hz_ = 0;
  std::int64_t blades_due_ns_ = 0;

  // An operator's.
  std::unique_ptr<PoseInput> source_;
  std::string source_name_;
  bool engaged_ = false;       // by message, whatever the poses' buttons say
  std::uint64_t offered_ = 0;  // poses pushed since Welcome
  struct Offered {
    std::uint64_t sequence, offered;
  };
  std::deque<Offered> unsettled_;  // messages whose poses the loop has not all counted yet
  std::uint64_t through_sequence_ = 0;
  protocol::PoseReport last_report_;

  // A simulator's, from its first Positions on.
  std::unique_ptr<PositionsInput> positions_;
  std::uint64_t positions_taken_ = 0;

  // A capture that is replayed for this session alone, and the state that it has come to.
  struct Scratch {
    Scratch(asio::io_context& io, std::size_t ring_bytes) : feed(io, ring_bytes) {}
    protocol::MeshFacts mesh;
    Feed feed;
  };
  std::unique_ptr<ReplayPlayer> player_;
  std::unique_ptr<Scratch> scratch_;  // null: it follows the live mesh
  std::uint64_t replay_number_ = 0;   // of the last capture that was opened

  // The outbox.
  std::deque<SharedFrame> control_, state_;
  std::size_t control_bytes_ = 0, state_bytes_ = 0;  // waiting and being written
  std::optional<protocol::Force> force_;
  std::vector<SharedFrame> writing_;
  std::size_t writing_control_ = 0, writing_state_ = 0;  // bytes of them
  std::int64_t write_began_ns_ = 0;                      // 0: no write is under way

  // Where the peer's state is, with all that the outbox holds.
  std::uint64_t revision_ = 0;
  bool behind_ = false;                       // the outbox was full: it must half empty first
  std::shared_ptr<const Snapshot> snapshot_;  // on its way
  std::size_t next_chunk_ = 0;
  std::shared_ptr<BoxPart> part_;  // with a box: what the peer holds at revision_
  std::size_t part_bytes_ = 0;     // of it, as counted
  bool box_turn_asked_ = false;
  std::int64_t box_cost_ns_ = 0;
  std::uint64_t snapshot_request_ = 0;  // the last one's number
  bool snapshot_wanted_ = false;        // requested, not here yet
  bool resync_again_ = false;
  protocol::SnapshotCause snapshot_cause_ = protocol::SnapshotCause::Join;
  std::uint32_t slow_snapshots_ = 0;
  std::int64_t next_due_ns_ = 0;  // of a rate-limited peer
  asio::steady_timer rate_timer_;
  bool rate_timer_armed_ = false;

  std::int64_t opened_ns_, last_received_ns_, last_ping_ns_ = 0, closing_since_ns_ = 0, last_report_ns_ = 0;
  std::int64_t rate_window_ns_ = 0;
  std::uint32_t rate_count_ = 0, rate_pose_messages_ = 0;
};

}  // namespace incise::stream
