#include <algorithm>

#include "server/core/mesh/tet_mesh.hpp"

// TetMesh: the operations that change it.
namespace incise::core {
void TetMesh::link(HalfFace a, HalfFace b) {
  if (a != kNone) tets_[tet_of(a)].opposite[face_of(a)] = b;
  if (b != kNone) tets_[tet_of(b)].opposite[face_of(b)] = a;
}

VertexId TetMesh::add_vertex(const Vec3& position, const Provenance& provenance, float h) {
  const VertexId v = vertex_slots();
  vertices_.push_back({position, kNone, h});
  at_boundary_.push_back(0);
  vertex_marks_.push_back();
  log_.add_vertex(provenance);
  if (deformed()) rest_.push_back(lerp(rest_[provenance.a], rest_[provenance.b], provenance.t));
  return v;
}

TetId TetMesh::add_tet(const std::array<VertexId, 4>& vertices, TetId parent) {
  const TetId t = tet_slots();
  tets_.push_back({vertices, {kNone, kNone, kNone, kNone}});
  if (!regions_.empty()) regions_.push_back(regions_[parent]);
  cut_masks_.push_back(0);
  tet_marks_.push_back();
  log_.add_tet(t, parent);
  ++live_tets_;
  return t;
}

void TetMesh::kill_tet(TetId t) {
  log_.touch_tet(*this, t);
  tets_[t].vertices[0] = kNone;
  --live_tets_;
}

void TetMesh::move_vertex(VertexId v, const Vec3& position) {
  log_.touch_vertex(*this, v);
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
    log_.touch_tet(*this, tet);
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
      } else if (k != j) {
        at_boundary_[m] = kAtBoundary | (at_boundary_[a] & at_boundary_[b] & kAtCut);
      }
    }
    link(half_face(near, i), half_face(far, j));
    const unsigned mask = cut_masks_[near], bit_i = 1u << i, bit_j = 1u << j;
    cut_masks_[far] = static_cast<std::uint8_t>(mask & ~bit_j);
    cut_masks_[near] = static_cast<std::uint8_t>(mask & ~bit_i);
    tets_[near].vertices[j] = m;
  }
  vertices_[m].tet = ring_scratch_[0];
  vertices_[b].tet = first_half;
  return m;
}

// Vertices of the edge's link carry the first of three marks, or the second where the boundary joins them to w; the other
// neighbours of w carry the third.
struct TetMesh::LinkMarks {
  std::uint32_t ring, along_w, at_w;
  bool holds(std::uint32_t mark) const { return mark == ring || mark == along_w; }
};

// The same for the boundary: the edge lies on it, too, and no other vertex is joined to both along it. Of faces at v: vertices
// that the boundary joins to w, too, without w and with it.
struct TetMesh::BoundaryLink {
  VertexId with_both[2] = {kNone, kNone}, without_w[8];
  std::size_t both = 0, without = 0;
  bool any = false;

  // False where there are too many.
  bool add(const TetMesh& mesh, HalfFace h, VertexId v, VertexId w, const LinkMarks& marks) {
    any = true;
    const auto face = mesh.face_vertices(h);
    const bool with_w = face[0] == w || face[1] == w || face[2] == w;
    for (VertexId x : face) {
      if (x == v || x == w || mesh.vertex_marks_[x] != marks.along_w) continue;
      if (with_w ? both == 2 : without == 8) return false;
      (with_w ? with_both[both++] : without_w[without++]) = x;
    }
    return true;
  }
  bool may_go() const {
    return !any || (both == 2 && std::all_of(without_w, without_w + without, [this](VertexId x) {
                      return x == with_both[0] || x == with_both[1];
                    }));
  }
};

