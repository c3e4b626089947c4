#include "server/core/mesh/boundary_grid.hpp"

#include <algorithm>
#include <cmath>

#include "server/core/util/room.hpp"

namespace incise::core {
namespace {

constexpr double kMaxCells = 16e6;
// Of a body that deforms: a tetrahedron's other vertices were as far from their anchors when it was entered, and a cut may
// let a vertex slide by a quarter of a cell besides.
constexpr double kSlackDeforming = 2 * BoundaryGrid::kFromAnchor + 0.25;

}  // namespace

BoundaryGrid::BoundaryGrid(const TetMesh& mesh) {
  Vec3 low{INFINITY, INFINITY, INFINITY}, high{-INFINITY, -INFINITY, -INFINITY};
  std::size_t boundary = 0;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t) || mesh.boundary_mask(t) == 0) continue;
    ++boundary;
    for (VertexId v : mesh.vertices(t)) {
      const Vec3& p = mesh.position(v);
      extend(p, low, high);
    }
  }
  if (boundary == 0) {
    head_.assign(1, kNone);
    return;
  }
  lay_out(low, high, 2 * mesh.mean_edge_length());
  nodes_.reserve(6 * boundary + 65536);
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t) && mesh.boundary_mask(t) != 0) add(mesh, t);
  }
}

BoundaryGrid::BoundaryGrid(const BoundaryGrid& other)
    : origin_(other.origin_),
      low_(other.low_),
      high_(other.high_),
      cell_(other.cell_),
      inverse_(other.inverse_),
      slack_(other.slack_),
      head_(other.head_),
      taken_(other.taken_.size(), 0),
      nodes_when_built_(other.nodes_when_built_),
      anchors_(other.anchors_) {
  std::copy(other.count_, other.count_ + 3, count_);
  nodes_.reserve(other.nodes_.capacity());
  nodes_.assign(other.nodes_.begin(), other.nodes_.end());
}

BoundaryGrid::BoundaryGrid(const Vec3& low, const Vec3& high, double cell) {
  begin_again(low, high, cell, 0);
}

void BoundaryGrid::begin_again(const Vec3& low, const Vec3& high, double cell, std::size_t nodes) {
  slack_ = kSlackDeforming;
  lay_out(low, high, cell);
  nodes_.clear();
  nodes_.reserve(nodes);
  anchors_.clear();
}

void BoundaryGrid::lay_out(const Vec3& low, const Vec3& high, double cell) {
  cell_ = cell;
  const Vec3 size = high - low;
  for (;; cell_ *= 1.5) {
    double cells = 1;
    for (int axis = 0; axis < 3; ++axis) {
      count_[axis] = static_cast<std::int64_t>(coordinate(size, axis) / cell_) + 1;
      cells *= static_cast<double>(count_[axis]);
    }
    if (cells <= kMaxCells) break;
  }
  origin_ = low;
  const Vec3 margin{cell_, cell_, cell_};
  low_ = low - margin;
  high_ = high + margin;
  inverse_ = 1 / cell_;
  head_.assign(static_cast<std::size_t>(count_[0] * count_[1] * count_[2]), kNone);
  taken_.assign(head_.size(), 0);
}

std::int64_t BoundaryGrid::cell_of(double x, int axis) const {
  // Clamped first, so that the conversion is defined; what is positive is rounded down by it.
  const double cell = (x - coordinate(origin_, axis)) * inverse_;
  return static_cast<std::int64_t>(std::clamp(cell, 0.0, static_cast<double>(count_[axis] - 1)));
}

void BoundaryGrid::add(const TetMesh& mesh, TetId t) {
  const auto& v = mesh.vertices(t);
  const Vec3 corners[4] = {mesh.position(v[0]), mesh.position(v[1]), mesh.position(v[2]),
                           mesh.position(v[3])};
  add_at(t, corners);
}

void BoundaryGrid::add_at(TetId t, const Vec3 (&corners)[4]) {
  Vec3 low = corners[0], high = low;
  for (int i = 1; i < 4; ++i) {
    const Vec3& p = corners[i];
    extend(p, low, high);
  }
  const std::int64_t first[3] = {cell_of(low.x, 0), cell_of(low.y, 1), cell_of(low.z, 2)};
  const std::int64_t last[3] = {cell_of(high.x, 0), cell_of(high.y, 1), cell_of(high.z, 2)};
  for (std::int64_t i = first[0]; i <= last[0]; ++i) {
    for (std::int64_t j = first[1]; j <= last[1]; ++j) {
      for (std::int64_t k = first[2]; k <= last[2]; ++k) {
        std::uint32_t& head = head_[index_of(i, j, k)];
        if (head != kNone && nodes_[head].tet == t) continue;
        nodes_.push_back({t, head});
        head = static_cast<std::uint32_t>(nodes_.size() - 1);
      }
    }
  }
}

