#include "server/haptics/tissue.hpp"

#include <utility>

namespace incise::haptics {

Tissue::Tissue(std::shared_ptr<const core::TetMesh> loaded)
    : body_(std::move(loaded)),
      surface_(*body_),
      cuts_(surface_.low(), surface_.high(), body_->mean_edge_length()),
      rest_(*body_, surface_) {}

void Tissue::note_cuts(const core::TetMesh& now, std::span<const core::HalfFace> faces) noexcept {
  for (const core::HalfFace face : faces) {
    const core::TetId t = core::tet_of(face);
    if (!now.alive(t) || (now.cut_mask(t) >> core::face_of(face) & 1) == 0) continue;
    const auto v = now.face_vertices(face);
    cuts_.mark(now.rest_position(v[0]), now.rest_position(v[1]), now.rest_position(v[2]));
  }
}

void Tissue::note_cuts(const core::TetMesh& now) noexcept {
  for (core::TetId t = 0; t < now.tet_slots(); ++t) {
    if (!now.alive(t) || now.cut_mask(t) == 0) continue;
    const core::HalfFace faces[4] = {core::half_face(t, 0), core::half_face(t, 1), core::half_face(t, 2),
                                     core::half_face(t, 3)};
    note_cuts(now, faces);
  }
}

}  // namespace incise::haptics
