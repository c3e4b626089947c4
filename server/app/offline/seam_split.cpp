#include "server/app/offline/seam_split.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <utility>

#include "server/replay/session_view.hpp"

namespace incise::app {
namespace {

using core::Vec3;
using core::VertexId;
using replay::to_protocol;

// In lengths of a part's longest edge: how far beyond a seam a corner may be. A tenth is seen.
constexpr double kMayReach = 0.02;
// In lengths of an edge: new vertices nearer than this to another one become that one.
constexpr double kSnap = 0.01;
constexpr int kDepth = 8;  // a seam's corners within one triangle

Vec3 core_vec(const protocol::Vec3& p) {
  return {p.x, p.y, p.z};
}

// A place in a triangle: weights of its corners. One that is exactly 0: on the edge opposite to that corner.
using Weights = std::array<double, 3>;

// A convex part of a triangle.
struct Part {
  std::vector<Weights> ring;
  std::uint32_t origin = core::kNone;
};

class SeamSplitter {
 public:
  SeamSplitter(const protocol::SurfaceLookup& lookup, const protocol::OriginTree& tree,
               std::vector<Vec3>& rest, std::vector<core::HalfFace>& faces, CutSurface& out)
      : lookup_(lookup), tree_(tree), rest_(rest), faces_(faces), out_(out) {}

