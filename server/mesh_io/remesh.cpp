#include "server/mesh_io/remesh.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <tuple>
#include <unordered_map>

namespace incise::mesh_io {
namespace {

using core::kNone;
using core::Vec3;
using core::VertexId;
using Triangle = std::array<VertexId, 3>;
using Function = std::function<double(const Vec3&)>;

// By central differences.
Vec3 gradient(const Function& f, const Vec3& p, double step) {
  return (0.5 / step) * Vec3{f({p.x + step, p.y, p.z}) - f({p.x - step, p.y, p.z}),
                             f({p.x, p.y + step, p.z}) - f({p.x, p.y - step, p.z}),
                             f({p.x, p.y, p.z + step}) - f({p.x, p.y, p.z - step})};
}

// Newton steps along the gradient, each no longer than a third of an edge. Without a function: no step.
Vec3 project(const Function& f, Vec3 p, double edge_length) {
  if (!f) return p;
  for (int i = 0; i < 6; ++i) {
    const double value = f(p);
    const Vec3 g = gradient(f, p, 1e-3 * edge_length);
    const double slope = squared_length(g);
    if (slope == 0) break;
    Vec3 step = (-value / slope) * g;
    const double l = length(step);
    if (l > edge_length / 3) step = (edge_length / 3 / l) * step;
    p += step;
    if (l < 1e-6 * edge_length) break;
  }
  return p;
}

// The cosine of the smallest angle of a triangle; 1 if it is degenerate.
double largest_cosine(const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 u = core::normalized(b - a), v = core::normalized(c - b), w = core::normalized(a - c);
  return std::max({-dot(u, w), -dot(v, u), -dot(w, v)});
}

// One pass over a surface. Each pass builds its own connectivity and changes no triangle twice, so it never
// reads outdated connectivity.
class Remesher {
 public:
  Remesher(Surface& surface, const Function& f, double edge_length)
      : p_(surface.positions), triangles_(surface.triangles), f_(f), edge_length_(edge_length) {}

  // Each pass halves what is too long.
  void split_long_edges(double limit, int passes) {
    bool again = true;
    for (int pass = 0; again && pass < passes; ++pass) again = split_pass(limit);
  }
  void collapse_short_edges() {
    bool again = true;
    for (int pass = 0; again && pass < 12; ++pass) again = collapse_pass();
  }
  void flip_edges() {
    bool again = true;
    for (int pass = 0; again && pass < 4; ++pass) again = flip_pass();
  }

  void smooth() {
    connect();
    std::vector<Vec3> moved(p_.size());
    for (VertexId v = 0; v < p_.size(); ++v) {
      Vec3 sum;
      double weight = 0;
      for (const std::uint32_t t : around(v)) {
        // Weighed by area, so that vertices spread evenly.
        const Triangle& tri = triangles_[t];
        const double area = length(cross(p_[tri[1]] - p_[tri[0]], p_[tri[2]] - p_[tri[0]]));
        sum += (area / 3) * (p_[tri[0]] + p_[tri[1]] + p_[tri[2]]);
        weight += area;
      }
      const Vec3 normal = core::normalized(gradient(f_, p_[v], 1e-3 * edge_length_));
      const Vec3 step = weight > 0 ? (1 / weight) * sum - p_[v] : Vec3{};
      moved[v] = project(f_, p_[v] + step - dot(step, normal) * normal, edge_length_);
    }
    p_ = std::move(moved);
  }

  void project_all() {
    for (Vec3& p : p_) p = project(f_, p, edge_length_);
  }

 private:
  struct Edge {
    VertexId a, b;       // a < b
    std::uint32_t s, t;  // its triangles
    VertexId c, d;       // their third vertices
    double squared_length;
  };

  // Fills the triangles of each vertex and the edges, ascending.
  void connect() {
    begin_.assign(p_.size() + 1, 0);
    for (const Triangle& t : triangles_) {
      for (const VertexId v : t) ++begin_[v + 1];
    }
    for (std::size_t v = 0; v < p_.size(); ++v) begin_[v + 1] += begin_[v];
    star_.resize(3 * triangles_.size());
    std::vector<std::uint32_t> next(begin_.begin(), begin_.end() - 1);
    for (std::uint32_t t = 0; t < triangles_.size(); ++t) {
      for (const VertexId v : triangles_[t]) star_[next[v]++] = t;
    }
    touched_.assign(triangles_.size(), 0);
  }
  struct Range {
    const std::uint32_t *first, *last;
    const std::uint32_t* begin() const { return first; }
    const std::uint32_t* end() const { return last; }
  };
  Range around(VertexId v) const { return {star_.data() + begin_[v], star_.data() + begin_[v + 1]}; }

