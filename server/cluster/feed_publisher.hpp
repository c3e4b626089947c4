#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "server/cluster/nats_client.hpp"
#include "server/cluster/session_subjects.hpp"
#include "server/stream/feed_listener.hpp"

namespace incise::cluster {

struct PublisherOptions {
  NatsOptions nats;
  std::string session;
  bool in_memory = true;  // the stream; else on the disk of nats-server
  int replicas = 1;
  std::int64_t stream_bytes = 128 << 20;  // that NATS keeps; the oldest go first
  double keep_s = 3600;
  std::size_t join_bytes = 16 << 20;   // of deltas that a reader finds behind a snapshot, at most
  std::size_t queue_bytes = 64 << 20;  // that wait to be published, at most
};

// What became of it, since the start.
struct PublisherCounters {
  bool connected = false;
  std::uint64_t connections = 0;  // made to NATS
  std::uint64_t failures = 0;     // of connections, and of what was published
  std::uint64_t messages = 0, bytes = 0;
  std::uint64_t deltas = 0, snapshots = 0;
  std::uint64_t dropped = 0;  // steps, because too much waited; a snapshot heals that
  std::uint64_t queued_bytes = 0;
  std::string trouble;  // why nothing goes out; "" while it does
};

// Publishes a session's frames to NATS: Welcome and a snapshot, deltas, and now and then again, so that a reader who joins has little to
// read. Whatever goes wrong, NATS slow, full or gone, ends in a new connection and a new snapshot: readers see no gap that
// they do not notice by its revision and hash (NATS.md).
//
// Thread: FeedListener's calls come from the stream thread and only queue; a thread of its own talks to NATS. counters() from any.
class FeedPublisher final : public stream::FeedListener {
 public:
  // Asks the server for a whole state; `ready` is called on the stream thread.
  using RequestState = std::function<void(protocol::View, std::function<void(stream::WholeState)> ready)>;
  using Log = std::function<void(bool warning, const std::string& line)>;
  // `may_write`: whether this instance still has the session; null: nobody else can have it. `fence`: its number.
  FeedPublisher(PublisherOptions options, Log log, std::function<bool()> may_write = nullptr,
                std::uint64_t fence = 0);
  ~FeedPublisher();

  void start(RequestState request);
  // Publishes what waits, for at most two seconds, and ends the thread. After the stream has stopped.
  void stop();
  PublisherCounters counters() const;

  void on_epoch(std::uint64_t epoch, std::uint64_t revision) override;
  void on_step(const stream::EncodedStep& step) override;
  void on_gap(std::uint64_t revision) override;
  void on_fields_set() override;
  void on_live(const stream::SharedFrame& frame) override;
  bool wants_blades() const override { return connected_.load(std::memory_order_relaxed); }

 private:
  struct Epoch {
    std::uint64_t epoch;
  };
  struct Gap {};
  struct FieldsSet {};
  struct State {
    protocol::View view;
    std::uint64_t request;
    stream::WholeState state;
  };
  using Item = std::variant<stream::EncodedStep, Epoch, Gap, FieldsSet, stream::SharedFrame, State>;

  // What readers of one view have.
  struct ViewState {
    explicit ViewState(protocol::View v) : view(v) {}
    protocol::View view;
    bool broken = true;                      // deltas would lead nowhere before the next snapshot
    bool wanted = true;                      // a snapshot
    std::uint64_t requested = 0;             // number of the request under way; 0: none
    std::vector<stream::EncodedStep> since;  // steps since it was requested
    std::size_t since_bytes = 0;
    std::size_t delta_bytes = 0;  // behind the last snapshot
    std::size_t snapshot_bytes = 0;
    std::int64_t snapshot_ns = 0;
    std::uint64_t first = 0, before = 0;  // where the last snapshot begins in the stream, and the one before
  };

  void push(Item item, std::size_t bytes);
  void run();
  void connect();
  void disconnect(const std::string& why);
  void make_stream();
  void work();
  void handle(Item& item);
  void handle(const stream::EncodedStep& step);
  void handle(State& state);
  void lose(ViewState& view);
  void request_wanted();
  void publish_delta(ViewState& view, const stream::EncodedStep& step);
  void purge(ViewState& view);
  void look_after_snapshots();
  void warn_if_small();
  // `ack`: waits for it, and returns the message's number in the stream. `live`: not kept.
  struct Headers {
    std::uint64_t revision = 0;
    std::optional<std::uint64_t> base_hash, fields_set;
  };
  std::uint64_t publish(const std::string& subject, const stream::SharedFrame& frame, const Headers& headers,
                        bool ack = false, bool live = false);
  void wait_for_acks();
  void require_health();
  static void on_refused(jsCtx*, jsPubAckErr* error, void* self);

  const PublisherOptions options_;
  const SessionSubjects subjects_;
  const Log log_;
  const std::function<bool()> may_write_;
  const std::uint64_t fence_;
  const std::string instance_;
  RequestState request_;

  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Item> queue_;         // guarded by mutex_
  std::size_t queued_bytes_ = 0;   // guarded by mutex_
  std::uint64_t now_epoch_ = 0;    // guarded by mutex_: the stream thread's
  bool stopping_ = false;          // guarded by mutex_
  std::string trouble_, refused_;  // guarded by mutex_
  std::atomic<bool> connected_{false};
  std::atomic<std::uint64_t> connections_{0}, failures_{0}, messages_{0}, bytes_{0}, deltas_{0},
      snapshots_{0}, dropped_{0};

  // The thread's.
  std::unique_ptr<NatsClient> client_;
  std::size_t part_bytes_ = 0;
  std::uint64_t epoch_ = 0, requests_ = 0, head_ = 0;
  std::int64_t logged_ns_ = 0, looked_ns_ = 0;
  std::string logged_;
  ViewState views_[2] = {ViewState(protocol::View::Volume), ViewState(protocol::View::Surface)};
  std::thread thread_;
};

}  // namespace incise::cluster
