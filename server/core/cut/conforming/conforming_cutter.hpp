#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "server/core/cut/cut_config.hpp"
#include "server/core/cut/cut_workspace.hpp"
#include "server/core/cut/cutter.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/mesh/vertex_star.hpp"
#include "server/core/stroke/swept_surface.hpp"
#include "server/core/util/run_sorter.hpp"

namespace incise::core {

// The policy `conforming`, for one blade. Five phases for each batch:
//
//   search    which tetrahedra the new swept triangles meet: from the ones met before and from the boundary inwards,
//             then by adjacency. They join the active tetrahedra.
//   events    where the surface crosses an edge of an active tetrahedron, a vertex is put on the surface: the nearer
//             end of the edge is snapped there, else the farther end, else the edge is split. A tetrahedron that
//             thereby gets all four vertices on the surface is flat and is removed.
//   repair    poor tetrahedra that this has left are improved.
//   open      a face opens exactly when the line between the reference points of its two tetrahedra crosses the
//             surface; each vertex gets one copy for each component of its star.
//
// All but the search keep one element behind the blade: a tetrahedron with a vertex near the blade's present line
// waits, for what is swept next may cross it too. So the result hardly depends on how finely the motion is chopped.
// At the stroke's end nothing waits any more.
//
// Each operation leaves a valid mesh, and the budget is looked at after each.
class ConformingCutter final : public Cutter {
 public:
  // Both must outlive this; the workspace is shared by all blades of the mesh.
  ConformingCutter(TetMesh& mesh, CutWorkspace& workspace, const CutConfig& config);

  void begin(const Batch& batch) override;
  bool advance(WorkBudget& budget) override;
  const CutCounts& counts() const override { return counts_; }
  void clinging(std::vector<VertexId>& out) const override;
  void prefetch() override;

 private:
  friend struct SessionFields;  // session_state.cpp

  // Measures of dihedral angles. A star with no angle below the first is good: a snap that leaves it so is taken freely, and
  // that is what repairs aim at. They take on what is below the second. When nothing better is left, a snap is taken down to
  // the third, and in need to the fourth.
  static constexpr double kGood = dihedral_measure(0.9876883406);       // 9 degrees
  static constexpr double kPoor = dihedral_measure(0.9914448614);       // 7.5 degrees
  static constexpr double kSnapFloor = dihedral_measure(0.9986295348);  // 3 degrees
  static constexpr double kFloor = dihedral_measure(0.9999904807);      // 0.25 degrees
  static constexpr double kExactFloor =
      dihedral_measure(0.99999998477);  // 0.01 degrees, where exactness is preferred

  enum class Phase { kIdle, kSeed, kSearch, kRim, kOrder, kEvents, kRepair, kVerify, kSelect, kSpare, kOpen };
  // Where the search begins, in this order.
  enum class Seed { kActive, kLastLine, kBoundary, kInside };

  // The surface crosses the edge (a, b) with a < b.
  struct Event {
    double nearness;  // distance of the crossing from the nearer end, by the edge's length: nearest go first
    double at;        // the crossing is at a + at (b - a)
    VertexId a, b;
    TetId tet;               // one that had the edge
    std::uint32_t triangle;  // of surface_
    std::uint32_t next;      // in the chain of events at vertex a
    std::uint32_t batch;     // that found it
    bool done;
  };

  struct Active {
    TetId tet;
    double since;    // the blade's travel before the batch that made it active, m
    double ripe_at;  // while the blade has travelled less in this stroke, it waits for certain, m
  };

  // The rim of the sweep pierces a face: the paper's second move, to the front and back planes, in general.
  struct RimEvent {
    TetId tet;
    std::array<VertexId, 3> face;
    Vec3 point;     // where
    Vec3 from, to;  // the stretch of the rim
    bool again;     // found on the second look
    bool done;
  };

  void forget_surface();
  bool retrace(const BladeLine& from, const BladeLine& to);
  bool turns_sharply(const BladeLine& from, const BladeLine& to);

