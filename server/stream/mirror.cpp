#include "server/stream/mirror.hpp"

#include <stdexcept>

#include "server/base/check.hpp"
#include "server/base/clock.hpp"

namespace incise::stream {

SharedFrame make_frame(const protocol::Body& body, std::uint64_t sequence) {
  return std::make_shared<const protocol::Frame>(protocol::encode(body, {sequence, monotonic_ns()}));
}

void Mirror::reset(const InitialState& initial) {
  if (std::string problem = load_initial(initial, volume_); !problem.empty()) {
    throw std::runtime_error("initial state: " + problem);
  }
  surface_.load(volume_);
  tets_at_.load(volume_);
  session_ = initial.session;
}

namespace {

// `from`, a delta of either view, as one of the surface that makes this change.
template <class D>
protocol::SurfaceDelta surface_delta(const D& from, const protocol::SurfaceChange& change,
                                     std::uint64_t surface_hash) {
  protocol::SurfaceDelta out;
  out.base_revision = from.base_revision;
  out.revision = from.revision;
  out.steps = from.steps;
  out.vertices = change.vertices();
  out.removed_vertices = change.removed_vertices;
  out.triangles = change.triangles();
  out.removed_triangles = change.removed_triangles;
  out.surface_hash = surface_hash;
  out.state_hash = from.state_hash;
  out.live_tets = from.live_tets;
  return out;
}

}  // namespace

std::optional<EncodedStep> Mirror::apply(const PublishedDelta& published) {
  const protocol::Delta& delta = arrays_.assign(published, volume_);
  tets_at_.follow(volume_, delta);
  const protocol::ApplyResult result = volume_.apply(delta);
  INCISE_CHECK(result, result.text);
  const protocol::SurfaceChange change = surface_.follow(volume_, delta);
  try {
    return EncodedStep{delta.revision, make_frame(delta),
                       make_frame(surface_delta(delta, change, surface_.surface_hash()))};
  } catch (const std::length_error&) {
    return std::nullopt;
  }
}

SharedFrame Mirror::follow_part(BoxPart& part, const protocol::Body& delta) {
  if (auto* volume = std::get_if<protocol::VolumePart>(&part.held)) {
    const auto& whole = std::get<protocol::Delta>(delta);
    INCISE_CHECK(volume->revision() == whole.base_revision && whole.revision == revision(),
                 volume->revision(), whole.revision);
    return make_frame(volume->follow_part(volume_, tets_at_, whole, part.box).view());
  }
  auto& surface = std::get<protocol::SurfaceReplica>(part.held);
  const auto& whole = std::get<protocol::SurfaceDelta>(delta);
  INCISE_CHECK(surface.revision() == whole.base_revision && whole.revision == revision(), surface.revision(),
               whole.revision);
  const protocol::SurfaceChange change = surface.follow_part(surface_, volume_, tets_at_, whole, part.box);
  return make_frame(surface_delta(whole, change, surface.surface_hash()));
}

}  // namespace incise::stream
