#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "server/core/cut/conforming/other_blades.hpp"
#include "server/core/cut/conforming/stroke_path.hpp"
#include "server/core/cut/conforming/tolerances.hpp"
#include "server/core/cut/cut_config.hpp"
#include "server/core/cut/cut_workspace.hpp"
#include "server/core/cut/cutter.hpp"
#include "server/core/geometry/box.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/mesh/vertex_star.hpp"
#include "server/core/util/work_budget.hpp"

namespace incise::core {

// What the stages of one blade's cut have in common, and the questions that all of them ask. They read the mesh here; only
// MeshEditor changes it.
struct CutContext {
  CutContext(const TetMesh& body, CutWorkspace& marks, const CutConfig& settings);
  CutContext(const CutContext&) = delete;

  const SweptSurface& surface() const { return path.surface(); }
  // The closest point of the surface to one that lies in it as a rule; looks farther only where nothing is near.
  bool closest_on_surface(const Vec3& p, Vec3& point, std::uint32_t& triangle) const {
    return surface().closest(p, tolerance::kSurfaceNear_h * h, point, triangle) ||
           surface().closest(p, tolerance::kSurfaceReach_h * h, point, triangle);
  }
  // Whether v was put on what is kept of the swept surface. Where the blade comes across its own cut later in the stroke, that
  // is an old cut like any other.
  bool on_surface(VertexId v) const {
    const CutWorkspace::VertexMarks& marks = workspace.vertices[v];
    return (marks.surface == stroke && marks.batch >= oldest_batch) ||
           (marks.also == stroke && marks.also_batch >= oldest_batch);
  }
  // In this batch. Where it lay on another blade's surface, it may lie on both.
  void put_on_surface(VertexId v) const {
    CutWorkspace::VertexMarks& marks = workspace.vertices[v];
    if (marks.surface != stroke) {
      marks.also = marks.surface;
      marks.also_batch = marks.batch;
    }
    marks.surface = stroke;
    marks.batch = batch;
  }
  // Or on what was swept before, by any stroke. It may have been moved since.
  bool was_on_surface(VertexId v) const { return workspace.vertices[v].surface != 0; }
  // All three vertices of a face.
  bool face_on_surface(HalfFace face) const {
    const auto v = mesh.face_vertices(face);
    return on_surface(v[0]) && on_surface(v[1]) && on_surface(v[2]);
  }
  bool on_rim(VertexId v) const { return workspace.vertices[v].rim == stroke; }
  // Whether v stands for the surface, though it is only near to that: it lies in an older cut that runs along there.
  bool stands(VertexId v) const { return workspace.vertices[v].stands == stroke; }
  // Whether a crossing of an edge of this length, `part` of it from its end v, is as good as at v.
  bool meets_end(VertexId v, double part, double length_m) const {
    if (!on_surface(v)) return false;
    const bool near = part * length_m < tolerance::kOne_h * h,
               near_for_the_edge = part < tolerance::kAtVertex_edge;
    return stands(v) ? near || near_for_the_edge : near && near_for_the_edge;
  }
  // Whether a crossing at v could not be dealt with.
  bool failed(VertexId v) const { return may_have_failed && workspace.vertices[v].failed == stroke; }

  // A box around all that is near the tissue.
  Box near_tissue() const { return Box{workspace.grid.low(), workspace.grid.high()}.widened(h); }
  // Whether both sides of a face are on one side of a surface that they are so far off.
  bool is_beside(double one_m, double other_m) const {
    return (one_m >= 0) == (other_m >= 0) &&
           std::min(std::abs(one_m), std::abs(other_m)) > tolerance::kBeside_h * h;
  }

  // Where the blade is now. `goes_on`: the stroke does.
  void set_front(const BladeLine& line, bool goes_on) {
    front = line;
    has_front = goes_on;
    const Box tissue{workspace.grid.low(), workspace.grid.high()};
    front_is_near = goes_on && tissue.widened(tolerance::kHot_local * mesh.widest_local_h())
                                   .meets(Box::around({line.heel, line.tip}));
  }
  // Whether v is near the blade, and by how much.
  bool hot(VertexId v, double* by_m = nullptr) const {
    if (!front_is_near) return false;
    const double reach = tolerance::kHot_local * mesh.local_h(v);
    const double d2 = squared_distance_to_segment(mesh.position(v), front.heel, front.tip);
    if (d2 >= reach * reach) return false;
    if (by_m != nullptr) *by_m = reach - std::sqrt(d2);
    return true;
  }

