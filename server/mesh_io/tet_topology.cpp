#include "server/mesh_io/tet_topology.hpp"

#include <algorithm>
#include <numeric>
#include <tuple>
#include <utility>

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
  const auto& tet = mesh_.tets[core::tet_of(h)];
  const auto& f = core::kFaceVertices[core::face_of(h)];
  SortedFace face{{tet[f[0]], tet[f[1]], tet[f[2]]}, false};
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

// Sorts the faces into buckets by their lowest vertex, then sorts each small bucket.
void TetTopology::match_faces() {
  const auto half_faces = static_cast<HalfFace>(4 * mesh_.tets.size());
  opposite_.assign(half_faces, kNone);
  std::vector<std::uint32_t> begin(mesh_.positions.size() + 1, 0);
  for (HalfFace h = 0; h < half_faces; ++h) ++begin[sorted_face(h).v[0] + 1];
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  struct Entry {
    VertexId mid, high;
    HalfFace h;
  };
  std::vector<Entry> entries(half_faces);
  std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
  for (HalfFace h = 0; h < half_faces; ++h) {
    const auto face = sorted_face(h);
    entries[next[face.v[0]]++] = {face.v[1], face.v[2], h};
  }
  for (VertexId v = 0; v < mesh_.positions.size(); ++v) {
    const auto first = entries.begin() + begin[v], last = entries.begin() + begin[v + 1];
    std::sort(first, last, [](const Entry& a, const Entry& b) {
      return std::tie(a.mid, a.high, a.h) < std::tie(b.mid, b.high, b.h);
    });
    for (auto it = first; it != last;) {
      auto end = it + 1;
      while (end != last && end->mid == it->mid && end->high == it->high) ++end;
      if (end - it > 2) refuse_shared_face(it->h, (it + 1)->h, (it + 2)->h, end - it);
      if (end - it == 2) {
        const HalfFace a = it->h, b = (it + 1)->h;
        if (apex(a) == apex(b)) refuse_twins(a, b);
        opposite_[a] = b;
        opposite_[b] = a;
      }
      it = end;
    }
  }
}

void TetTopology::refuse_twins(HalfFace a, HalfFace b) const {
  names_.fail(names_.tet(core::tet_of(a)) + " and " + names_.number(core::tet_of(b)) + " have the same " +
              names_.place(mesh_.tets[core::tet_of(a)]) + ": remove one of them");
}

void TetTopology::refuse_shared_face(HalfFace a, HalfFace b, HalfFace c, std::ptrdiff_t count) const {
  if (apex(a) == apex(b)) refuse_twins(a, b);
  if (apex(b) == apex(c)) refuse_twins(b, c);
  if (apex(a) == apex(c)) refuse_twins(a, c);
  const auto f = sorted_face(a).v;
  const auto tet = [this](HalfFace h) { return names_.number(core::tet_of(h)); };
  names_.fail(std::to_string(count) + " tetrahedra (" + tet(a) + ", " + tet(b) + ", " + tet(c) +
              (count > 3 ? ", ..." : "") + ") share the face with " + names_.place(f[0]) + ", " +
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
