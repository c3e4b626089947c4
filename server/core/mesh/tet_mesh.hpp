#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "protocol/tet_faces.hpp"
#include "server/core/geometry/quality.hpp"
#include "server/core/geometry/vec3.hpp"
#include "server/core/mesh/change_log.hpp"
#include "server/core/mesh/delta.hpp"
#include "server/core/mesh/fresh_marks.hpp"
#include "server/core/mesh/mesh_data.hpp"
#include "server/core/util/archive.hpp"
#include "server/core/util/work_budget.hpp"

namespace incise::core {

inline constexpr HalfFace half_face(TetId tet, int face) {
  return 4 * tet + static_cast<HalfFace>(face);
}
inline constexpr TetId tet_of(HalfFace h) {
  return h >> 2;
}
inline constexpr int face_of(HalfFace h) {
  return static_cast<int>(h & 3u);
}

// Vertex i of tetrahedron t, as 4 t + i; half-face 4 t + i is opposite to it.
using Corner = std::uint32_t;

inline constexpr int index_of(Corner c) {
  return static_cast<int>(c & 3u);
}

using protocol::kFaceVertices;
// The two vertices of each of the six edges.
inline constexpr int kEdgeVertices[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};
// By a set of vertices, bit i for vertex i: the edges that have one of these and one other, bit e for edge e.
inline constexpr std::array<std::uint8_t, 16> kEdgesAcross = [] {
  std::array<std::uint8_t, 16> across{};
  for (unsigned vertices = 0; vertices < 16; ++vertices) {
    for (unsigned e = 0; e < 6; ++e) {
      const unsigned i = vertices >> kEdgeVertices[e][0] & 1u, j = vertices >> kEdgeVertices[e][1] & 1u;
      across[vertices] = static_cast<std::uint8_t>(across[vertices] | (i ^ j) << e);
    }
  }
  return across;
}();

// Bit i: the i-th of the four is `value`. Without branches, which would go wrong half of the time.
inline unsigned which_are(const std::array<std::uint32_t, 4>& four, std::uint32_t value) {
#if defined(__SSE__)
  using Lanes = std::uint32_t __attribute__((vector_size(16)));
  using Floats = float __attribute__((vector_size(16)));
  Lanes lanes;
  std::memcpy(&lanes, four.data(), sizeof lanes);
  return static_cast<unsigned>(__builtin_ia32_movmskps(reinterpret_cast<Floats>(lanes == value)));
#else
  unsigned bits = 0;
  for (unsigned i = 0; i < 4; ++i) bits |= (four[i] == value ? 1u : 0u) << i;
  return bits;
#endif
}

inline std::array<VertexId, 3> ascending(std::array<VertexId, 3> f) {
  if (f[0] > f[1]) std::swap(f[0], f[1]);
  if (f[1] > f[2]) std::swap(f[1], f[2]);
  if (f[0] > f[1]) std::swap(f[0], f[1]);
  return f;
}

// A mesh that a TetMesh cannot be built from. The message names the tetrahedra and vertices by index.
struct MeshError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// A tetrahedral mesh that can be cut: positions, tetrahedra, and across each face its neighbour. Indices into flat
// arrays, not pointers: they stay valid while the arrays grow, they are the ids that clients see, and an id is never
// used again once its tetrahedron is gone.
//
// Invariants, between any two calls (server/core/mesh/validate.hpp checks them): adjacency is symmetric; the tetrahedra
// around a vertex are connected through faces that contain it ("face-connected star"); a vertex knows one of them.
// Positive orientation is the caller's to keep: the policy `croll` does not.
//
// A ChangeLog records what changes between two commits; commit() turns it into a delta and brings the state hash up to date.
// Each call costs what it touches, never what the mesh holds. Thread: one, at a time.
class TetMesh {
 public:
  // Builds adjacency; O(vertices + tets). A vertex whose star is not face-connected is split at once into copies
  // (initial_vertex_copies() counts them). Throws MeshError on a coordinate that is not finite, a bad index, a
  // repeated vertex in a tetrahedron, a face that more than two tetrahedra share, or arrays that differ in length.
  explicit TetMesh(const MeshData& data);
  // A copy, of a mesh in which no step is under way, with room to grow. It reads nothing that queries write: several threads may copy
  // and query the same mesh, stars, rings and edges apart. O(mesh), a tenth of building it.
  TetMesh(const TetMesh& other);
  TetMesh& operator=(const TetMesh&) = delete;

