#include "protocol/surface_asset.hpp"

#include <algorithm>
#include <limits>
#include <tuple>

namespace incise::protocol {
namespace {

constexpr std::uint32_t kLeafTriangles = 4;
// The tree halves the triangles at each level, so this is beyond any number of them.
constexpr std::size_t kMaxLevels = 64;

Vec3 minus(const Vec3& a, const Vec3& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
Vec3 plus(const Vec3& a, double s, const Vec3& b) {
  return {a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
}
double dot(const Vec3& a, const Vec3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
Vec3 normal_of(const Corners& c) {
  return cross(minus(c[1], c[0]), minus(c[2], c[0]));
}
Vec3 middle_of(const Corners& c) {
  return {(c[0].x + c[1].x + c[2].x) / 3, (c[0].y + c[1].y + c[2].y) / 3, (c[0].z + c[1].z + c[2].z) / 3};
}

// The squared distance of p from the triangle. Ericson, Real-Time Collision Detection (2005), section 5.1.5.
double squared_distance(const Corners& t, const Vec3& p) {
  const auto to = [&p](const Vec3& q) {
    const Vec3 d = minus(p, q);
    return dot(d, d);
  };
  const Vec3 ab = minus(t[1], t[0]), ac = minus(t[2], t[0]), ap = minus(p, t[0]);
  const double d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return to(t[0]);
  const Vec3 bp = minus(p, t[1]);
  const double d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return to(t[1]);
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return to(plus(t[0], d1 / (d1 - d3), ab));
  const Vec3 cp = minus(p, t[2]);
  const double d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return to(t[2]);
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return to(plus(t[0], d2 / (d2 - d6), ac));
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0)
    return to(plus(t[1], (d4 - d3) / ((d4 - d3) + (d5 - d6)), minus(t[2], t[1])));
  const double sum = va + vb + vc;
  return to(plus(plus(t[0], vb / sum, ab), vc / sum, ac));
}

double squared_distance(const Vec3& low, const Vec3& high, const Vec3& p) {
  const auto outside = [](double from, double to, double x) {
    return x < from ? from - x : x > to ? x - to : 0;
  };
  const Vec3 d{outside(low.x, high.x, p.x), outside(low.y, high.y, p.y), outside(low.z, high.z, p.z)};
  return dot(d, d);
}

}  // namespace

OriginTree::OriginTree(std::span<const double> positions, std::span<const std::uint32_t> triangles) {
  const auto vertex = [&](std::uint32_t v) -> Vec3 {
    const double* p = &positions[3 * std::size_t{v}];
    return {p[0], p[1], p[2]};
  };
  const std::size_t n = triangles.size() / 3;
  triangles_.reserve(n);
  for (std::size_t i = 0; i < n; ++i) {
    const Corners corners{vertex(triangles[3 * i]), vertex(triangles[3 * i + 1]),
                          vertex(triangles[3 * i + 2])};
    triangles_.push_back({corners, normal_of(corners), static_cast<std::uint32_t>(i)});
  }
  if (n > 0) build(0, static_cast<std::uint32_t>(n));
  place_.resize(n);
  for (std::uint32_t i = 0; i < n; ++i) place_[triangles_[i].index] = i;
}

void OriginTree::build(std::uint32_t begin, std::uint32_t end) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  Node node{{kInfinity, kInfinity, kInfinity}, {-kInfinity, -kInfinity, -kInfinity}, begin, end - begin, 0};
  for (std::uint32_t i = begin; i < end; ++i) {
    for (const Vec3& c : triangles_[i].corners) {
      node.low = {std::min(node.low.x, c.x), std::min(node.low.y, c.y), std::min(node.low.z, c.z)};
      node.high = {std::max(node.high.x, c.x), std::max(node.high.y, c.y), std::max(node.high.z, c.z)};
    }
  }
  const std::size_t me = nodes_.size();
  nodes_.push_back(node);
  if (end - begin <= kLeafTriangles) return;
  const Vec3 size = minus(node.high, node.low);
  double Vec3::*const axis = size.x >= size.y && size.x >= size.z ? &Vec3::x
                             : size.y >= size.z                   ? &Vec3::y
                                                                  : &Vec3::z;
  const std::uint32_t half = begin + (end - begin) / 2;
  std::nth_element(triangles_.begin() + begin, triangles_.begin() + half, triangles_.begin() + end,
                   [axis](const Triangle& a, const Triangle& b) {
                     const double x = middle_of(a.corners).*axis, y = middle_of(b.corners).*axis;
                     return x != y ? x < y : a.index < b.index;
                   });
  nodes_[me].count = 0;
  build(begin, half);
  nodes_[me].right = static_cast<std::uint32_t>(nodes_.size());
  build(half, end);
}

void OriginTree::search(const Vec3& p, const Vec3* facing, Best& best) const {
  std::array<std::uint32_t, kMaxLevels> waiting{};
  std::size_t n = 0;
  waiting[n++] = 0;
  while (n > 0) {
    const std::uint32_t at = waiting[--n];
    const Node& node = nodes_[at];
    if (squared_distance(node.low, node.high, p) > best.squared_distance) continue;
    if (node.count == 0) {
      const Node &left = nodes_[at + 1], &right = nodes_[node.right];
      const bool right_first =
          squared_distance(right.low, right.high, p) < squared_distance(left.low, left.high, p);
      waiting[n++] = right_first ? at + 1 : node.right;
      waiting[n++] = right_first ? node.right : at + 1;
      continue;
    }
    for (std::uint32_t i = node.first; i < node.first + node.count; ++i) {
      const Triangle& t = triangles_[i];
      if (facing != nullptr && !(dot(t.normal, *facing) > 0)) continue;
      const double d = squared_distance(t.corners, p);
      if (d < best.squared_distance || (d == best.squared_distance && t.index < best.index))
        best = {d, t.index};
    }
  }
}

std::uint32_t OriginTree::origin_of(const Corners& rest, std::uint32_t near) const {
  if (triangles_.empty()) return kNoId;
  const Vec3 p = middle_of(rest), facing = normal_of(rest);
  Best best{std::numeric_limits<double>::infinity(), kNoId};
  if (near < size()) {
    const Triangle& t = triangles_[place_[near]];
    if (dot(t.normal, facing) > 0) best = {squared_distance(t.corners, p), near};
  }
  search(p, &facing, best);
  if (best.index == kNoId) search(p, nullptr, best);
  return best.index;
}

std::array<double, 3> barycentric(const Corners& triangle, const Vec3& p) {
  const Vec3 normal = normal_of(triangle), from = minus(p, triangle[0]);
  const Vec3 ab = minus(triangle[1], triangle[0]), ac = minus(triangle[2], triangle[0]);
  const double area = dot(normal, normal);
  if (!(area > 0)) return {1, 0, 0};
  const double b = dot(cross(from, ac), normal) / area, c = dot(cross(ab, from), normal) / area;
  return {1 - b - c, b, c};
}

SurfaceLookup::SurfaceLookup(const SurfaceAsset& asset) : asset_(asset) {
  const std::size_t n = asset.triangles.size() / 3;
  neighbours_.assign(n, {kNoId, kNoId, kNoId});
  // Edges by their vertices; of each triangle's edge also the corner (3 triangle + k) that it is opposite to.
  struct Edge {
    std::uint32_t low, high, corner;
  };
  std::vector<Edge> edges;
  edges.reserve(3 * n);
  for (std::uint32_t c = 0; c < 3 * n; ++c) {
    const std::uint32_t t = c / 3, a = asset.triangles[3 * t + (c + 1) % 3],
                        b = asset.triangles[3 * t + (c + 2) % 3];
    edges.push_back({std::min(a, b), std::max(a, b), c});
  }
  std::sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) {
    return std::tie(a.low, a.high, a.corner) < std::tie(b.low, b.high, b.corner);
  });
  const auto same_look = [&](std::uint32_t a, std::uint32_t b) {
    const std::size_t s = a / 3, t = b / 3;
    if (!asset.material_indices.empty() && asset.material_indices[s] != asset.material_indices[t])
      return false;
    if (asset.uvs.empty()) return true;
    for (const std::uint32_t i : {(a + 1) % 3, (a + 2) % 3}) {
      for (const std::uint32_t j : {(b + 1) % 3, (b + 2) % 3}) {
        if (asset.triangles[3 * s + i] != asset.triangles[3 * t + j]) continue;
        if (!std::equal(&asset.uvs[2 * (3 * s + i)], &asset.uvs[2 * (3 * s + i)] + 2,
                        &asset.uvs[2 * (3 * t + j)]))
          return false;
      }
    }
    return true;
  };
  for (std::size_t i = 1; i < edges.size(); ++i) {
    const Edge &a = edges[i - 1], &b = edges[i];
    if (a.low != b.low || a.high != b.high || !same_look(a.corner, b.corner)) continue;
    neighbours_[a.corner / 3][a.corner % 3] = b.corner / 3;
    neighbours_[b.corner / 3][b.corner % 3] = a.corner / 3;
  }
}

SurfaceLookup::Place SurfaceLookup::find(std::uint32_t origin, const Vec3& rest) const {
  constexpr int kMaxSteps = 16;  // a face spans few triangles
  Place at{origin, barycentric(corners(origin), rest)};
  std::uint32_t before = kNoId;
  for (int step = 0; step < kMaxSteps; ++step) {
    const auto least = std::min_element(at.weights.begin(), at.weights.end());
    const std::uint32_t next = neighbours_[at.triangle][static_cast<std::size_t>(least - at.weights.begin())];
    // Beyond a ridge both triangles send it to the other.
    if (*least >= 0 || next == kNoId || next == before) break;
    before = at.triangle;
    at = {next, barycentric(corners(next), rest)};
  }
  return at;
}

Corners SurfaceLookup::corners(std::uint32_t triangle) const {
  const auto corner = [&](std::size_t k) -> Vec3 {
    const double* p = &asset_.positions[3 * std::size_t{asset_.triangles[3 * std::size_t{triangle} + k]}];
    return {p[0], p[1], p[2]};
  };
  return {corner(0), corner(1), corner(2)};
}

}  // namespace incise::protocol