  std::vector<Edge> edges() const {
    struct Half {
      VertexId a, b, c;
      std::uint32_t t;
    };
    std::vector<Half> halves;
    halves.reserve(3 * triangles_.size());
    for (std::uint32_t t = 0; t < triangles_.size(); ++t) {
      const Triangle& tri = triangles_[t];
      for (std::size_t i = 0; i < 3; ++i) {
        const VertexId a = tri[i], b = tri[(i + 1) % 3];
        halves.push_back({std::min(a, b), std::max(a, b), tri[(i + 2) % 3], t});
      }
    }
    std::sort(halves.begin(), halves.end(),
              [](const Half& x, const Half& y) { return std::tie(x.a, x.b, x.t) < std::tie(y.a, y.b, y.t); });
    std::vector<Edge> found;
    found.reserve(halves.size() / 2);
    for (std::size_t i = 0; i + 1 < halves.size(); i += 2) {
      const Half &x = halves[i], &y = halves[i + 1];
      found.push_back({x.a, x.b, x.t, y.t, x.c, y.c, squared_length(p_[x.a] - p_[x.b])});
    }
    return found;
  }

  static void replace(Triangle& t, VertexId from, VertexId to) {
    for (VertexId& v : t) {
      if (v == from) v = to;
    }
  }
  Vec3 normal(const Triangle& t) const { return cross(p_[t[1]] - p_[t[0]], p_[t[2]] - p_[t[0]]); }

  bool split_pass(double limit) {
    connect();
    auto candidates = edges();
    std::erase_if(candidates, [limit](const Edge& e) { return e.squared_length <= limit * limit; });
    std::sort(candidates.begin(), candidates.end(), [](const Edge& x, const Edge& y) {
      return x.squared_length != y.squared_length ? x.squared_length > y.squared_length
                                                  : std::tie(x.a, x.b) < std::tie(y.a, y.b);
    });
    for (const Edge& e : candidates) {
      if (touched_[e.s] || touched_[e.t]) continue;
      touched_[e.s] = touched_[e.t] = 1;
      const auto middle = static_cast<VertexId>(p_.size());
      p_.push_back(project(f_, core::lerp(p_[e.a], p_[e.b], 0.5), edge_length_));
      for (const std::uint32_t t : {e.s, e.t}) {
        Triangle other = triangles_[t];
        replace(triangles_[t], e.a, middle);
        replace(other, e.b, middle);
        triangles_.push_back(other);
      }
    }
    return !candidates.empty();
  }

  bool collapse_pass() {
    connect();
    auto candidates = edges();
    const double limit = 4.0 / 5.0 * edge_length_;
    std::erase_if(candidates, [limit](const Edge& e) { return e.squared_length >= limit * limit; });
    std::sort(candidates.begin(), candidates.end(), [](const Edge& x, const Edge& y) {
      return x.squared_length != y.squared_length ? x.squared_length < y.squared_length
                                                  : std::tie(x.a, x.b) < std::tie(y.a, y.b);
    });
    bool changed = false;
    for (const Edge& e : candidates) {
      if (!can_collapse(e)) continue;
      const Vec3 target = project(f_, core::lerp(p_[e.a], p_[e.b], 0.5), edge_length_);
      if (!stays_sound(e, target)) continue;
      p_[e.a] = target;
      for (const VertexId v : {e.a, e.b}) {
        for (const std::uint32_t t : around(v)) touched_[t] = 1;
      }
      for (const std::uint32_t t : around(e.b)) replace(triangles_[t], e.b, e.a);
      changed = true;
    }
    if (!changed) return false;
    std::erase_if(triangles_, [](const Triangle& t) { return t[0] == t[1] || t[1] == t[2] || t[2] == t[0]; });
    drop_unused();
    return true;
  }

  // The link condition: the ends share only two neighbours (Dey et al. 1999). And nothing around has changed.
  bool can_collapse(const Edge& e) {
    ring_.clear();
    for (const std::uint32_t t : around(e.a)) {
      if (touched_[t]) return false;
      for (const VertexId v : triangles_[t]) ring_.push_back(v);
    }
    std::sort(ring_.begin(), ring_.end());
    other_ring_.clear();
    for (const std::uint32_t t : around(e.b)) {
      if (touched_[t]) return false;
      for (const VertexId v : triangles_[t]) other_ring_.push_back(v);
    }
    std::sort(other_ring_.begin(), other_ring_.end());
    other_ring_.erase(std::unique(other_ring_.begin(), other_ring_.end()), other_ring_.end());
    std::size_t common = 0;
    for (const VertexId v : other_ring_) {
      if (v != e.a && v != e.b && std::binary_search(ring_.begin(), ring_.end(), v)) ++common;
    }
    // A vertex of three triangles at c or d would be left with two.
    return common == 2 && valence(e.c) > 3 && valence(e.d) > 3;
  }
  std::size_t valence(VertexId v) const { return begin_[v + 1] - begin_[v]; }

