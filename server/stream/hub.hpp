#pragma once

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "server/stream/access.hpp"
#include "server/stream/box_turns.hpp"
#include "server/stream/feed.hpp"
#include "server/stream/server.hpp"

namespace incise::stream {

class Session;

// What StreamCounters are made of, to be read from any thread.
struct HubCounters {
  std::atomic<std::uint64_t> revision{0}, state_hash{0}, accepted{0}, refused{0}, deltas{0}, bytes_out{0},
      bytes_in{0}, messages_in{0}, bad_messages{0}, coalesced{0}, snapshots{0}, slow_snapshots{0},
      slow_disconnects{0}, resumed{0}, ring_bytes{0}, ring_deltas{0}, half_open_closed{0}, part_bytes{0},
      box_turns{0}, box_turns_ns{0}, box_coalesced{0}, boxes_refused{0}, wrong_tokens{0},
      tokens_not_looked_at{0}, resets{0}, takeovers{0}, handovers{0};
  std::atomic<std::uint32_t> sessions{0}, connections{0};
};

// What all sessions share: the feed of the live mesh, the list of sessions, who holds which blade.
//
// Thread: the stream thread, counters() apart. Owns: the live feed.
class Hub {
 public:
  Hub(asio::io_context& io, const StreamConfig& config, ServerFacts facts, PeerInput& input,
      Providers providers);
  ~Hub();

  // A new state for all; at the start and after a reset.
  void reset(std::shared_ptr<const InitialState> initial);
  // Sends what apply() has added; once for many deltas, so that a thread that is behind makes fewer, larger writes.
  void advance_all();
  void send_force(const protocol::Force& force);
  void apply(const std::shared_ptr<const PublishedDelta>& delta);

  asio::io_context& io() { return io_; }
  const StreamConfig& config() const { return config_; }
  const ServerFacts& facts() const { return facts_; }
  const Providers& providers() const { return providers_; }
  PeerInput& input() { return input_; }
  ReplayLibrary* library() const { return providers_.library; }
  Feed& live() { return live_; }
  BoxTurns& box_turns() { return box_turns_; }
  HubCounters& counters() { return *counters_; }
  // As of the last tick.
  const RecordingNow& recording() const { return recording_; }

  // Takes a connection in; where too many have not said Hello, the one of them that is there for the longest is closed.
  // Nothing, when the server stops. The socket stays the caller's.
  class Ticket;
  std::optional<Ticket> admit(asio::ip::tcp::socket& socket);
  Access& access() { return access_; }
  // Counts a refusal for want of a token, and logs it. `what`: what was asked for.
  void note_refusal(const Access::Answer& answer, const std::string& what, const std::string& peer);
  void audit(Audit kind, const std::string& line) const {
    if (providers_.audit) providers_.audit(kind, line);
  }
  void add(const std::shared_ptr<Session>& session) { sessions_.insert(session); }
  void remove(const std::shared_ptr<Session>& session) { sessions_.erase(session); }
  // Whether another session may be welcomed.
  bool has_room() const { return counters_->sessions.load(std::memory_order_relaxed) < config_.max_sessions; }
  // Who holds the source of that name, if it is a session of ours.
  std::shared_ptr<Session> holder(const std::string& source_name) const;

  // A session has said goodbye to a peer that does not read. Of too many of those the first is closed.
  void linger(const std::shared_ptr<Session>& session);

  // Deadlines, pings and reports; starts the clock that calls itself.
  void start_clock();
  // Says goodbye to all sessions. None is left when their connections have ended.
  void stop();
  // Ends what is left.
  void close_all();
  bool idle() const { return sessions_.empty(); }

 private:
  void tick();
  void follow_recording();
  void send_statistics();
  void send_blades();

  asio::io_context& io_;
  const StreamConfig& config_;
  ServerFacts facts_;
  PeerInput& input_;
  Providers providers_;
  Access access_;
  // Connections that have not said Hello, by the order in which they came, as descriptors of our own: whatever becomes of
  // the connection's, these are not used for another.
  struct HalfOpen {
    ~HalfOpen();
    void close(std::map<std::uint64_t, int>::iterator which);
    std::map<std::uint64_t, int> sockets;
  };
  // Shared with the tickets: connections that never end are destroyed with the io_context, after the hub.
  std::shared_ptr<HubCounters> counters_ = std::make_shared<HubCounters>();
  std::shared_ptr<HalfOpen> half_open_ = std::make_shared<HalfOpen>();
  std::set<std::shared_ptr<Session>> sessions_;
  std::deque<std::weak_ptr<Session>> lingering_;
  asio::steady_timer clock_, blade_clock_;
  std::map<std::uint32_t, std::int64_t> blade_sent_ns_;  // arrival of the last pose sent, by source
  std::uint64_t ticks_ = 0;
  RecordingNow recording_;
  bool stopping_ = false;
  Feed live_;
  BoxTurns box_turns_;
};

// One connection's place in the counts. Moves.
class Hub::Ticket {
 public:
  Ticket(std::shared_ptr<HubCounters> counters, std::shared_ptr<HalfOpen> half_open, std::uint64_t number,
         asio::ip::tcp::endpoint peer)
      : counters_(std::move(counters)),
        half_open_(std::move(half_open)),
        number_(number),
        peer_(std::move(peer)) {
    ++counters_->connections;
  }
  Ticket(Ticket&& other) noexcept
      : counters_(std::exchange(other.counters_, nullptr)),
        half_open_(std::exchange(other.half_open_, nullptr)),
        number_(other.number_),
        peer_(std::move(other.peer_)),
        welcomed_(std::exchange(other.welcomed_, false)) {}
  Ticket& operator=(Ticket&&) = delete;
  ~Ticket();
  // It has said Hello.
  void welcome();
  const asio::ip::tcp::endpoint& peer() const { return peer_; }
  // It was told goodbye: its place among the sessions is free.
  void leave() {
    if (std::exchange(welcomed_, false)) --counters_->sessions;
  }

 private:
  void leave_half_open();
  std::shared_ptr<HubCounters> counters_;
  std::shared_ptr<HalfOpen> half_open_;
  std::uint64_t number_;  // among all connections
  asio::ip::tcp::endpoint peer_;
  bool welcomed_ = false;
};

}  // namespace incise::stream