bool TetMesh::may_collapse(TetId from, VertexId v, VertexId w) const {
  ring(from, v, w, ring_scratch_);
  const std::uint32_t first = vertex_marks_.fresh(3);
  const LinkMarks marks{first, first + 1, first + 2};
  for (TetId t : ring_scratch_) {
    for (VertexId x : tets_[t].vertices) vertex_marks_[x] = marks.ring;
    // Between two boundary faces nothing would be left to hold the edge opposite.
    if (tets_[t].opposite[local_index(t, v)] == kNone && tets_[t].opposite[local_index(t, w)] == kNone)
      return false;
  }
  mark_link_of(w, marks);
  star(v, star_scratch_);
  BoundaryLink boundary;
  for (const Corner corner : star_scratch_) {
    const TetId t = tet_of(corner);
    int link_vertices = 0;
    bool has_w = false;
    for (VertexId x : tets_[t].vertices) {
      if (x == v) continue;
      if (vertex_marks_[x] == marks.at_w) return false;
      has_w = has_w || x == w;
      link_vertices += marks.holds(vertex_marks_[x]) ? 1 : 0;
    }
    for (int f = 0; f < 4; ++f) {
      if (f == index_of(corner) || tets_[t].opposite[f] != kNone) continue;
      if (!boundary.add(*this, half_face(t, f), v, w, marks)) return false;
    }
    // Two of the link's vertices in a face at v: where the edge between them is not around (v, w), it may be in w's
    // link as well. Three are in three such faces.
    if (!has_w && link_vertices >= 2 && !edges_are_around(t, v, marks)) return false;
  }
  return boundary.may_go();
}

void TetMesh::mark_link_of(VertexId w, const LinkMarks& marks) const {
  star(w, star_scratch_);
  for (const Corner corner : star_scratch_) {
    const TetId t = tet_of(corner);
    for (VertexId x : tets_[t].vertices) {
      if (!marks.holds(vertex_marks_[x])) vertex_marks_[x] = marks.at_w;
    }
    for (int f = 0; f < 4; ++f) {
      if (f == index_of(corner) || tets_[t].opposite[f] != kNone) continue;
      for (VertexId x : face_vertices(half_face(t, f))) {
        if (marks.holds(vertex_marks_[x])) vertex_marks_[x] = marks.along_w;
      }
    }
  }
}

// Whether each edge of t between two vertices of the link belongs to a tetrahedron of the ring.
bool TetMesh::edges_are_around(TetId t, VertexId v, const LinkMarks& marks) const {
  const auto& tet = tets_[t].vertices;
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < i; ++j) {
      const VertexId x = tet[i], y = tet[j];
      if (x == v || y == v || !marks.holds(vertex_marks_[x]) || !marks.holds(vertex_marks_[y])) continue;
      const bool around = std::any_of(ring_scratch_.begin(), ring_scratch_.end(), [&](TetId r) {
        return local_index(r, x) >= 0 && local_index(r, y) >= 0;
      });
      if (!around) return false;
    }
  }
  return true;
}

void TetMesh::collapse(TetId from, VertexId v, VertexId w) {
  ring(from, v, w, ring_scratch_);
  star(v, star_scratch_);
  const VertexId healed = apex_of_both_sides(v, w);
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
      log_.touch_tet(*this, tet_of(h));
      const bool cut = (cut_masks_[t] >> was & 1) != 0;
      if (cut) cut_masks_[tet_of(h)] |= static_cast<std::uint8_t>(1u << face_of(h));
    };
    if (beyond_v == kNone && beyond_w != kNone) expose(beyond_w, at_v);
    if (beyond_w == kNone && beyond_v != kNone) expose(beyond_v, at_w);
    link(beyond_v, beyond_w);
  }
  for (TetId t : ring_scratch_) kill_tet(t);
  for (const Corner corner : star_scratch_) {
    const TetId t = tet_of(corner);
    if (!alive(t)) continue;
    log_.touch_tet(*this, t);
    tets_[t].vertices[index_of(corner)] = w;
    vertices_[w].tet = t;
  }
  vertices_[v].tet = kNone;
  at_boundary_[w] |= std::exchange(at_boundary_[v], std::uint8_t{0});
  if (healed == kNone) return;
  for (const VertexId x : {w, healed}) {
    if (!has_boundary_face(x)) at_boundary_[x] = 0;
  }
}