  // Counts of slots ever used: ids run below these.
  std::uint32_t vertex_slots() const { return static_cast<std::uint32_t>(vertices_.size()); }
  std::uint32_t tet_slots() const { return static_cast<std::uint32_t>(tets_.size()); }
  std::uint32_t live_tets() const { return live_tets_; }
  std::uint32_t initial_vertex_copies() const { return initial_vertex_copies_; }
  // Mean length of the edges of the mesh as loaded: h, m.
  double mean_edge_length() const { return mean_edge_length_; }

  const Vec3& position(VertexId v) const { return vertices_[v].position; }
  // A tetrahedron that has v; kNone where none is left.
  TetId vertex_tet(VertexId v) const { return vertices_[v].tet; }
  // Whether any tetrahedron has v.
  bool is_used(VertexId v) const { return vertices_[v].tet != kNone; }
  // Mean length of the edges at v when v came into being, m.
  double local_h(VertexId v) const { return static_cast<double>(vertices_[v].h); }
  // No vertex has a larger one.
  double widest_local_h() const { return widest_local_h_; }
  // Whether a face at v has nothing on its other side. O(1).
  bool at_boundary(VertexId v) const { return at_boundary_[v] != 0; }
  // False: no face at v has been opened by a cut. O(1).
  bool may_be_at_cut(VertexId v) const { return (at_boundary_[v] & kAtCut) != 0; }

  // For what will be read soon. Functions that only do this, and that GCC does not inline by itself, have to be inlined by force: it takes
  // one without any effect for one that need not be called.
  void prefetch(TetId t) const { __builtin_prefetch(&tets_[t]); }
  void prefetch_position(VertexId v) const { __builtin_prefetch(&vertices_[v]); }
  // Where v's star begins: v has to be in the caches by now.
  void prefetch_star(VertexId v) const {
    if (vertices_[v].tet == kNone) return;
    __builtin_prefetch(&tets_[vertices_[v].tet]);
    __builtin_prefetch(&tet_marks_[vertices_[v].tet]);
  }
  // The same for its next tetrahedra.
  [[gnu::always_inline]] void prefetch_around_first(VertexId v) const {
    if (vertices_[v].tet == kNone) return;
    for (const HalfFace h : tets_[vertices_[v].tet].opposite) {
      if (h == kNone) continue;
      __builtin_prefetch(&tets_[tet_of(h)]);
      __builtin_prefetch(&tet_marks_[tet_of(h)]);
    }
  }
  // For what will be changed soon.
  void prefetch_to_change(TetId t) const {
    prefetch(t);
    __builtin_prefetch(&cut_masks_[t]);
    log_.prefetch(t);
  }
  // Prefetches some tetrahedra and those around them, which are appended until there are `most`.
  void prefetch_around(std::vector<TetId>& tets, std::size_t most) const;

