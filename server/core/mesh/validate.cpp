#include "server/core/mesh/validate.hpp"

#include <algorithm>
#include <vector>

#include "server/core/geometry/predicates.hpp"

namespace incise::core {
namespace {

std::string name(TetId t) {
  return "tetrahedron " + std::to_string(t);
}

std::string check_tet(const TetMesh& mesh, TetId t, bool orientation) {
  const auto& v = mesh.vertices(t);
  for (int i = 0; i < 4; ++i) {
    if (v[i] >= mesh.vertex_slots())
      return name(t) + " names a vertex that never was: " + std::to_string(v[i]);
    for (int j = 0; j < i; ++j) {
      if (v[i] == v[j]) return name(t) + " has vertex " + std::to_string(v[i]) + " twice";
    }
    if (!is_finite(mesh.position(v[i]))) return "vertex " + std::to_string(v[i]) + " has no finite position";
  }
  if (orientation &&
      orient3d(mesh.position(v[0]), mesh.position(v[1]), mesh.position(v[2]), mesh.position(v[3])) <= 0) {
    return name(t) + " is not positively oriented: volume " + std::to_string(mesh.volume(t));
  }
  for (int f = 0; f < 4; ++f) {
    const HalfFace h = half_face(t, f), o = mesh.opposite(h);
    const bool cut = (mesh.cut_mask(t) >> f & 1) != 0;
    if (o == kNone) continue;
    if (cut) return name(t) + ": face " + std::to_string(f) + " is marked cut, but has a neighbour";
    if (tet_of(o) >= mesh.tet_slots() || !mesh.alive(tet_of(o))) return name(t) + " has a dead neighbour";
    if (mesh.opposite(o) != h)
      return name(t) + " and " + std::to_string(tet_of(o)) + ": adjacency is not symmetric";
    // Each sees the shared face counter-clockwise from its outside: the other way round.
    const auto mine = mesh.face_vertices(h);
    auto theirs = mesh.face_vertices(o);
    std::swap(theirs[0], theirs[1]);
    std::rotate(theirs.begin(), std::find(theirs.begin(), theirs.end(), mine[0]), theirs.end());
    if (mine != theirs) {
      return name(t) + " and " + std::to_string(tet_of(o)) + " share no face, or lie on the same side of it";
    }
  }
  return {};
}

// That v's star is in order where its tetrahedra, counted by other means, are `incident` many.
std::string check_star(const TetMesh& mesh, VertexId v, std::vector<std::uint32_t>& star) {
  const TetId t = mesh.vertex_tet(v);
  if (t == kNone || !mesh.alive(t) || mesh.local_index(t, v) < 0) {
    return "vertex " + std::to_string(v) + " names a tetrahedron that does not have it";
  }
  mesh.star(v, star);
  const bool at_boundary = std::ranges::any_of(
      star, [&](Corner c) { return (mesh.boundary_mask(tet_of(c)) & ~(1u << index_of(c))) != 0; });
  if (mesh.at_boundary(v) != at_boundary)
    return "vertex " + std::to_string(v) + (at_boundary ? " is" : " is not") + " at the boundary";
  const bool at_cut = std::ranges::any_of(
      star, [&](Corner c) { return (mesh.cut_mask(tet_of(c)) & ~(1u << index_of(c))) != 0; });
  if (at_cut && !mesh.may_be_at_cut(v)) return "vertex " + std::to_string(v) + " is at a cut";
  return {};
}

}  // namespace

std::string validate(const TetMesh& mesh, bool orientation) {
  std::vector<std::uint32_t> incident(mesh.vertex_slots(), 0);
  std::uint32_t live = 0;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    ++live;
    if (auto problem = check_tet(mesh, t, orientation); !problem.empty()) return problem;
    for (VertexId v : mesh.vertices(t)) ++incident[v];
  }
  if (live != mesh.live_tets()) return "live tetrahedra are miscounted";
  std::vector<std::uint32_t> star;
  for (VertexId v = 0; v < mesh.vertex_slots(); ++v) {
    if (incident[v] == 0) continue;
    if (auto problem = check_star(mesh, v, star); !problem.empty()) return problem;
    if (star.size() != incident[v]) {
      return "vertex " + std::to_string(v) + ": " + std::to_string(incident[v]) + " tetrahedra, of which " +
             std::to_string(star.size()) + " are connected through faces";
    }
  }
  const bool committed = mesh.touched_tets().empty() && mesh.touched_vertices().empty();
  if (committed && mesh.compute_state_hash() != mesh.state_hash()) return "the state hash is wrong";
  return {};
}

std::string validate_near(const TetMesh& mesh, std::span<const TetId> tets, bool orientation) {
  std::vector<std::uint32_t> star;
  for (TetId t : tets) {
    if (!mesh.alive(t)) continue;
    if (auto problem = check_tet(mesh, t, orientation); !problem.empty()) return problem;
    for (VertexId v : mesh.vertices(t)) {
      if (auto problem = check_star(mesh, v, star); !problem.empty()) return problem;
      const auto in_star = [&](std::uint32_t corner) { return tet_of(corner) == t; };
      if (std::none_of(star.begin(), star.end(), in_star)) {
        return name(t) + " is cut off from the star of its vertex " + std::to_string(v);
      }
    }
  }
  return {};
}

}  // namespace incise::core
