#pragma once

#include <boost/asio/awaitable.hpp>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "server/stream/admission.hpp"
#include "server/stream/feed_follower.hpp"
#include "server/stream/message_rate.hpp"
#include "server/stream/operator_blade.hpp"
#include "server/stream/outbox.hpp"
#include "server/stream/peer_context.hpp"
#include "server/stream/peer_replay.hpp"
#include "server/stream/refusal.hpp"
#include "server/stream/simulator_positions.hpp"
#include "server/stream/transport.hpp"

namespace incise::stream {

class Peer;

// The connected peers, as one of them needs them. Peers implements it.
class PeerDirectory {
 public:
  virtual void add(const std::shared_ptr<Peer>& peer) = 0;
  virtual void remove(const std::shared_ptr<Peer>& peer) = 0;
  // The peer that holds that blade; null where none does.
  virtual std::shared_ptr<Peer> holder(const std::string& source_name) const = 0;
  // Sends every peer what it should have by now.
  virtual void advance_all() = 0;
  // The server has said goodbye to that peer, which does not read.
  virtual void linger(const std::shared_ptr<Peer>& peer) = 0;

 protected:
  ~PeerDirectory() = default;
};

// One connected client, from Hello to Bye: reads its messages, passes each to the part that it is for, and keeps its
// deadlines. The parts know nothing of each other, except that all but MessageRate write to the outbox.
//
// Thread: the stream thread, all of it. Owns: the transport, the parts.
class Peer final : public std::enable_shared_from_this<Peer>,
                   private Outbox::Owner,
                   private PeerReplay::Owner {
 public:
  Peer(PeerContext& context, PeerDirectory& others, std::unique_ptr<Transport> transport, Ticket ticket);
  ~Peer();

  // Serves the peer until the connection has ended.
  asio::awaitable<void> run();

  // The live mesh has moved on.
  void advance() { follower_.advance(); }
  // The live mesh's ids start again: Welcome, and a snapshot. `same_ids`: a snapshot is enough.
  void on_live_reset(bool same_ids);
  // Deadlines, pings, pose reports. About 20 times a second.
  void tick(std::int64_t now_ns);
  // A control message. Only once it is welcomed.
  void send(SharedFrame frame);
  // Tells an operator that recording has stopped; nobody else.
  void warn_not_recorded();
  // To the operator who holds that blade.
  void send_force(const protocol::Force& force);
  // To the simulator that sets positions: the loop has made a step of one of its messages.
  void report_deformation(const PublishedDelta& step);
  // Whether it asked for the blades' poses and follows the mesh that they cut.
  bool wants_blades() const { return open() && blade_rate_hz_ > 0 && !replay_.feed(); }
  // Skips them while other messages wait, or where the last ones went out too recently.
  void send_blades(const std::vector<SharedFrame>& frames, std::int64_t now_ns);
  // Whether it is a simulator that asked for what blades do to the body.
  bool wants_loads() const { return open() && load_rate_hz_ > 0; }
  // Of each blade the newest, if it was not sent yet and the peer's time has come; none while much is unread.
  void send_loads(std::span<const protocol::BladeLoad> loads, std::int64_t now_ns);
  // Says goodbye and ends the connection once that is written.
  void finish(protocol::ByeReason reason, const std::string& text);
  void close();

  // Among all connections.
  std::uint64_t number() const { return ticket_.number(); }
  bool open() const { return stage_ == Stage::kOpen; }
  bool holds(const std::string& source_name) const {
    return blade_.held() && blade_.source_name() == source_name;
  }

 private:
  enum class Stage { kHandshake, kOpen, kClosing, kClosed };
  bool ending() const { return stage_ == Stage::kClosing || stage_ == Stage::kClosed; }

  // peer.cpp: messages
  asio::awaitable<bool> receive();
  asio::awaitable<void> dispatch(protocol::Message message);
  asio::awaitable<void> on_poses(const protocol::PoseBatch& batch, std::uint64_t sequence);
  asio::awaitable<void> on_stroke(const protocol::StrokeControl& control, std::uint64_t sequence);
  void on_positions(const protocol::Positions& positions, std::uint64_t sequence);
  void on_field_values(const protocol::FieldValues& values, std::uint64_t sequence);
  void on_model(const protocol::BladeModel& model, std::uint64_t sequence);
  PeerInput::Later refuse_later(std::uint64_t sequence);
  static void complain_to(const std::weak_ptr<Peer>& peer, const Refusal& refusal, std::uint64_t sequence);
  PeerInput::Answer answer_undo(std::uint64_t sequence);
  void on_reset(std::uint64_t sequence);
  void on_undo(const protocol::Undo& undo, std::uint64_t sequence);
  void on_replay(const protocol::ReplayControl& control, std::uint64_t sequence);

  // peer_handshake.cpp: Hello to Welcome
  asio::awaitable<void> on_hello(const protocol::Hello& hello, std::uint64_t sequence);
  asio::awaitable<void> catch_up(const protocol::Hello& hello);
  asio::awaitable<std::optional<Refusal>> check_token(const protocol::Hello& hello);
  asio::awaitable<std::optional<Refusal>> take_blade(const protocol::Hello& hello);
  asio::awaitable<std::unique_ptr<PoseInput>> take_over(const protocol::Hello& hello);
  std::string why_taken(const std::string& source_name) const;
  asio::awaitable<std::optional<Refusal>> wait_until_open(std::unique_ptr<PoseInput>& input);
  void send_welcome(bool resumed);
  void complain_of_fields(std::uint64_t sequence);

  // Outbox::Owner
  void on_too_slow(const std::string& what) override;
  void on_written() override { follower_.advance(); }
  void on_last_written() override;
  void on_write_failed() override { close(); }
  std::shared_ptr<void> keep() override { return shared_from_this(); }
  // PeerReplay::Owner
  void on_state_replaced() override;
  void on_replay_advanced() override { follower_.advance(); }

  void tick_handshake(std::int64_t now_ns);
  void tick_open(std::int64_t now_ns);
  void end_with_blade(const BladeEnd& end);
  // What one of its messages may be long.
  std::size_t accepted_bytes() const;
  // Ends the connection with an Error.
  void refuse(const Refusal& refusal, std::uint64_t sequence = 0);
  // Whether the peer's version of the protocol has that view as we send it.
  bool speaks(protocol::View view) const;
  // Frees the blade, where one is held, and logs why.
  void release_blade(const std::string& why);
  void release_parts(const std::string& why);
  std::string described() const;  // in the log
  std::string with_blade() const;

  PeerContext& context_;
  PeerDirectory& others_;
  std::unique_ptr<Transport> transport_;
  Ticket ticket_;
  Stage stage_ = Stage::kHandshake;
  bool waits_for_origin_ = false;  // for another server's blade, in the handshake
  const std::string address_;
  std::string client_name_;
  protocol::Role role_ = protocol::Role::Viewer;
  std::uint32_t protocol_version_ = 0;

  MessageRate rate_;
  Outbox outbox_;
  PeerReplay replay_;
  FeedFollower follower_;
  OperatorBlade blade_;
  SimulatorPositions positions_;

  float blade_rate_hz_ = 0;  // of BladePose messages
  std::int64_t blades_due_ns_ = 0;
  float load_rate_hz_ = 0;  // of BladeLoad messages
  std::int64_t loads_due_ns_ = 0;
  MessageRate model_rate_{8 * 1000};  // every blade's at the highest rate
  struct SentLoad {
    std::uint32_t source;
    std::uint64_t number, skipped;
  };
  std::vector<SentLoad> sent_loads_;
  std::int64_t opened_ns_, last_received_ns_, last_ping_ns_ = 0, last_report_ns_ = 0, closing_since_ns_ = 0;
};

}  // namespace incise::stream
