#include "server/mesh_io/surface_check.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/triangle_intersection.hpp"

namespace incise::mesh_io {
namespace {

using core::kNone;
using core::Vec3;
using core::VertexId;

constexpr double kLargest = 1e+60, kSmallest = 1e-60;  // as in tet_repair.cpp: the limit of exact predicates
constexpr std::size_t kMaxPairs = 1000;  // of intersecting triangles; beyond that the text says "at least"
constexpr std::size_t kNamedPairs = 3;

class SurfaceCheck {
 public:
  SurfaceCheck(Surface surface, const std::string& file, std::vector<std::string>& warnings)
      : surface_(std::move(surface)), file_(file), warnings_(warnings) {}

  ClosedSurface run() {
    check_positions();
    check_triangles();
    match_edges();
    orient();
    check_intersections();
    return sort_shells();
  }

 private:
  struct Shell {
    std::vector<std::uint32_t> triangles;
    double volume = 0;  // signed, as the file orients it
    Vec3 low, high;
    std::size_t parent = SIZE_MAX;
    enum class Kind { kBody, kInclusion, kCavity } kind = Kind::kBody;
  };

  [[noreturn]] void fail(const std::string& message) const { throw MeshError(file_ + ": " + message); }
  void warn(const std::string& message) { warnings_.push_back(file_ + ": " + message); }
  const Vec3& corner(std::size_t triangle, std::size_t i) const {
    return surface_.positions[surface_.triangles[triangle][i]];
  }
  std::string place(std::size_t triangle) const {
    return "triangle " + std::to_string(triangle) + " " + to_text(corner(triangle, 0)) + " " +
           to_text(corner(triangle, 1)) + " " + to_text(corner(triangle, 2));
  }
  std::string edge_place(VertexId a, VertexId b) const {
    return "from " + to_text(surface_.positions[a]) + " to " + to_text(surface_.positions[b]);
  }

  void check_positions() {
    for (Vec3& p : surface_.positions) {
      for (double* x : {&p.x, &p.y, &p.z}) {
        if (!std::isfinite(*x)) fail("a vertex has a coordinate that is not finite");
        if (std::abs(*x) > kLargest) {
          fail("the vertex " + to_text(p) + " lies beyond " + to_text(kLargest) +
               " m: check the file's numbers and the scale");
        }
        if (std::abs(*x) < kSmallest) *x = 0;
      }
    }
  }

  void check_triangles() const {
    std::size_t degenerate = 0, first = 0;
    for (std::size_t i = 0; i < surface_.triangles.size(); ++i) {
      const auto& t = surface_.triangles[i];
      const bool repeats = t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
      if (!repeats && !is_collinear(corner(i, 0), corner(i, 1), corner(i, 2))) continue;
      if (degenerate++ == 0) first = i;
    }
    if (degenerate > 0) {
      fail(std::to_string(degenerate) + (degenerate == 1 ? " triangle is" : " triangles are") +
           " degenerate, without area (the first: " + place(first) +
           "); remove them and join their neighbours");
    }
  }

