#include "server/core/cut/conforming/active_set.hpp"

#include <algorithm>

namespace incise::core {

using namespace tolerance;

void ActiveSet::tell_others(VertexId v, const Vec3& from) {
  std::vector<ActiveSet*>& sets = cut_.workspace.active_sets;
  if (sets.size() == 1) return;
  // A tetrahedron's mark is that of the last one that takes it: in an order that a session goes on with from a checkpoint.
  std::sort(sets.begin(), sets.end(), [](const ActiveSet* one, const ActiveSet* other) {
    return one->cut_.stroke < other->cut_.stroke;
  });
  for (ActiveSet* other : sets) {
    if (other == this || other->entries_.empty()) continue;
    const std::uint32_t batch = other->first_batch_between(from, cut_.mesh.position(v));
    if (batch == kNone) continue;
    cut_.mesh.star(v, star_);
    cut_.work.add(star_.size(), cost::kStarCornersAUnit);
    for (const Corner corner : star_) other->add(tet_of(corner), batch);
  }
}

// Of the batches whose surface lies between two points the first one; kNone: none does.
std::uint32_t ActiveSet::first_batch_between(const Vec3& a, const Vec3& b) const {
  std::uint32_t first = kNone;
  const SweptSurface& surface = cut_.surface();
  cut_.work += cost::kFindCrossing;
  surface.any_between(Points<2>({a, b}), cut_.clear_m, [&](std::uint32_t i) {
    const SweptTriangle& triangle = surface[i];
    double at;
    if (crosses(a, b, triangle.signed_distance(a), triangle.signed_distance(b), triangle, cut_.clear_m, at))
      first = std::min(first, triangle.batch);
    return false;
  });
  return first;
}

void ActiveSet::append(TetId t, double since_m) {
  cut_.workspace.tets[t].active = cut_.stroke;
  entries_.push_back({t, since_m, 0});
  for (VertexId v : cut_.mesh.vertices(t)) widest_m_ = std::max(widest_m_, cut_.mesh.local_h(v));
}

// What a split or a flip makes active now may reach some edge lengths farther back than the oldest active tetrahedron.
double ActiveSet::needed_since_m() const {
  double oldest = cut_.path.travel_before_batch_m();
  for (const Entry& entry : entries_) oldest = std::min(oldest, entry.since_m);
  return oldest - kKeptBehind_local * widest_m_;
}

bool ActiveSet::ripe(Entry& entry) {
  if (!cut_.has_front) return true;
  if (cut_.path.travel_m() < entry.ripe_at_m) return false;
  cut_.work += cost::kLook;
  for (VertexId v : cut_.mesh.vertices(entry.tet)) {
    auto& marks = cut_.workspace.vertices[v];
    double by_m;
    if (marks.looked_at != scan_) {
      marks.looked_at = scan_;
      marks.hot = cut_.hot(v);
    }
    if (!marks.hot || !cut_.hot(v, &by_m)) continue;
    entry.ripe_at_m = cut_.path.travel_m() + by_m;
    return false;
  }
  return true;
}

void ActiveSet::clinging(std::vector<VertexId>& out) const {
  const TetMesh& mesh = cut_.mesh;
  for (const Entry& entry : entries_) {
    if (!mesh.alive(entry.tet)) continue;
    out.insert(out.end(), mesh.vertices(entry.tet).begin(), mesh.vertices(entry.tet).end());
    // And its neighbours, or they could slip past the blade between two batches.
    for (int f = 0; f < 4; ++f) {
      const HalfFace o = mesh.opposite(half_face(entry.tet, f));
      if (o != kNone) out.push_back(mesh.vertices(tet_of(o))[face_of(o)]);
    }
  }
}

void ActiveSet::prefetch() {
  prefetched_.clear();
  prefetched_.reserve(kMaxPrefetched);
  // The last ones are nearest to the blade.
  for (std::size_t i = entries_.size(); i > 0 && prefetched_.size() < kMaxPrefetched; --i) {
    if (cut_.mesh.alive(entries_[i - 1].tet)) prefetched_.push_back(entries_[i - 1].tet);
  }
  cut_.mesh.prefetch_around(prefetched_, kMaxPrefetched);
  for (TetId t : prefetched_) {
    __builtin_prefetch(&cut_.workspace.tets[t]);
    for (VertexId v : cut_.mesh.vertices(t)) __builtin_prefetch(&cut_.workspace.vertices[v]);
  }
}

void ActiveSet::archive_entries(Archive& io) {
  io.list(entries_, 20, [&](Entry& entry) {
    io(entry.tet);
    io(entry.since_m);
    io(entry.ripe_at_m);
    io.demand(entry.since_m >= 0, "active since before its stroke");
    io.demand(entry.tet < cut_.mesh.tet_slots(), "an active tetrahedron that does not exist");
  });
}

}  // namespace incise::core
