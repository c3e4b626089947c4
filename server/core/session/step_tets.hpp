#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/in_chunks.hpp"
#include "server/core/session/tet_clusters.hpp"
#include "server/core/util/room.hpp"

namespace incise::core {

// The vertices of all tetrahedra as of the last revision, and which of these lie on the boundary, apart from the rest of the mesh: a step
// of a host simulation looks at all of them, and it is memory that it waits for. Each has a slot. Those that are there when the first step
// comes stand cluster by cluster, so that one meets the vertices of those before it in the nearest cache; in a mesh file they may stand anyhow.
class StepTets {
 public:
  // Both must outlive this.
  StepTets(const TetMesh& mesh, const TetClusters& clusters) : mesh_(mesh), clusters_(clusters) {}

  // Takes in the tetrahedra that it does not have yet, until it has all (true) or the budget is spent (false).
  bool catch_up(WorkBudget& budget) {
    const std::size_t count = mesh_.tet_slots();
    if (slot_of_.empty()) {
      reserve_room(slot_of_, count);
      reserve_room(vertices_, count);
      boundary_.reserve(room_for(count) / 64);
      alive_.reserve(room_for(count) / 64);
    }
    std::size_t next = slot_of_.size();
    const auto make_room = [this](std::size_t i) {
      slot_of_.push_back(kNone);
      if (boundary_.size() * 64 <= i) boundary_.push_back(0);
    };
    if (!in_chunks(next, count, budget, 1, make_room)) return false;
    const std::span<const TetId> members = clusters_.members();
    if (!has_clusters_ &&
        !in_chunks(next_member_, members.size(), budget, 1, [&](std::size_t i) { take_in(members[i]); }))
      return false;
    has_clusters_ = true;
    next = looked_at_;
    return in_chunks(next, count, budget, 1, [this](std::size_t i) {
      take_in(static_cast<TetId>(i));
      looked_at_ = i + 1;
    });
  }
  // After a cut.
  void follow(const Delta& delta) {
    for (const TetState& tet : delta.upserted) {
      if (!has(tet.id)) continue;
      vertices_[slot_of_[tet.id]] = tet.vertices;
      set(boundary_, tet.id, tet.boundary_mask != 0);
    }
    for (const TetId t : delta.removed) {
      if (!has(t)) continue;
      vertices_[slot_of_[t]] = {};
      set(alive_, slot_of_[t], false);
      set(boundary_, t, false);
    }
  }

  // Slots.
  std::size_t size() const { return vertices_.size(); }
  // Of the 64 slots that this one is among: bit k says whether the k-th holds a living tetrahedron.
  std::uint64_t alive_64(std::size_t slot) const { return alive_[slot / 64]; }
  // Of dead ones: a vertex of the mesh, four times.
  const std::array<VertexId, 4>& vertices(std::size_t slot) const { return vertices_[slot]; }
  // kNone: it has none.
  std::uint32_t slot_of(TetId t) const { return slot_of_[t]; }

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
          mesh_.prefetch(static_cast<TetId>((next + kAhead) * 64) +
                         static_cast<TetId>(std::countr_zero(later)));
      }
      for (; bits != 0; bits &= bits - 1)
        visit(static_cast<TetId>(next * 64) + static_cast<TetId>(std::countr_zero(bits)));
    }
    next = 0;
    return true;
  }

 private:
  static constexpr std::size_t kAhead = 2;  // words of 64, of what is fetched
  static void set(std::vector<std::uint64_t>& bits, std::size_t i, bool is) {
    const std::uint64_t bit = std::uint64_t{1} << (i % 64);
    bits[i / 64] = is ? bits[i / 64] | bit : bits[i / 64] & ~bit;
  }
  bool has(TetId t) const { return t < slot_of_.size() && slot_of_[t] != kNone; }
  void take_in(TetId t) {
    if (has(t) || !mesh_.alive(t)) return;
    const std::size_t slot = vertices_.size();
    slot_of_[t] = static_cast<std::uint32_t>(slot);
    vertices_.push_back(mesh_.vertices(t));
    if (alive_.size() * 64 <= slot) alive_.push_back(0);
    set(alive_, slot, true);
    set(boundary_, t, mesh_.on_boundary(t));
  }

  const TetMesh& mesh_;
  const TetClusters& clusters_;
  std::vector<std::uint32_t> slot_of_;  // by tetrahedron
  std::size_t next_member_ = 0;         // of the clusters' lists, while these are taken in
  bool has_clusters_ = false;
  std::size_t looked_at_ = 0;  // tetrahedra, for those that are in no cluster
  std::vector<std::array<VertexId, 4>> vertices_;
  std::vector<std::uint64_t> alive_;     // a bit for each slot
  std::vector<std::uint64_t> boundary_;  // a bit for each tetrahedron
};

}  // namespace incise::core