// The third vertex of a face that alone was opened between v and w, with both of its sides at the boundary: a collapse closes it. Of
// the ring of the edge.
VertexId TetMesh::apex_of_both_sides(VertexId v, VertexId w) const {
  if (!at_boundary(v) || !at_boundary(w)) return kNone;
  VertexId first = kNone;
  for (const TetId t : ring_scratch_) {
    for (int f = 0; f < 4; ++f) {
      const VertexId off = tets_[t].vertices[f];
      if (off == v || off == w || tets_[t].opposite[f] != kNone) continue;
      for (const VertexId x : face_vertices(half_face(t, f))) {
        if (x == v || x == w) continue;
        if (x == first) return x;
        if (first == kNone) first = x;
      }
    }
  }
  return kNone;
}

bool TetMesh::has_boundary_face(VertexId v) const {
  star(v, star_scratch_);
  return std::ranges::any_of(
      star_scratch_, [this](Corner c) { return (boundary_mask(tet_of(c)) & ~(1u << index_of(c))) != 0; });
}

// Whether an edge of tetrahedron `from` has tetrahedra all around it.
bool TetMesh::is_inside(TetId from, VertexId a, VertexId b) const {
  if (!at_boundary(a) || !at_boundary(b)) return true;
  VertexId off[2];
  int n = 0;
  for (VertexId v : tets_[from].vertices) {
    if (v != a && v != b) off[n++] = v;
  }
  VertexId behind = off[0], ahead = off[1];
  for (TetId t = from;;) {
    const HalfFace h = tets_[t].opposite[local_index(t, behind)];
    if (h == kNone) return false;
    t = tet_of(h);
    if (t == from) return true;
    behind = ahead;
    ahead = tets_[t].vertices[face_of(h)];
  }
}

// Bit k: the face's edge from its k-th vertex to the next one is.
unsigned TetMesh::edges_inside(HalfFace h) const {
  const auto v = face_vertices(h);
  unsigned inside = 0;
  for (std::size_t k = 0; k < 3; ++k) inside |= (is_inside(tet_of(h), v[k], v[(k + 1) % 3]) ? 1u : 0u) << k;
  return inside;
}

void TetMesh::begin_noting(std::size_t max_stars) {
  noted_.first_mark = vertex_marks_.fresh(static_cast<std::uint32_t>(max_stars));
  noted_.stars.clear();
  noted_.sides.clear();
}

void TetMesh::note_side(VertexId v, HalfFace side) {
  const auto at = static_cast<std::uint32_t>(noted_.sides.size());
  noted_.sides.push_back({side, kNone});
  const std::uint32_t star = vertex_marks_[v] - noted_.first_mark;
  if (vertex_marks_[v] < noted_.first_mark) {
    vertex_marks_[v] = noted_.first_mark + static_cast<std::uint32_t>(noted_.stars.size());
    noted_.stars.push_back({v, at, at});
  } else {
    noted_.sides[noted_.stars[star].last].next = at;
    noted_.stars[star].last = at;
  }
}

void TetMesh::open_side(HalfFace side) {
  const TetId t = tet_of(side);
  log_.touch_tet(*this, t);
  tets_[t].opposite[face_of(side)] = kNone;
  cut_masks_[t] |= static_cast<std::uint8_t>(1u << face_of(side));
  for (const VertexId v : face_vertices(side)) {
    note_side(v, side);
    at_boundary_[v] = kAtBoundary | kAtCut;
  }
}

