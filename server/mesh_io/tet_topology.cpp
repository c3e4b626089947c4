#include "server/mesh_io/tet_topology.hpp"

#include <algorithm>
#include <numeric>
#include <utility>

#include "server/core/mesh/face_matching.hpp"
#include "server/mesh_io/mesh_error.hpp"

namespace incise::mesh_io {

using core::HalfFace;
using core::kNone;
using core::TetId;
using core::VertexId;

// ------------------------------------------------------------------------------------------------ TetNames

void TetNames::fail(const std::string& message) const {
  throw MeshError(file_ + ": " + message);
}

std::string TetNames::place(VertexId v) const {
  return "vertex " + number(v) + " at " + to_text(mesh_.positions[v]);
}

std::string TetNames::place(const std::array<VertexId, 4>& v) const {
  const auto& p = mesh_.positions;
  return "vertices " + number(v[0]) + ", " + number(v[1]) + ", " + number(v[2]) + ", " + number(v[3]) +
         ", around " + to_text(0.25 * (p[v[0]] + p[v[1]] + p[v[2]] + p[v[3]]));
}

// ------------------------------------------------------------------------------------------------ TetTopology

TetTopology::SortedFace TetTopology::sorted_face(HalfFace h) const {
  SortedFace face{this->face(h), false};
  const auto order = [&face](std::size_t i, std::size_t j) {
    if (face.v[i] > face.v[j]) {
      std::swap(face.v[i], face.v[j]);
      face.odd = !face.odd;
    }
  };
  order(0, 1);
  order(1, 2);
  order(0, 1);
  return face;
}

void TetTopology::match_faces() {
  opposite_.assign(4 * mesh_.tets.size(), kNone);
  turned_ = sum_in_halves(mesh_.tets.size(), [this](core::MatchPart part) { return match_faces(part); });
  refuse_twins();
}

std::size_t TetTopology::match_faces(core::MatchPart part) {
  std::size_t turned_here = 0;
  core::match_faces(
      static_cast<HalfFace>(opposite_.size()), mesh_.positions.size(), part,
      [this](HalfFace h) { return face(h); },
      [this, &turned_here](HalfFace a, HalfFace b, bool turned) {
        opposite_[a] = b;
        opposite_[b] = a;
        turned_here += turned;
      },
      [this](std::span<const HalfFace> same) { refuse_shared_face(same); });
  return turned_here;
}

// Two tetrahedra that share two faces have the same four vertices.
void TetTopology::refuse_twins() const {
  for (TetId t = 0; t < mesh_.tets.size(); ++t) {
    const HalfFace* const o = &opposite_[core::half_face(t, 0)];
    if (o[0] != kNone && o[1] != kNone && core::tet_of(o[0]) == core::tet_of(o[1]))
      refuse_twins(core::half_face(t, 0), o[0]);
  }
}

void TetTopology::refuse_twins(HalfFace a, HalfFace b) const {
  names_.fail(names_.tet(core::tet_of(a)) + " and " + names_.number(core::tet_of(b)) + " have the same " +
              names_.place(mesh_.tets[core::tet_of(a)]) + ": remove one of them");
}

void TetTopology::refuse_shared_face(std::span<const HalfFace> same) const {
  const HalfFace a = same[0], b = same[1], c = same[2];
  if (apex(a) == apex(b)) refuse_twins(a, b);
  if (apex(b) == apex(c)) refuse_twins(b, c);
  if (apex(a) == apex(c)) refuse_twins(a, c);
  const auto f = sorted_face(a).v;
  const auto tet = [this](HalfFace h) { return names_.number(core::tet_of(h)); };
  names_.fail(std::to_string(same.size()) + " tetrahedra (" + tet(a) + ", " + tet(b) + ", " + tet(c) +
              (same.size() > 3 ? ", ..." : "") + ") share the face with " + names_.place(f[0]) + ", " +
              names_.place(f[1]) + " and " + names_.place(f[2]) +
              "; a face has one or two: remove those that overlap");
}

bool TetTopology::on_boundary(TetId t) const {
  for (int f = 0; f < 4; ++f) {
    if (opposite_[core::half_face(t, f)] == kNone) return true;
  }
  return false;
}

void TetTopology::detach(TetId t) {
  for (int f = 0; f < 4; ++f) {
    const HalfFace h = core::half_face(t, f);
    if (opposite_[h] != kNone) opposite_[opposite_[h]] = kNone;
  }
}

void TetTopology::list_stars() {
  star_begin_.assign(mesh_.positions.size() + 1, 0);
  for (const auto& tet : mesh_.tets) {
    for (const VertexId v : tet) ++star_begin_[v + 1];
  }
  std::partial_sum(star_begin_.begin(), star_begin_.end(), star_begin_.begin());
  star_.resize(4 * mesh_.tets.size());
  std::vector<std::uint32_t> next(star_begin_.begin(), star_begin_.end() - 1);
  for (TetId t = 0; t < mesh_.tets.size(); ++t) {
    for (const VertexId v : mesh_.tets[t]) star_[next[v]++] = t;
  }
}

}  // namespace incise::mesh_io
