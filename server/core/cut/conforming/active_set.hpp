#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"

namespace incise::core {

// The tetrahedra that the stroke has met and that are not decided yet: they may have crossings to deal with or faces to open.
class ActiveSet {
 public:
  struct Entry {
    TetId tet;
    double since_m;    // the blade's travel before the batch that made it active
    double ripe_at_m;  // while the blade has travelled less in this stroke, it waits for certain
  };

  explicit ActiveSet(CutContext& cut) : cut_(cut) {}
  ActiveSet(const ActiveSet&) = delete;

  bool has(TetId t) const { return cut_.workspace.tets[t].active == cut_.stroke; }
  void add(TetId t) {
    if (!has(t)) append(t, cut_.path.travel_before_batch_m());
  }
  // The same, where what has met it was swept in that batch.
  void add(TetId t, std::uint32_t batch) {
    if (!has(t)) append(t, cut_.path.travel_before_m(batch));
  }
  // Other blades have been here: takes what they have made or changed, where there is something to do.
  void take_offered();
  void clear() {
    entries_.clear();
    widest_m_ = 0;
  }
  void clear_entries() { entries_.clear(); }
  std::size_t size() const { return entries_.size(); }
  Entry& operator[](std::size_t i) { return entries_[i]; }
  const std::vector<Entry>& entries() const { return entries_; }
  // For a scan that is at entry i: in a large mesh the next ones are in no cache.
  [[gnu::always_inline]] void fetch_ahead(std::size_t i) const {
    if (i + 8 >= entries_.size()) return;
    const TetId soon = entries_[i + 8].tet, next = entries_[i + 4].tet;
    cut_.mesh.prefetch(soon);
    __builtin_prefetch(&cut_.workspace.tets[soon]);
    if (!cut_.mesh.alive(next)) return;
    for (VertexId v : cut_.mesh.vertices(next)) {
      __builtin_prefetch(&cut_.workspace.vertices[v]);
      cut_.mesh.prefetch_position(v);
    }
  }

  // How far back the swept surface may still be needed, as the blade's travel, m.
  double needed_since_m() const;

  // A scan asks whether entries are ripe. No vertex may move meanwhile, so each vertex is looked at once.
  void begin_scan() { scan_ = cut_.workspace.next_serial(); }
  // Whether none of its vertices is near the blade: certain while the blade has travelled less than they were away.
  bool ripe(Entry& entry);

  // Compacts the entries while they are scanned in order: keeps one, at `kept` or after it; drops one.
  void keep(std::size_t& kept, std::size_t i) { entries_[kept++] = entries_[i]; }
  void drop(std::size_t i) { cut_.workspace.tets[entries_[i].tet].active = 0; }
  void resize(std::size_t kept) { entries_.resize(kept); }

  void clinging(std::vector<VertexId>& out) const;
  void prefetch();

  void archive_entries(Archive& io);
  double& widest_m() { return widest_m_; }

 private:
  std::uint32_t batch_that_meets(TetId t) const;
  void append(TetId t, double since_m);

  CutContext& cut_;
  std::vector<Entry> entries_;
  double widest_m_ = 0;     // the largest local mesh width at any of this stroke's
  std::uint32_t scan_ = 0;  // its serial
  std::vector<TetId> prefetched_;
};

}  // namespace incise::core
