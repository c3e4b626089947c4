#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <variant>
#include <vector>

#include "protocol/messages.hpp"
#include "server/stream/mirror.hpp"

namespace incise::stream {

// A whole state, encoded, for any number of sessions at once. `begin` lacks the cause, which is each
// session's own.
struct Snapshot {
  std::uint64_t epoch = 0;
  protocol::SnapshotBegin begin;
  std::vector<SharedFrame> chunks;
  SharedFrame end;
  std::size_t bytes = 0;
  // With a box: what it holds. Such a snapshot is for one session, which takes this over.
  std::shared_ptr<BoxPart> part;
};

// Encodes snapshots on a thread of its own, from a replica of its own that follows the mirror: a snapshot of
// millions of tetrahedra takes a tenth of a second, in which deltas must go on to everybody else. What is
// asked for is done in order, so a snapshot has the last revision that was pushed before the request.
//
// Thread: all calls from one thread; `ready` comes on the keeper's. Owns: the thread, the replica.
class SnapshotKeeper {
 public:
  using Ready = std::function<void(std::shared_ptr<const Snapshot>)>;

  SnapshotKeeper();
  // Ends the thread; requests that wait are dropped.
  ~SnapshotKeeper();

  void reset(std::shared_ptr<const InitialState> initial);
  void push(std::shared_ptr<const PublishedDelta> delta);
  // `box`: only what touches it.
  void request(protocol::View view, const std::optional<protocol::Box>& box, Ready ready);

 private:
  struct Request {
    protocol::View view;
    std::optional<protocol::Box> box;
    Ready ready;
  };
  using Task =
      std::variant<std::shared_ptr<const InitialState>, std::shared_ptr<const PublishedDelta>, Request>;
  void enqueue(Task task);
  void run();
  std::shared_ptr<const Snapshot> encode(protocol::View view, const std::optional<protocol::Box>& box);

  // The thread's.
  protocol::Replica replica_{protocol::kMaxVertices, protocol::kMaxTets};
  std::optional<protocol::SurfaceReplica> surface_;  // of it, once somebody has asked for that view
  std::uint64_t epoch_ = 0;
  DeltaArrays arrays_;
  // The last one of each view, while somebody still sends it: many who join at once share it.
  std::weak_ptr<const Snapshot> last_[3];

  std::mutex mutex_;
  std::condition_variable wake_;
  std::vector<Task> tasks_;  // guarded by mutex_
  bool stopping_ = false;    // guarded by mutex_
  std::thread thread_;
};

}  // namespace incise::stream
