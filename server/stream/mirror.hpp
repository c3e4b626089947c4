#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <variant>

#include "protocol/framing.hpp"
#include "protocol/replica.hpp"
#include "protocol/surface.hpp"
#include "protocol/volume_part.hpp"
#include "server/stream/delta_arrays.hpp"
#include "server/stream/published_delta.hpp"

namespace incise::stream {

using SharedFrame = std::shared_ptr<const protocol::Frame>;

// A delta that came from another server: as it goes out to viewers of view Volume, and decoded.
struct ReceivedDelta {
  SharedFrame frame;
  protocol::Message message;  // points into the frame, or owns a copy

  const protocol::Delta& delta() const { return std::get<protocol::Delta>(message.body); }
};
// Copies the delta. Null where it is too long for a message. O(delta).
std::shared_ptr<const ReceivedDelta> received_delta(const protocol::Delta& delta);

// One step as it goes out, encoded once for all peers.
struct EncodedStep {
  std::uint64_t base_revision = 0, revision = 0;
  std::uint64_t base_hash = 0;  // the state's hash before it
  SharedFrame volume, surface;

  std::size_t bytes() const { return volume->tcp().size() + surface->tcp().size(); }
};

// What one peer with a box of interest holds, of either view.
struct BoxPart {
  protocol::Box box;
  std::variant<protocol::SurfaceReplica, protocol::VolumePart> held;

  std::uint64_t revision() const {
    return std::visit([](const auto& part) { return part.revision(); }, held);
  }
  // The memory it takes, roughly.
  std::size_t bytes() const {
    return std::visit([](const auto& part) { return part.bytes(); }, held);
  }
};

// The state that clients see, kept with the clients' own code, so that a delta that a client would refuse is found
// here first.
//
// Thread: the stream thread. Owns: both replicas, and the index of tetrahedra by vertex.
class Mirror {
 public:
  // Loads a state. Throws std::runtime_error where no client could hold it.
  void reset(const InitialState& initial);
  // The same, from what another server has sent.
  void reset(protocol::Replica volume, std::uint64_t epoch,
             std::shared_ptr<const protocol::OriginTree> origins);

  struct Applied {
    std::optional<EncodedStep>
        step;                     // nothing where it is too long for one message: peers then need a snapshot
    protocol::MeshChange change;  // for peers with a box of interest
  };
  // Applies a delta and encodes it for both views. A delta that does not fit is a bug of ours and ends the process.
  // O(delta log surface), and what is cut off, whose triangles get another piece.
  Applied apply(const PublishedDelta& published);
  // One that another server made, of one revision or several. It fits: a replica of the same state has applied it.
  Applied apply(const ReceivedDelta& received);

  // Names this run of ids.
  std::uint64_t epoch() const { return epoch_; }
  std::uint64_t revision() const { return volume_.revision(); }
  const protocol::Replica& volume() const { return volume_; }
  const protocol::SurfaceReplica& surface() const { return surface_; }
  // Brings `part` from the revision where `change` begins to the mirror's, and returns the delta that does the same
  // for the peer. Throws std::length_error where that is too long for one message. O(change + part).
  SharedFrame follow_part(BoxPart& part, const protocol::MeshChange& change);

 private:
  // The rest, of the volume.
  void load(std::uint64_t epoch, std::shared_ptr<const protocol::OriginTree> origins);
  // `frame`: the delta encoded, or null.
  Applied apply(const protocol::Delta& delta, SharedFrame frame);

  std::uint64_t epoch_ = 0;
  protocol::Replica volume_{protocol::kMaxVertices, protocol::kMaxTets};
  protocol::SurfaceReplica surface_;
  protocol::TetIndex tets_at_;
  DeltaArrays arrays_;
  std::vector<std::uint32_t> look_at_;  // scratch
};

// A message as it goes to one peer or many.
SharedFrame make_frame(const protocol::Body& body, std::uint64_t sequence = 0);

}  // namespace incise::stream