  // Fills neighbour_[3 t + i], the triangle across the edge from corner i to corner i + 1, and whether it
  // runs along the edge in the same direction (then one of the two must be turned).
  void match_edges() {
    struct Edge {
      VertexId low, high;
      std::uint32_t half_edge;
      bool reversed;
    };
    std::vector<Edge> edges;
    edges.reserve(3 * surface_.triangles.size());
    for (std::uint32_t t = 0; t < surface_.triangles.size(); ++t) {
      for (std::uint32_t i = 0; i < 3; ++i) {
        const VertexId a = surface_.triangles[t][i], b = surface_.triangles[t][(i + 1) % 3];
        edges.push_back({std::min(a, b), std::max(a, b), 3 * t + i, a > b});
      }
    }
    std::sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) {
      return std::tie(a.low, a.high, a.half_edge) < std::tie(b.low, b.high, b.half_edge);
    });
    neighbour_.assign(edges.size(), kNone);
    turned_.assign(edges.size(), 0);
    std::vector<Edge> open, crowded;
    for (auto it = edges.begin(); it != edges.end();) {
      auto end = it + 1;
      while (end != edges.end() && end->low == it->low && end->high == it->high) ++end;
      if (end - it == 1) open.push_back(*it);
      if (end - it > 2) crowded.push_back(*it);
      if (end - it == 2) {
        const auto &a = *it, &b = *(it + 1);
        check_twins(a.half_edge / 3, b.half_edge / 3);
        neighbour_[a.half_edge] = b.half_edge / 3;
        neighbour_[b.half_edge] = a.half_edge / 3;
        turned_[a.half_edge] = turned_[b.half_edge] = a.reversed == b.reversed;
      } else {
        for (auto one = it; one != end; ++one) {
          for (auto other = it; other != one; ++other) check_twins(other->half_edge / 3, one->half_edge / 3);
        }
      }
      it = end;
    }
    std::string problem;
    const auto count = [](std::size_t n) {
      return std::to_string(n) + (n == 1 ? " edge has" : " edges have");
    };
    if (!open.empty()) {
      problem = "the surface is open: " + count(open.size()) + " one triangle only (the first: triangle " +
                std::to_string(open[0].half_edge / 3) + ", " + edge_place(open[0].low, open[0].high) + ")";
    }
    if (!crowded.empty()) {
      problem += (problem.empty() ? "the surface is non-manifold: " : "; and non-manifold: ") +
                 count(crowded.size()) + " more than two triangles (the first: triangle " +
                 std::to_string(crowded[0].half_edge / 3) + ", " +
                 edge_place(crowded[0].low, crowded[0].high) + ")";
    }
    if (!problem.empty()) fail(problem + "; only a closed surface can be filled: repair it there");
  }

  void check_twins(std::uint32_t a, std::uint32_t b) const {
    auto s = surface_.triangles[a], t = surface_.triangles[b];
    std::sort(s.begin(), s.end());
    std::sort(t.begin(), t.end());
    if (s == t)
      fail(place(a) + " and triangle " + std::to_string(b) +
           " have the same vertices: remove one of them; of a body that was cut, take its .vtu instead of "
           "the surface");
  }

  // Turns triangles so that neighbours agree, shell by shell, following the majority of the shell.
  void orient() {
    std::vector<std::uint8_t> seen(surface_.triangles.size(), 0), turn(surface_.triangles.size(), 0);
    std::size_t turned = 0;
    std::uint32_t first_turned = kNone;
    for (std::uint32_t seed = 0; seed < surface_.triangles.size(); ++seed) {
      if (seen[seed]) continue;
      Shell shell;
      shell.triangles.assign(1, seed);
      seen[seed] = 1;
      std::size_t turns = 0;
      for (std::size_t k = 0; k < shell.triangles.size(); ++k) {
        const std::uint32_t t = shell.triangles[k];
        turns += turn[t];
        for (std::uint32_t i = 0; i < 3; ++i) {
          const std::uint32_t n = neighbour_[3 * t + i];
          const auto wanted = static_cast<std::uint8_t>(turn[t] ^ turned_[3 * t + i]);
          if (!seen[n]) {
            seen[n] = 1;
            turn[n] = wanted;
            shell.triangles.push_back(n);
          } else if (turn[n] != wanted) {
            fail("the surface has one side only (like a Moebius strip), at " + place(t) +
                 ": it bounds no volume, repair it there");
          }
        }
      }
      const bool majority = 2 * turns > shell.triangles.size();
      for (const std::uint32_t t : shell.triangles) {
        if ((turn[t] != 0) == majority) continue;
        turn_over(t);
        if (turned++ == 0 || t < first_turned) first_turned = t;
      }
      shells_.push_back(std::move(shell));
    }
    if (turned > 0) {
      warn(std::to_string(turned) + (turned == 1 ? " triangle was" : " triangles were") +
           " turned over to agree with the neighbours (the first: " + place(first_turned) + ")");
    }
  }

  void turn_over(std::uint32_t t) {
    std::swap(surface_.triangles[t][1], surface_.triangles[t][2]);
    const auto corners = [i = 3 * std::size_t{t}](auto& values) {
      if (!values.empty()) std::swap(values[i + 1], values[i + 2]);
    };
    corners(surface_.look.uvs);
    corners(surface_.look.normals);
    corners(surface_.look.colours);
  }

