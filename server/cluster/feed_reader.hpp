#pragma once

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "protocol/framing.hpp"
#include "server/cluster/nats_client.hpp"
#include "server/cluster/session_subjects.hpp"

namespace incise::cluster {

// Reads a session that FeedPublisher has put on NATS, as if it were a viewer's connection: one Welcome and snapshot, then deltas without a
// gap. It begins at the newest snapshot that the stream keeps; what it does not need of later ones it passes over.
//
// A delta goes out only if its base is the revision and the hash that went out last. If not, nothing more goes out until
// the publisher's next snapshot, or until the stream, read again, leads on.
//
// Thread: one of its own, on which the sink is called; resync() from any.
class FeedReader {
 public:
  struct Held {
    std::uint64_t epoch = 0, revision = 0, state_hash = 0;  // epoch 0: nothing
  };
  class Sink {
   public:
    // Welcome, SnapshotBegin, SnapshotChunk, FieldValues, SnapshotEnd, Delta (or SurfaceDelta), Stats, BladePose. The sender's clock is
    // `ahead_ns` ahead of ours, as far as the two machines agree on Unix time.
    virtual void on_message(const protocol::Message& message, std::int64_t ahead_ns) = 0;
    virtual void on_lost(const std::string& why) = 0;
    virtual Held held() const = 0;

   protected:
    ~Sink() = default;
  };

  FeedReader(NatsOptions nats, const std::string& session, protocol::View view = protocol::View::Volume);
  ~FeedReader();
  void start(Sink& sink);
  void stop();
  // The sink's state is wrong: a snapshot comes, and no delta before it.
  void resync();

 private:
  // One protocol message, put together of its parts.
  struct Whole {
    enum class Kind { kWelcome, kSnapshot, kDelta } kind;
    std::uint64_t epoch, revision, base_hash, fields_set, fence;
    std::string instance;
    std::vector<std::byte> bytes;
  };
  enum class Mode {
    kWaiting,  // for a Welcome to begin at
    kTaking,   // a snapshot, which goes to the sink
    kPassing,  // over one
    kFields,   // likewise, but for values that a client has set
    kFollowing,
  };

  void run();
  void read();
  void read_live(natsSubscription* live);
  std::uint64_t newest_delta(NatsClient& client, std::uint64_t behind) const;
  bool add_part(natsMsg* message);
  void handle();
  void on_welcome(const protocol::Message& message);
  void on_snapshot(const protocol::Message& message);
  void on_delta(const protocol::Message& message);
  bool leads_on(const protocol::Welcome& welcome) const;
  void lose(const std::string& why);
  bool stopping() const;

  const NatsOptions nats_;
  const std::string session_;
  const SessionSubjects subjects_;
  const protocol::View view_;
  Sink* sink_ = nullptr;
  Mode mode_ = Mode::kWaiting;
  Held held_;               // what went out last
  std::uint64_t tail_ = 0;  // the newest delta that the stream had when reading it began
  std::uint64_t fields_set_ = 0, fence_ = 0;
  std::string instance_;  // whose deltas we follow
  std::int64_t ahead_ns_ = 0;
  std::int64_t live_ns_ = 0, moved_ns_ = 0;  // when something live came; when a delta or a snapshot went out
  std::uint64_t live_revision_ = 0;
  bool again_ = false;  // read the stream again
  std::atomic<bool> resync_{false};
  bool fresh_ = false;  // the sink wants a snapshot
  bool lost_ = false;   // and the sink knows
  bool partial_ = false;
  std::size_t parts_ = 0;  // of whole_, that have come
  Whole whole_{};
  mutable std::mutex mutex_;
  std::condition_variable wake_;
  bool stopping_ = false;  // guarded by mutex_
  std::thread thread_;
};

}  // namespace incise::cluster
