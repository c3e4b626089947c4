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

// One step as it goes out, encoded once for all sessions.
struct EncodedStep {
  std::uint64_t revision = 0;  // takes revision - 1 to this
  SharedFrame volume, surface;

  std::size_t bytes() const { return volume->tcp().size() + surface->tcp().size(); }
};

// What one session with a box of interest holds, of either view.
struct BoxPart {
  protocol::Box box;
  std::variant<protocol::SurfaceReplica, protocol::VolumePart> held;

  std::uint64_t revision() const {
    return std::visit([](const auto& part) { return part.revision(); }, held);
  }
  // About how much memory it takes.
  std::size_t bytes() const {
    return std::visit([](const auto& part) { return part.bytes(); }, held);
  }
};

// The state that clients see, kept with the clients' own code: a delta that a client would refuse is found
// here first.
//
// Thread: the stream thread. Owns: both replicas, and what finds the neighbours of a moved vertex in them.
class Mirror {
 public:
  // Checks the state. Throws std::runtime_error where it is not one that a client could hold.
  void reset(const InitialState& initial);

  struct Applied {
    std::optional<EncodedStep>
        step;  // nothing where it is too long for one message: sessions then need a snapshot
    protocol::MeshChange change;  // for those with a box of interest
  };
  // Applies a delta and encodes it for both views. A delta that does not fit is a bug of ours and ends the
  // process. O(delta log surface).
  Applied apply(const PublishedDelta& published);

  // Names this run of ids.
  std::uint64_t epoch() const { return epoch_; }
  std::uint64_t revision() const { return volume_.revision(); }
  const protocol::Replica& volume() const { return volume_; }
  const protocol::SurfaceReplica& surface() const { return surface_; }
  // Brings `part`, of what there was when `change` began, to what there is now, and returns the delta that does so for the
  // one who holds the part. Throws std::length_error where it is too long for one message. O(change + part).
  SharedFrame follow_part(BoxPart& part, const protocol::MeshChange& change);

 private:
  std::uint64_t epoch_ = 0;
  protocol::Replica volume_{protocol::kMaxVertices, protocol::kMaxTets};
  protocol::SurfaceReplica surface_;
  protocol::TetIndex tets_at_;
  DeltaArrays arrays_;
};

// A message as it goes to one session or many.
SharedFrame make_frame(const protocol::Body& body, std::uint64_t sequence = 0);

}  // namespace incise::stream
