#include "server/haptics/blade_probe.hpp"

#include <algorithm>
#include <array>
#include <bitset>
#include <cmath>

namespace incise::haptics {
namespace {

using core::BladeLine;
using core::BoundaryGrid;
using core::TetId;
using core::TetMesh;
using core::Vec3;

constexpr double kCutNear_h =
    0.15;  // an edge this near to a cut face, all along a tetrahedron, lies in the cut
constexpr double kAside_h = 0.03;  // how far beside a cut is looked where the edge lies in it
constexpr double kAlong = 0.5;     // sine of the angle to a face beyond which an edge crosses it
constexpr double kSame = 1e-7;     // parameters that differ by less are one crossing
constexpr double kMostStretches = 256;

// Where along a line the tissue is cut already.
class CutStretches {
 public:
  void add(double from, double to) noexcept {
    const int last = bin(to);
    for (int i = bin(from); i <= last; ++i) cut_.set(static_cast<std::size_t>(i));
  }
  // The part of [a, b] that is not.
  double uncut(double a, double b) const noexcept {
    const int first = bin(a), last = bin(b);
    int open = 0;
    for (int i = first; i <= last; ++i) open += !cut_.test(static_cast<std::size_t>(i));
    return static_cast<double>(open) / (last - first + 1);
  }

 private:
  static constexpr int kBins = 512;
  static int bin(double t) noexcept { return static_cast<int>(std::clamp(t, 0.0, 1.0) * (kBins - 1) + 0.5); }
  std::bitset<kBins> cut_;
};

struct Crossing {
  double at;  // parameter on the line
  core::HalfFace face;
  bool entering;
};

// The crossings of the line with the boundary, in order.
class Crossings {
 public:
  // `cuts`: also notes where cut faces lie along the line; may be null.
  Crossings(const TetMesh& mesh, const BoundaryGrid& grid, const BladeLine& line, CutStretches* cuts) noexcept
      : mesh_(mesh), heel_(line.heel), d_(line.tip - line.heel), cuts_(cuts) {
    double from = 0, to = 1;
    if (!clip(grid.low(), grid.high(), from, to)) return;
    // Boxes about as long as a cell is wide, so that few cells beside the line are looked at.
    const double stretches = std::ceil((to - from) * length(d_) / grid.cell());
    const int count = static_cast<int>(std::clamp(stretches, 1.0, kMostStretches));
    for (int i = 0; i < count; ++i) {
      const Vec3 a = heel_ + (from + (to - from) * i / count) * d_;
      const Vec3 b = heel_ + (from + (to - from) * (i + 1) / count) * d_;
      grid.visit_box({std::min(a.x, b.x), std::min(a.y, b.y), std::min(a.z, b.z)},
                     {std::max(a.x, b.x), std::max(a.y, b.y), std::max(a.z, b.z)},
                     [this](TetId t) { test(t); });
    }
    std::sort(found_.begin(), found_.begin() + count_,
              [](const Crossing& a, const Crossing& b) { return a.at < b.at; });
  }
  const Crossing* begin() const { return found_.data(); }
  const Crossing* end() const { return found_.data() + count_; }

 private:
  // Cuts [from, to] down to what lies in the box; false where nothing does.
  bool clip(const Vec3& low, const Vec3& high, double& from, double& to) const noexcept {
    const double p[3] = {heel_.x, heel_.y, heel_.z}, d[3] = {d_.x, d_.y, d_.z};
    const double l[3] = {low.x, low.y, low.z}, h[3] = {high.x, high.y, high.z};
    for (int axis = 0; axis < 3; ++axis) {
      if (d[axis] == 0) {
        if (p[axis] < l[axis] || p[axis] > h[axis]) return false;
        continue;
      }
      const double a = (l[axis] - p[axis]) / d[axis], b = (h[axis] - p[axis]) / d[axis];
      from = std::max(from, std::min(a, b));
      to = std::min(to, std::max(a, b));
    }
    return from <= to;
  }

  void test(TetId t) noexcept {
    if (!mesh_.alive(t)) return;
    for (int f = 0; f < 4; ++f) {
      if (mesh_.neighbor(t, f) != core::kNone) continue;
      const auto v = mesh_.face_vertices(core::half_face(t, f));
      const Vec3 a = mesh_.position(v[0]) - heel_, b = mesh_.position(v[1]) - heel_,
                 c = mesh_.position(v[2]) - heel_;
      if (cuts_ && (mesh_.cut_mask(t) >> f & 1) != 0) note_cut(a, b, c);
      const double ab = dot(cross(a, b), d_), bc = dot(cross(b, c), d_), ca = dot(cross(c, a), d_);
      if (!((ab >= 0 && bc >= 0 && ca >= 0) || (ab <= 0 && bc <= 0 && ca <= 0))) continue;
      const double sum = ab + bc + ca;
      if (sum == 0) continue;
      const double length2 = squared_length(d_);
      const double at = (ab * dot(c, d_) + bc * dot(a, d_) + ca * dot(b, d_)) / (sum * length2);
      if (!(at >= 0 && at <= 1)) continue;
      add({at, core::half_face(t, f), dot(cross(b - a, c - a), d_) < 0});
    }
  }