// Whether the faces that open_faces() has opened may part a star. Around an edge that was inside the tissue, and at which no other one
// opens, a face's sides hang together still: it parts nothing, so its other edge may be such a one to the next. Faces around a vertex
// open in several turns, as a rule, and only the last of them parts its star.
bool TetMesh::may_part(const Noted::Star& star) const {
  struct Opened {
    VertexId ends[2];
    bool inside[2];  // the edges to them were
  };
  constexpr std::size_t kMax = 16;
  Opened opened[kMax];
  std::size_t count = 0;
  // Both sides of each face are noted one after the other, six times in all.
  for (std::uint32_t s = star.first; s != kNone; s = noted_.sides[noted_.sides[s].next].next) {
    if (count == kMax) return true;
    const auto v = face_vertices(noted_.sides[s].side);
    const unsigned inside = edges_inside_[s / 6];
    const std::size_t k = v[0] == star.vertex ? 0 : v[1] == star.vertex ? 1 : 2;
    const std::size_t next = (k + 1) % 3, last = (k + 2) % 3;
    opened[count++] = {{v[next], v[last]}, {(inside >> k & 1) != 0, (inside >> last & 1) != 0}};
  }
  const auto hangs_together = [&](const Opened& face, int e) {
    if (!face.inside[e]) return false;
    int faces = 0;
    for (std::size_t i = 0; i < count; ++i)
      faces += opened[i].ends[0] == face.ends[e] || opened[i].ends[1] == face.ends[e] ? 1 : 0;
    return faces == 1;
  };
  for (std::size_t i = 0; i < count;) {
    if (hangs_together(opened[i], 0) || hangs_together(opened[i], 1)) {
      opened[i] = opened[--count];
      i = 0;
    } else {
      ++i;
    }
  }
  return count > 0;
}

void TetMesh::split_noted_stars() {
  for (const Noted::Star& noted : noted_.stars) {
    const std::uint32_t mark = tet_marks_.fresh();
    const VertexId v = noted.vertex;
    star_scratch_.clear();
    component(v, vertices_[v].tet, mark, star_scratch_);
    for (std::uint32_t s = noted.first; s != kNone; s = noted_.sides[s].next) {
      const TetId t = tet_of(noted_.sides[s].side);
      if (tet_marks_[t] == mark) continue;
      star_scratch_.clear();
      component(v, t, mark, star_scratch_);
      const VertexId copy = add_vertex(vertices_[v].position, {v, v, 0}, vertices_[v].h);
      vertices_[copy].tet = t;
      at_boundary_[copy] = at_boundary_[v];
      for (const Corner corner : star_scratch_) {
        log_.touch_tet(*this, tet_of(corner));
        tets_[tet_of(corner)].vertices[index_of(corner)] = copy;
      }
    }
  }
}

std::uint32_t TetMesh::open_faces(std::span<const HalfFace> faces) {
  begin_noting(6 * faces.size());
  edges_inside_.clear();
  for (HalfFace h : faces) edges_inside_.push_back(static_cast<std::uint8_t>(edges_inside(h)));
  std::uint32_t opened = 0;
  for (std::size_t i = 0; i < faces.size(); ++i) {
    const HalfFace h = faces[i], o = opposite(h);
    if (o == kNone) continue;
    edges_inside_[opened++] = edges_inside_[i];
    open_side(h);
    open_side(o);
  }
  // Before any vertex has a copy.
  std::erase_if(noted_.stars, [this](const Noted::Star& star) { return !may_part(star); });
  split_noted_stars();
  return opened;
}

// Whether the star of a tetrahedron's vertex i may come apart without it. The faces of its that go on hang together around the edges inside the
// tissue: each of these joins the two faces at it.
bool TetMesh::may_part_without(TetId t, int i) const {
  const auto& tet = tets_[t];
  int beyond = 0, joined = 0;
  for (int f = 0; f < 4; ++f) {
    if (f == i) continue;
    beyond += tet.opposite[f] != kNone ? 1 : 0;
    joined += is_inside(t, tet.vertices[i], tet.vertices[f]) ? 1 : 0;
  }
  return joined + 1 < beyond;
}

