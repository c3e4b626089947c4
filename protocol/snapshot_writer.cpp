#include <algorithm>
#include <cstddef>

#include "protocol/replica.hpp"

namespace incise::protocol {

SnapshotWriter::SnapshotWriter(const Replica& replica, SnapshotCause cause, std::size_t chunk_elements)
    : replica_(replica), chunk_elements_(std::max<std::size_t>(1, chunk_elements)) {
  const auto chunks_of = [&](std::size_t n) { return (n + chunk_elements_ - 1) / chunk_elements_; };
  begin_.view = View::Volume;
  begin_.revision = replica.revision();
  begin_.cause = cause;
  begin_.vertex_count = replica.vertex_count();
  begin_.tet_count = replica.live_tets();
  begin_.triangle_count = replica.boundary_faces();
  for (const auto& [id, tet] : replica.piece_names()) {
    if (!replica.alive(tet)) continue;
    piece_ids_.push_back(id);
    piece_names_.push_back(tet);
  }
  begin_.piece_ids = piece_ids_;
  begin_.piece_names = piece_names_;
  begin_.chunks =
      static_cast<std::uint32_t>(chunks_of(replica.vertex_count()) + chunks_of(replica.live_tets()));
}

bool SnapshotWriter::next() {
  if (chunks_made_ == begin_.chunks) return false;
  chunk_ = {};
  chunk_.index = chunks_made_++;
  if (next_vertex_ < begin_.vertex_count) {
    const std::size_t n = std::min<std::size_t>(chunk_elements_, begin_.vertex_count - next_vertex_);
    chunk_.first_vertex = next_vertex_;
    chunk_.positions = replica_.positions().subspan(3 * std::size_t{next_vertex_}, 3 * n);
    if (replica_.deformed())
      chunk_.rest_positions = replica_.rest_positions().subspan(3 * std::size_t{next_vertex_}, 3 * n);
    next_vertex_ += static_cast<std::uint32_t>(n);
    return true;
  }
  ids_.clear();
  vertices_.clear();
  regions_.clear();
  cut_masks_.clear();
  boundary_masks_.clear();
  for (; next_tet_ < replica_.tet_slots() && ids_.size() < chunk_elements_; ++next_tet_) {
    if (!replica_.alive(next_tet_)) continue;
    ids_.push_back(next_tet_);
    const auto& v = replica_.vertices(next_tet_);
    vertices_.insert(vertices_.end(), v.begin(), v.end());
    regions_.push_back(replica_.region(next_tet_));
    cut_masks_.push_back(replica_.cut_mask(next_tet_));
    boundary_masks_.push_back(replica_.boundary_mask(next_tet_));
  }
  chunk_.tets = {ids_, vertices_, regions_, cut_masks_, boundary_masks_};
  return true;
}

}  // namespace incise::protocol
