#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/in_chunks.hpp"
#include "server/core/util/room.hpp"

namespace incise::core {

// The vertices of all tetrahedra as of the last revision, and which of these lie on the boundary, apart from the rest of the mesh: a step
// of a host simulation looks at all of them, and it is memory that it waits for.
class StepTets {
 public:
  explicit StepTets(const TetMesh& mesh) : mesh_(mesh) {}

  // Takes in the tetrahedra that it does not have yet, until it has all (true) or the budget is spent (false).
  bool catch_up(WorkBudget& budget) {
    const std::size_t count = mesh_.tet_slots();
    if (vertices_.empty()) reserve_room(vertices_, count);
    if (boundary_.empty()) {
      boundary_.reserve(room_for(count) / 64);
      alive_.reserve(room_for(count) / 64);
    }
    std::size_t next = vertices_.size();
    return in_chunks(next, count, budget, 1, [this](std::size_t i) {
      const auto t = static_cast<TetId>(i);
      vertices_.push_back({});
      if (boundary_.size() * 64 <= i) {
        boundary_.push_back(0);
        alive_.push_back(0);
      }
      if (mesh_.alive(t)) set(t, mesh_.vertices(t), mesh_.on_boundary(t));
    });
  }
  // After a cut.
  void follow(const Delta& delta) {
    for (const TetState& tet : delta.upserted)
      if (tet.id < vertices_.size()) set(tet.id, tet.vertices, tet.boundary_mask != 0);
    for (const TetId t : delta.removed) {
      if (t >= vertices_.size()) continue;
      vertices_[t] = {};
      set(alive_, t, false);
      set(boundary_, t, false);
    }
  }

  std::size_t size() const { return vertices_.size(); }
  // Of the 64 tetrahedra that t is among: bit k says whether the k-th is alive.
  std::uint64_t alive_64(TetId t) const { return alive_[t / 64]; }
  // Of dead ones: a vertex of the mesh, four times.
  const std::array<VertexId, 4>& vertices(TetId t) const { return vertices_[t]; }

  // Calls visit(tet) for those on the boundary, ascending, from `next` (of the words of 64) on.
  template <class Visit>
  bool visit_boundary(std::size_t& next, WorkBudget& budget, Visit visit) const {
    for (; next < boundary_.size(); ++next) {
      std::uint64_t bits = boundary_[next];
      if (bits == 0) continue;
      if (budget.spent()) return false;
      budget.charge(1 + std::popcount(bits) / 4);
      // They lie far apart.
      if (next + kAhead < boundary_.size()) {
        for (std::uint64_t later = boundary_[next + kAhead]; later != 0; later &= later - 1)
          __builtin_prefetch(
              &vertices_[(next + kAhead) * 64 + static_cast<std::size_t>(std::countr_zero(later))]);
      }
      for (; bits != 0; bits &= bits - 1)
        visit(static_cast<TetId>(next * 64) + static_cast<TetId>(std::countr_zero(bits)));
    }
    next = 0;
    return true;
  }

 private:
  static constexpr std::size_t kAhead = 2;  // words of 64, of what is fetched
  static void set(std::vector<std::uint64_t>& bits, TetId t, bool is) {
    const std::uint64_t bit = std::uint64_t{1} << (t % 64);
    bits[t / 64] = is ? bits[t / 64] | bit : bits[t / 64] & ~bit;
  }
  void set(TetId t, const std::array<VertexId, 4>& vertices, bool on_boundary) {
    vertices_[t] = vertices;
    set(alive_, t, true);
    set(boundary_, t, on_boundary);
  }

  const TetMesh& mesh_;
  std::vector<std::array<VertexId, 4>> vertices_;
  std::vector<std::uint64_t> alive_, boundary_;  // a bit for each
};

}  // namespace incise::core