// Appends what is in a cell, and strikes off what is stale.
void BoundaryGrid::take_cell(const TetMesh& mesh, std::size_t cell, std::vector<TetId>& out) {
  std::uint32_t* link = &head_[cell];
  while (*link != kNone) {
    Node& node = nodes_[*link];
    if (!mesh.alive(node.tet) || mesh.boundary_mask(node.tet) == 0) {
      *link = node.next;
    } else {
      out.push_back(node.tet);
      link = &node.next;
    }
  }
}

bool BoundaryGrid::contains(const Vec3& p) const {
  for (int axis = 0; axis < 3; ++axis) {
    const double first = coordinate(origin_, axis), x = coordinate(p, axis);
    if (x < first || x > first + cell_ * static_cast<double>(count_[axis])) return false;
  }
  return true;
}

void BoundaryGrid::near(const TetMesh& mesh, const SweptTriangle& triangle, std::uint32_t search,
                        std::vector<TetId>& out) {
  if (nodes_.empty()) return;
  // Columns of cells along the axis that the normal is nearest to: each holds a few cells of the plane.
  const Vec3 n = triangle.normal;
  const int along = std::abs(n.x) >= std::abs(n.y) ? (std::abs(n.x) >= std::abs(n.z) ? 0 : 2)
                                                   : (std::abs(n.y) >= std::abs(n.z) ? 1 : 2);
  const int u = (along + 1) % 3, w = (along + 2) % 3;
  const double slack = slack_ * cell_;
  const double top = coordinate(origin_, along) + cell_ * static_cast<double>(count_[along]) + slack;
  const double bottom = coordinate(origin_, along) - slack;
  double low[3], high[3];
  for (int axis = 0; axis < 3; ++axis) {
    low[axis] = coordinate(triangle.low, axis) - slack;
    high[axis] = coordinate(triangle.high, axis) + slack;
    const double first = coordinate(origin_, axis), last = first + cell_ * static_cast<double>(count_[axis]);
    if (high[axis] < first || low[axis] > last) return;
  }
  const double nu = coordinate(n, u), nw = coordinate(n, w), na = coordinate(n, along);
  // The triangle's edges in the (u, w) plane, inward, to pass over columns beside it.
  double edge_u[3], edge_w[3], edge_at[3];
  for (int e = 0; e < 3; ++e) {
    const Vec3 &a = triangle.corners[e], &b = triangle.corners[(e + 1) % 3],
               &c = triangle.corners[(e + 2) % 3];
    edge_u[e] = coordinate(a, w) - coordinate(b, w);
    edge_w[e] = coordinate(b, u) - coordinate(a, u);
    edge_at[e] = edge_u[e] * coordinate(a, u) + edge_w[e] * coordinate(a, w);
    if (edge_u[e] * coordinate(c, u) + edge_w[e] * coordinate(c, w) < edge_at[e]) {
      edge_u[e] = -edge_u[e];
      edge_w[e] = -edge_w[e];
      edge_at[e] = -edge_at[e];
    }
  }
  const double half = 0.5 * cell_ + slack;
  for (std::int64_t i = cell_of(low[u], u); i <= cell_of(high[u], u); ++i) {
    const double cu = coordinate(origin_, u) + cell_ * (static_cast<double>(i) + 0.5);
    for (std::int64_t j = cell_of(low[w], w); j <= cell_of(high[w], w); ++j) {
      const double cw = coordinate(origin_, w) + cell_ * (static_cast<double>(j) + 0.5);
      bool beside = false;
      for (int e = 0; e < 3; ++e) {
        const double reach = half * (std::abs(edge_u[e]) + std::abs(edge_w[e]));
        beside = beside || edge_u[e] * cu + edge_w[e] * cw + reach < edge_at[e];
      }
      if (beside) continue;
      const double middle = (triangle.offset - nu * cu - nw * cw) / na;
      const double reach = half * (std::abs(nu) + std::abs(nw)) / std::abs(na) + slack;
      const double from = std::max(middle - reach, low[along]), to = std::min(middle + reach, high[along]);
      if (from > to || from > top || to < bottom) continue;
      for (std::int64_t k = cell_of(from, along); k <= cell_of(to, along); ++k) {
        std::int64_t at[3];
        at[along] = k;
        at[u] = i;
        at[w] = j;
        const auto cell = index_of(at[0], at[1], at[2]);
        if (taken_[cell] == search) continue;
        taken_[cell] = search;
        take_cell(mesh, cell, out);
      }
    }
  }
}

