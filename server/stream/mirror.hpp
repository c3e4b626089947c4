#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "protocol/framing.hpp"
#include "protocol/replica.hpp"
#include "protocol/surface.hpp"
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

// The state that clients see, kept with the clients' own code: a delta that a client would refuse is found
// here first.
//
// Thread: the stream thread. Owns: both replicas.
class Mirror {
 public:
  // Checks the state. Throws std::runtime_error where it is not one that a client could hold.
  void reset(const InitialState& initial);

  // Applies a delta and encodes it for both views. A delta that does not fit is a bug of ours and ends the
  // process. Nothing comes back for a delta too long for one message: sessions then need a snapshot. O(delta
  // log surface).
  std::optional<EncodedStep> apply(const PublishedDelta& published);

  std::uint64_t session() const { return session_; }
  std::uint64_t revision() const { return volume_.revision(); }
  const protocol::Replica& volume() const { return volume_; }
  const protocol::SurfaceReplica& surface() const { return surface_; }
  // Brings `part`, of what was the surface when `delta` began, to what it is now, and returns the delta that does so
  // for whoever holds the part. O(delta log surface).
  SharedFrame follow_part(protocol::SurfaceReplica& part, const protocol::Box& box,
                          const protocol::SurfaceDelta& delta);

 private:
  std::uint64_t session_ = 0;
  protocol::Replica volume_{protocol::kMaxVertices, protocol::kMaxTets};
  protocol::SurfaceReplica surface_;
  protocol::SurfaceIndex index_;
  DeltaArrays arrays_;
};

// CLOCK_MONOTONIC now, ns: the clock of all times in the server.
std::int64_t monotonic_ns();

// A message as it goes to one session or many.
SharedFrame make_frame(const protocol::Body& body, std::uint64_t sequence = 0);

}  // namespace incise::stream
