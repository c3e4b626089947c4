#include "server/stream/mirror.hpp"

#include <stdexcept>
#include <utility>

#include "server/base/check.hpp"
#include "server/base/clock.hpp"

namespace incise::stream {

SharedFrame make_frame(const protocol::Body& body, std::uint64_t sequence) {
  return std::make_shared<const protocol::Frame>(protocol::encode(body, {sequence, monotonic_ns()}));
}

void Mirror::reset(const InitialState& initial) {
  if (initial.mirror) {
    *this = *initial.mirror;
    epoch_ = initial.epoch;
    return;
  }
  if (std::string problem = load_initial(initial, volume_); !problem.empty()) {
    throw std::runtime_error("initial state: " + problem);
  }
  load(initial.epoch, initial.origins);
}

void Mirror::reset(protocol::Replica volume, std::uint64_t epoch,
                   std::shared_ptr<const protocol::OriginTree> origins) {
  volume_ = std::move(volume);
  load(epoch, std::move(origins));
}

void Mirror::load(std::uint64_t epoch, std::shared_ptr<const protocol::OriginTree> origins) {
  static_cast<void>(volume_.pieces());  // from then on they are followed
  surface_.set_origins(std::move(origins));
  surface_.load(volume_);
  tets_at_.load(volume_);
  epoch_ = epoch;
}

namespace {

// The surface's delta for this change, with the steps of `from`.
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
  out.rest = change.rest();
  return out;
}

}  // namespace

std::shared_ptr<const ReceivedDelta> received_delta(const protocol::Delta& delta) {
  auto received = std::make_shared<ReceivedDelta>();
  try {
    received->frame = make_frame(delta);
  } catch (const std::length_error&) {
    return nullptr;
  }
  protocol::DecodeResult decoded = protocol::decode(received->frame->body());
  INCISE_CHECK(decoded, decoded.error);
  received->message = std::move(*decoded.message);
  return received;
}

Mirror::Applied Mirror::apply(const PublishedDelta& published) {
  return apply(arrays_.assign(published, volume_), nullptr);
}

Mirror::Applied Mirror::apply(const ReceivedDelta& received) {
  return apply(received.delta(), received.frame);
}

Mirror::Applied Mirror::apply(const protocol::Delta& delta, SharedFrame frame) {
  Applied out{std::nullopt, protocol::MeshChange(volume_, delta)};
  const std::uint64_t base_hash = volume_.state_hash();
  tets_at_.follow(volume_, delta);
  const protocol::ApplyResult result = volume_.apply(delta);
  INCISE_CHECK(result, result.text);
  look_at_.clear();
  volume_.follow_pieces(tets_at_, delta, look_at_);
  out.change.tets.insert(out.change.tets.end(), look_at_.begin(), look_at_.end());
  if (surface_.finds_origins()) {
    // A triangle whose corner a cut has moved may have another origin.
    for (const std::uint32_t v : out.change.cut_moved) tets_at_.append_tets(v, look_at_);
  }
  const protocol::SurfaceChange change = surface_.follow(volume_, delta, look_at_);
  try {
    out.step = EncodedStep{delta.base_revision, delta.revision, base_hash,
                           frame ? std::move(frame) : make_frame(delta),
                           make_frame(surface_delta(delta, change, surface_.surface_hash()))};
  } catch (const std::length_error&) {
  }
  return out;
}

SharedFrame Mirror::follow_part(BoxPart& part, const protocol::MeshChange& change) {
  INCISE_CHECK(part.revision() == change.base_revision && change.revision == revision(), part.revision(),
               change.revision);
  if (auto* volume = std::get_if<protocol::VolumePart>(&part.held))
    return make_frame(volume->follow_part(volume_, tets_at_, change, part.box).view());
  auto& surface = std::get<protocol::SurfaceReplica>(part.held);
  const protocol::SurfaceChange done = surface.follow_part(surface_, tets_at_, change, part.box);
  return make_frame(surface_delta(change, done, surface.surface_hash()));
}

}  // namespace incise::stream
