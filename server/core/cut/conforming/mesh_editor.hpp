#pragma once

#include <algorithm>
#include <array>
#include <span>
#include <utility>
#include <vector>

#include "server/core/cut/conforming/active_set.hpp"
#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/cut/conforming/films.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/mesh/vertex_star.hpp"

namespace incise::core {

// Changes the mesh for one blade. Each operation does all that follows from it:
//
//                 verification  becomes active               entered in   free to be   to be repaired
//                 looks again                                the grid     moved again
//   snap          its star      what has three vertices on   -            -            v, unless its star is good
//                               the surface now; failed ones
//   stand         -             what has three vertices on   -            -            -
//                               the surface now
//   move          its star      failed ones, and what the    -            its star     -
//                               surface crosses now
//   split         the ring      the ring, new ones           new ones     -            the new vertex
//   split_fan     -             new ones, where the ring is  new ones     -            -
//   collapse      its star      its star                     its star and its star     -
//                                                            behind it
//   replace       new ones      new ones                     new ones     new ones     -
//   remove        -             -                            neighbours   film: its    copies of its vertices
//                                                                         vertices
//   open          -             -                            both sides   -            -
//   fail          -             its star                     -            -            -
//
// What each of them makes or changes is offered to other blades, but for what is taken out (OtherBlades).
//
// Snaps and splits do not free vertices to be moved again, for they all come before the repairs of their round. Counts
// what is done (CutContext::counts).
class MeshEditor {
 public:
  MeshEditor(TetMesh& mesh, CutContext& cut, ActiveSet& active)
      : mesh_(mesh), cut_(cut), active_(active), film_pass_(cut.workspace), films_(cut) {}

  // A vertex that was put on the surface by this batch, or made by that, whose star may not be good.
  struct Changed {
    VertexId vertex;
    int times = 0;  // it was repaired, not well enough
  };
  // For the repair stage, in the order in which they came.
  std::vector<Changed>& changed() { return changed_; }

  // v, whose star that is, goes onto the surface. What becomes flat is removed.
  void snap(const VertexStar& star, VertexId v, const Vec3& target);
  // The same, where the star's worst measure there is known, and what becomes flat.
  void snap(const VertexStar& star, VertexId v, const Vec3& target, double worst,
            std::span<const TetId> flat);
  // The same, where the sweep ends.
  void snap_to_rim(const VertexStar& star, VertexId v, const Vec3& target);
  // v lies on the surface, or stands for it, where it is. Before verification.
  void stand(VertexId v);
  // v, whose star that is, goes to a better place.
  void move(const VertexStar& star, VertexId v, const Vec3& target);
  // No vertex has been put in a bend yet, no tetrahedron made, and none taken out.
  void begin_batch() {
    in_bend_.clear();
    made_.clear();
    bared_.clear();
  }
  // The tetrahedra that this batch has made, or that have got another vertex; some are gone again. Nothing is known of their faces.
  const std::vector<TetId>& made() const { return made_; }
  // The vertices of what has been taken out in this batch, with their copies.
  const std::vector<VertexId>& bared() const { return bared_; }
  // Whether v was put there by this batch: without it, the chord of the bend that it splits is back.
  bool is_in_bend(VertexId v) const { return std::ranges::find(in_bend_, v) != in_bend_.end(); }
  // Puts a vertex on the edge (a, b) of `tet`, at a + t (b - a). kInBend: it has to stay, so repairs do not merge it.
  enum class NewVertex { kOnSurface, kNotYet, kInBend };
  VertexId split(TetId tet, VertexId a, VertexId b, double t, NewVertex is = NewVertex::kOnSurface);
  // Puts a vertex on the edge (a, b) of `tet`, at a + t (b - a), in that tetrahedron's fan around it, where all is decided: see PinchedEdges.
  void split_fan(TetId tet, VertexId a, VertexId b, double t);
  // Merges v, whose star that is, into w along an edge of t. TetMesh::may_collapse() must hold.
  void collapse(const VertexStar& star, TetId t, VertexId v, VertexId w);
  // TetMesh::replace(). The new tetrahedra; none where the two sets do not match.
  std::span<const TetId> replace(std::span<const TetId> removed,
                                 std::span<const std::array<VertexId, 4>> added);
  // Takes out a tetrahedron that is part of the surface, as a repair, unless a film hangs by it alone.
  void remove_film(TetId t);
  // Whether a film would come off if v went to `target`, where these become flat: it hangs by what would be too flat to be kept. O(1) as a rule.
  bool tears_film(VertexId v, const Vec3& target, std::span<const TetId> flat);
  void open(std::span<const HalfFace> faces);

  // A crossing at v could not be dealt with: ragged faces may open around it.
  void fail(VertexId v);

 private:
  bool keeps_rest(std::span<const TetId> removed, std::span<const std::array<VertexId, 4>> added) const;
  // What verification found to be clear is looked at again only where it has changed since.
  void look_again(TetId t) { cut_.workspace.tets[t].pass = 0; }
  void enter(TetId t) {
    if (mesh_.boundary_mask(t) != 0) cut_.workspace.grid.add(mesh_, t);
  }
  void may_move_again(std::span<const VertexId> vertices) {
    for (VertexId v : vertices) cut_.workspace.vertices[v].tried = 0;
  }
  // It is new, or has got another vertex.
  void note_made(TetId t) {
    made_.push_back(t);
    cut_.others.offer(t);
  }
  void judge_again(const VertexStar& star, VertexId v);
  void take_what_is_crossed(const VertexStar& star, VertexId v);
  void move_to(const VertexStar& star, VertexId v, const Vec3& target);
  void remove_flat(TetId t, bool may_stay);
  bool film_hangs_by(std::span<const TetId> flat);
  bool hangs_together_around(TetId t, std::span<const TetId> flat);
  bool is_film_without(std::span<const TetId> flat, TetId n);
  bool is_crumb(std::span<const TetId> tets) const;
  void remove_crumb(TetId t);
  void account(HalfFace h);

  TetMesh& mesh_;
  CutContext& cut_;
  ActiveSet& active_;
  std::vector<Changed> changed_;
  std::vector<VertexId> in_bend_, bared_;
  std::vector<TetId> made_;
  TetPass film_pass_;
  Films films_;
  std::vector<TetId> flat_, too_flat_, crumb_, film_, ring_, new_tets_;  // scratch
  std::vector<std::uint32_t> star_;                                      // scratch
  std::vector<std::pair<VertexId, std::uint32_t>> crossed_;              // scratch
};

}  // namespace incise::core
