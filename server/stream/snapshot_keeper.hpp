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

#include "protocol/fields.hpp"
#include "protocol/messages.hpp"
#include "server/stream/mirror.hpp"

namespace incise::stream {

using SharedFrames = std::shared_ptr<const std::vector<SharedFrame>>;

// A whole state, encoded, for any number of peers at once. `begin` lacks the cause, which differs from peer to peer.
struct Snapshot {
  std::uint64_t epoch = 0;
  protocol::SnapshotBegin begin;                      // points to the next two
  std::vector<std::uint32_t> piece_ids, piece_names;  // of the whole volume
  std::vector<SharedFrame> chunks;
  std::vector<SharedFrames> fields;  // of each field there is; empty: they were not asked for
  SharedFrame end;
  std::size_t bytes = 0;
  // With a box: what it contains. Such a snapshot is for one peer, which takes the part over.
  std::shared_ptr<BoxPart> part;
};

// The field as clients are told of it.
protocol::FieldFacts facts_of(const core::Field& field);

// Encodes snapshots on a thread of its own, from a replica of its own that follows the mirror, and carries the body's fields there: a snapshot of millions
// of tetrahedra takes a tenth of a second, and deltas must go on to everybody else. Calls take effect in order, so a
// snapshot has the last revision that was applied before the request.
//
// Thread: all calls from one thread; `ready` is called on the keeper's. Owns: the thread, the replica.
class SnapshotKeeper {
 public:
  using Ready = std::function<void(std::shared_ptr<const Snapshot>)>;

  SnapshotKeeper();
  // Ends the thread; requests that still wait are dropped.
  ~SnapshotKeeper();

  void reset(std::shared_ptr<const InitialState> initial);
  void apply(std::shared_ptr<const PublishedDelta> delta);
  void apply(std::shared_ptr<const ReceivedDelta> delta);
  // With a box: only what touches it. With `fields`, which a box has not: their values, too.
  void request(protocol::View view, const std::optional<protocol::Box>& box, bool fields, Ready ready);

  // Sets rows of a field to what a client says they were at that revision. Those that a cut has made or given other material since stay as
  // they are. There is such a field, and it has these rows. False: too much waits. `always`: take them all the same.
  bool set(NewFieldValues values, bool always = false);
  // All values of these fields, as they are after what came before this call.
  using FieldsReady = std::function<void(std::uint64_t epoch, std::vector<SharedFrames>)>;
  void request_fields(std::vector<std::uint32_t> fields, FieldsReady ready);

 private:
  struct Request {
    protocol::View view;
    std::optional<protocol::Box> box;
    bool fields;
    Ready ready;
  };
  struct FieldsRequest {
    std::vector<std::uint32_t> fields;
    FieldsReady ready;
  };
  using Task = std::variant<std::shared_ptr<const InitialState>, std::shared_ptr<const PublishedDelta>,
                            std::shared_ptr<const ReceivedDelta>, Request, NewFieldValues, FieldsRequest>;
  void enqueue(Task task);
  void run();
  void reset_to(const InitialState& initial);
  std::shared_ptr<const Snapshot> encode(const Request& request);
  void apply_now(const protocol::Delta& delta);
  void set_now(const NewFieldValues& values);
  // Encoded once for all who ask.
  SharedFrames field_frames(std::uint32_t field);

  // The keeper's thread's.
  protocol::Replica replica_{protocol::kMaxVertices, protocol::kMaxTets};
  protocol::SurfaceReplica surface_;  // of replica_ as it was at the last request for that view
  protocol::FieldReplica fields_;
  // Of each vertex and tetrahedron, where there are fields: the revision that made it, or gave it other material.
  std::vector<std::uint64_t> vertex_since_, tet_since_;
  std::vector<SharedFrames> field_frames_;  // null: not of what is now
  std::uint64_t epoch_ = 0, surface_epoch_ = 0;
  DeltaArrays arrays_;
  // The last snapshot of each view while a peer is still sent it: many that join at once share it.
  std::weak_ptr<const Snapshot> last_[3];

  std::mutex mutex_;
  std::condition_variable wake_;
  std::vector<Task> tasks_;       // guarded by mutex_
  std::size_t bytes_to_set_ = 0;  // in these; guarded by mutex_
  bool stopping_ = false;         // guarded by mutex_
  std::thread thread_;
};

}  // namespace incise::stream