  // Whether a face is about to open: each side apart.
  bool is_pending(HalfFace face) const {
    return (workspace.tets[tet_of(face)].pending >> face_of(face) & 1) != 0;
  }
  void set_pending(HalfFace face) const {
    workspace.tets[tet_of(face)].pending |= static_cast<std::uint8_t>(1u << face_of(face));
  }
  void clear_pending(HalfFace face) const {
    workspace.tets[tet_of(face)].pending &= static_cast<std::uint8_t>(~(1u << face_of(face)));
  }

  void gather(VertexStar& star, VertexId v) const;
  // VertexStar::worst_at(); kInverted where one of the flat ones lies across a bend, between two parts of the surface: what is
  // removed must be part of it.
  double worst_at(const VertexStar& star, const Vec3& p, double limit, double thickness_m,
                  std::vector<TetId>& flat) const;
  // Calls visit(triangle, t) where the surface crosses the segment a b, at a + t (b - a), until it returns true; returns whether
  // it did. `a_on`, `b_on`: an end lies on the surface, which is then no crossing.
  template <class Visit>
  bool any_crossing(const Vec3& a, bool a_on, const Vec3& b, bool b_on, Visit visit) const {
    return surface().any_between(Points<2>({a, b}), clear_m, [&](std::uint32_t i) {
      const SweptTriangle& s = surface()[i];
      const double da = s.signed_distance(a), db = s.signed_distance(b);
      if ((a_on && std::abs(da) <= clear_m) || (b_on && std::abs(db) <= clear_m)) return false;
      double t;
      return crosses(a, b, da, db, s, clear_m, t) && visit(i, t);
    });
  }
  // The first of these.
  bool find_crossing(const Vec3& a, bool a_on, const Vec3& b, bool b_on, std::uint32_t& triangle,
                     double& t) const;
  // The batch that swept there; kNone: the surface does not cross the edge (a, b).
  std::uint32_t batch_across(VertexId a, VertexId b) const;
  // The worst of the tetrahedra that splitting the edge (a, b) of `tet` makes; stops beyond `limit`.
  double worst_after_split(TetId tet, VertexId a, VertexId b, double t, double limit) const;

  // Whether a face that a cut has opened is at v.
  bool at_cut(VertexId v) const;

  const TetMesh& mesh;
  CutWorkspace& workspace;
  const CutConfig config;
  const double h;        // mean edge length, m
  const double clear_m;  // nearer to a plane than this only exact arithmetic decides

  std::uint32_t stroke = 0, batch = 0;
  StrokePath path;
  std::uint32_t oldest_batch = 0;  // of the path
  bool has_front = false;          // the stroke goes on: what is near the blade waits
  bool front_is_near = false;      // and it has not left all tissue behind
  BladeLine front;                 // the blade now
  // The stroke's sweep has come upon a cut, older or its own, or upon the end of a sweep, or leads to the boundary beside it.
  bool meets_cut = false;
  bool may_have_failed = true;  // false: the stroke has dealt with all crossings so far
  OtherBlades others;

  CutCounts counts;
  mutable WorkMeter work;
  // What judging has cost, about, in the part of the batch that is under way. Counted by what depends on the mesh alone: `work` depends on what is
  // kept in memory, too, and a session that goes on from a checkpoint has to end its parts where the others do.
  mutable std::size_t part_judging = 0;
  // Whether there may be more tetrahedra than before.
  bool may_add() const { return config.prefer != Preference::kNoGrowth; }
  // Whether that part is worth a delta of its own, or would be with as much as this on top. In fresh tissue batches do not take long.
  bool part_is_full(std::size_t more = 0) const {
    const std::size_t cost =
        part_judging + cost::kPartEvent * counts.events + cost::kPartFace * counts.cut_faces;
    return meets_cut && cost > 0 && cost + more >= cost::kPart;
  }

 private:
  mutable std::vector<TetId> ring_;  // scratch
  mutable std::vector<Corner> corners_;
};

}  // namespace incise::core