TetId BoundaryGrid::locate(const TetMesh& mesh, const Vec3& p, std::int64_t* looked_at) const {
  if (nodes_.empty()) return kNone;
  const double inside[3] = {p.x, p.y, p.z};
  for (int axis = 0; axis < 3; ++axis) {
    const double first = coordinate(origin_, axis);
    if (inside[axis] < first || inside[axis] > first + cell_ * static_cast<double>(count_[axis]))
      return kNone;
  }
  // Looks along each axis both ways for the nearest boundary face, until one way gives an answer. The line is axis
  // parallel, so it stays in one row of cells; a grazed edge can mislead one way, hardly all six. In a body that
  // deforms a face may have moved into the row from the cells beside it.
  const int beside = anchored() ? 1 : 0;
  for (int way = 0; way < 6; ++way) {
    const int axis = way % 3;
    const int sign = way < 3 ? 1 : -1;
    Vec3 d{};
    (axis == 0 ? d.x : axis == 1 ? d.y : d.z) = sign;
    std::int64_t cell[3] = {cell_of(p.x, 0), cell_of(p.y, 1), cell_of(p.z, 2)};
    double nearest = INFINITY;
    HalfFace hit = kNone;
    bool from_inside = false;
    for (; cell[axis] >= 0 && cell[axis] < count_[axis]; cell[axis] += sign) {
      const auto visit = [&](TetId t) {
        if (looked_at != nullptr) ++*looked_at;
        if (!mesh.alive(t)) return;
        for (int f = 0; f < 4; ++f) {
          if (mesh.neighbor(t, f) != kNone) continue;
          const auto v = mesh.face_vertices(half_face(t, f));
          const Vec3 a = mesh.position(v[0]) - p, b = mesh.position(v[1]) - p, c = mesh.position(v[2]) - p;
          const double ab = dot(cross(a, b), d), bc = dot(cross(b, c), d), ca = dot(cross(c, a), d);
          if (!((ab >= 0 && bc >= 0 && ca >= 0) || (ab <= 0 && bc <= 0 && ca <= 0))) continue;
          const double sum = ab + bc + ca;
          if (sum == 0) continue;
          const double at = (ab * dot(c, d) + bc * dot(a, d) + ca * dot(b, d)) / sum;
          if (at < 0 || at >= nearest) continue;
          nearest = at;
          hit = half_face(t, f);
          from_inside = dot(cross(b - a, c - a), d) > 0;
        }
      };
      const int u = (axis + 1) % 3, w = (axis + 2) % 3;
      for (std::int64_t i = std::max<std::int64_t>(cell[u] - beside, 0);
           i <= std::min(cell[u] + beside, count_[u] - 1); ++i) {
        for (std::int64_t j = std::max<std::int64_t>(cell[w] - beside, 0);
             j <= std::min(cell[w] + beside, count_[w] - 1); ++j) {
          std::int64_t at[3];
          at[axis] = cell[axis];
          at[u] = i;
          at[w] = j;
          visit_cell(at[0], at[1], at[2], visit);
        }
      }
      if (hit != kNone &&
          nearest < cell_ * static_cast<double>(std::abs(cell[axis] - cell_of(inside[axis], axis)) - beside))
        break;
    }
    if (hit == kNone) continue;
    if (!from_inside) return kNone;
    const TetId found = walk(mesh, tet_of(hit), p + nearest * d, p, [](TetId, double, double) {});
    if (found != kNone) return found;
  }
  return kNone;
}

void BoundaryGrid::archive(Archive& io, const TetMesh& mesh) {
  io(origin_);
  io(low_);
  io(high_);
  io(cell_);
  io(inverse_);
  io(slack_);
  for (std::int64_t& n : count_) io(n);
  io.list(head_, 4, [&](std::uint32_t& head) { io(head); });
  io.list(nodes_, 8, [&](Node& node) {
    io(node.tet);
    io(node.next);
  });
  std::uint64_t when_built = nodes_when_built_;
  io(when_built);
  nodes_when_built_ = when_built;
  io.list(anchors_, 24, [&](Vec3& anchor) { io(anchor); });
  if (io.reads()) check_restored(io, mesh);
}

void BoundaryGrid::check_restored(Archive& io, const TetMesh& mesh) {
  io.demand(nodes_when_built_ <= nodes_.size(), "a grid that has shrunk");
  io.demand(slack_ >= 0.25 && slack_ <= 1, "a grid with another slack");
  io.demand(anchors_.size() <= mesh.vertex_slots(), "more anchors than vertices");
  std::uint64_t cells = 1;
  for (const std::int64_t n : count_) {
    io.demand(n > 0 && n <= (1 << 25), "a grid without cells");
    if (!io.failed()) cells *= static_cast<std::uint64_t>(n);
    io.demand(cells <= head_.size(), "a grid of other cells");
    if (io.failed()) return;
  }
  io.demand(cells == head_.size(), "a grid of other cells");
  io.demand(cell_ > 0 && std::isfinite(cell_) && inverse_ == 1 / cell_, "grid cells without a size");
  for (const std::uint32_t head : head_)
    io.demand(head == kNone || head < nodes_.size(), "a grid cell lists nothing");
  // A list leads to ever older nodes, so it cannot go in a circle.
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    io.demand(nodes_[i].tet < mesh.tet_slots(), "the grid names no tetrahedron");
    io.demand(nodes_[i].next == kNone || nodes_[i].next < i, "a grid list goes in a circle");
  }
  nodes_.reserve(room_for(nodes_.size()));
  taken_.assign(head_.size(), 0);
}

}  // namespace incise::core
