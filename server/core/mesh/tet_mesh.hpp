#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "protocol/tet_faces.hpp"
#include "server/core/geometry/vec3.hpp"
#include "server/core/mesh/delta.hpp"
#include "server/core/mesh/mesh_data.hpp"
#include "server/core/util/archive.hpp"
#include "server/core/util/id_set.hpp"
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

using protocol::kFaceVertices;
// The two vertices of each of the six edges.
inline constexpr int kEdgeVertices[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};

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
// All that changes between two commits is recorded; commit() turns the record into a delta and brings the state
// hash up to date. Each call costs what it touches, never what the mesh holds. Thread: one, at a time.
class TetMesh {
 public:
  // Builds adjacency; O(vertices + tets). A vertex whose star is not face-connected is split at once into copies
  // (initial_vertex_copies() counts them). Throws MeshError on a bad index, a repeated vertex in a tetrahedron, or a
  // face that more than two tetrahedra share.
  explicit TetMesh(const MeshData& data);

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
  // Mean length of the edges at v when v came into being, m.
  double local_h(VertexId v) const { return static_cast<double>(vertices_[v].h); }

  // What will be asked for soon.
  void prefetch(TetId t) const { __builtin_prefetch(&tets_[t]); }
  void prefetch_position(VertexId v) const { __builtin_prefetch(&vertices_[v]); }
  // All that is known of some tetrahedra and of what is nearest to them, which is appended until there are `most`.
  void prefetch_around(std::vector<TetId>& tets, std::size_t most) const;

  bool alive(TetId t) const { return tets_[t].vertices[0] != kNone; }
  const std::array<VertexId, 4>& vertices(TetId t) const { return tets_[t].vertices; }
  // The half-face on the other side; kNone on the boundary.
  HalfFace opposite(HalfFace h) const { return tets_[tet_of(h)].opposite[face_of(h)]; }
  TetId neighbor(TetId t, int face) const {
    const HalfFace h = tets_[t].opposite[face];
    return h == kNone ? kNone : tet_of(h);
  }
  std::int32_t region(TetId t) const { return attributes_[t].region; }
  // Whether there is more than one.
  bool has_regions() const { return has_regions_; }
  // Which piece of the body it is in (server/core/session/piece_tracker.hpp). Not part of the state that the hash names.
  std::uint32_t piece(TetId t) const { return attributes_[t].piece; }
  void set_piece(TetId t, std::uint32_t piece) { attributes_[t].piece = piece; }
  std::uint8_t cut_mask(TetId t) const { return attributes_[t].cut_mask; }
  std::uint8_t boundary_mask(TetId t) const;
  std::array<VertexId, 3> face_vertices(HalfFace h) const;
  // Outward from the tetrahedron, as long as twice the face's area, m^2.
  Vec3 twice_area(HalfFace h) const;
  // Which of its four vertices v is; -1 where it is none.
  int local_index(TetId t, VertexId v) const;
  TetState state(TetId t) const;
  double volume(TetId t) const;
  // The quality measure of quality.hpp; smaller is better.
  double worst_dihedral(TetId t) const;
  Vec3 barycentre(TetId t) const;

  // The tetrahedra around v, as 4 t + (index of v in t). Replaces what `star` holds. O(star), some 10 ns each.
  void star(VertexId v, std::vector<std::uint32_t>& star) const;
  // The tetrahedra around the edge (a, b), starting from one that has it, in ring order. On the boundary the first
  // and the last are those with a boundary face at the edge. Replaces what `ring` holds.
  void ring(TetId from, VertexId a, VertexId b, std::vector<TetId>& ring) const;
  // A tetrahedron that has both; kNone where the two are not joined by an edge. O(star of a).
  TetId find_edge(VertexId a, VertexId b) const;