  // The work done since it was taken last, for the budget.
  void charge(WorkBudget& budget) {
    budget.charge(work_);
    work_ = 0;
  }

  // --- search
  void seed(WorkBudget& budget);
  void search(WorkBudget& budget);
  bool probe(TetId t);
  void add_event(VertexId a, VertexId b, TetId t, std::uint32_t triangle, double at);
  void enqueue(TetId t);
  void activate(TetId t);
  void fail(VertexId v);
  void judge_again(const VertexStar& star, VertexId v);
  void gather(VertexStar& star, VertexId v) const {
    star.gather(mesh_, v, [this](VertexId w) { return on_surface(w); });
    work_ += 2 + static_cast<std::int64_t>(star.corners().size() / 2);
  }

  // --- the rim
  bool stands_for(VertexId v, const Vec3& point) const;
  void probe_rim(TetId t, const Vec3& from, const Vec3& to);
  void work_rim(WorkBudget& budget);
  void handle(const RimEvent& event);

  // --- events
  void begin_order();
  void order(WorkBudget& budget);
  void work_events(WorkBudget& budget);
  void verify(WorkBudget& budget);
  bool collect_from(TetId t);
  // What verify() found to be clear is looked at again only where it has changed since.
  void look_again(TetId t) { workspace_.tets[t].seen = 0; }
  bool ripe(Active& entry);
  bool hot(VertexId v, double* by_m = nullptr) const;
  bool on_rim(VertexId v) const { return workspace_.vertices[v].rim == stroke_; }
  // Whether v was put on what is kept of the swept surface. Where the blade comes across its own cut later in the stroke, that
  // is an old cut like any other.
  bool on_surface(VertexId v) const {
    const CutWorkspace::VertexMarks& marks = workspace_.vertices[v];
    return marks.surface == stroke_ && marks.batch >= oldest_;
  }
  void mark_on_surface(VertexId v) {
    workspace_.vertices[v].surface = stroke_;
    workspace_.vertices[v].batch = batch_;
  }
  bool find_crossing(const Vec3& a, bool a_on, const Vec3& b, bool b_on, std::uint32_t& triangle,
                     double& t) const;
  void handle(std::uint32_t index);
  struct Placement {
    Vec3 target;
    double worst = kInverted;  // the star's worst measure there
  };
  double worst_at(const VertexStar& star, const Vec3& p, double limit, double thickness);
  int freedom(const VertexStar& star, const Vec3* surface_normal, Vec3 (&basis)[3]) const;
  void search_placement(const VertexStar& star, bool on_surface, std::uint32_t triangle, double goal,
                        double thickness, Placement& placement);
  Placement place(VertexStar& star, VertexId v, const Event& event, const Vec3& crossing, double limit,
                  bool search);
  bool stay(const VertexStar& star, Placement& placement);
  void snap(const VertexStar& star, VertexId v, const Vec3& target);
  double split_worst(TetId tet, VertexId a, VertexId b, double t, double limit);
  void split(TetId tet, VertexId a, VertexId b, double t);
  void remove_flat(TetId t);

  // --- repair
  void begin_repairs();
  void repair(WorkBudget& budget);
  void begin_repair();
  void improve();
  void improve_by_moving(VertexId v);
  void note_poor(TetId t);
  void stir(std::span<const VertexId> vertices);
  void improve_by_collapse(TetId t);
  bool is_film(TetId t) const;
  void thin_out(VertexId v);
  bool try_collapse(const VertexStar& star, TetId t, VertexId v, VertexId w);
  bool try_flips(TetId t);
  bool remove_edge(TetId t, VertexId a, VertexId b);
  bool flip_face(HalfFace h);
  bool replace(std::span<const TetId> removed, std::span<const std::array<VertexId, 4>> added);