  bool alive(TetId t) const { return tets_[t].vertices[0] != kNone; }
  const std::array<VertexId, 4>& vertices(TetId t) const { return tets_[t].vertices; }
  // The half-face on the other side; kNone on the boundary.
  HalfFace opposite(HalfFace h) const { return tets_[tet_of(h)].opposite[face_of(h)]; }
  TetId neighbor(TetId t, int face) const {
    const HalfFace h = tets_[t].opposite[face];
    return h == kNone ? kNone : tet_of(h);
  }
  std::int32_t region(TetId t) const { return regions_.empty() ? region_ : regions_[t]; }
  // Whether there is more than one.
  bool has_regions() const { return has_regions_; }
  // Whether it had faces of older cuts when it was loaded (MeshData::cut_masks). A session that is restored does not know.
  bool came_cut() const { return came_cut_; }
  std::uint8_t cut_mask(TetId t) const { return cut_masks_[t]; }
  std::uint8_t boundary_mask(TetId t) const {
    return static_cast<std::uint8_t>(which_are(tets_[t].opposite, kNone));
  }
  bool on_boundary(TetId t) const { return which_are(tets_[t].opposite, kNone) != 0; }
  std::array<VertexId, 3> face_vertices(HalfFace h) const {
    const auto& v = tets_[tet_of(h)].vertices;
    const auto& f = kFaceVertices[face_of(h)];
    return {v[f[0]], v[f[1]], v[f[2]]};
  }
  // Outward from the tetrahedron, as long as twice the face's area, m^2.
  Vec3 twice_area(HalfFace h) const {
    const auto v = face_vertices(h);
    const Vec3& a = position(v[0]);
    return cross(position(v[1]) - a, position(v[2]) - a);
  }
  // Which of its four vertices v is; -1 where it does not have v.
  int local_index(TetId t, VertexId v) const {
    const unsigned at = which_are(tets_[t].vertices, v);
    return at == 0 ? -1 : std::countr_zero(at);
  }
  TetState state(TetId t) const { return {t, tets_[t].vertices, region(t), cut_masks_[t], boundary_mask(t)}; }
  double volume(TetId t) const {
    const auto& v = tets_[t].vertices;
    return signed_volume(position(v[0]), position(v[1]), position(v[2]), position(v[3]));
  }
  // The quality measure of quality.hpp; smaller is better.
  double worst_dihedral(TetId t) const {
    const auto& v = tets_[t].vertices;
    return core::worst_dihedral(position(v[0]), position(v[1]), position(v[2]), position(v[3]));
  }
  Vec3 face_middle(HalfFace h) const {
    const auto v = face_vertices(h);
    return (1.0 / 3.0) * (position(v[0]) + position(v[1]) + position(v[2]));
  }
  Vec3 barycentre(TetId t) const {
    const auto& v = tets_[t].vertices;
    return 0.25 * ((position(v[0]) + position(v[1])) + (position(v[2]) + position(v[3])));
  }

  // The tetrahedra around v, each by its corner at v. Replaces what `star` holds. O(star), some 10 ns each.
  void star(VertexId v, std::vector<Corner>& star) const;
  // The tetrahedra around the edge (a, b), starting from one that has it, in ring order. On the boundary the first
  // and the last are those with a boundary face at the edge. Replaces what `ring` holds.
  void ring(TetId from, VertexId a, VertexId b, std::vector<TetId>& ring) const;
  // A tetrahedron that has both; kNone where the two are not joined by an edge. O(star of a).
  TetId find_edge(VertexId a, VertexId b) const;

  // A vertex slides to another place of the body: it stands for the material that is there. Once deformed, for what is between there and where it was, as far
  // as no tetrahedron turns inside out at rest.
  void move_vertex(VertexId v, const Vec3& position);
  // Puts a vertex on the edge (a, b) of tetrahedron `from`, at a + t (b - a), and splits all tetrahedra around it in
  // two: the half at a keeps its id. Returns the vertex.
  VertexId split_edge(TetId from, VertexId a, VertexId b, double t);
  // Whether collapse() of the edge from v to w keeps the mesh a manifold: their links meet in the link of the edge alone
  // (Dey, Edelsbrunner, Guha and Nekhayev 1999, "Topology preserving edge contraction"). A vertex of the boundary only goes
  // along the boundary.
  bool may_collapse(TetId from, VertexId v, VertexId w) const;
  // Merges v into w along an edge of tetrahedron `from`: the tetrahedra around the edge go, the others at v get w.
  // v keeps its position and belongs to nothing afterwards.
  void collapse(TetId from, VertexId v, VertexId w);
  // Opens interior faces (each given by either half) as cut faces, then gives every vertex of theirs one copy for
  // each face-connected component of its star. Faces that are open already are passed over. Returns how many opened.
  std::uint32_t open_faces(std::span<const HalfFace> faces);
  // Takes a tetrahedron out; the faces that its neighbours shared with it become cut faces; splits vertices likewise.
  void remove_tet(TetId t);
  // Replaces tetrahedra by others that fill the same space, on the same vertices: the one primitive of all flips.
  // `added` are positively oriented vertex quadruples; regions are those of the first removed one. Returns false, and
  // changes nothing, where faces of the two sets do not match.
  bool replace(std::span<const TetId> removed, std::span<const std::array<VertexId, 4>> added,
               std::vector<TetId>& new_ids);