  // The stretch of the line that is next to the triangle, if it runs along it: clipped to the slab around its plane,
  // and to its edges. Corners relative to the heel.
  void note_cut(const Vec3& a, const Vec3& b, const Vec3& c) noexcept {
    const Vec3 n = normalized(cross(b - a, c - a));
    const double slope = dot(n, d_);
    if (std::abs(slope) > kAlong * length(d_)) return;
    const double near = kCutNear_h * mesh_.mean_edge_length();
    double from = 0, to = 1;
    // Keeps offset + slope t >= -near.
    const auto clip_to = [&](double offset, double rise) {
      if (rise > 0) from = std::max(from, (-near - offset) / rise);
      if (rise < 0) to = std::min(to, (-near - offset) / rise);
      if (rise == 0 && offset < -near) to = -1;
    };
    clip_to(-dot(n, a), slope);
    clip_to(dot(n, a), -slope);
    const Vec3* const corners[4] = {&a, &b, &c, &a};
    for (int e = 0; e < 3 && from <= to; ++e) {
      const Vec3 inward = normalized(cross(n, *corners[e + 1] - *corners[e]));
      clip_to(-dot(inward, *corners[e]), dot(inward, d_));
    }
    if (from <= to) cuts_->add(from, to);
  }

  void add(const Crossing& crossing) noexcept {
    if (count_ == kMostCrossings) return;
    for (int i = 0; i < count_; ++i) {
      if (found_[static_cast<std::size_t>(i)].face == crossing.face) return;
    }
    found_[static_cast<std::size_t>(count_++)] = crossing;
  }

  const TetMesh& mesh_;
  const Vec3 heel_, d_;
  CutStretches* const cuts_;
  std::array<Crossing, kMostCrossings> found_;
  int count_ = 0;
};

// Sums over the tetrahedra that the edge passes.
class Sum {
 public:
  Sum(const TetMesh& mesh, const Materials& materials, const BladeLine& line,
      const CutStretches& cuts) noexcept
      : mesh_(mesh),
        materials_(materials),
        cuts_(cuts),
        line_(line),
        length_(distance(line.heel, line.tip)) {}

  // Walks from parameter a inside `tet`, or on its face, to b. Returns where it left the tissue; b where it did not.
  double walk(TetId tet, double a, double b) noexcept {
    double reached = a;
    TetId last = tet;
    const auto visit = [&](TetId t, double in, double out) {
      last = t;
      reached = a + out * (b - a);
      add(t, a + in * (b - a), reached);
    };
    if (core::walk(mesh_, tet, at(a), at(b), visit, kMostSteps) == core::kNone) note_cut(last, at(reached));
    const double from = std::min(a, reached), to = std::max(a, reached);
    // A stretch that begins where the last one ended, on the other side of a cut, continues it.
    if (from - stretch_to_ < 1e-6 && stretch_to_ > stretch_from_) {
      stretch_to_ = std::max(stretch_to_, to);
    } else {
      stretch_from_ = from;
      stretch_to_ = to;
    }
    if (stretch_to_ - stretch_from_ > sum_.to - sum_.from) {
      sum_.from = stretch_from_;
      sum_.to = stretch_to_;
    }
    return reached;
  }

  // The normal of a cut face by which a walk ended; zero where none did.
  const Vec3& cut_normal() const noexcept { return cut_normal_; }

  Engagement result() noexcept {
    if (sum_.length_m > 0) {
      sum_.middle /= sum_.length_m;
      sum_.stiffness_n_m += point_stiffness_ / sum_.length_m;
    }
    return sum_;
  }

 private:
  Vec3 at(double t) const noexcept { return lerp(line_.heel, line_.tip, t); }

  void add(TetId t, double in, double out) noexcept {
    if (in <=
        out) {  // forward: what was counted is not counted again, though inverted tetrahedra may overlap
      in = std::max(in, counted_to_);
      counted_to_ = std::max(counted_to_, out);
      if (out <= in) return;
    } else {
      counted_to_ = std::max(counted_to_, in);
    }
    const double piece = std::abs(out - in) * length_;
    if (!(piece > 0)) return;
    const Material& material = materials_.of(mesh_.region(t));
    sum_.length_m += piece;
    sum_.middle += piece * 0.5 * (in + out);
    point_stiffness_ += piece * material.stiffness_n_m;
    sum_.stiffness_n_m += piece * material.stiffness_pa;
    sum_.friction_n_s_m += piece * material.friction_n_s_m2;
    sum_.puncture_n = std::max(sum_.puncture_n, material.puncture_n);
    const double uncut = piece * cuts_.uncut(std::min(in, out), std::max(in, out));
    sum_.uncut_m += uncut;
    sum_.fracture_n += uncut * material.toughness_j_m2;
  }

  Vec3 normal(core::HalfFace face) const noexcept {
    const auto v = mesh_.face_vertices(face);
    const Vec3& a = mesh_.position(v[0]);
    return normalized(cross(mesh_.position(v[1]) - a, mesh_.position(v[2]) - a));
  }

