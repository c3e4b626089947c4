#include "server/stream/delta_arrays.hpp"

#include <bit>
#include <span>
#include <type_traits>

#include "protocol/state_hash.hpp"

namespace incise::stream {
namespace {

// An array of core vectors is an array of doubles: x y z x y z ...
static_assert(sizeof(core::Vec3) == 3 * sizeof(double) && std::is_trivially_copyable_v<core::Vec3>);

std::span<const double> flat(const std::vector<core::Vec3>& positions) {
  return {reinterpret_cast<const double*>(positions.data()), 3 * positions.size()};
}

protocol::Vec3 to_protocol(const core::Vec3& v) {
  return {v.x, v.y, v.z};
}

protocol::Step step_of(const PublishedDelta& published) {
  const core::Delta& d = published.delta;
  protocol::Step step;
  step.revision = d.revision;
  step.source = d.source;
  step.stroke = d.stroke;
  step.batch = d.batch;
  step.stroke_ended = d.stroke_ended;
  step.from_heel = to_protocol(d.from.heel);
  step.from_tip = to_protocol(d.from.tip);
  step.to_heel = to_protocol(d.to.heel);
  step.to_tip = to_protocol(d.to.tip);
  step.from_source_ns = d.from_t_ns;
  step.to_source_ns = d.to_t_ns;
  step.arrival_ns = published.arrival_ns;
  step.drain_ns = published.drain_ns;
  step.cut_ns = published.cut_ns;
  step.cut_faces = d.cut_faces;
  step.cut_area_m2 = d.cut_area;
  step.snaps = d.snaps;
  step.splits = d.splits;
  step.min_dihedral_deg = d.min_dihedral_deg;
  step.max_deviation_h = d.max_deviation_h;
  step.state_hash = d.state_hash;
  return step;
}

}  // namespace

const protocol::Delta& DeltaArrays::assign(const PublishedDelta& published, const protocol::Replica& before) {
  const core::Delta& d = published.delta;
  provenance_a_.clear();
  provenance_b_.clear();
  provenance_t_.clear();
  for (const core::Provenance& p : d.provenance) {
    provenance_a_.push_back(p.a);
    provenance_b_.push_back(p.b);
    provenance_t_.push_back(p.t);
  }
  tet_ids_.clear();
  tet_vertices_.clear();
  regions_.clear();
  cut_masks_.clear();
  boundary_masks_.clear();
  std::uint32_t created = 0;
  for (const core::TetState& t : d.upserted) {
    tet_ids_.push_back(t.id);
    tet_vertices_.insert(tet_vertices_.end(), t.vertices.begin(), t.vertices.end());
    regions_.push_back(t.region);
    cut_masks_.push_back(t.cut_mask);
    boundary_masks_.push_back(t.boundary_mask);
    created += t.id >= before.tet_slots();
  }
  piece_ids_.clear();
  piece_sizes_.clear();
  piece_names_.clear();
  for (const core::Delta::Piece& piece : d.pieces) {
    piece_ids_.push_back(piece.id);
    piece_sizes_.push_back(piece.tets);
    piece_names_.push_back(piece.tet);
  }

  rest_ids_.clear();
  rest_.clear();
  if (!d.moved_rest.empty() || !d.added_rest.empty()) {
    rest_ids_.assign(d.moved.begin(), d.moved.end());
    for (std::uint32_t i = 0; i < d.added_rest.size(); ++i) rest_ids_.push_back(before.vertex_count() + i);
    rest_.assign(d.moved_rest.begin(), d.moved_rest.end());
    rest_.insert(rest_.end(), d.added_rest.begin(), d.added_rest.end());
  }

  blend_ids_.clear();
  blend_vertices_.clear();
  blend_weights_.clear();
  for (const core::Blend& blend : d.blends) {
    blend_ids_.push_back(blend.vertex);
    blend_vertices_.insert(blend_vertices_.end(), blend.from.begin(), blend.from.end());
    blend_weights_.insert(blend_weights_.end(), blend.weights.begin(), blend.weights.end());
  }

  protocol::Delta& m = message_;
  m.base_revision = d.revision - 1;
  m.revision = d.revision;
  m.steps.assign(1, step_of(published));
  m.moved_ids = d.moved;
  m.moved_positions = flat(d.moved_positions);
  m.first_added = before.vertex_count();
  m.added_positions = flat(d.added_positions);
  m.provenance_a = provenance_a_;
  m.provenance_b = provenance_b_;
  m.provenance_t = provenance_t_;
  m.tets = {tet_ids_, tet_vertices_, regions_, cut_masks_, boundary_masks_};
  m.removed_tets = d.removed;
  m.boundary_upserted = d.boundary_upserted;
  m.boundary_removed = d.boundary_removed;
  m.piece_ids = piece_ids_;
  m.piece_sizes = piece_sizes_;
  m.piece_names = piece_names_;
  m.vertex_count = before.vertex_count() + static_cast<std::uint32_t>(d.added_positions.size());
  m.live_tets = before.live_tets() + created - static_cast<std::uint32_t>(d.removed.size());
  m.state_hash = d.state_hash;
  m.first_new_tet = before.tet_slots();
  m.rest_ids = rest_ids_;
  m.rest_positions = flat(rest_);
  m.tet_elders = d.elders;
  m.blend_ids = blend_ids_;
  m.blend_vertices = blend_vertices_;
  m.blend_weights = blend_weights_;
  return m;
}

std::string load_initial(const InitialState& initial, protocol::Replica& replica) {
  std::vector<std::uint32_t> ids, vertices;
  std::vector<std::int32_t> regions;
  std::vector<std::uint8_t> cut_masks, boundary_masks;
  ids.reserve(initial.tets.size());
  vertices.reserve(4 * initial.tets.size());
  regions.reserve(initial.tets.size());
  cut_masks.reserve(initial.tets.size());
  boundary_masks.reserve(initial.tets.size());
  std::uint64_t hash = 0;
  for (const core::TetState& t : initial.tets) {
    ids.push_back(t.id);
    vertices.insert(vertices.end(), t.vertices.begin(), t.vertices.end());
    regions.push_back(t.region);
    cut_masks.push_back(t.cut_mask);
    boundary_masks.push_back(t.boundary_mask);
    hash ^= protocol::tet_hash(t.id, t.vertices.data(), t.region, t.cut_mask);
  }
  const protocol::TetArrays tets{ids, vertices, regions, cut_masks, boundary_masks};
  if (initial.piece_ids.empty() && initial.rest.empty())
    return replica.load(flat(initial.positions), tets, initial.revision).text;

  for (std::uint32_t v = 0; v < initial.positions.size(); ++v) {
    const core::Vec3& p = initial.positions[v];
    hash ^= protocol::vertex_hash(v, p.x, p.y, p.z);
  }
  // Only a snapshot carries pieces and rest positions.
  protocol::SnapshotBegin begin;
  begin.piece_ids = initial.piece_ids;
  begin.piece_names = initial.piece_names;
  begin.revision = initial.revision;
  begin.chunks = 1;
  begin.vertex_count = static_cast<std::uint32_t>(initial.positions.size());
  begin.tet_count = static_cast<std::uint32_t>(initial.tets.size());
  for (const std::uint8_t mask : boundary_masks)
    begin.triangle_count += static_cast<std::uint32_t>(std::popcount(mask));
  protocol::SnapshotChunk chunk;
  chunk.positions = flat(initial.positions);
  chunk.tets = tets;
  chunk.rest_positions = flat(initial.rest);
  if (auto r = replica.begin(begin); !r) return r.text;
  if (auto r = replica.chunk(chunk); !r) return r.text;
  return replica.end({initial.revision, hash, 0}).text;
}

}  // namespace incise::stream