  // Ends a step: what changed since the last commit, by ids ascending; fills the mesh part of `delta` (moved,
  // added, upserted, removed, boundary, cut faces and area) and its state hash. O(change log change).
  void commit(Delta& delta);
  // The same in portions: goes on until done (true) or the budget is spent (false). `delta` must be the same, and nothing
  // may change in between.
  bool commit(Delta& delta, WorkBudget& budget);
  // A step of its own, in which the body deforms: nothing may have changed since the last commit. `moved`, ascending, are
  // swapped into `delta` with their positions. `hash_change`: the XOR of their hash_change(). O(moved), some 5 ns each.
  void deform(std::vector<VertexId>& moved, std::vector<Vec3>& positions, std::uint64_t hash_change,
              Delta& delta);
  // By what the state hash changes when these vertices go to these places.
  std::uint64_t hash_change(std::span<const VertexId> moved, std::span<const Vec3> to) const;
  // What vertices count for in it at these places.
  static std::uint64_t hash_at(std::span<const VertexId> vertices, std::span<const Vec3> places);
  // Whether deform() was ever called. From then on each vertex has a rest position: where the material that it stands for
  // is in the body at rest. Until then that is its position.
  bool deformed() const { return !rest_.empty(); }
  const Vec3& rest_position(VertexId v) const { return deformed() ? rest_[v] : vertices_[v].position; }
  // Of a tetrahedron with these vertices at rest, m^3.
  double rest_volume(const std::array<VertexId, 4>& v) const {
    return signed_volume(rest_position(v[0]), rest_position(v[1]), rest_position(v[2]), rest_position(v[3]));
  }
  double worst_dihedral_at_rest(const std::array<VertexId, 4>& v) const {
    return core::worst_dihedral(rest_position(v[0]), rest_position(v[1]), rest_position(v[2]),
                                rest_position(v[3]));
  }
  // What an edit leaves a tetrahedron at least of the ratio of its volumes, at rest and where it is now.
  static constexpr double kLeastAtRest = 0.1;
  // The smallest angle that an edit may leave at rest, unless the tetrahedra had a smaller one there before, or have one no larger than twice that where they
  // are now: repairs see to those. As measures of worst_dihedral().
  static constexpr double kWorstAtRest = dihedral_measure(0.9986295348);  // 3 degrees
  static bool is_fair_at_rest(double at_rest, double before, double now) {
    return at_rest <= std::max(kWorstAtRest, before) || 1 - at_rest >= 0.25 * (1 - now);
  }
  // The state hash after the last commit.
  std::uint64_t state_hash() const { return log_.state_hash(); }
  // The same from scratch; O(mesh). For tests and load.
  std::uint64_t compute_state_hash() const;
  // What each counts for in it.
  std::uint64_t hash_of_vertex(VertexId v) const;
  std::uint64_t hash_of_tet(TetId t) const;
  // Where a vertex that is new since the last commit comes from.
  const Provenance& provenance(VertexId v) const { return log_.provenance(v); }
  bool is_new(VertexId v) const { return log_.is_new(v); }
  bool is_new_tet(TetId t) const { return log_.is_new_tet(t); }
  // Of a tetrahedron that is new since then: one that was there, in whose place it is.
  TetId elder(TetId t) const { return log_.elder(t); }
  // Tetrahedra touched since the last commit (new and changed ones that are alive).
  std::span<const TetId> touched_tets() const { return log_.touched_tets(); }
  // Vertices moved since the last commit that existed then.
  std::span<const VertexId> touched_vertices() const { return log_.touched_vertices(); }

  // Which tetrahedron a vertex names is part of it: stars are walked from there, and ids follow from the walk. O(mesh).
  void archive(Archive& io);