  // The middle of the intersection of two triangles' boxes.
  Vec3 common_middle(std::size_t s, std::size_t t) const {
    const auto middle = [&](auto axis) {
      const auto [s0, s1] = std::minmax({corner(s, 0).*axis, corner(s, 1).*axis, corner(s, 2).*axis});
      const auto [t0, t1] = std::minmax({corner(t, 0).*axis, corner(t, 1).*axis, corner(t, 2).*axis});
      return 0.5 * (std::max(s0, t0) + std::min(s1, t1));
    };
    return {middle(&Vec3::x), middle(&Vec3::y), middle(&Vec3::z)};
  }

  void check_intersections() const {
    const auto pairs = self_intersections(surface_, kMaxPairs);
    if (pairs.empty()) return;
    std::string message =
        "the surface intersects itself: " + std::string(pairs.size() == kMaxPairs ? "at least " : "") +
        std::to_string(pairs.size()) + (pairs.size() == 1 ? " pair" : " pairs") +
        " of triangles cross or touch (";
    for (std::size_t i = 0; i < std::min(pairs.size(), kNamedPairs); ++i) {
      if (i > 0) message += "; ";
      message += "triangles " + std::to_string(pairs[i].first) + " and " + std::to_string(pairs[i].second) +
                 " near " + to_text(common_middle(pairs[i].first, pairs[i].second));
    }
    message += pairs.size() > kNamedPairs ? "; ...)" : ")";
    fail(message + "; repair it there");
  }

  // ---------------------------------------------------------------------------------- shells within shells

  ClosedSurface sort_shells() {
    for (Shell& shell : shells_) measure(shell);
    for (std::size_t i = 0; i < shells_.size(); ++i) find_parent(i);
    std::vector<std::size_t> by_depth(shells_.size());
    for (std::size_t i = 0; i < by_depth.size(); ++i) by_depth[i] = i;
    // A parent encloses more volume, so it comes first.
    std::sort(by_depth.begin(), by_depth.end(), [this](std::size_t a, std::size_t b) {
      const double va = std::abs(shells_[a].volume), vb = std::abs(shells_[b].volume);
      return va != vb ? va > vb : a < b;
    });
    std::size_t inside_out = 0;
    for (const std::size_t i : by_depth) {
      Shell& shell = shells_[i];
      if (shell.parent != SIZE_MAX && shells_[shell.parent].kind != Shell::Kind::kCavity) {
        const bool against = (shell.volume < 0) != (shells_[shell.parent].volume < 0);
        shell.kind = against ? Shell::Kind::kCavity : Shell::Kind::kInclusion;
      } else if (shell.volume < 0) {
        ++inside_out;
      }
    }
    if (inside_out > 0) {
      warn(shells_.size() == 1 ? "the surface is inside out: it was turned over"
                               : std::to_string(inside_out) + " of " + std::to_string(shells_.size()) +
                                     " shells are inside out: they were turned over");
    }
    ClosedSurface closed;
    std::int32_t inclusions = 0;
    for (Shell& shell : shells_) {
      const bool outward = shell.kind != Shell::Kind::kCavity;
      if ((shell.volume > 0) != outward) {
        for (const std::uint32_t t : shell.triangles) turn_over(t);
      }
      if (shell.kind == Shell::Kind::kInclusion) ++inclusions;
      if (shell.kind == Shell::Kind::kBody) closed.volume += std::abs(shell.volume);
      if (shell.kind == Shell::Kind::kCavity) closed.volume -= std::abs(shell.volume);
    }
    std::int32_t next_region = 1;
    for (const Shell& shell : shells_) {
      if (shell.kind == Shell::Kind::kCavity) {
        closed.holes.push_back(point_within(shell, 1));  // a cavity's triangles face into it
      } else if (inclusions > 0) {
        closed.regions.push_back(
            {point_within(shell, -1), shell.kind == Shell::Kind::kBody ? 0 : next_region++});
      }
    }
    closed.surface = std::move(surface_);
    return closed;
  }