  // A vertex slides to another place of the body: it stands for the material that is there.
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
  // By what the state hash changes when v goes there.
  std::uint64_t hash_change(VertexId v, const Vec3& to) const;
  // Whether deform() was ever called. From then on each vertex has a rest position: where the material that it stands for
  // is in the body at rest. Until then that is its position.
  bool deformed() const { return !rest_.empty(); }
  const Vec3& rest_position(VertexId v) const { return deformed() ? rest_[v] : vertices_[v].position; }
  // The state hash after the last commit.
  std::uint64_t state_hash() const { return hash_; }
  // The same from scratch; O(mesh). For tests and load.
  std::uint64_t compute_state_hash() const;
  // Where a vertex that is new since the last commit comes from.
  const Provenance& provenance(VertexId v) const { return provenance_[v - first_new_vertex_]; }
  bool is_new(VertexId v) const { return v >= first_new_vertex_; }
  bool is_new_tet(TetId t) const { return t >= first_new_tet_; }
  // Tetrahedra touched since the last commit (new and changed ones that are alive).
  std::span<const TetId> touched_tets() const { return touched_tets_; }
  // Vertices moved since the last commit that existed then.
  std::span<const VertexId> touched_vertices() const { return touched_vertices_; }

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
  struct Attributes {
    std::int32_t region = 0;
    std::uint32_t piece = 0;
    std::uint8_t cut_mask = 0;
  };
  void check_restored(Archive& io);
  void link(HalfFace a, HalfFace b);
  void build_adjacency();
  void split_initial_vertices();
  void touch_vertex(VertexId v);
  void touch_tet(TetId t);
  void record_tet(TetId t, const TetState& before);
  VertexId add_vertex(const Vec3& position, const Provenance& provenance, float h);
  Vec3 rest_at(VertexId v, const Vec3& position) const;
  // Region and piece are those of `parent`.
  TetId add_tet(const std::array<VertexId, 4>& vertices, TetId parent);
  void kill_tet(TetId t);
  // Around a change that opens faces: the corners at each opened side are noted; then each vertex of them gets one copy
  // for each face-connected component of its star but the one that holds the tetrahedron that it names.
  void begin_noting(std::size_t most_corners);
  void note_corner(VertexId v, std::uint32_t corner);
  void open_side(HalfFace side);
  void split_noted_stars();
  void component(VertexId v, TetId from, std::vector<std::uint32_t>& corners) const;
  void next_mark() const;
  void next_vertex_marks(std::uint32_t count) const;
  // Empties what a step fills of the mesh, pieces apart.
  static void clear_mesh(Delta& delta);
  void commit_tet(TetId t, Delta& delta);
  void end_commit(Delta& delta);
  void begin_step();
  std::uint64_t hash_of_vertex(VertexId v) const;
  std::uint64_t hash_of_tet(TetId t) const;

  std::vector<Vertex> vertices_;
  std::vector<Vec3> rest_;  // by vertex, once deformed
  std::vector<Tet> tets_;
  std::vector<Attributes> attributes_;
  std::uint32_t live_tets_ = 0;
  bool has_regions_ = false;
  std::uint32_t initial_vertex_copies_ = 0;
  std::int64_t cut_sides_ = 0;
  double mean_edge_length_ = 0;

  // The record of the running step.
  std::vector<VertexId> touched_vertices_;
  std::vector<TetId> touched_tets_;
  std::vector<std::uint32_t> record_;  // by tetrahedron: where it is in touched_tets_, if it is there
  std::vector<TetState> before_;       // one for each of touched_tets_
  VertexId first_new_vertex_ = 0;
  TetId first_new_tet_ = 0;
  std::vector<Provenance> provenance_;
  std::uint64_t hash_ = 0;
  // How far commit() is.
  enum class Committing { kNothing, kMoved, kAdded, kTets, kNewTets };
  Committing committing_ = Committing::kNothing;
  std::size_t next_commit_ = 0;
  IdSet vertices_in_order_, tets_in_order_;  // that existed before the step and are touched
  int commit_sides_ = 0;
  double commit_side_area_ = 0;

  // Scratch, kept so that a warm step allocates nothing.
  mutable std::uint32_t mark_ = 0;
  mutable std::vector<std::uint32_t> tet_mark_;
  mutable std::uint32_t vertex_mark_value_ = 0;
  mutable std::vector<std::uint32_t> vertex_mark_;
  struct NotedCorner {
    std::uint32_t corner, next;  // the next one at the same vertex
  };
  struct NotedStar {
    VertexId vertex;
    std::uint32_t first, last;  // into noted_corners_
  };
  std::uint32_t first_noted_mark_ = 0;  // of noted_stars_[0]; the others count on
  std::vector<NotedStar> noted_stars_;
  std::vector<NotedCorner> noted_corners_;
  mutable std::vector<std::uint32_t> star_scratch_;
  mutable std::vector<TetId> ring_scratch_;
};

}  // namespace incise::core