void TetMesh::remove_tet(TetId t) {
  begin_noting(12);
  unsigned whole = 0;  // bit i: the star of vertex i stays in one
  for (int i = 0; i < 4; ++i) whole |= (may_part_without(t, i) ? 0u : 1u) << i;
  for (int f = 0; f < 4; ++f) {
    const HalfFace o = tets_[t].opposite[f];
    if (o != kNone) open_side(o);
  }
  const auto stays_whole = [&](const Noted::Star& star) {
    return (whole >> local_index(t, star.vertex) & 1) != 0;
  };
  std::erase_if(noted_.stars, stays_whole);
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

// Which face of the added tetrahedra is which: one of the hole's, or one of another added tetrahedron.
struct TetMesh::Replacement {
  static constexpr std::size_t kMax = 32;
  static constexpr std::uint32_t kOfShell = kNone - 1;
  struct Face {
    std::array<VertexId, 3> vertices;  // ascending
    HalfFace outside = kNone;          // what lies beyond
    std::uint32_t side = 0;            // of the added tetrahedra, 4 i + f
    bool cut = false, matched = false;
  };

  // The faces around the removed set.
  void collect(const TetMesh& mesh, std::span<const TetId> removed) {
    for (TetId t : removed) {
      for (int f = 0; f < 4; ++f) {
        const HalfFace o = mesh.tets_[t].opposite[f];
        if (o != kNone && std::find(removed.begin(), removed.end(), tet_of(o)) != removed.end()) continue;
        shell[shell_size++] = {ascending(mesh.face_vertices(half_face(t, f))), o, 0,
                               (mesh.cut_masks_[t] >> f & 1) != 0, false};
      }
    }
  }
  // Matches the faces of the added set with the shell, then with each other. False where one is left.
  bool match() {
    partner.fill(kNone);
    for (std::size_t i = 0; i < added.size(); ++i) {
      for (int f = 0; f < 4; ++f) {
        if (partner[4 * i + f] == kNone && !match_shell(i, f) && !match_added(i, f)) return false;
      }
    }
    return matched == shell_size;
  }
  std::array<VertexId, 3> face(std::size_t i, int f) const {
    const auto& k = kFaceVertices[f];
    return ascending({added[i][k[0]], added[i][k[1]], added[i][k[2]]});
  }
  bool match_shell(std::size_t i, int f) {
    const auto wanted = face(i, f);
    for (std::size_t s = 0; s < shell_size; ++s) {
      if (shell[s].matched || shell[s].vertices != wanted) continue;
      shell[s].matched = true;
      shell[s].side = static_cast<std::uint32_t>(4 * i + f);
      ++matched;
      partner[4 * i + f] = kOfShell;
      return true;
    }
    return false;
  }
  bool match_added(std::size_t i, int f) {
    const auto wanted = face(i, f);
    for (std::size_t j = i + 1; j < added.size(); ++j) {
      for (int g = 0; g < 4; ++g) {
        if (partner[4 * j + g] != kNone || face(j, g) != wanted) continue;
        partner[4 * i + f] = static_cast<std::uint32_t>(4 * j + g);
        partner[4 * j + g] = static_cast<std::uint32_t>(4 * i + f);
        return true;
      }
    }
    return false;
  }

  std::span<const std::array<VertexId, 4>> added;
  std::array<Face, 4 * kMax> shell;
  std::size_t shell_size = 0, matched = 0;
  std::array<std::uint32_t, 4 * kMax> partner;  // 4 i + f of the other side, or kOfShell
};

bool TetMesh::replace(std::span<const TetId> removed, std::span<const std::array<VertexId, 4>> added,
                      std::vector<TetId>& new_ids) {
  new_ids.clear();
  if (removed.empty() || removed.size() > Replacement::kMax || added.size() > Replacement::kMax) return false;
  Replacement replacement;
  replacement.added = added;
  replacement.collect(*this, removed);
  if (!replacement.match()) return false;

  const TetId first = tet_slots();
  for (const auto& vertices : added) new_ids.push_back(add_tet(vertices, removed[0]));
  for (std::size_t i = 0; i < added.size(); ++i) {
    for (int f = 0; f < 4; ++f) {
      const std::uint32_t p = replacement.partner[4 * i + f];
      if (p < Replacement::kOfShell) tets_[new_ids[i]].opposite[f] = 4 * first + p;
      vertices_[added[i][f]].tet = new_ids[i];
    }
  }
  for (std::size_t s = 0; s < replacement.shell_size; ++s) {
    const HalfFace h = 4 * first + replacement.shell[s].side;
    link(h, replacement.shell[s].outside);
    if (replacement.shell[s].cut) cut_masks_[tet_of(h)] |= static_cast<std::uint8_t>(1u << face_of(h));
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

}  // namespace incise::core