  // No triangle around the collapsed edge turns over, and no edge becomes too long.
  bool stays_sound(const Edge& e, const Vec3& target) const {
    const double limit = 4.0 / 3.0 * edge_length_;
    for (const VertexId v : {e.a, e.b}) {
      for (const std::uint32_t t : around(v)) {
        if (t == e.s || t == e.t) continue;
        Vec3 corners[3];
        for (std::size_t i = 0; i < 3; ++i) {
          corners[i] = triangles_[t][i] == v ? target : p_[triangles_[t][i]];
          if (triangles_[t][i] != v && core::distance(corners[i], target) > limit) return false;
        }
        const Vec3 before = normal(triangles_[t]),
                   after = cross(corners[1] - corners[0], corners[2] - corners[0]);
        if (!(dot(before, after) > 0.3 * length(before) * length(after))) return false;
      }
    }
    return true;
  }

  // Flips an edge if that raises the smallest angle of its two triangles.
  bool flip_pass() {
    connect();
    bool changed = false;
    for (const Edge& e : edges()) {
      if (touched_[e.s] || touched_[e.t] || valence(e.a) <= 3 || valence(e.b) <= 3 ||
          are_neighbours(e.c, e.d))
        continue;
      // With a -> b in triangle s: s = (a, b, c) and t = (b, a, d) become (a, d, c) and (d, b, c).
      const Triangle& s = triangles_[e.s];
      const bool forward =
          (s[0] == e.a && s[1] == e.b) || (s[1] == e.a && s[2] == e.b) || (s[2] == e.a && s[0] == e.b);
      const VertexId a = forward ? e.a : e.b, b = forward ? e.b : e.a;
      const Triangle first{a, e.d, e.c}, second{e.d, b, e.c};
      const double before =
          std::max(largest_cosine(p_[a], p_[b], p_[e.c]), largest_cosine(p_[b], p_[a], p_[e.d]));
      const double after =
          std::max(largest_cosine(p_[a], p_[e.d], p_[e.c]), largest_cosine(p_[e.d], p_[b], p_[e.c]));
      if (after >= before - 1e-9) continue;
      const Vec3 mean = core::normalized(normal(triangles_[e.s]) + normal(triangles_[e.t]));
      const Vec3 n1 = normal(first), n2 = normal(second);
      if (dot(n1, mean) <= 0.5 * length(n1) || dot(n2, mean) <= 0.5 * length(n2)) continue;
      for (const VertexId v : {e.a, e.b, e.c, e.d}) {
        for (const std::uint32_t t : around(v)) touched_[t] = 1;
      }
      triangles_[e.s] = first;
      triangles_[e.t] = second;
      changed = true;
    }
    return changed;
  }

  bool are_neighbours(VertexId a, VertexId b) const {
    for (const std::uint32_t t : around(a)) {
      if (std::find(triangles_[t].begin(), triangles_[t].end(), b) != triangles_[t].end()) return true;
    }
    return false;
  }

  void drop_unused() {
    std::vector<VertexId> renumbered(p_.size(), kNone);
    for (const Triangle& t : triangles_) {
      for (const VertexId v : t) renumbered[v] = 0;
    }
    VertexId kept = 0;
    for (std::size_t v = 0; v < p_.size(); ++v) {
      if (renumbered[v] == kNone) continue;
      p_[kept] = p_[v];
      renumbered[v] = kept++;
    }
    p_.resize(kept);
    for (Triangle& t : triangles_) {
      for (VertexId& v : t) v = renumbered[v];
    }
  }

