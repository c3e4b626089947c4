#pragma once

#include <atomic>
#include <boost/asio/awaitable.hpp>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "client/held_state.hpp"
#include "server/relay/operator_link.hpp"
#include "server/relay/origin_documents.hpp"
#include "server/relay/upstream.hpp"
#include "server/stream/server.hpp"

namespace incise::relay {

// What a relay's session has done, for reports.
struct Figures {
  std::string upstream;  // its name
  std::string body;      // the mesh's, once it has come
  bool connected = false;
  int hops = 1;                // to the server; kMaxHops + 1: more than that
  std::string trouble;         // why viewers may be behind; "": they are not
  std::uint64_t welcomes = 0;  // connections that were welcomed
  std::uint64_t resumed = 0;   // of these, without a snapshot
  std::uint64_t epochs = 0;    // resets and undos that passed through
  std::uint64_t snapshots = 0, deltas = 0,
                combined = 0;  // that came; of the deltas those of several revisions
  std::uint64_t refused = 0;   // messages that did not fit, or led to another hash than announced
  double round_trip_ms = 0;
  struct Operator {
    std::string source_name;
    std::uint32_t source = 0;
    double round_trip_ms = 0;
  };
  std::vector<Operator> operators;
  protocol::Stats origin;  // the newest
};

// One session of a relay: follows an upstream, checks what comes against its own replica, and serves the same to viewers. What is wrong
// never reaches them; while nothing comes they keep what they have.
//
// Thread: start() and stop() from the one that made it, figures() from any. Its own thread runs the upstream and publishes; the
// PeerInput is the stream thread's. Owns: both threads, the replica, the server.
class Session final : private Upstream::Sink, private stream::PeerInput {
 public:
  using MakeUpstream = std::function<std::unique_ptr<Upstream>(asio::io_context&)>;
  struct Reports {
    std::function<std::string()> stats_json, metrics_text;
    std::function<std::string()> sessions_json;  // of the directory; empty: there is none
    std::function<void(stream::Audit, const std::string& address, const std::string& line)> audit;
    // It listens, at first and where the origin has another body; or why it cannot.
    std::function<void(std::uint16_t tcp_port, std::uint16_t http_port)> on_listening;
    std::function<void(const std::string& why)> on_failed;
  };

  Session(std::string name, stream::StreamConfig config, const MakeUpstream& make_upstream);
  ~Session() override;

  // Listens once the upstream has sent a whole state.
  void start(Reports reports);
  // Says goodbye to all, then ends.
  void stop();

  const std::string& name() const { return name_; }
  Figures figures() const;
  stream::StreamCounters counters() const;

 private:
  // Upstream::Sink
  void on_message(const protocol::Message& message, std::int64_t ahead_ns) override;
  void on_lost(const std::string& why) override;
  Held held() const override;

  // stream::PeerInput
  std::unique_ptr<stream::PoseInput> open(std::string_view source_name,
                                          const std::optional<protocol::BladeEdge>& blade) override;
  std::unique_ptr<stream::PoseInput> take_over(std::string_view source_name,
                                               const std::optional<protocol::BladeEdge>& blade) override;
  std::string no_simulators() const override;
  bool reset(const Later& later) override;
  std::string undo(const stream::UndoRequest& request, const Answer& answer) override;
  std::unique_ptr<stream::PoseInput> open_link(OperatorLink::Wanted wanted);
  Later while_served(const Later& later) const;

  void on(const protocol::Welcome& welcome);
  void on(const protocol::SnapshotBegin& begin);
  void on(const protocol::SnapshotChunk& chunk);
  void on(const protocol::SnapshotEnd& end);
  void on(const protocol::FieldValues& values);
  void on(const protocol::Delta& delta, std::int64_t ahead_ns);
  void on(const protocol::Stats& stats);
  // What came does not fit.
  void refuse(const protocol::ApplyResult& result);
  // Makes the state what viewers follow.
  void show();
  void serve(std::shared_ptr<const stream::InitialState> initial);
  std::shared_ptr<stream::InitialState> initial_state() const;
  stream::ServerFacts facts() const;
  stream::Providers providers();
  asio::awaitable<void> fetch();
  // After a loss: an origin that was started with another configuration may look otherwise.
  asio::awaitable<void> check_look();
  // "": none but that of a cycle, or what the relay that is followed has.
  void set_trouble(std::string trouble);
  // Where operators and administrators are sent. Nothing in a cycle, which would send them round until no session is left.
  std::optional<Origin> origin() const;

  const std::string name_;
  stream::StreamConfig config_;
  Reports reports_;
  asio::io_context io_{1};
  asio::executor_work_guard<asio::io_context::executor_type> work_;
  std::unique_ptr<Upstream> upstream_;

  // The session's thread's.
  client::HeldState state_;
  protocol::Welcome welcome_;  // the newest
  protocol::Welcome body_;     // for which the server was made
  bool shown_ = false;         // the server follows the state
  OriginDocuments documents_;
  bool fetching_ = false;  // them

  std::atomic<std::uint64_t> servers_{0};  // made so far

  mutable std::mutex mutex_;                // of all below
  std::shared_ptr<stream::Server> server_;  // changed by the session's thread
  Figures figures_;
  std::string cycle_;   // the trouble of following a cycle; "": we do not
  std::string beyond_;  // what the relay has that is followed; "": none
  protocol::Recording recording_ = protocol::Recording::Off;
  std::vector<protocol::BladePose> blades_;
  std::vector<std::weak_ptr<OperatorLink>> links_;
  std::thread thread_;
};

}  // namespace incise::relay