  // --- opening
  void select(WorkBudget& budget);
  Vec3 reference(TetId t) const;
  bool separates(HalfFace h) const;
  unsigned may_separate(TetId t) const;
  bool select_faces(TetId t);
  void spare_islands(WorkBudget& budget);
  void spare_island(HalfFace side);
  void join_larger_side(std::span<const TetId> members);
  bool stands_clear(HalfFace h) const;
  bool is_ragged(HalfFace h) const;
  bool is_thin(TetId t) const;
  void open(WorkBudget& budget);
  void note_opening(HalfFace h);
  void finish();

  TetMesh& mesh_;
  CutWorkspace& workspace_;
  const CutConfig config_;
  const double h_;
  const double clear_;  // nearer to a plane than this, m, only exact arithmetic decides

  Phase phase_ = Phase::kIdle;
  CutCounts counts_;
  std::uint32_t stroke_ = 0, batch_ = 0;
  bool has_front_ = false;
  BladeLine front_;               // the blade now
  Vec3 heading_;                  // normal of the sweep where it began or last turned sharply
  SweptSurface surface_;          // as far back as active tetrahedra may still need it
  std::size_t first_latest_ = 0;  // triangle of this batch
  std::vector<Active> active_;
  double widest_ = 0;  // the largest local mesh width at any of this stroke's, m
  struct Swept {
    std::uint32_t batch;
    double travel;  // of the blade in this stroke before the batch, m
  };
  std::vector<Swept> swept_;  // the batches of surface_
  std::uint32_t oldest_ = 0;  // of them
  // Lines between which the surface covers what the blade has swept, from one that is on it.
  static constexpr std::size_t kMostRetraced = 256;
  std::vector<BladeLine> retraced_;
  double travel_ = 0;

  mutable std::int64_t work_ = 0;  // units not charged yet

  std::vector<TetId> queue_;  // of the search at work
  std::size_t queue_next_ = 0;
  std::uint32_t search_ = 0;  // its serial
  Seed seed_ = Seed::kActive;
  std::size_t next_seed_ = 0;
  std::vector<TetId> candidates_;  // near a new triangle
  std::size_t next_candidate_ = 0;

  std::vector<RimEvent> rim_events_;
  std::size_t next_rim_ = 0;

  std::size_t next_active_ = 0;
  int round_ = 0;
  std::vector<Event> events_;
  // Nearest crossing first.
  struct EventKey {
    double nearness;
    VertexId a, b;
    std::uint32_t index;
    bool operator<(const EventKey& other) const {
      if (nearness != other.nearness) return nearness < other.nearness;
      if (a != other.a) return a < other.a;
      return b != other.b ? b < other.b : index < other.index;
    }
  };
  RunSorter<EventKey> order_;
  std::size_t next_event_ = 0;
  int pass_ = 0;
  std::vector<std::uint32_t> again_;  // that this pass works on, after the first
  std::vector<std::uint32_t> retry_;
  std::uint32_t collection_ = 0;
  std::size_t first_leftover_ = 0;
  std::uint32_t verified_ = 0;  // serial of this batch's verification

  std::vector<HalfFace> to_open_;
  std::size_t next_open_ = 0;
  std::uint32_t spared_ = 0;  // serial of the search for islands

  // A vertex put on the surface by this batch, or made by that, whose star may not be good.
  struct Changed {
    VertexId vertex;
    int times = 0;  // it was repaired, not well enough
  };
  std::vector<Changed> changed_;
  std::size_t next_changed_ = 0;
  // The vertex that is repaired, and its poor tetrahedra, of which one is at work: moving one of its vertices (0 to 3),
  // flips (4), collapses (5).
  Changed repaired_{};
  bool repairing_ = false;
  std::uint32_t repairs_ = 0;  // serial of the repairs at work
  std::vector<TetId> poor_;
  std::size_t next_poor_ = 0;
  int remedy_ = 0;

  VertexStar star_, other_star_;
  std::vector<TetId> flat_, ring_, new_tets_, prefetched_;
  std::vector<std::uint32_t> star_ids_;
};

}  // namespace incise::core