  void measure(Shell& shell) const {
    const Vec3 origin = corner(shell.triangles[0], 0);
    shell.low = shell.high = origin;
    for (const std::uint32_t t : shell.triangles) {
      shell.volume += dot(cross(corner(t, 0) - origin, corner(t, 1) - origin), corner(t, 2) - origin) / 6.0;
      for (std::size_t i = 0; i < 3; ++i) {
        const Vec3& p = corner(t, i);
        extend(p, shell.low, shell.high);
      }
    }
    if (shell.volume == 0) fail("the shell with " + place(shell.triangles[0]) + " encloses no volume");
  }

  // The smallest shell around shell i. Shells do not cross, so one vertex decides.
  void find_parent(std::size_t i) {
    const Vec3& p = corner(shells_[i].triangles[0], 0);
    for (std::size_t j = 0; j < shells_.size(); ++j) {
      const Shell& other = shells_[j];
      if (j == i || p.x < other.low.x || p.y < other.low.y || p.z < other.low.z || p.x > other.high.x ||
          p.y > other.high.y || p.z > other.high.z || !encloses(other, p)) {
        continue;
      }
      std::size_t& parent = shells_[i].parent;
      if (parent == SIZE_MAX || std::abs(other.volume) < std::abs(shells_[parent].volume)) parent = j;
    }
  }

  // By the winding number: the solid angles of the triangles (van Oosterom and Strackee 1983, equation 8) sum
  // to 4 pi for a point inside, to zero for one outside.
  bool encloses(const Shell& shell, const Vec3& p) const {
    double angle = 0;
    for (const std::uint32_t t : shell.triangles) {
      const Vec3 a = corner(t, 0) - p, b = corner(t, 1) - p, c = corner(t, 2) - p;
      const double la = length(a), lb = length(b), lc = length(c);
      angle += 2 * std::atan2(dot(a, cross(b, c)),
                              la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb);
    }
    return std::abs(angle) > 2 * std::numbers::pi;
  }

  // A point on the inner (-1) or outer (1) side of a shell's largest triangle: half way along its normal to
  // what the normal meets first.
  Vec3 point_within(const Shell& shell, double direction) const {
    std::uint32_t largest = shell.triangles[0];
    const auto normal = [this](std::uint32_t t) {
      return core::cross(corner(t, 1) - corner(t, 0), corner(t, 2) - corner(t, 0));
    };
    for (const std::uint32_t t : shell.triangles) {
      if (squared_length(normal(t)) > squared_length(normal(largest))) largest = t;
    }
    const Vec3 from = (1.0 / 3.0) * (corner(largest, 0) + corner(largest, 1) + corner(largest, 2));
    const Vec3 way = direction * core::normalized(normal(largest));
    double nearest = length(shell.high - shell.low);
    for (std::uint32_t t = 0; t < surface_.triangles.size(); ++t) {
      if (t == largest) continue;
      // Moeller and Trumbore 1997: from + s * way = the point of triangle t with barycentric coordinates u,
      // v.
      const Vec3 e1 = corner(t, 1) - corner(t, 0), e2 = corner(t, 2) - corner(t, 0);
      const Vec3 h = cross(way, e2);
      const double determinant = dot(e1, h);
      if (determinant == 0) continue;
      const Vec3 o = from - corner(t, 0);
      const double u = dot(o, h) / determinant;
      const Vec3 q = cross(o, e1);
      const double v = dot(way, q) / determinant;
      const double s = dot(e2, q) / determinant;
      if (u < -1e-9 || v < -1e-9 || u + v > 1 + 1e-9 || s <= 0) continue;
      nearest = std::min(nearest, s);
    }
    return from + (0.5 * nearest) * way;
  }

  Surface surface_;
  const std::string& file_;
  std::vector<std::string>& warnings_;
  std::vector<std::uint32_t> neighbour_;
  std::vector<std::uint8_t> turned_;
  std::vector<Shell> shells_;
};

}  // namespace

ClosedSurface check_surface(Surface surface, const std::string& file, std::vector<std::string>& warnings) {
  return SurfaceCheck(std::move(surface), file, warnings).run();
}

}  // namespace incise::mesh_io
