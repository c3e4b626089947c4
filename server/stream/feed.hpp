#pragma once

#include <boost/asio/io_context.hpp>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "server/stream/delta_ring.hpp"
#include "server/stream/mirror.hpp"
#include "server/stream/refusal.hpp"
#include "server/stream/snapshot_keeper.hpp"

namespace incise::stream {

namespace asio = boost::asio;

// A state that peers follow, with what they are sent of it: the mirror, the ring of encoded steps, snapshots. There
// is one for the live mesh, and one for each peer that replays a capture.
//
// Thread: the stream thread. Owns: the mirror, the snapshot thread.
class Feed {
 public:
  Feed(asio::io_context& io, std::size_t ring_bytes) : io_(io), ring_(ring_bytes), changes_(ring_bytes) {}

  // Another epoch.
  void reset(std::shared_ptr<const InitialState> initial);
  void apply(const std::shared_ptr<const PublishedDelta>& delta);
  void apply(const std::shared_ptr<const ReceivedDelta>& delta);

  const Mirror& mirror() const { return mirror_; }
  const DeltaRing& ring() const { return ring_; }
  // That the body has, and how often clients have set each.
  const std::vector<protocol::FieldFacts>& fields() const { return fields_; }
  const std::vector<std::uint64_t>& fields_set() const { return fields_set_; }
  std::uint64_t times_fields_set() const;
  // What a client says of one of them, for everybody; or why not.
  std::optional<Refusal> set_field(const protocol::FieldValues& values);
  // All values of one of them, from another server that says so of this revision.
  void set_field(NewFieldValues values);
  // Calls `ready` on this thread, later: values at the mirror's revision as it is now.
  void request_fields(std::vector<std::uint32_t> fields, SnapshotKeeper::FieldsReady ready);

  // Whether deltas lead on from the state of that revision with that hash (0: not known). The hash matters after a
  // crash: a server that resumes a capture may have lost its last steps and made others in their place.
  bool can_resume(std::uint64_t revision, std::uint64_t hash) const;
  // Calls `ready` on this thread, later.
  void request_snapshot(protocol::View view, const std::optional<protocol::Box>& box, bool fields,
                        SnapshotKeeper::Ready ready);
  // The delta from `base` to the mirror's revision, made once for all who ask. Null where only a snapshot helps.
  SharedFrame coalesced(protocol::View view, std::uint64_t base);
  // Brings `part` to the mirror's revision and returns the delta that does the same for the peer that holds it. Null
  // where only a snapshot helps; the part is then of no use. The changes are kept longer than the ring keeps deltas,
  // because a box may have to wait for its turn.
  SharedFrame part_delta(BoxPart& part);

 private:
  void keep(Mirror::Applied applied);

  asio::io_context& io_;
  Mirror mirror_;
  DeltaRing ring_;
  ChangeRing changes_;
  std::map<std::pair<protocol::View, std::uint64_t>, SharedFrame> coalesced_;  // up to the mirror's revision
  std::vector<protocol::FieldFacts> fields_;
  std::vector<std::uint64_t> fields_set_;
  SnapshotKeeper keeper_;
};

}  // namespace incise::stream
