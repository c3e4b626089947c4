#include "server/core/cut/conforming/pinched_edges.hpp"

#include <algorithm>
#include <utility>

namespace incise::core {

using namespace tolerance;

void PinchedEdges::clear() {
  for (const ListedVertex& listed : vertices_) cut_.workspace.vertices[listed.vertex].listed = false;
  vertices_.clear();
  edges_.clear();
}

void PinchedEdges::list(VertexId v) {
  if (!cut_.may_add() || std::exchange(cut_.workspace.vertices[v].listed, true)) return;
  vertices_.push_back({v, cut_.path.travel_m() + kFar_h * cut_.h});
}

bool PinchedEdges::advance(WorkBudget& budget) {
  for (; next_bared_ < editor_.bared().size(); ++next_bared_) list(editor_.bared()[next_bared_]);
  for (; next_vertex_ < vertices_.size() && is_ripe(vertices_[next_vertex_].ripe_at_m); ++next_vertex_) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    if (next_vertex_ + 4 < vertices_.size()) {
      mesh_.prefetch_position(vertices_[next_vertex_ + 4].vertex);
      mesh_.prefetch_star(vertices_[next_vertex_ + 2].vertex);
    }
    find_pinched(vertices_[next_vertex_].vertex);
  }
  for (; next_edge_ < edges_.size() && is_ripe(edges_[next_edge_].ripe_at_m); ++next_edge_) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    part(edges_[next_edge_].a, edges_[next_edge_].b);
  }
  vertices_.erase(vertices_.begin(), vertices_.begin() + static_cast<std::ptrdiff_t>(next_vertex_));
  edges_.erase(edges_.begin(), edges_.begin() + static_cast<std::ptrdiff_t>(next_edge_));
  begin();
  return true;
}

void PinchedEdges::find_pinched(VertexId v) {
  cut_.workspace.vertices[v].listed = false;
  mesh_.star(v, star_);
  cut_.work.add(star_.size(), cost::kStarCornersAUnit);
  ends_.clear();
  const std::uint32_t scan = cut_.workspace.next_serial();
  std::size_t edges = 0;
  for (Corner c : star_) {
    const TetId t = tet_of(c);
    const unsigned mask = mesh_.boundary_mask(t) & ~(1u << index_of(c));
    if (mask == 0) continue;
    const auto& vertices = mesh_.vertices(t);
    for (int f = 0; f < 4; ++f) {
      if (!(mask >> f & 1)) continue;
      for (int i = 0; i < 4; ++i) {
        const VertexId w = vertices[i];
        if (i == f || w == v) continue;
        edges += std::exchange(cut_.workspace.vertices[w].looked_at, scan) != scan ? 1 : 0;
        ends_.push_back(w);
      }
    }
  }
  cut_.work.add(ends_.size(), cost::kStarCornersAUnit);
  // An edge has two boundary faces for each fan. Nearly always there is one.
  if (ends_.size() == 2 * edges) return;
  std::sort(ends_.begin(), ends_.end());
  for (std::size_t i = 0; i + 2 < ends_.size(); ++i) {
    // Both ends may list it: the second time it has been parted.
    if (ends_[i] != ends_[i + 2] || (i > 0 && ends_[i - 1] == ends_[i])) continue;
    edges_.push_back({v, ends_[i], cut_.path.travel_m() + kPinchedWait_h * cut_.h});
  }
}

// Smaller fans first, so that few tetrahedra are added.
void PinchedEdges::part(VertexId a, VertexId b) {
  list_fans(a, b);
  std::sort(fans_.begin(), fans_.end());
  std::size_t left = fans_.size();
  for (std::size_t i = 0; i < fans_.size() && left > 1; ++i) left -= try_parting(fans_[i].tet, a, b) ? 1 : 0;
}

// The edge may have been split or parted since it was taken down, or its fans joined by what has been merged.
void PinchedEdges::list_fans(VertexId a, VertexId b) {
  fans_.clear();
  mesh_.star(a, star_);
  cut_.work.add(star_.size(), cost::kStarCornersAUnit);
  around_.clear();
  for (Corner c : star_) {
    if (mesh_.local_index(tet_of(c), b) >= 0) around_.push_back(tet_of(c));
  }
  while (!around_.empty()) {
    const TetId t = around_.front();
    mesh_.ring(t, a, b, ring_);
    fans_.push_back({ring_.size(), t});
    std::erase_if(around_, [this](TetId r) { return std::ranges::find(ring_, r) != ring_.end(); });
  }
}

// Not where it would leave a needle.
bool PinchedEdges::try_parting(TetId fan, VertexId a, VertexId b) {
  for (double at : {0.5, 0.35, 0.65}) {
    if (cut_.worst_after_split(fan, a, b, at, kSnapFloor) > kSnapFloor) continue;
    editor_.split_fan(fan, a, b, at);
    return true;
  }
  return false;
}

void PinchedEdges::archive(Archive& io) {
  io.list(vertices_, 12, [&](ListedVertex& listed) {
    io(listed.vertex);
    io(listed.ripe_at_m);
    io.demand(listed.vertex < mesh_.vertex_slots(), "a listed vertex that does not exist");
    if (io.reads() && !io.failed()) cut_.workspace.vertices[listed.vertex].listed = true;
  });
  io.list(edges_, 16, [&](PinchedEdge& edge) {
    io(edge.a);
    io(edge.b);
    io(edge.ripe_at_m);
    io.demand(edge.a < mesh_.vertex_slots() && edge.b < mesh_.vertex_slots() && edge.a != edge.b,
              "a pinched edge that does not exist");
  });
}

}  // namespace incise::core
