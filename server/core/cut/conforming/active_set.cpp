#include "server/core/cut/conforming/active_set.hpp"

#include <algorithm>

namespace incise::core {

using namespace tolerance;

void ActiveSet::take_offered() {
  if (cut_.others.are_none()) return;
  // Another blade may have taken the mark.
  for (const Entry& entry : entries_) cut_.workspace.tets[entry.tet].active = cut_.stroke;
  for (TetId t : cut_.others.offered()) {
    if (!cut_.mesh.alive(t)) continue;
    if (!has(t)) {
      const std::uint32_t batch = batch_that_meets(t);
      if (batch == kNone) continue;
      add(t, batch);
    }
    cut_.meets_cut = true;
  }
  cut_.others.offered().clear();
}

// The batch in which something was swept that t has to be parted by: where an edge crosses that, or a face lies on it. kNone: there is none.
std::uint32_t ActiveSet::batch_that_meets(TetId t) const {
  const auto& v = cut_.mesh.vertices(t);
  for (const auto& [i, j] : kEdgeVertices) {
    const std::uint32_t batch = cut_.batch_across(v[i], v[j]);
    if (batch != kNone) return batch;
  }
  if (std::ranges::count_if(v, [this](VertexId w) { return cut_.on_surface(w); }) < 3) return kNone;
  Vec3 closest;
  std::uint32_t triangle = 0;
  return cut_.closest_on_surface(cut_.mesh.barycentre(t), closest, triangle) ? cut_.surface()[triangle].batch
                                                                             : kNone;
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
  if (!cut_.front_is_near) return true;
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
