#include "server/stream/mirror.hpp"

#include <ctime>
#include <stdexcept>

#include "server/core/check.hpp"

namespace incise::stream {

std::int64_t monotonic_ns() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

SharedFrame make_frame(const protocol::Body& body, std::uint64_t sequence) {
  return std::make_shared<const protocol::Frame>(protocol::encode(body, {sequence, monotonic_ns()}));
}

void Mirror::reset(const InitialState& initial) {
  if (std::string problem = load_initial(initial, volume_); !problem.empty()) {
    throw std::runtime_error("initial state: " + problem);
  }
  surface_.load(volume_);
  index_.load(surface_);
  session_ = initial.session;
}

std::optional<EncodedStep> Mirror::apply(const PublishedDelta& published) {
  const protocol::Delta& delta = arrays_.assign(published, volume_);
  const protocol::ApplyResult result = volume_.apply(delta);
  INCISE_CHECK(result, result.text);
  const protocol::SurfaceChange change = surface_.follow(volume_, delta);
  index_.add(surface_, change.triangles());

  protocol::SurfaceDelta surface;
  surface.base_revision = delta.base_revision;
  surface.revision = delta.revision;
  surface.steps = delta.steps;
  surface.vertices = change.vertices();
  surface.removed_vertices = change.removed_vertices;
  surface.triangles = change.triangles();
  surface.removed_triangles = change.removed_triangles;
  surface.surface_hash = surface_.surface_hash();
  surface.state_hash = delta.state_hash;
  surface.live_tets = delta.live_tets;
  try {
    return EncodedStep{delta.revision, make_frame(delta), make_frame(surface)};
  } catch (const std::length_error&) {
    return std::nullopt;
  }
}

SharedFrame Mirror::follow_part(protocol::SurfaceReplica& part, const protocol::Box& box,
                                const protocol::SurfaceDelta& delta) {
  INCISE_CHECK(part.revision() == delta.base_revision && delta.revision == revision(), part.revision(),
               delta.revision);
  const protocol::SurfaceChange change = part.follow_part(surface_, index_, delta, box);
  protocol::SurfaceDelta out;
  out.base_revision = delta.base_revision;
  out.revision = delta.revision;
  out.steps = delta.steps;
  out.vertices = change.vertices();
  out.removed_vertices = change.removed_vertices;
  out.triangles = change.triangles();
  out.removed_triangles = change.removed_triangles;
  out.surface_hash = part.surface_hash();
  out.state_hash = delta.state_hash;
  out.live_tets = delta.live_tets;
  return make_frame(out);
}

}  // namespace incise::stream
