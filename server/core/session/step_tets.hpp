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
// Of those on the boundary there are copies in the order of their ids, in which the boundary grid enters them.
class StepTets {
 public:
  // Both must outlive this.
  StepTets(const TetMesh& mesh, const TetClusters& clusters) : mesh_(mesh), clusters_(clusters) {}

  // Takes in the tetrahedra that it does not have yet, until it has all (true) or the budget is spent (false).
  bool catch_up(WorkBudget& budget) {
    const std::size_t count = mesh_.tet_slots();
    if (slot_of_.empty()) {
      // In small pages: the system may take milliseconds to find a large one, and this is in a frame. They are read in order, which
      // needs none.
      slot_of_.reserve(room_for(count));
      vertices_.reserve(room_for(count));
      boundary_.reserve(room_for(count) / 64);
      copies_.reserve(room_for(count) / 64);
      copied_.reserve(room_for(count) / 4);
      alive_.reserve(room_for(count) / 64);
    }
    std::size_t next = slot_of_.size();
    const auto make_room = [this](std::size_t i) {
      slot_of_.push_back(kNone);
      if (boundary_.size() * 64 > i) return;
      boundary_.push_back(0);
      copies_.push_back({});
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
      set_boundary(tet.id, tet.boundary_mask != 0);
    }
    for (const TetId t : delta.removed) {
      if (!has(t)) continue;
      vertices_[slot_of_[t]] = {};
      set(alive_, slot_of_[t], false);
      set_boundary(t, false);
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

  // Calls visit(tet, vertices) for those on the boundary, ascending, from `next` (of the words of 64) on.
  template <class Visit>
  bool visit_boundary(std::size_t& next, WorkBudget& budget, Visit visit) {
    for (; next < boundary_.size(); ++next) {
      std::uint64_t bits = boundary_[next];
      if (bits == 0) continue;
      if (budget.spent()) return false;
      budget.charge(1 + std::popcount(bits) / 4);
      if (!copies_[next].is_fresh) copy(next);
      const std::array<VertexId, 4>* vertices = &copied_[copies_[next].first];
      for (; bits != 0; bits &= bits - 1)
        visit(static_cast<TetId>(next * 64) + static_cast<TetId>(std::countr_zero(bits)), *vertices++);
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
  void set_boundary(TetId t, bool is) {
    // What is not there and was not is in no copy.
    if (is || (boundary_[t / 64] >> (t % 64) & 1) != 0) copies_[t / 64].is_fresh = false;
    set(boundary_, t, is);
  }
  // Copies the vertices of a word's tetrahedra on the boundary, where there were as many before, or behind all others.
  void copy(std::size_t word) {
    // They lie far apart.
    if (word + kAhead < boundary_.size() && !copies_[word + kAhead].is_fresh) {
      for (std::uint64_t later = boundary_[word + kAhead]; later != 0; later &= later - 1)
        mesh_.prefetch(static_cast<TetId>((word + kAhead) * 64) +
                       static_cast<TetId>(std::countr_zero(later)));
    }
    Copies& copies = copies_[word];
    const auto count = static_cast<std::uint32_t>(std::popcount(boundary_[word]));
    if (count > copies.room) {
      copies.first = static_cast<std::uint32_t>(copied_.size());
      // Powers of two: what is left behind is less than what is used.
      copies.room = std::bit_ceil(count);
      copied_.resize(copied_.size() + copies.room);
    }
    copies.is_fresh = true;
    std::size_t at = copies.first;
    for (std::uint64_t bits = boundary_[word]; bits != 0; bits &= bits - 1)
      copied_[at++] =
          mesh_.vertices(static_cast<TetId>(word * 64) + static_cast<TetId>(std::countr_zero(bits)));
  }
  bool has(TetId t) const { return t < slot_of_.size() && slot_of_[t] != kNone; }
  void take_in(TetId t) {
    if (has(t) || !mesh_.alive(t)) return;
    const std::size_t slot = vertices_.size();
    slot_of_[t] = static_cast<std::uint32_t>(slot);
    vertices_.push_back(mesh_.vertices(t));
    if (alive_.size() * 64 <= slot) alive_.push_back(0);
    set(alive_, slot, true);
    set_boundary(t, mesh_.on_boundary(t));
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
  // Of a word of these.
  struct Copies {
    std::uint32_t first = 0, room = 0;  // in copied_
    bool is_fresh = false;
  };
  std::vector<Copies> copies_;
  std::vector<std::array<VertexId, 4>> copied_;
};

}  // namespace incise::core