  MeshData export_data() const;  // live tetrahedra and used vertices, renumbered in id order

 private:
  struct Vertex {
    Vec3 position;
    TetId tet = kNone;
    float h = 0;
  };
  struct Tet {
    std::array<VertexId, 4> vertices;
    std::array<HalfFace, 4> opposite;
  };
  // Where vertices may belong to more than one component of their star: they are noted with the sides of faces at them that have opened,
  // then each gets one copy for each face-connected component but the one that holds the tetrahedron that it names.
  struct Noted {
    struct Side {
      HalfFace side;
      std::uint32_t next;  // the next one at the same vertex
    };
    struct Star {
      VertexId vertex;
      std::uint32_t first, last;  // into sides
    };
    std::uint32_t first_mark = 0;  // of stars[0]; the others count on
    std::vector<Star> stars;
    std::vector<Side> sides;
  };
  struct LinkMarks;     // of may_collapse()
  struct BoundaryLink;  // likewise
  struct Replacement;   // of replace()

  // mesh_build.cpp
  void measure_edges();
  void find_widest();
  void build_adjacency();
  void take_regions(std::span<const std::int32_t> regions);
  void archive_attributes(Archive& io);
  void take_adjacency(std::span<const HalfFace> opposite);
  void split_initial_vertices();
  void find_boundary();
  void check_restored(Archive& io);
  // mesh_edit.cpp
  void link(HalfFace a, HalfFace b);
  VertexId add_vertex(const Vec3& position, const Provenance& provenance, float h);
  // Of the region of `parent`, and in its place.
  TetId add_tet(const std::array<VertexId, 4>& vertices, TetId parent);
  void kill_tet(TetId t);
  void mark_link_of(VertexId w, const LinkMarks& marks) const;
  bool edges_are_around(TetId t, VertexId v, const LinkMarks& marks) const;
  VertexId apex_of_both_sides(VertexId v, VertexId w) const;
  bool has_boundary_face(VertexId v) const;
  bool is_inside(TetId from, VertexId a, VertexId b) const;
  unsigned edges_inside(HalfFace h) const;
  void begin_noting(std::size_t max_stars);
  void note_side(VertexId v, HalfFace side);
  void open_side(HalfFace side);
  bool may_part(const Noted::Star& star) const;
  bool may_part_without(TetId t, int i) const;
  void split_noted_stars();
  // mesh_deform.cpp
  Vec3 material_at(VertexId v, const Vec3& position) const;
  bool stays_valid_at_rest(VertexId v, const Vec3& position, const Vec3& rest) const;
  Vec3 rest_at(VertexId v, const Vec3& position) const;
  // tet_mesh.cpp
  void component(VertexId v, TetId from, std::uint32_t mark, std::vector<Corner>& corners) const;

  std::vector<Vertex> vertices_;
  // By vertex: kAtBoundary, and kAtCut where one of its boundary faces is or was one of a cut; else 0.
  static constexpr std::uint8_t kAtBoundary = 1, kAtCut = 2;
  std::vector<std::uint8_t> at_boundary_;
  std::vector<Vec3> rest_;  // likewise, once deformed
  std::vector<Tet> tets_;
  std::vector<std::uint8_t> cut_masks_;  // by tetrahedron
  std::vector<std::int32_t> regions_;    // likewise; none: all are in region_
  std::int32_t region_ = 0;
  std::uint32_t live_tets_ = 0;
  bool has_regions_ = false;
  bool came_cut_ = false;
  std::uint32_t initial_vertex_copies_ = 0;
  double mean_edge_length_ = 0;
  double widest_local_h_ = 0;

  ChangeLog log_;

  // Scratch, kept so that a warm step allocates nothing.
  mutable FreshMarks tet_marks_, vertex_marks_;
  Noted noted_;
  std::vector<std::uint8_t> edges_inside_;  // of each face that opens
  mutable std::vector<Corner> star_scratch_;
  mutable std::vector<Corner> component_scratch_ = std::vector<Corner>(256);
  mutable std::vector<TetId> ring_scratch_;
};

}  // namespace incise::core
