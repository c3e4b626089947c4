#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/vertex_positions.hpp"
#include "server/core/stroke/stroke_builder.hpp"
#include "server/core/util/archive.hpp"
#include "server/core/util/work_budget.hpp"

namespace incise::core {

// Whether a vertex may lie there.
inline bool is_place(const Vec3& p) {
  // Nothing that is nearer is too far, however the roots are rounded.
  constexpr double kSurelyNear_m2 = 0.99 * kFarthest_m * kFarthest_m;
  return squared_length(p) < kSurelyNear_m2 || (is_finite(p) && length(p) <= kFarthest_m);
}

// A vertex, and where it has to be after the step.
struct VertexPlace {
  VertexId vertex;
  Vec3 place;
};

// The vertices that cuts have moved or made since the revision that a step of a host simulation was computed for. The simulation does not know their
// material, so what it says of them is not taken. They go along with what they hang on: by the affine map, from places at rest, that is nearest to where the other vertices of their
// tetrahedra go; where few of these are known, those next to them count as well, and where none is, those that have been placed by then. A part in which
// nothing is known goes as one, with what is nearest. What a step does not name stays, as it does
// elsewhere.
class LateVertices {
 public:
  // It must outlive this.
  explicit LateVertices(const TetMesh& mesh);

  // Records the vertices that a cut has moved or made in delta.revision.
  void note_cut(const Delta& delta);
  // Whether the simulation that sent these knew where v is.
  bool is_known(const VertexPositions& positions, VertexId v) const;
  // Where these positions want a vertex; null: they do not say so, or did not know where it is. Of several positions: O(log(positions)).
  const Vec3* wanted_place(const VertexPositions& positions, VertexId v) const;

  // Finds where they go. `positions` must live until that is done; `clinging`: some vertices' places are given.
  void begin(const VertexPositions& positions, std::span<const VertexPlace> clinging);
  // Works until all is found (true) or the budget is spent (false). O(late vertices), and a look at each 64th vertex.
  bool advance(WorkBudget& budget);
  // Where those go that do not cling, ascending. What moves nowhere may be among them.
  std::span<const VertexPlace> places() const { return std::span(places_).subspan(clinging_); }

  void archive(Archive& io);

 private:
  // Those that hang on something known first, then those that hang on these, and so on; at last the parts that hang on nothing known.
  enum class Phase { kFind, kPlace, kSpread, kParts, kDone };

  template <class Work>
  bool one_by_one(std::size_t count, WorkBudget& budget, Work work);
  void find_in(std::size_t block);
  void place(VertexId v, WorkBudget& budget);
  void look_farther(WorkBudget& budget);
  void begin_fit();
  void add_to_fit(VertexId w);
  void begin_spreading();
  void ask_around(VertexId v, WorkBudget& budget);
  void place_part(VertexId v, WorkBudget& budget);
  void finish();
  void note_places(std::size_t first);
  bool is_late(VertexId v) const { return known_since_[v] > positions_->revision; }
  bool has_place(VertexId v) const {
    return place_at_[v] < places_.size() && places_[place_at_[v]].vertex == v;
  }
  // What these positions say of a vertex that is known; null: nothing.
  const Vec3* given_place(const VertexPositions& positions, VertexId v) const;
  std::span<const VertexId> ring_of(VertexId v, WorkBudget& budget);
  // Where a vertex goes; null: not known so far.
  const Vec3* place_of(VertexId v) const;

  const TetMesh& mesh_;
  std::vector<std::uint64_t> known_since_;  // by vertex: the revision of the last cut that moved or made it
  std::vector<std::uint64_t> latest_;       // of each 64 of these

  const VertexPositions* positions_ = nullptr;
  Phase phase_ = Phase::kDone;
  std::size_t next_ = 0;                 // that is looked at, in this phase
  std::vector<VertexId> late_;           // all but what clings
  std::vector<VertexId> front_;          // of these: those that may be placed now
  std::vector<VertexPlace> places_;      // what clings, and what has been placed
  std::vector<VertexPlace> placed_;      // since the last spreading
  std::size_t clinging_ = 0;             // of places_, the first
  std::vector<std::uint32_t> place_at_;  // by vertex: where it is in places_, if it is
  std::vector<std::uint32_t> met_;       // by vertex: the look or the spreading that met it last
  std::uint32_t serial_ = 0;             // of that, ever
  // The vertices of the tetrahedra at one, itself first: of those that this step has asked for. Late vertices lie beside each other, so most
  // are asked for many times.
  struct Ring {
    VertexId vertex;
    std::uint32_t first;  // in ring_vertices_; the next ring's are behind them
  };
  std::vector<Ring> rings_;
  std::vector<VertexId> ring_vertices_;
  std::vector<std::uint32_t> ring_at_;  // by vertex: where it is in rings_, if it is
  std::vector<Corner> star_;
  std::vector<VertexId> around_;
  std::vector<Vec3> from_, to_;
  bool moves_ = false;                             // one of these
  std::vector<std::pair<double, VertexId>> near_;  // scratch: by squared distance
};

}  // namespace incise::core
