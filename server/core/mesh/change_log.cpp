#include "server/core/mesh/change_log.hpp"

#include <algorithm>

#include "server/base/check.hpp"
#include "server/core/mesh/tet_mesh.hpp"

namespace incise::core {

void ChangeLog::begin_step(VertexId vertex_slots, TetId tet_slots) {
  first_new_vertex_ = vertex_slots;
  first_new_tet_ = tet_slots;
  vertices_in_order_.grow(vertex_slots);
  tets_in_order_.grow(tet_slots);
  finder_.grow(vertex_slots);
}

void ChangeLog::forget(VertexId vertex_slots, TetId tet_slots, std::uint64_t hash) {
  touched_vertices_.clear();
  touched_tets_.clear();
  before_.clear();
  provenance_.clear();
  elder_.clear();
  finder_.clear();
  begin_step(vertex_slots, tet_slots);
  hash_ = hash;
}

void ChangeLog::begin_as(const ChangeLog& other, VertexId vertex_slots, TetId tet_slots) {
  INCISE_CHECK(other.touched_tets_.empty() && other.touched_vertices_.empty(), other.touched_tets_.size(),
               other.touched_vertices_.size());
  forget(vertex_slots, tet_slots, other.hash_);
  cut_sides_ = other.cut_sides_;
}

void ChangeLog::note_vertex(const TetMesh& mesh, VertexId v) {
  touched_vertices_.push_back(v);
  finder_.note_vertex(v, mesh.rest_position(v));
  hash_ ^= mesh.hash_of_vertex(v);
}

void ChangeLog::note_tet(const TetMesh& mesh, TetId t) {
  record(t, mesh.state(t));
  hash_ ^= mesh.hash_of_tet(t);
}

void ChangeLog::clear_mesh(Delta& delta) {
  delta.moved.clear();
  delta.moved_positions.clear();
  delta.added_positions.clear();
  delta.provenance.clear();
  delta.blends.clear();
  delta.moved_rest.clear();
  delta.added_rest.clear();
  delta.upserted.clear();
  delta.removed.clear();
  delta.elders.clear();
  delta.boundary_upserted.clear();
  delta.boundary_removed.clear();
}

bool ChangeLog::commit(const TetMesh& mesh, Delta& delta, WorkBudget& budget) {
  if (committing_ == Committing::kNothing) {
    clear_mesh(delta);
    delta.first_added = first_new_vertex_;
    step_sides_ = 0;
    step_side_area_ = 0;
    committing_ = Committing::kMoved;
  }
  if (committing_ == Committing::kMoved) {
    if (!commit_moved(mesh, delta, budget)) return false;
    next_ = 0;
    committing_ = Committing::kAdded;
  }
  if (committing_ == Committing::kAdded) {
    if (!commit_added(mesh, delta, budget)) return false;
    next_ = 0;
    committing_ = Committing::kBefore;
  }
  if (committing_ < Committing::kTets) {
    if (!find_blends(mesh, delta, budget)) return false;
    committing_ = Committing::kTets;
  }
  if (committing_ == Committing::kTets) {
    if (!commit_tets(mesh, delta, budget)) return false;
    next_ = first_new_tet_;
    committing_ = Committing::kNewTets;
  }
  if (!commit_new_tets(mesh, delta, budget)) return false;
  end_commit(mesh, delta);
  return true;
}

bool ChangeLog::commit_moved(const TetMesh& mesh, Delta& delta, WorkBudget& budget) {
  while (!vertices_in_order_.empty()) {
    if (budget.spent()) return false;
    budget.charge(2);
    const VertexId v = vertices_in_order_.take();
    hash_ ^= mesh.hash_of_vertex(v);
    delta.moved.push_back(v);
    delta.moved_positions.push_back(mesh.position(v));
    if (mesh.deformed()) delta.moved_rest.push_back(mesh.rest_position(v));
  }
  return true;
}

bool ChangeLog::commit_added(const TetMesh& mesh, Delta& delta, WorkBudget& budget) {
  for (; next_ < provenance_.size(); ++next_) {
    if (budget.spent()) return false;
    budget.charge(1);
    const VertexId v = first_new_vertex_ + static_cast<VertexId>(next_);
    hash_ ^= mesh.hash_of_vertex(v);
    delta.added_positions.push_back(mesh.position(v));
    delta.provenance.push_back(provenance_[next_]);
    if (mesh.deformed()) delta.added_rest.push_back(mesh.rest_position(v));
  }
  return true;
}

// Which material the step's vertices stand for now.
bool ChangeLog::find_blends(const TetMesh& mesh, Delta& delta, WorkBudget& budget) {
  if (delta.moved.empty() && provenance_.empty()) return true;
  if (committing_ == Committing::kBefore) {
    if (!note_tets_before(mesh, budget)) return false;
    next_ = 0;
    committing_ = Committing::kBlendMoved;
  }
  if (committing_ == Committing::kBlendMoved) {
    if (!blend_moved(mesh, delta, budget)) return false;
    next_ = 0;
    committing_ = Committing::kBlendAdded;
  }
  return blend_added(mesh, delta, budget);
}

bool ChangeLog::note_tets_before(const TetMesh& mesh, WorkBudget& budget) {
  for (; next_ < before_.size(); ++next_) {
    if (budget.spent()) return false;
    if (before_[next_].id == kNone) continue;
    budget.charge(1);
    finder_.note_tet(mesh, before_[next_], static_cast<std::uint32_t>(next_));
  }
  return true;
}

bool ChangeLog::blend_moved(const TetMesh& mesh, Delta& delta, WorkBudget& budget) {
  for (; next_ < delta.moved.size(); ++next_) {
    if (budget.spent()) return false;
    const VertexId v = delta.moved[next_];
    if (finder_.rest_before(v) == mesh.rest_position(v)) continue;
    delta.blends.push_back(finder_.find(mesh, *this, v, {&v, 1}));
    budget.charge(1 + static_cast<std::int64_t>(finder_.take_work() / 2));
  }
  return true;
}

// A vertex that lies between its parents as they are now needs none: with their fields it gets its own.
bool ChangeLog::blend_added(const TetMesh& mesh, Delta& delta, WorkBudget& budget) {
  for (; next_ < provenance_.size(); ++next_) {
    if (budget.spent()) return false;
    const VertexId v = first_new_vertex_ + static_cast<VertexId>(next_);
    const Provenance& p = provenance_[next_];
    if (lerp(mesh.rest_position(p.a), mesh.rest_position(p.b), p.t) == mesh.rest_position(v)) continue;
    const VertexId near[2] = {ancestor(p.a), ancestor(p.b)};
    delta.blends.push_back(finder_.find(mesh, *this, v, near));
    budget.charge(1 + static_cast<std::int64_t>(finder_.take_work() / 2));
  }
  return true;
}

// A vertex from before the step, near v.
VertexId ChangeLog::ancestor(VertexId v) const {
  while (is_new(v)) v = provenance(v).t < 0.5 ? provenance(v).a : provenance(v).b;
  return v;
}

bool ChangeLog::commit_tets(const TetMesh& mesh, Delta& delta, WorkBudget& budget) {
  while (!tets_in_order_.empty()) {
    if (budget.spent()) return false;
    budget.charge(2);
    commit_tet(mesh, tets_in_order_.take(), delta);
  }
  return true;
}

bool ChangeLog::commit_new_tets(const TetMesh& mesh, Delta& delta, WorkBudget& budget) {
  for (; next_ < mesh.tet_slots(); ++next_) {
    if (budget.spent()) return false;
    budget.charge(2);
    commit_tet(mesh, static_cast<TetId>(next_), delta);
  }
  return true;
}

// What has become of one tetrahedron that the step has touched or made.
void ChangeLog::commit_tet(const TetMesh& mesh, TetId t, Delta& delta) {
  const TetState& before = before_[record_[t]];
  const bool existed = before.id != kNone;
  const bool lives = mesh.alive(t);
  if (lives) {
    delta.upserted.push_back(mesh.state(t));
    if (!existed) delta.elders.push_back(elder(t));
    hash_ ^= mesh.hash_of_tet(t);
  } else if (existed) {
    delta.removed.push_back(t);
  }
  const TetState after = lives ? delta.upserted.back() : TetState{};
  if (before.cut_mask != 0) count_sides(mesh, before, -1);
  if (after.cut_mask != 0) count_sides(mesh, after, 1);
  if ((before.boundary_mask | after.boundary_mask) != 0) commit_boundary(t, before, after, delta);
}

// A tetrahedron that does not exist has no boundary faces.
void ChangeLog::commit_boundary(TetId t, const TetState& before, const TetState& after, Delta& delta) {
  for (int f = 0; f < 4; ++f) {
    const bool was = (before.boundary_mask >> f & 1) != 0;
    const bool is = (after.boundary_mask >> f & 1) != 0;
    if (is) {
      const auto same = [&](int k) {
        return before.vertices[kFaceVertices[f][k]] == after.vertices[kFaceVertices[f][k]];
      };
      const bool cut_as_before = (before.cut_mask >> f & 1) == (after.cut_mask >> f & 1);
      if (!was || !cut_as_before || !same(0) || !same(1) || !same(2))
        delta.boundary_upserted.push_back(half_face(t, f));
    } else if (was) {
      delta.boundary_removed.push_back(half_face(t, f));
    }
  }
}

void ChangeLog::count_sides(const TetMesh& mesh, const TetState& tet, int sign) {
  for (int f = 0; f < 4; ++f) {
    if (!(tet.cut_mask >> f & 1)) continue;
    const Vec3& a = mesh.position(tet.vertices[kFaceVertices[f][0]]);
    const Vec3 n = cross(mesh.position(tet.vertices[kFaceVertices[f][1]]) - a,
                         mesh.position(tet.vertices[kFaceVertices[f][2]]) - a);
    step_sides_ += sign;
    step_side_area_ += sign * 0.5 * length(n);
  }
}

void ChangeLog::end_commit(const TetMesh& mesh, Delta& delta) {
  // Of the totals, so that steps with an odd number of sides add up.
  const std::int64_t faces_before = (cut_sides_ + 1) / 2;
  cut_sides_ += step_sides_;
  delta.cut_faces =
      static_cast<std::uint32_t>(std::max<std::int64_t>((cut_sides_ + 1) / 2 - faces_before, 0));
  delta.cut_area = std::max(0.5 * step_side_area_, 0.0);
  forget(mesh.vertex_slots(), mesh.tet_slots(), hash_);
  delta.state_hash = hash_;
  committing_ = Committing::kNothing;
}

void ChangeLog::archive(Archive& io) {
  io(cut_sides_);
  io(hash_);
}

}  // namespace incise::core