  std::vector<Vec3>& p_;
  std::vector<Triangle>& triangles_;
  const Function& f_;
  const double edge_length_;
  std::vector<std::uint32_t> begin_, star_;
  std::vector<std::uint8_t> touched_;
  std::vector<VertexId> ring_, other_ring_;
};

}  // namespace

Surface isosurface(const Function& f, const Vec3& low, const Vec3& high, double cell) {
  const Vec3 extent = high - low;
  const auto points = [cell](double side) { return static_cast<std::uint32_t>(std::ceil(side / cell)) + 1; };
  const std::uint32_t nx = points(extent.x), ny = points(extent.y), nz = points(extent.z);
  const auto position = [&](std::uint32_t index) {
    const std::uint32_t i = index % nx, j = index / nx % ny, k = index / nx / ny;
    return low + cell * Vec3{static_cast<double>(i), static_cast<double>(j), static_cast<double>(k)};
  };
  std::vector<double> values(std::size_t{nx} * ny * nz);
  for (std::uint32_t i = 0; i < values.size(); ++i) values[i] = f(position(i));

  Surface surface;
  std::unordered_map<std::uint64_t, VertexId> crossing;  // of a grid edge; looked up, never walked
  const auto vertex = [&](std::uint32_t a, std::uint32_t b) {
    if (a > b) std::swap(a, b);
    const auto [it, added] =
        crossing.try_emplace((std::uint64_t{a} << 32) | b, static_cast<VertexId>(surface.positions.size()));
    // Not at the very ends, where triangles would have no area.
    if (added)
      surface.positions.push_back(
          lerp(position(a), position(b), std::clamp(values[a] / (values[a] - values[b]), 0.05, 0.95)));
    return it->second;
  };
  // The six tetrahedra of a cube: the monotone paths from corner 0 to corner 7 (bit 0: x, bit 1: y, bit 2:
  // z).
  constexpr int kPaths[6][4] = {{0, 1, 3, 7}, {0, 3, 2, 7}, {0, 2, 6, 7},
                                {0, 6, 4, 7}, {0, 4, 5, 7}, {0, 5, 1, 7}};
  for (std::uint32_t k = 0; k + 1 < nz; ++k) {
    for (std::uint32_t j = 0; j + 1 < ny; ++j) {
      for (std::uint32_t i = 0; i + 1 < nx; ++i) {
        const std::uint32_t corner = i + nx * (j + ny * k);
        for (const auto& path : kPaths) {
          std::uint32_t inside[4], outside[4];
          int ins = 0, outs = 0;
          std::uint32_t tet[4];
          for (int n = 0; n < 4; ++n) {
            tet[n] = corner + static_cast<std::uint32_t>(path[n] & 1) +
                     nx * (static_cast<std::uint32_t>(path[n] >> 1 & 1) +
                           ny * static_cast<std::uint32_t>(path[n] >> 2));
            (values[tet[n]] < 0 ? inside[ins++] : outside[outs++]) = tet[n];
          }
          if (ins == 0 || outs == 0) continue;
          const auto add = [&](VertexId a, VertexId b, VertexId c) {
            // Outward means away from a corner that is inside.
            const Vec3 normal = cross(surface.positions[b] - surface.positions[a],
                                      surface.positions[c] - surface.positions[a]);
            if (dot(normal, surface.positions[a] - position(inside[0])) < 0) std::swap(b, c);
            surface.triangles.push_back({a, b, c});
          };
          // One after the other: compilers differ in the order of a call's arguments, and so would the vertices'.
          if (ins == 1) {
            const VertexId c = vertex(inside[0], outside[2]), b = vertex(inside[0], outside[1]),
                           a = vertex(inside[0], outside[0]);
            add(a, b, c);
          } else if (outs == 1) {
            const VertexId c = vertex(inside[2], outside[0]), b = vertex(inside[1], outside[0]),
                           a = vertex(inside[0], outside[0]);
            add(a, b, c);
          } else {
            const VertexId a = vertex(inside[0], outside[0]), b = vertex(inside[0], outside[1]),
                           c = vertex(inside[1], outside[1]), d = vertex(inside[1], outside[0]);
            add(a, b, c);
            add(a, c, d);
          }
        }
      }
    }
  }
  return surface;
}

void remesh_isotropically(Surface& surface, const Function& f, double edge_length, int iterations) {
  Remesher remesher(surface, f, edge_length);
  remesher.project_all();
  for (int i = 0; i < iterations; ++i) {
    remesher.split_long_edges(4.0 / 3.0 * edge_length, 8);
    remesher.collapse_short_edges();
    remesher.flip_edges();
    remesher.smooth();
  }
  for (int i = 0; i < iterations; ++i) {
    remesher.flip_edges();
    remesher.smooth();
  }
}

void split_long_edges(Surface& surface, double max_length) {
  const Function nowhere;
  Remesher(surface, nowhere, max_length).split_long_edges(max_length, 1000);
}

}  // namespace incise::mesh_io