  void note_cut(TetId t, const Vec3& exit) noexcept {
    double nearest = INFINITY;
    for (int f = 0; f < 4; ++f) {
      if ((mesh_.cut_mask(t) >> f & 1) == 0) continue;
      const core::HalfFace face = core::half_face(t, f);
      const Vec3 n = normal(face);
      const double off = std::abs(dot(n, exit - mesh_.position(mesh_.face_vertices(face)[0])));
      if (off >= nearest) continue;
      nearest = off;
      cut_normal_ = n;
    }
  }

  const TetMesh& mesh_;
  const Materials& materials_;
  const CutStretches& cuts_;
  const BladeLine line_;
  const double length_;
  double stretch_from_ = -1, stretch_to_ = -1, counted_to_ = 0;
  double point_stiffness_ = 0;  // times length
  Engagement sum_;
  Vec3 cut_normal_;
};

// The probe of one line. `cut_normal`: of a cut that it crosses or lies in; zero where there is none.
Engagement probe_once(const TetMesh& mesh, const BoundaryGrid& grid, const Materials& materials,
                      const BladeLine& line, const Crossings& crossings, const CutStretches& cuts,
                      Vec3& cut_normal) noexcept {
  Sum sum(mesh, materials, line, cuts);
  double done = -1;  // the line is dealt with up to here
  if (crossings.begin() == crossings.end()) {
    // Wholly inside or wholly outside.
    const TetId t = grid.locate(mesh, line.heel);
    if (t != core::kNone) sum.walk(t, 0, 1);
    return sum.result();
  }
  for (const Crossing& crossing : crossings) {
    if (crossing.entering) {
      if (crossing.at < done - kSame) continue;
      done = std::max(done, sum.walk(core::tet_of(crossing.face), crossing.at, 1));
    } else if (done < 0) {
      // The first crossing leads out: the heel is inside.
      sum.walk(core::tet_of(crossing.face), crossing.at, 0);
      done = crossing.at;
    }
  }
  cut_normal = sum.cut_normal();
  return sum.result();
}

// The point of the triangle nearest to p (Ericson 2005, "Real-Time Collision Detection", section 5.1.5: by the
// Voronoi regions of its vertices and edges).
Vec3 nearest_on_triangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) noexcept {
  const Vec3 ab = b - a, ac = c - a, ap = p - a;
  const double d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return a;
  const Vec3 bp = p - b;
  const double d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return b;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + (d1 / (d1 - d3)) * ab;
  const Vec3 cp = p - c;
  const double d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return c;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + (d2 / (d2 - d6)) * ac;
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return b + ((d4 - d3) / ((d4 - d3) + (d5 - d6))) * (c - b);
  const double denominator = va + vb + vc;
  if (!(denominator > 0)) return a;
  return a + (vb / denominator) * ab + (vc / denominator) * ac;
}

}  // namespace

Engagement probe(const TetMesh& mesh, const BoundaryGrid& grid, const Materials& materials,
                 const BladeLine& line) noexcept {
  Vec3 cut_normal;
  CutStretches cuts;
  const Crossings crossings(mesh, grid, line, &cuts);
  Engagement best = probe_once(mesh, grid, materials, line, crossings, cuts, cut_normal);
  if (squared_length(cut_normal) == 0) return best;
  // An edge that lies in a cut crosses its faces to and fro by rounding, and gets lost between them. A little beside it
  // is seen whole, on either side.
  for (const double side : {kAside_h, -kAside_h}) {
    const Vec3 aside = side * mesh.mean_edge_length() * cut_normal;
    const BladeLine beside{line.heel + aside, line.tip + aside};
    Vec3 ignored;
    const Engagement other =
        probe_once(mesh, grid, materials, beside, Crossings(mesh, grid, beside, nullptr), cuts, ignored);
    if (other.length_m > best.length_m) best = other;
  }
  return best;
}

std::optional<SurfacePoint> nearest_surface(const TetMesh& mesh, const BoundaryGrid& grid, const Vec3& p,
                                            double radius) noexcept {
  const Vec3 reach{radius, radius, radius};
  double nearest2 = radius * radius;
  std::optional<SurfacePoint> found;
  grid.visit_box(p - reach, p + reach, [&](TetId t) {
    if (!mesh.alive(t)) return;
    for (int f = 0; f < 4; ++f) {
      if (mesh.neighbor(t, f) != core::kNone || (mesh.cut_mask(t) >> f & 1) != 0) continue;
      const auto v = mesh.face_vertices(core::half_face(t, f));
      const Vec3 &a = mesh.position(v[0]), &b = mesh.position(v[1]), &c = mesh.position(v[2]);
      const Vec3 point = nearest_on_triangle(p, a, b, c);
      const double distance2 = squared_length(p - point);
      if (distance2 >= nearest2) continue;
      nearest2 = distance2;
      found = SurfacePoint{point, cross(b - a, c - a), 0};
    }
  });
  if (!found) return found;
  found->distance_m = std::sqrt(nearest2);
  found->normal = normalized(found->normal);
  return found;
}

}  // namespace incise::haptics
