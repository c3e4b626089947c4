#pragma once

// Several successive deltas as one: for subscribers who want fewer, or cannot keep up.

#include <cstdint>
#include <span>
#include <vector>

#include "protocol/messages.hpp"
#include "protocol/surface.hpp"

namespace incise::protocol {

// A delta that owns its arrays.
struct OwnedDelta {
  std::uint64_t base_revision = 0, revision = 0;
  std::vector<Step> steps;
  std::vector<std::uint32_t> moved_ids;
  std::vector<double> moved_positions;
  std::uint32_t first_added = 0;
  std::vector<double> added_positions;
  std::vector<std::uint32_t> provenance_a, provenance_b;
  std::vector<double> provenance_t;
  std::vector<std::uint32_t> tet_ids, tet_vertices;
  std::vector<std::int32_t> tet_regions;
  std::vector<std::uint8_t> tet_cut_masks, tet_boundary_masks;
  std::vector<std::uint32_t> removed_tets;
  std::vector<std::uint32_t> boundary_upserted, boundary_removed;
  std::vector<std::uint32_t> piece_ids, piece_sizes, piece_tets, piece_names;
  std::uint32_t vertex_count = 0;
  std::uint32_t live_tets = 0;
  std::uint64_t state_hash = 0;
  std::uint32_t first_new_tet = 0;
  std::vector<std::uint32_t> added_ids, removed_vertices;
  std::uint64_t part_hash = 0;
  std::vector<std::uint32_t> rest_ids;
  std::vector<double> rest_positions;
  std::vector<std::uint32_t> blend_ids, blend_vertices;
  std::vector<double> blend_weights;
  std::vector<std::uint32_t> round_added, round_blends;
  std::vector<std::uint32_t> tet_elders;

  // Spans into this object; the steps are copied.
  Delta view() const;
};

// A surface delta that owns its arrays.
struct OwnedSurfaceDelta {
  std::uint64_t base_revision = 0, revision = 0;
  std::vector<Step> steps;
  SurfaceChange change;
  std::uint64_t surface_hash = 0;
  std::uint64_t state_hash = 0;
  std::uint32_t live_tets = 0;

  SurfaceDelta view() const;
};

// One delta with the same effect as `deltas` one after the other: it takes a state at the first one's base
// revision to the same state, hash, pieces and steps included. Vertices keep the provenance of the delta that
// added them, and the blends of each delta are a round of their own: fields come out as step by step. There must be at least one delta, and each must start where the one before ends (else
// std::invalid_argument). Not for deltas of a part of the volume (VolumePart), which are made from those of the
// whole. O(n log n) in their size.
OwnedDelta coalesce(std::span<const Delta> deltas);
OwnedSurfaceDelta coalesce(std::span<const SurfaceDelta> deltas);

}  // namespace incise::protocol
