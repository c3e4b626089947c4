#include "server/core/mesh/tet_mesh.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "protocol/state_hash.hpp"
#include "server/base/check.hpp"
#include "server/core/geometry/quality.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/core/util/room.hpp"

namespace incise::core {
namespace {

std::array<VertexId, 3> sorted(std::array<VertexId, 3> f) {
  if (f[0] > f[1]) std::swap(f[0], f[1]);
  if (f[1] > f[2]) std::swap(f[1], f[2]);
  if (f[0] > f[1]) std::swap(f[0], f[1]);
  return f;
}

}  // namespace

// ------------------------------------------------------------------------------------------------ building

TetMesh::TetMesh(const MeshData& data) {
  const std::size_t vertex_count = data.positions.size(), tet_count = data.tets.size();
  if (vertex_count >= kNone / 2 || tet_count >= kNone / 16) {
    throw MeshError("the mesh has " + std::to_string(tet_count) + " tetrahedra; at most " +
                    std::to_string(kNone / 16 - 1) + " fit");
  }
  if (!data.regions.empty() && data.regions.size() != tet_count) {
    throw MeshError("regions given for " + std::to_string(data.regions.size()) + " of " +
                    std::to_string(tet_count) + " tetrahedra");
  }
  vertices_.reserve(room_for(vertex_count));
  for (const Vec3& p : data.positions) vertices_.push_back({p, kNone, 0});
  tets_.reserve(room_for(tet_count));
  attributes_.reserve(room_for(tet_count));
  for (std::size_t t = 0; t < tet_count; ++t) {
    const auto& v = data.tets[t];
    for (int i = 0; i < 4; ++i) {
      if (v[i] >= vertex_count) {
        throw MeshError("tetrahedron " + std::to_string(t) + " names vertex " + std::to_string(v[i]) +
                        " of " + std::to_string(vertex_count));
      }
      for (int j = 0; j < i; ++j) {
        if (v[i] == v[j]) {
          throw MeshError("tetrahedron " + std::to_string(t) + " names vertex " + std::to_string(v[i]) +
                          " twice");
        }
      }
      vertices_[v[i]].tet = static_cast<TetId>(t);
    }
    tets_.push_back({v, {kNone, kNone, kNone, kNone}});
    attributes_.push_back({data.regions.empty() ? 0 : data.regions[t], 0, 0});
  }
  live_tets_ = static_cast<std::uint32_t>(tet_count);
  for (const std::int32_t region : data.regions) has_regions_ = has_regions_ || region != data.regions[0];

  // Edge lengths: an edge counts once for each tetrahedron around it, which weighs it by the space it stands for.
  std::vector<double> sums(vertex_count, 0.0);
  std::vector<std::uint32_t> counts(vertex_count, 0);
  double sum = 0;
  for (const Tet& tet : tets_) {
    for (const auto& edge : kEdgeVertices) {
      const VertexId a = tet.vertices[edge[0]], b = tet.vertices[edge[1]];
      const double l = distance(vertices_[a].position, vertices_[b].position);
      sum += l;
      sums[a] += l;
      sums[b] += l;
      ++counts[a];
      ++counts[b];
    }
  }
  for (std::size_t v = 0; v < vertex_count; ++v) {
    if (counts[v] > 0) vertices_[v].h = static_cast<float>(sums[v] / counts[v]);
  }
  mean_edge_length_ = tet_count > 0 ? sum / (6.0 * static_cast<double>(tet_count)) : 0;

  vertex_mark_.reserve(room_for(vertex_count));
  record_.reserve(room_for(tet_count));
  tet_mark_.reserve(room_for(tet_count));
  vertex_mark_.resize(vertex_count, 0);
  record_.resize(tet_count, 0);
  tet_mark_.resize(tet_count, 0);
  vertices_in_order_.grow(vertex_count);
  tets_in_order_.grow(tet_count);

  build_adjacency();
  split_initial_vertices();

  touched_vertices_.clear();
  touched_tets_.clear();
  before_.clear();
  provenance_.clear();
  begin_step();
  hash_ = compute_state_hash();
}

void TetMesh::link(HalfFace a, HalfFace b) {
  if (a != kNone) tets_[tet_of(a)].opposite[face_of(a)] = b;
  if (b != kNone) tets_[tet_of(b)].opposite[face_of(b)] = a;
}

// Buckets the faces by their lowest vertex, then matches within the bucket: linear in the mesh.
void TetMesh::build_adjacency() {
  std::vector<std::uint32_t> begin(vertices_.size() + 1, 0);
  const HalfFace half_faces = 4 * tet_slots();
  for (HalfFace h = 0; h < half_faces; ++h) ++begin[sorted(face_vertices(h))[0] + 1];
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  struct Entry {
    VertexId mid, max;
    HalfFace h;
  };
  std::vector<Entry> entries(half_faces);
  {
    std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
    for (HalfFace h = 0; h < half_faces; ++h) {
      const auto f = sorted(face_vertices(h));
      entries[next[f[0]]++] = {f[1], f[2], h};
    }
  }
  for (std::size_t v = 0; v < vertices_.size(); ++v) {
    const auto first = entries.begin() + begin[v], last = entries.begin() + begin[v + 1];
    std::sort(first, last, [](const Entry& a, const Entry& b) {
      return a.mid != b.mid ? a.mid < b.mid : a.max != b.max ? a.max < b.max : a.h < b.h;
    });
    for (auto it = first; it != last;) {
      auto end = it + 1;
      while (end != last && end->mid == it->mid && end->max == it->max) ++end;
      if (end - it > 2) {
        throw MeshError("tetrahedra " + std::to_string(tet_of(it->h)) + ", " +
                        std::to_string(tet_of((it + 1)->h)) + " and " + std::to_string(tet_of((it + 2)->h)) +
                        " share the face (" + std::to_string(v) + ", " + std::to_string(it->mid) + ", " +
                        std::to_string(it->max) + ")");
      }
      if (end - it == 2) link(it->h, (it + 1)->h);
      it = end;
    }
  }
}

// Real meshes have a few vertices where two parts merely touch.
void TetMesh::split_initial_vertices() {
  std::vector<std::uint32_t> incident(vertices_.size(), 0);
  for (const Tet& tet : tets_) {
    for (VertexId v : tet.vertices) ++incident[v];
  }
  std::vector<bool> pinched(vertices_.size(), false);
  bool any = false;
  for (VertexId v = 0; v < incident.size(); ++v) {
    if (incident[v] == 0) continue;
    star(v, star_scratch_);
    if (star_scratch_.size() != incident[v]) pinched[v] = any = true;
  }
  if (!any) return;
  begin_noting(4 * tets_.size());
  for (TetId t = 0; t < tet_slots(); ++t) {
    for (std::uint32_t i = 0; i < 4; ++i) {
      if (pinched[tets_[t].vertices[i]]) note_corner(tets_[t].vertices[i], 4 * t + i);
    }
  }
  // The part that the file lists first keeps the vertex.
  for (const NotedStar& noted : noted_stars_)
    vertices_[noted.vertex].tet = noted_corners_[noted.first].corner >> 2;
  const std::uint32_t slots = vertex_slots();
  split_noted_stars();
  initial_vertex_copies_ = vertex_slots() - slots;
}

// ------------------------------------------------------------------------------------------------ queries

std::uint8_t TetMesh::boundary_mask(TetId t) const {
  unsigned mask = 0;
  for (unsigned f = 0; f < 4; ++f) mask |= (tets_[t].opposite[f] == kNone ? 1u : 0u) << f;
  return static_cast<std::uint8_t>(mask);
}

std::array<VertexId, 3> TetMesh::face_vertices(HalfFace h) const {
  const auto& v = tets_[tet_of(h)].vertices;
  const auto& f = kFaceVertices[face_of(h)];
  return {v[f[0]], v[f[1]], v[f[2]]};
}

Vec3 TetMesh::twice_area(HalfFace h) const {
  const auto v = face_vertices(h);
  const Vec3& a = position(v[0]);
  return cross(position(v[1]) - a, position(v[2]) - a);
}

int TetMesh::local_index(TetId t, VertexId v) const {
  const auto& tet = tets_[t].vertices;
  for (int i = 0; i < 4; ++i) {
    if (tet[i] == v) return i;
  }
  return -1;
}

TetState TetMesh::state(TetId t) const {
  return {t, tets_[t].vertices, attributes_[t].region, attributes_[t].cut_mask, boundary_mask(t)};
}

double TetMesh::volume(TetId t) const {
  const auto& v = tets_[t].vertices;
  return signed_volume(position(v[0]), position(v[1]), position(v[2]), position(v[3]));
}

double TetMesh::worst_dihedral(TetId t) const {
  const auto& v = tets_[t].vertices;
  return core::worst_dihedral(position(v[0]), position(v[1]), position(v[2]), position(v[3]));
}

Vec3 TetMesh::barycentre(TetId t) const {
  const auto& v = tets_[t].vertices;
  return 0.25 * ((position(v[0]) + position(v[1])) + (position(v[2]) + position(v[3])));
}

// A mark that no tetrahedron bears. After 2^32 of them, some hours of cutting, the old ones are wiped.
void TetMesh::next_mark() const {
  if (++mark_ != 0) return;
  std::fill(tet_mark_.begin(), tet_mark_.end(), 0u);
  mark_ = 1;
}

// The same for vertices: `count` marks, the last of which is vertex_mark_value_.
void TetMesh::next_vertex_marks(std::uint32_t count) const {
  if (vertex_mark_value_ > kNone - count) {
    std::fill(vertex_mark_.begin(), vertex_mark_.end(), 0u);
    vertex_mark_value_ = 0;
  }
  vertex_mark_value_ += count;
}

// The tetrahedra around v that can be reached from `from` through faces that contain v. What is found is fetched while those
// found before it are looked at: in a large mesh waiting for memory is most of this.
void TetMesh::component(VertexId v, TetId from, std::vector<std::uint32_t>& corners) const {
  std::size_t next = corners.size();
  tet_mark_[from] = mark_;
  corners.push_back(4 * from);
  while (next < corners.size()) {
    std::uint32_t& corner = corners[next++];
    const Tet& tet = tets_[corner >> 2];
    const auto& vertices = tet.vertices;
    const std::uint32_t i = vertices[0] == v ? 0 : vertices[1] == v ? 1 : vertices[2] == v ? 2 : 3;
    corner += i;
    for (std::uint32_t f = 0; f < 4; ++f) {
      if (f == i || tet.opposite[f] == kNone) continue;
      const TetId t = tet_of(tet.opposite[f]);
      if (tet_mark_[t] == mark_) continue;
      tet_mark_[t] = mark_;
      prefetch(t);
      corners.push_back(4 * t);
    }
  }
}

void TetMesh::prefetch_around(std::vector<TetId>& tets, std::size_t most) const {
  next_mark();
  for (TetId t : tets) tet_mark_[t] = mark_;
  for (std::size_t i = 0; i < tets.size(); ++i) {
    const TetId t = tets[i];
    __builtin_prefetch(&attributes_[t]);
    __builtin_prefetch(&record_[t]);
    for (VertexId v : tets_[t].vertices) {
      prefetch_position(v);
      __builtin_prefetch(&vertex_mark_[v]);
    }
    for (HalfFace h : tets_[t].opposite) {
      if (h == kNone || tet_mark_[tet_of(h)] == mark_ || tets.size() >= most) continue;
      tet_mark_[tet_of(h)] = mark_;
      prefetch(tet_of(h));
      tets.push_back(tet_of(h));
    }
  }
}

void TetMesh::star(VertexId v, std::vector<std::uint32_t>& star) const {
  star.clear();
  if (vertices_[v].tet == kNone) return;
  next_mark();
  component(v, vertices_[v].tet, star);
}

void TetMesh::ring(TetId from, VertexId a, VertexId b, std::vector<TetId>& ring) const {
  ring.clear();
  // The two vertices of `from` off the edge.
  VertexId off[2];
  int n = 0;
  for (VertexId v : tets_[from].vertices) {
    if (v != a && v != b) off[n++] = v;
  }
  INCISE_CHECK(n == 2, from, a, b);
  // Turns around the edge: leaves through the face opposite to `behind`, so that `ahead` is the next one's behind.
  const auto turn = [&](VertexId behind, VertexId ahead) {
    TetId t = from;
    for (;;) {
      const HalfFace h = tets_[t].opposite[local_index(t, behind)];
      if (h == kNone) return false;
      t = tet_of(h);
      if (t == from) return true;
      ring.push_back(t);
      behind = ahead;
      ahead = tets_[t].vertices[face_of(h)];
    }
  };
  ring.push_back(from);
  if (turn(off[0], off[1])) return;
  std::reverse(ring.begin(), ring.end());
  turn(off[1], off[0]);
}

TetId TetMesh::find_edge(VertexId a, VertexId b) const {
  if (vertices_[a].tet == kNone) return kNone;
  next_mark();
  star_scratch_.clear();
  component(a, vertices_[a].tet, star_scratch_);
  for (std::uint32_t corner : star_scratch_) {
    if (local_index(corner >> 2, b) >= 0) return corner >> 2;
  }
  return kNone;
}

// ------------------------------------------------------------------------------------------------ the record

std::uint64_t TetMesh::hash_of_vertex(VertexId v) const {
  const Vec3& p = vertices_[v].position;
  return protocol::vertex_hash(v, p.x, p.y, p.z);
}

std::uint64_t TetMesh::hash_of_tet(TetId t) const {
  return protocol::tet_hash(t, tets_[t].vertices.data(), attributes_[t].region, attributes_[t].cut_mask);
}

void TetMesh::touch_vertex(VertexId v) {
  if (is_new(v) || !vertices_in_order_.insert(v)) return;
  touched_vertices_.push_back(v);
  hash_ ^= hash_of_vertex(v);
}

void TetMesh::record_tet(TetId t, const TetState& before) {
  record_[t] = static_cast<std::uint32_t>(touched_tets_.size());
  touched_tets_.push_back(t);
  before_.push_back(before);
}

void TetMesh::touch_tet(TetId t) {
  if (is_new_tet(t) || !tets_in_order_.insert(t)) return;
  record_tet(t, state(t));
  hash_ ^= hash_of_tet(t);
}

VertexId TetMesh::add_vertex(const Vec3& position, const Provenance& provenance, float h) {
  const VertexId v = vertex_slots();
  vertices_.push_back({position, kNone, h});
  vertex_mark_.push_back(0);
  provenance_.push_back(provenance);
  if (deformed()) rest_.push_back(lerp(rest_[provenance.a], rest_[provenance.b], provenance.t));
  return v;
}

TetId TetMesh::add_tet(const std::array<VertexId, 4>& vertices, TetId parent) {
  const TetId t = tet_slots();
  tets_.push_back({vertices, {kNone, kNone, kNone, kNone}});
  attributes_.push_back({attributes_[parent].region, attributes_[parent].piece, 0});
  tet_mark_.push_back(0);
  record_.push_back(0);
  record_tet(t, {});
  ++live_tets_;
  return t;
}

void TetMesh::kill_tet(TetId t) {
  touch_tet(t);
  tets_[t].vertices[0] = kNone;
  --live_tets_;
}

void TetMesh::clear_mesh(Delta& delta) {
  delta.moved.clear();
  delta.moved_positions.clear();
  delta.added_positions.clear();
  delta.provenance.clear();
  delta.moved_rest.clear();
  delta.added_rest.clear();
  delta.upserted.clear();
  delta.removed.clear();
  delta.boundary_upserted.clear();
  delta.boundary_removed.clear();
}

void TetMesh::commit(Delta& delta) {
  WorkBudget budget = WorkBudget::unlimited();
  commit(delta, budget);
}

bool TetMesh::commit(Delta& delta, WorkBudget& budget) {
  if (committing_ == Committing::kNothing) {
    clear_mesh(delta);
    delta.first_added = first_new_vertex_;
    commit_sides_ = 0;
    commit_side_area_ = 0;
    committing_ = Committing::kMoved;
  }
  if (committing_ == Committing::kMoved) {
    while (!vertices_in_order_.empty()) {
      if (budget.spent()) return false;
      budget.charge(2);
      const VertexId v = vertices_in_order_.take();
      hash_ ^= hash_of_vertex(v);
      delta.moved.push_back(v);
      delta.moved_positions.push_back(vertices_[v].position);
      if (deformed()) delta.moved_rest.push_back(rest_[v]);
    }
    next_commit_ = 0;
    committing_ = Committing::kAdded;
  }
  if (committing_ == Committing::kAdded) {
    for (; next_commit_ < provenance_.size(); ++next_commit_) {
      if (budget.spent()) return false;
      budget.charge(1);
      const VertexId v = first_new_vertex_ + static_cast<VertexId>(next_commit_);
      hash_ ^= hash_of_vertex(v);
      delta.added_positions.push_back(vertices_[v].position);
      delta.provenance.push_back(provenance_[next_commit_]);
      if (deformed()) delta.added_rest.push_back(rest_[v]);
    }
    committing_ = Committing::kTets;
  }
  if (committing_ == Committing::kTets) {
    while (!tets_in_order_.empty()) {
      if (budget.spent()) return false;
      budget.charge(2);
      commit_tet(tets_in_order_.take(), delta);
    }
    next_commit_ = first_new_tet_;
    committing_ = Committing::kNewTets;
  }
  for (; next_commit_ < tet_slots(); ++next_commit_) {
    if (budget.spent()) return false;
    budget.charge(2);
    commit_tet(static_cast<TetId>(next_commit_), delta);
  }
  end_commit(delta);
  return true;
}

// What the step has made of one tetrahedron that it touched.
void TetMesh::commit_tet(TetId t, Delta& delta) {
  const TetState& before = before_[record_[t]];
  const auto count_sides = [&](const TetState& tet, int sign) {
    for (int f = 0; f < 4; ++f) {
      if (!(tet.cut_mask >> f & 1)) continue;
      const Vec3& a = position(tet.vertices[kFaceVertices[f][0]]);
      const Vec3 n = cross(position(tet.vertices[kFaceVertices[f][1]]) - a,
                           position(tet.vertices[kFaceVertices[f][2]]) - a);
      commit_sides_ += sign;
      commit_side_area_ += sign * 0.5 * length(n);
    }
  };
  const bool existed = before.id != kNone;
  const bool lives = alive(t);
  if (lives) {
    delta.upserted.push_back(state(t));
    hash_ ^= hash_of_tet(t);
  } else if (existed) {
    delta.removed.push_back(t);
  }
  const TetState after = lives ? delta.upserted.back() : TetState{};
  if (existed) count_sides(before, -1);
  if (lives) count_sides(after, 1);
  for (int f = 0; f < 4; ++f) {
    const bool was = existed && (before.boundary_mask >> f & 1);
    const bool is = lives && (after.boundary_mask >> f & 1);
    if (is) {
      const auto same = [&](int k) {
        return before.vertices[kFaceVertices[f][k]] == after.vertices[kFaceVertices[f][k]];
      };
      const bool cut_as_before = (before.cut_mask >> f & 1) == (after.cut_mask >> f & 1);
      if (!was || !cut_as_before || !same(0) || !same(1) || !same(2)) {
        delta.boundary_upserted.push_back(half_face(t, f));
      }
    } else if (was) {
      delta.boundary_removed.push_back(half_face(t, f));
    }
  }
}

void TetMesh::end_commit(Delta& delta) {
  // Of the totals, so that steps with an odd number of sides add up.
  const std::int64_t faces_before = (cut_sides_ + 1) / 2;
  cut_sides_ += commit_sides_;
  delta.cut_faces =
      static_cast<std::uint32_t>(std::max<std::int64_t>((cut_sides_ + 1) / 2 - faces_before, 0));
  delta.cut_area = std::max(0.5 * commit_side_area_, 0.0);

  touched_vertices_.clear();
  touched_tets_.clear();
  before_.clear();
  provenance_.clear();
  begin_step();
  delta.state_hash = hash_;
  committing_ = Committing::kNothing;
}

// All that there is, is old.
void TetMesh::begin_step() {
  first_new_vertex_ = vertex_slots();
  first_new_tet_ = tet_slots();
  vertices_in_order_.grow(vertex_slots());
  tets_in_order_.grow(tet_slots());
}

std::uint64_t TetMesh::compute_state_hash() const {
  std::uint64_t hash = 0;
  for (VertexId v = 0; v < vertex_slots(); ++v) hash ^= hash_of_vertex(v);
  for (TetId t = 0; t < tet_slots(); ++t) {
    if (alive(t)) hash ^= hash_of_tet(t);
  }
  return hash;
}

// ------------------------------------------------------------------------------------------------ changes

void TetMesh::move_vertex(VertexId v, const Vec3& position) {
  touch_vertex(v);
  if (deformed()) rest_[v] = rest_at(v, position);
  vertices_[v].position = position;
}

VertexId TetMesh::split_edge(TetId from, VertexId a, VertexId b, double t) {
  ring(from, a, b, ring_scratch_);
  const float h = 0.5f * (vertices_[a].h + vertices_[b].h);
  const VertexId m = add_vertex(lerp(position(a), position(b), t), {a, b, t}, h);
  const std::size_t n = ring_scratch_.size();
  const TetId first_half = tet_slots();
  for (TetId tet : ring_scratch_) {
    touch_tet(tet);
    std::array<VertexId, 4> half = tets_[tet].vertices;
    for (VertexId& v : half) {
      if (v == a) v = m;
    }
    add_tet(half, tet);
  }
  // The half at b of the ring's r-th tetrahedron is first_half + r, laid out as the tetrahedron was.
  for (std::size_t r = 0; r < n; ++r) {
    const TetId near = ring_scratch_[r];
    const TetId far = first_half + static_cast<TetId>(r);
    const int i = local_index(near, a), j = local_index(near, b);
    for (int k = 0; k < 4; ++k) {
      const HalfFace h_near = tets_[near].opposite[k];
      if (k == i) {
        link(half_face(far, i), h_near);
      } else if (k != j && h_near != kNone) {
        const TetId other = tet_of(h_near);
        const std::size_t next = r + 1 == n ? 0 : r + 1, previous = r == 0 ? n - 1 : r - 1;
        const std::size_t q = ring_scratch_[next] == other ? next : previous;
        tets_[far].opposite[k] = half_face(first_half + static_cast<TetId>(q), face_of(h_near));
      }
    }
    link(half_face(near, i), half_face(far, j));
    const unsigned mask = attributes_[near].cut_mask, bit_i = 1u << i, bit_j = 1u << j;
    attributes_[far].cut_mask = static_cast<std::uint8_t>(mask & ~bit_j);
    attributes_[near].cut_mask = static_cast<std::uint8_t>(mask & ~bit_i);
    tets_[near].vertices[j] = m;
  }
  vertices_[m].tet = ring_scratch_[0];
  vertices_[b].tet = first_half;
  return m;
}

bool TetMesh::may_collapse(TetId from, VertexId v, VertexId w) const {
  ring(from, v, w, ring_scratch_);
  // Vertices of the edge's link carry the first mark, or the second where the boundary joins them to w; the other neighbours
  // of w the third.
  next_vertex_marks(3);
  const std::uint32_t at_w = vertex_mark_value_, along_w = at_w - 1, in_ring = at_w - 2;
  const auto in_link = [&](VertexId x) { return vertex_mark_[x] == in_ring || vertex_mark_[x] == along_w; };
  for (TetId t : ring_scratch_) {
    for (VertexId x : tets_[t].vertices) vertex_mark_[x] = in_ring;
    // Between two boundary faces nothing would be left to hold the edge opposite.
    if (tets_[t].opposite[local_index(t, v)] == kNone && tets_[t].opposite[local_index(t, w)] == kNone)
      return false;
  }
  star(w, star_scratch_);
  for (std::uint32_t corner : star_scratch_) {
    for (VertexId x : tets_[corner >> 2].vertices) {
      if (!in_link(x)) vertex_mark_[x] = at_w;
    }
    for (std::uint32_t f = 0; f < 4; ++f) {
      if (f == (corner & 3u) || tets_[corner >> 2].opposite[f] != kNone) continue;
      for (VertexId x : face_vertices(4 * (corner >> 2) + f)) {
        if (in_link(x)) vertex_mark_[x] = along_w;
      }
    }
  }
  star(v, star_scratch_);
  // In boundary faces at v: vertices that the boundary joins to w, too, without w and with it.
  VertexId with_both[2] = {kNone, kNone}, without_w[8];
  std::size_t both = 0, without = 0;
  bool on_boundary = false;
  for (std::uint32_t corner : star_scratch_) {
    const TetId t = corner >> 2;
    const auto& tet = tets_[t].vertices;
    int link_vertices = 0;
    bool has_w = false;
    for (VertexId x : tet) {
      if (x == v) continue;
      if (vertex_mark_[x] == at_w) return false;
      has_w = has_w || x == w;
      link_vertices += in_link(x) ? 1 : 0;
    }
    for (std::uint32_t f = 0; f < 4; ++f) {
      if (f == (corner & 3u) || tets_[t].opposite[f] != kNone) continue;
      on_boundary = true;
      const auto face = face_vertices(4 * t + f);
      const bool with_w = face[0] == w || face[1] == w || face[2] == w;
      for (VertexId x : face) {
        if (x == v || x == w || vertex_mark_[x] != along_w) continue;
        if (with_w ? both == 2 : without == 8) return false;
        (with_w ? with_both[both++] : without_w[without++]) = x;
      }
    }
    // Two of the link's vertices in a face at v: where the edge between them is not around (v, w), it may be in w's
    // link as well. Three are in three such faces.
    if (has_w || link_vertices < 2) continue;
    for (int i = 0; i < 4; ++i) {
      for (int j = 0; j < i; ++j) {
        const VertexId x = tet[i], y = tet[j];
        if (x == v || y == v || !in_link(x) || !in_link(y)) continue;
        const bool around = std::any_of(ring_scratch_.begin(), ring_scratch_.end(), [&](TetId r) {
          return local_index(r, x) >= 0 && local_index(r, y) >= 0;
        });
        if (!around) return false;
      }
    }
  }
  // The same for the boundary: the edge lies on it, too, and no other vertex is joined to both along it.
  return !on_boundary || (both == 2 && std::all_of(without_w, without_w + without, [&](VertexId x) {
                            return x == with_both[0] || x == with_both[1];
                          }));
}

void TetMesh::collapse(TetId from, VertexId v, VertexId w) {
  ring(from, v, w, ring_scratch_);
  star(v, star_scratch_);
  for (TetId t : ring_scratch_) {
    const int at_v = local_index(t, v), at_w = local_index(t, w);
    const HalfFace beyond_v = tets_[t].opposite[at_v];  // across the face that has w
    const HalfFace beyond_w = tets_[t].opposite[at_w];
    for (HalfFace h : {beyond_v, beyond_w}) {
      if (h == kNone) continue;
      // A vertex that named this tetrahedron finds a neighbour there.
      for (VertexId x : tets_[tet_of(h)].vertices) {
        if (vertices_[x].tet == t) vertices_[x].tet = tet_of(h);
      }
    }
    // What lay beyond one of the two faces lies at the boundary now where the other one did, and at a cut where that was one.
    const auto expose = [&](HalfFace h, int was) {
      touch_tet(tet_of(h));
      const bool cut = (attributes_[t].cut_mask >> was & 1) != 0;
      if (cut) attributes_[tet_of(h)].cut_mask |= static_cast<std::uint8_t>(1u << face_of(h));
    };
    if (beyond_v == kNone && beyond_w != kNone) expose(beyond_w, at_v);
    if (beyond_w == kNone && beyond_v != kNone) expose(beyond_v, at_w);
    link(beyond_v, beyond_w);
  }
  for (TetId t : ring_scratch_) kill_tet(t);
  for (std::uint32_t corner : star_scratch_) {
    const TetId t = corner >> 2;
    if (!alive(t)) continue;
    touch_tet(t);
    tets_[t].vertices[corner & 3u] = w;
    vertices_[w].tet = t;
  }
  vertices_[v].tet = kNone;
}

void TetMesh::begin_noting(std::size_t most_corners) {
  next_vertex_marks(static_cast<std::uint32_t>(most_corners));
  first_noted_mark_ = vertex_mark_value_ - static_cast<std::uint32_t>(most_corners) + 1;
  noted_stars_.clear();
  noted_corners_.clear();
}

void TetMesh::note_corner(VertexId v, std::uint32_t corner) {
  const auto at = static_cast<std::uint32_t>(noted_corners_.size());
  noted_corners_.push_back({corner, kNone});
  const std::uint32_t star = vertex_mark_[v] - first_noted_mark_;
  if (vertex_mark_[v] < first_noted_mark_) {
    vertex_mark_[v] = first_noted_mark_ + static_cast<std::uint32_t>(noted_stars_.size());
    noted_stars_.push_back({v, at, at});
  } else {
    noted_corners_[noted_stars_[star].last].next = at;
    noted_stars_[star].last = at;
  }
}

void TetMesh::open_side(HalfFace side) {
  const TetId t = tet_of(side);
  touch_tet(t);
  tets_[t].opposite[face_of(side)] = kNone;
  attributes_[t].cut_mask |= static_cast<std::uint8_t>(1u << face_of(side));
  for (const int i : kFaceVertices[face_of(side)])
    note_corner(tets_[t].vertices[i], 4 * t + static_cast<std::uint32_t>(i));
}

void TetMesh::split_noted_stars() {
  for (const NotedStar& noted : noted_stars_) {
    next_mark();
    const VertexId v = noted.vertex;
    star_scratch_.clear();
    component(v, vertices_[v].tet, star_scratch_);
    for (std::uint32_t c = noted.first; c != kNone; c = noted_corners_[c].next) {
      const TetId t = noted_corners_[c].corner >> 2;
      if (tet_mark_[t] == mark_) continue;
      star_scratch_.clear();
      component(v, t, star_scratch_);
      const VertexId copy = add_vertex(vertices_[v].position, {v, v, 0}, vertices_[v].h);
      vertices_[copy].tet = t;
      for (std::uint32_t corner : star_scratch_) {
        touch_tet(corner >> 2);
        tets_[corner >> 2].vertices[corner & 3u] = copy;
      }
    }
  }
}

std::uint32_t TetMesh::open_faces(std::span<const HalfFace> faces) {
  begin_noting(6 * faces.size());
  std::uint32_t opened = 0;
  for (HalfFace h : faces) {
    const HalfFace o = opposite(h);
    if (o == kNone) continue;
    ++opened;
    open_side(h);
    open_side(o);
  }
  split_noted_stars();
  return opened;
}

void TetMesh::remove_tet(TetId t) {
  begin_noting(12);
  for (int f = 0; f < 4; ++f) {
    const HalfFace o = tets_[t].opposite[f];
    if (o != kNone) open_side(o);
  }
  for (int i = 0; i < 4; ++i) {
    const VertexId v = tets_[t].vertices[i];
    if (vertices_[v].tet != t) continue;
    // Another one that has the vertex, beyond a face at it, if there is one.
    vertices_[v].tet = kNone;
    for (int f = 0; f < 4; ++f) {
      if (f != i && tets_[t].opposite[f] != kNone) vertices_[v].tet = tet_of(tets_[t].opposite[f]);
    }
  }
  kill_tet(t);
  split_noted_stars();
}

bool TetMesh::replace(std::span<const TetId> removed, std::span<const std::array<VertexId, 4>> added,
                      std::vector<TetId>& new_ids) {
  constexpr std::size_t kMost = 32;
  struct Face {
    std::array<VertexId, 3> vertices;  // ascending
    HalfFace outside = kNone;          // for faces of the removed set: what lies beyond
    std::uint32_t side = 0;            // for faces of the added set: 4 i + f
    bool cut = false, matched = false;
  };
  new_ids.clear();
  if (removed.empty() || removed.size() > kMost || added.size() > kMost) return false;
  const auto within = [&](TetId t) { return std::find(removed.begin(), removed.end(), t) != removed.end(); };
  std::array<Face, 4 * kMost> shell;
  std::size_t shell_size = 0;
  for (TetId t : removed) {
    for (int f = 0; f < 4; ++f) {
      const HalfFace o = tets_[t].opposite[f];
      if (o != kNone && within(tet_of(o))) continue;
      shell[shell_size++] = {sorted(face_vertices(half_face(t, f))), o, 0,
                             (attributes_[t].cut_mask >> f & 1) != 0, false};
    }
  }
  // Match the faces of the added set with the shell, then with each other.
  std::array<std::uint32_t, 4 * kMost>
      partner;  // 4 i + f of the other side, or kNone - 1 - (index in the shell)
  partner.fill(kNone);
  const auto face_of_added = [&](std::size_t i, int f) {
    const auto& k = kFaceVertices[f];
    return sorted({added[i][k[0]], added[i][k[1]], added[i][k[2]]});
  };
  std::size_t shell_matched = 0;
  for (std::size_t i = 0; i < added.size(); ++i) {
    for (int f = 0; f < 4; ++f) {
      if (partner[4 * i + f] != kNone) continue;
      const auto face = face_of_added(i, f);
      bool found = false;
      for (std::size_t s = 0; s < shell_size && !found; ++s) {
        if (shell[s].matched || shell[s].vertices != face) continue;
        shell[s].matched = found = true;
        shell[s].side = static_cast<std::uint32_t>(4 * i + f);
        ++shell_matched;
        partner[4 * i + f] = kNone - 1;
      }
      for (std::size_t j = i + 1; j < added.size() && !found; ++j) {
        for (int g = 0; g < 4 && !found; ++g) {
          if (partner[4 * j + g] != kNone || face_of_added(j, g) != face) continue;
          found = true;
          partner[4 * i + f] = static_cast<std::uint32_t>(4 * j + g);
          partner[4 * j + g] = static_cast<std::uint32_t>(4 * i + f);
        }
      }
      if (!found) return false;
    }
  }
  if (shell_matched != shell_size) return false;

  const TetId first = tet_slots();
  for (const auto& vertices : added) new_ids.push_back(add_tet(vertices, removed[0]));
  for (std::size_t i = 0; i < added.size(); ++i) {
    for (int f = 0; f < 4; ++f) {
      const std::uint32_t p = partner[4 * i + f];
      if (p < kNone - 1) tets_[new_ids[i]].opposite[f] = 4 * first + p;
      vertices_[added[i][f]].tet = new_ids[i];
    }
  }
  for (std::size_t s = 0; s < shell_size; ++s) {
    const HalfFace h = 4 * first + shell[s].side;
    link(h, shell[s].outside);
    if (shell[s].cut) attributes_[tet_of(h)].cut_mask |= static_cast<std::uint8_t>(1u << face_of(h));
  }
  for (TetId t : removed) {
    for (VertexId v : tets_[t].vertices) {
      // A vertex that the added set does not have (a collapse) is left without this tetrahedron.
      if (vertices_[v].tet == t) vertices_[v].tet = kNone;
    }
    kill_tet(t);
  }
  return true;
}

MeshData TetMesh::export_data() const {
  MeshData data;
  std::vector<VertexId> renumbered(vertices_.size(), kNone);
  for (const Tet& tet : tets_) {
    if (tet.vertices[0] == kNone) continue;
    for (VertexId v : tet.vertices) renumbered[v] = 0;
  }
  for (VertexId v = 0; v < vertex_slots(); ++v) {
    if (renumbered[v] == kNone) continue;
    renumbered[v] = static_cast<VertexId>(data.positions.size());
    data.positions.push_back(vertices_[v].position);
  }
  for (TetId t = 0; t < tet_slots(); ++t) {
    if (!alive(t)) continue;
    const auto& v = tets_[t].vertices;
    data.tets.push_back({renumbered[v[0]], renumbered[v[1]], renumbered[v[2]], renumbered[v[3]]});
    data.regions.push_back(attributes_[t].region);
  }
  return data;
}

void TetMesh::archive(Archive& io) {
  io(mean_edge_length_);
  io(initial_vertex_copies_);
  io(has_regions_);
  io(cut_sides_);
  io(hash_);
  io.list(vertices_, 32, [&](Vertex& v) {
    io(v.position);
    io(v.tet);
    io(v.h);
  });
  io.list(rest_, 24, [&](Vec3& rest) { io(rest); });
  io.list(tets_, 32, [&](Tet& t) {
    for (VertexId& v : t.vertices) io(v);
    for (HalfFace& o : t.opposite) io(o);
  });
  io.list(attributes_, 9, [&](Attributes& a) {
    io(a.region);
    io(a.piece);
    io(a.cut_mask);
  });
  if (!io.reads()) return;
  check_restored(io);
  if (io.failed()) return;
  grow_to(vertices_, vertices_.size());
  if (deformed()) grow_to(rest_, rest_.size());
  grow_to(tets_, tets_.size());
  grow_to(attributes_, tets_.size());
  grow_to(vertex_mark_, vertices_.size());
  grow_to(record_, tets_.size());
  grow_to(tet_mark_, tets_.size());
  begin_step();
  const std::string problem = validate(*this, false);
  io.demand(problem.empty(), problem.c_str());
}

// That no index leads astray; validate() looks at the rest.
void TetMesh::check_restored(Archive& io) {
  io.demand(tets_.size() < kNone / 16 && vertices_.size() < kNone / 2, "the mesh is too large");
  io.demand(attributes_.size() == tets_.size(), "attributes and tetrahedra differ in number");
  io.demand(rest_.empty() || rest_.size() == vertices_.size(),
            "rest positions and vertices differ in number");
  io.demand(mean_edge_length_ > 0 && std::isfinite(mean_edge_length_), "h is not positive");
  if (io.failed()) return;
  live_tets_ = 0;
  for (const Tet& t : tets_) {
    if (t.vertices[0] == kNone) continue;
    ++live_tets_;
    for (VertexId v : t.vertices) io.demand(v < vertex_slots(), "a tetrahedron names no vertex");
    for (HalfFace o : t.opposite) {
      io.demand(o == kNone || (tet_of(o) < tet_slots() && alive(tet_of(o))), "a neighbour does not exist");
    }
  }
  if (io.failed()) return;
  for (VertexId v = 0; v < vertex_slots(); ++v) {
    const TetId t = vertex_tet(v);
    io.demand(t == kNone || (t < tet_slots() && alive(t) && local_index(t, v) >= 0),
              "a vertex names a tetrahedron that does not have it");
    io.demand(vertices_[v].h >= 0 && std::isfinite(vertices_[v].h), "a local width is no length");
  }
}

}  // namespace incise::core