  void run() {
    const std::vector<std::array<VertexId, 3>> triangles = std::move(out_.surface.triangles);
    std::vector<std::vector<Part>> parts(triangles.size());
    for (std::size_t t = 0; t < triangles.size(); ++t) {
      if (out_.cut[t] != 0 || out_.origins[t] == core::kNone) continue;
      triangle_ = triangles[t];
      clip({{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, out_.origins[t]}, 0, parts[t]);
      if (parts[t].size() < 2) continue;
      for (Part& part : parts[t]) join(part, parts[t]);
      // Every edge's vertices are known before any triangle is made.
      for (const Part& part : parts[t])
        for (const Weights& w : part.ring)
          if (std::find(w.begin(), w.end(), 0) != w.end()) vertex_at(w);
    }
    const CutSurface before = std::exchange(out_, {});
    out_.surface.positions = before.surface.positions;
    const std::vector<core::HalfFace> faces = std::exchange(faces_, {});
    for (std::size_t t = 0; t < triangles.size(); ++t) {
      triangle_ = triangles[t];
      if (parts[t].size() < 2) parts[t] = {{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, before.origins[t]}};
      inner_.clear();
      for (const Part& part : parts[t]) {
        for (const auto& made : triangulated(vertices_of(part))) {
          out_.surface.triangles.push_back(made);
          out_.origins.push_back(part.origin);
          out_.cut.push_back(before.cut[t]);
          out_.pieces.push_back(before.pieces[t]);
          faces_.push_back(faces[t]);
        }
      }
    }
  }

 private:
  Vec3 at_rest(const Weights& w) const {
    return w[0] * rest_[triangle_[0]] + w[1] * rest_[triangle_[1]] + w[2] * rest_[triangle_[2]];
  }

  struct Line {
    std::uint32_t triangle = 0;
    std::size_t corner = 0;
  };
  // The seam that a corner of the part is farthest beyond.
  std::optional<Line> worst(const Part& part) const {
    double size = 0;
    for (std::size_t i = 0; i < part.ring.size(); ++i)
      size = std::max(size, length(at_rest(part.ring[i]) - at_rest(part.ring[(i + 1) % part.ring.size()])));
    double most = kMayReach * size;
    std::optional<Line> found;
    for (const Weights& corner : part.ring) {
      const auto place = lookup_.find(part.origin, to_protocol(at_rest(corner)));
      const auto least = std::min_element(place.weights.begin(), place.weights.end());
      const auto k = static_cast<std::size_t>(least - place.weights.begin());
      if (*least >= 0 || !lookup_.is_seam(place.triangle, k)) continue;
      const protocol::Corners c = lookup_.corners(place.triangle);
      const Vec3 a = core_vec(c[k]), b = core_vec(c[(k + 1) % 3]), d = core_vec(c[(k + 2) % 3]);
      const double height = length(cross(b - a, d - a)) / length(d - b);
      if (-*least * height > most) {
        most = -*least * height;
        found = Line{place.triangle, k};
      }
    }
    return found;
  }

  void clip(Part part, int depth, std::vector<Part>& done) const {
    const std::optional<Line> line = depth < kDepth ? worst(part) : std::nullopt;
    if (!line) {
      done.push_back(std::move(part));
      return;
    }
    const protocol::Corners seam = lookup_.corners(line->triangle);
    std::vector<double> side;
    for (const Weights& w : part.ring)
      side.push_back(protocol::barycentric(seam, to_protocol(at_rest(w)))[line->corner]);
    Part here{{}, part.origin}, beyond;
    for (std::size_t i = 0; i < part.ring.size(); ++i) {
      const std::size_t j = (i + 1) % part.ring.size();
      (side[i] >= 0 ? here : beyond).ring.push_back(part.ring[i]);
      if ((side[i] >= 0) == (side[j] >= 0)) continue;
      // From the same end in both directions.
      const bool turned = part.ring[j] < part.ring[i];
      const Weights &a = part.ring[turned ? j : i], &b = part.ring[turned ? i : j];
      const double x = side[turned ? j : i] / (side[turned ? j : i] - side[turned ? i : j]);
      Weights between{};
      for (std::size_t n = 0; n < 3; ++n) between[n] = a[n] == b[n] ? a[n] : a[n] + x * (b[n] - a[n]);
      here.ring.push_back(between);
      beyond.ring.push_back(between);
    }
    if (here.ring.size() < 3 || beyond.ring.size() < 3) {
      done.push_back(std::move(part));
      return;
    }
    beyond.origin = origin_of(beyond);
    clip(std::move(here), depth + 1, done);
    clip(std::move(beyond), depth + 1, done);
  }

  // By its middle and the way that it faces, as that of a triangle.
  std::uint32_t origin_of(const Part& part) const {
    Vec3 middle, of_all;
    for (const Weights& w : part.ring) middle = middle + at_rest(w);
    middle = (1.0 / static_cast<double>(part.ring.size())) * middle;
    for (const VertexId v : triangle_) of_all = of_all + (1.0 / 3) * rest_[v];
    protocol::Corners corners;
    for (std::size_t k = 0; k < 3; ++k)
      corners[k] = to_protocol(middle + 1e-3 * (rest_[triangle_[k]] - of_all));
    return tree_.origin_of(corners);
  }

  // Gives the part the corners of the others that lie on its edges.
  static void join(Part& part, const std::vector<Part>& all) {
    for (const Part& other : all) {
      for (const Weights& w : other.ring) {
        if (std::find(part.ring.begin(), part.ring.end(), w) != part.ring.end()) continue;
        for (std::size_t i = 0; i < part.ring.size(); ++i) {
          const Weights &a = part.ring[i], &b = part.ring[(i + 1) % part.ring.size()];
          double along = 0, squared = 0, off = 0;
          for (std::size_t n = 0; n < 3; ++n) {
            along += (w[n] - a[n]) * (b[n] - a[n]);
            squared += (b[n] - a[n]) * (b[n] - a[n]);
          }
          const double x = along / squared;
          for (std::size_t n = 0; n < 3; ++n) off = std::max(off, std::abs(a[n] + x * (b[n] - a[n]) - w[n]));
          if (!(x > 0 && x < 1 && off < 1e-9)) continue;
          part.ring.insert(part.ring.begin() + static_cast<std::ptrdiff_t>(i) + 1, w);
          break;
        }
      }
    }
  }

  VertexId add_vertex(const Vec3& at_rest, const Vec3& position) {
    rest_.push_back(at_rest);
    out_.surface.positions.push_back(position);
    return static_cast<VertexId>(rest_.size() - 1);
  }

  VertexId add_vertex(const Weights& w) {
    Vec3 position;
    for (std::size_t k = 0; k < 3; ++k) position = position + w[k] * out_.surface.positions[triangle_[k]];
    return add_vertex(at_rest(w), position);
  }

  struct OnEdge {
    std::pair<VertexId, VertexId> ends;
    double x = 0;  // from the lower one
  };
  OnEdge on_edge(const Weights& w, std::size_t k) const {
    const std::size_t i = (k + 1) % 3, j = (k + 2) % 3;
    return triangle_[i] < triangle_[j] ? OnEdge{{triangle_[i], triangle_[j]}, w[j]}
                                       : OnEdge{{triangle_[j], triangle_[i]}, w[i]};
  }

  VertexId vertex_at(const Weights& w) {
    for (std::size_t k = 0; k < 3; ++k)
      if (w[(k + 1) % 3] == 0 && w[(k + 2) % 3] == 0) return triangle_[k];
    for (std::size_t k = 0; k < 3; ++k) {
      if (w[k] != 0) continue;
      const OnEdge place = on_edge(w, k);
      if (place.x < kSnap) return place.ends.first;
      if (place.x > 1 - kSnap) return place.ends.second;
      auto& there = edges_[place.ends];
      for (const auto& [x, vertex] : there)
        if (std::abs(x - place.x) < kSnap) return vertex;
      return there[place.x] = add_vertex(w);
    }
    const auto [known, is_new] = inner_.try_emplace(w);
    if (is_new) known->second = add_vertex(w);
    return known->second;
  }

  // Where on the edge opposite to corner k a vertex is, if it is there.
  std::optional<double> along(VertexId v, std::size_t k) const {
    const auto ends = std::minmax(triangle_[(k + 1) % 3], triangle_[(k + 2) % 3]);
    if (v == ends.first) return 0;
    if (v == ends.second) return 1;
    const auto edge = edges_.find(ends);
    if (edge == edges_.end()) return std::nullopt;
    for (const auto& [x, vertex] : edge->second)
      if (vertex == v) return x;
    return std::nullopt;
  }

  // With those that others have put on the triangle's edges. Nothing where a part has become a line.
  std::vector<VertexId> vertices_of(const Part& part) {
    std::vector<VertexId> corners;
    for (const Weights& w : part.ring) corners.push_back(vertex_at(w));
    corners.erase(std::unique(corners.begin(), corners.end()), corners.end());
    while (corners.size() > 1 && corners.front() == corners.back()) corners.pop_back();
    std::vector<VertexId> ring;
    for (std::size_t i = 0; i < corners.size(); ++i) {
      const VertexId from = corners[i], to = corners[(i + 1) % corners.size()];
      ring.push_back(from);
      for (std::size_t k = 0; k < 3; ++k) {
        const auto first = along(from, k), last = along(to, k);
        const auto edge = edges_.find(std::minmax(triangle_[(k + 1) % 3], triangle_[(k + 2) % 3]));
        if (!first || !last || edge == edges_.end()) continue;
        std::vector<VertexId> between;
        for (const auto& [x, vertex] : edge->second)
          if (x > std::min(*first, *last) && x < std::max(*first, *last)) between.push_back(vertex);
        if (*first > *last) std::reverse(between.begin(), between.end());
        ring.insert(ring.end(), between.begin(), between.end());
      }
    }
    for (std::size_t k = 0; k < 3; ++k)
      if (std::all_of(ring.begin(), ring.end(), [&](VertexId v) { return along(v, k).has_value(); }))
        return {};
    return ring;
  }

  // Whether the corner after `from` is one: not on the way to `to`.
  bool turns(VertexId from, VertexId at, VertexId to) const {
    const Vec3 a = rest_[at] - rest_[from], b = rest_[to] - rest_[at];
    return length(cross(a, b)) > 0.02 * length(a) * length(b);
  }

  // Four corners by a diagonal; more, or those that lie in one line, around the middle.
  std::vector<std::array<VertexId, 3>> triangulated(const std::vector<VertexId>& ring) {
    if (ring.size() < 3) return {};
    if (ring.size() == 3) return {{ring[0], ring[1], ring[2]}};
    bool convex = ring.size() == 4;
    for (std::size_t i = 0; convex && i < 4; ++i)
      convex = turns(ring[i], ring[(i + 1) % 4], ring[(i + 2) % 4]);
    if (convex) {
      const bool even = length(rest_[ring[2]] - rest_[ring[0]]) < length(rest_[ring[3]] - rest_[ring[1]]);
      return even ? std::vector<std::array<VertexId, 3>>{{ring[0], ring[1], ring[2]},
                                                         {ring[0], ring[2], ring[3]}}
                  : std::vector<std::array<VertexId, 3>>{{ring[0], ring[1], ring[3]},
                                                         {ring[1], ring[2], ring[3]}};
    }
    Vec3 at_rest, position;
    const double share = 1.0 / static_cast<double>(ring.size());
    for (const VertexId v : ring) {
      at_rest = at_rest + share * rest_[v];
      position = position + share * out_.surface.positions[v];
    }
    const VertexId middle = add_vertex(at_rest, position);
    std::vector<std::array<VertexId, 3>> fan;
    for (std::size_t i = 0; i < ring.size(); ++i)
      fan.push_back({ring[i], ring[(i + 1) % ring.size()], middle});
    return fan;
  }

  const protocol::SurfaceLookup& lookup_;
  const protocol::OriginTree& tree_;
  std::vector<Vec3>& rest_;
  std::vector<core::HalfFace>& faces_;
  CutSurface& out_;
  // New vertices of edges, by their share of the way from the lower end; those within the present triangle.
  std::map<std::pair<VertexId, VertexId>, std::map<double, VertexId>> edges_;
  std::map<Weights, VertexId> inner_;
  std::array<VertexId, 3> triangle_{};
};

}  // namespace

void split_at_seams(const protocol::SurfaceLookup& lookup, const protocol::OriginTree& tree,
                    std::vector<core::Vec3>& rest, std::vector<core::HalfFace>& faces, CutSurface& out) {
  SeamSplitter(lookup, tree, rest, faces, out).run();
}

}  // namespace incise::app
