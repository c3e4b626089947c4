#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <span>

#include "protocol/fields.hpp"
#include "protocol/messages.hpp"
#include "protocol/replica.hpp"
#include "protocol/surface.hpp"
#include "protocol/volume_part.hpp"

namespace incise::client {

// The mesh as the client holds it: a replica of the view in force, its fields, and how far it is.
//
// Thread: changed by the client's thread, which may read without the lock. Others lock mutex() for the replicas.
// Owns: the replicas.
class HeldState {
 public:
  // `full_check_interval`: every so many revisions the whole replica is hashed. 0: never.
  HeldState(std::uint32_t max_vertices, std::uint32_t max_tets, protocol::View view,
            std::uint32_t full_check_interval)
      : volume_(max_vertices, max_tets), view_(view), full_check_interval_(full_check_interval) {}

  // `fields`: Welcome.fields.
  protocol::ApplyResult begin(const protocol::SnapshotBegin& begin,
                              std::span<const protocol::FieldFacts> fields);
  protocol::ApplyResult add(const protocol::SnapshotChunk& chunk);
  protocol::ApplyResult add(const protocol::FieldValues& values);
  protocol::ApplyResult end(const protocol::SnapshotEnd& end);
  protocol::ApplyResult apply(const protocol::Delta& delta);
  protocol::ApplyResult apply(const protocol::SurfaceDelta& delta);
  // Welcome promises a snapshot, or the state was wrong: deltas until then are of no use.
  void await_snapshot() {
    awaiting_snapshot_ = true;
    in_snapshot_ = false;
  }
  // What is held is of another epoch.
  void forget() { whole_ = false; }

  bool awaiting_snapshot() const { return awaiting_snapshot_; }
  bool in_snapshot() const { return in_snapshot_; }
  protocol::View view() const { return view_; }
  bool boxed() const { return boxed_; }
  std::uint32_t chunks_done() const { return chunks_done_; }
  std::uint32_t chunks_total() const { return chunks_total_; }
  protocol::SnapshotCause snapshot_cause() const { return snapshot_cause_; }
  // From any thread. Where whole() holds, revision() is of the present epoch.
  bool whole() const { return whole_; }
  std::uint64_t revision() const { return revision_; }
  // The whole mesh's hash at that revision, as the server announced it.
  std::uint64_t state_hash() const { return state_hash_; }

  std::mutex& mutex() const { return mutex_; }
  const protocol::Replica& volume() const { return volume_; }
  const protocol::SurfaceReplica& surface() const { return surface_; }
  const protocol::VolumePart& part() const { return part_; }
  const protocol::FieldReplica& fields() const { return fields_; }

 private:
  template <class F>
  protocol::ApplyResult change(F&& function);
  template <class D>
  bool due_for_full_check(const D& delta) const;

  mutable std::mutex mutex_;  // of the replicas and fields
  protocol::Replica volume_;
  protocol::SurfaceReplica surface_;
  protocol::VolumePart part_;
  protocol::FieldReplica fields_;

  protocol::View view_;  // in force
  bool boxed_ = false;   // likewise: the snapshot was of what touches a box
  std::atomic<bool> whole_{false};
  bool awaiting_snapshot_ = false;
  bool in_snapshot_ = false;                          // between its beginning and its end
  std::uint32_t chunks_done_ = 0, chunks_total_ = 0;  // of the last snapshot
  protocol::SnapshotCause snapshot_cause_ = protocol::SnapshotCause::Join;
  std::atomic<std::uint64_t> revision_{0};
  std::uint64_t state_hash_ = 0;
  const std::uint64_t full_check_interval_;
};

}  // namespace incise::client
