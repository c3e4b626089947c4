#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/mesh/blend_finder.hpp"
#include "server/core/mesh/delta.hpp"
#include "server/core/util/archive.hpp"
#include "server/core/util/id_set.hpp"
#include "server/core/util/room.hpp"
#include "server/core/util/work_budget.hpp"

namespace incise::core {

class TetMesh;

// What the running step has changed in a mesh; commit() turns it into a delta. Keeps the state hash: the XOR over vertices and
// tetrahedra (protocol/state_hash.hpp). What the step touches is taken out of it when it is touched, and put back by commit().
class ChangeLog {
 public:
  // Ids below these exist; the rest of the step's ids are new.
  void begin_step(VertexId vertex_slots, TetId tet_slots);
  void grow_to(std::size_t vertices, std::size_t tets) {
    finder_.reserve(vertices);
    core::grow_to(record_, tets);
  }

  // Before a vertex is moved.
  void touch_vertex(const TetMesh& mesh, VertexId v) {
    if (!is_new(v) && vertices_in_order_.insert(v)) note_vertex(mesh, v);
  }
  // Before a tetrahedron changes or goes.
  void touch_tet(const TetMesh& mesh, TetId t) {
    if (!is_new_tet(t) && tets_in_order_.insert(t)) note_tet(mesh, t);
  }
  // The next vertex and tetrahedron are new. `parent`: a tetrahedron of the same piece.
  void add_vertex(const Provenance& provenance) { provenance_.push_back(provenance); }
  void add_tet(TetId t, TetId parent) {
    elder_.push_back(is_new_tet(parent) ? elder(parent) : parent);
    record_.push_back(0);
    record(t, {});
  }
  // A step that only moves vertices.
  void deform(std::uint64_t hash_change) { hash_ ^= hash_change; }

  // See TetMesh::commit().
  bool commit(const TetMesh& mesh, Delta& delta, WorkBudget& budget);
  // Empties what a step fills of the mesh, pieces apart.
  static void clear_mesh(Delta& delta);
  // The log of a copy of a mesh in which no step is under way.
  void begin_as(const ChangeLog& other, VertexId vertex_slots, TetId tet_slots);
  // Forgets the step, of a mesh that has this hash.
  void forget(VertexId vertex_slots, TetId tet_slots, std::uint64_t hash);

  const Provenance& provenance(VertexId v) const { return provenance_[v - first_new_vertex_]; }
  // Whether the step has changed or made it; as which record.
  bool touched(TetId t) const { return record_[t] < touched_tets_.size() && touched_tets_[record_[t]] == t; }
  // A tetrahedron as it was before the step; kNone as its id where it did not exist.
  const TetState& before(std::uint32_t record) const { return before_[record]; }
  bool is_new(VertexId v) const { return v >= first_new_vertex_; }
  bool is_new_tet(TetId t) const { return t >= first_new_tet_; }
  TetId elder(TetId t) const { return elder_[t - first_new_tet_]; }
  std::span<const TetId> touched_tets() const { return touched_tets_; }
  std::span<const VertexId> touched_vertices() const { return touched_vertices_; }
  std::uint64_t state_hash() const { return hash_; }
  void prefetch(TetId t) const { __builtin_prefetch(&record_[t]); }

  void archive(Archive& io);

 private:
  void note_vertex(const TetMesh& mesh, VertexId v);
  void note_tet(const TetMesh& mesh, TetId t);
  void record(TetId t, const TetState& before) {
    record_[t] = static_cast<std::uint32_t>(touched_tets_.size());
    touched_tets_.push_back(t);
    before_.push_back(before);
  }
  bool commit_moved(const TetMesh& mesh, Delta& delta, WorkBudget& budget);
  bool commit_added(const TetMesh& mesh, Delta& delta, WorkBudget& budget);
  bool find_blends(const TetMesh& mesh, Delta& delta, WorkBudget& budget);
  bool note_tets_before(const TetMesh& mesh, WorkBudget& budget);
  bool blend_moved(const TetMesh& mesh, Delta& delta, WorkBudget& budget);
  bool blend_added(const TetMesh& mesh, Delta& delta, WorkBudget& budget);
  VertexId ancestor(VertexId v) const;
  bool commit_tets(const TetMesh& mesh, Delta& delta, WorkBudget& budget);
  bool commit_new_tets(const TetMesh& mesh, Delta& delta, WorkBudget& budget);
  void commit_tet(const TetMesh& mesh, TetId t, Delta& delta);
  void commit_boundary(TetId t, const TetState& before, const TetState& after, Delta& delta);
  void count_sides(const TetMesh& mesh, const TetState& tet, int sign);
  void end_commit(const TetMesh& mesh, Delta& delta);

  std::vector<VertexId> touched_vertices_;
  std::vector<TetId> touched_tets_;
  std::vector<std::uint32_t> record_;  // by tetrahedron: where it is in touched_tets_, if it is there
  std::vector<TetState> before_;       // one for each of touched_tets_
  VertexId first_new_vertex_ = 0;
  TetId first_new_tet_ = 0;
  std::vector<Provenance> provenance_;       // of new vertices
  std::vector<TetId> elder_;                 // of new tetrahedra
  IdSet vertices_in_order_, tets_in_order_;  // that existed before the step and are touched
  BlendFinder finder_;
  std::uint64_t hash_ = 0;
  std::int64_t cut_sides_ = 0;  // sides of faces that cuts have opened, since load

  // How far commit() is.
  enum class Committing { kNothing, kMoved, kAdded, kBefore, kBlendMoved, kBlendAdded, kTets, kNewTets };
  Committing committing_ = Committing::kNothing;
  std::size_t next_ = 0;
  int step_sides_ = 0;
  double step_side_area_ = 0;  // m^2
};

}  // namespace incise::core
