#include "server/core/cut/croll/croll_cutter.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace incise::core {
namespace {

int sign(double d) {
  return d > 0 ? 1 : d < 0 ? -1 : 0;
}

double distance_to_line(const Vec3& p, const BladeLine& line) {
  const Vec3 u = line.tip - line.heel;
  const double l = length(u);
  return l > 0 ? length(cross(u, p - line.heel)) / l : 0;
}

const Vec3& farther_end(const BladeLine& line, const BladeLine& from) {
  return distance_to_line(line.heel, from) > distance_to_line(line.tip, from) ? line.heel : line.tip;
}

}  // namespace

// ---------------------------------------------------------------------- 3.1 Identify the cut plane

// The planes of the sweep from one line to another; false where it has no area. The paper's p1 and p2 are the
// heel and the tip of the back line, its p3 is the end of the front line that is farther away.
bool CrollCutter::make_sweep(const BladeLine& back, const BladeLine& front, double h, Sweep& sweep) {
  const auto plane_through = [](const Vec3& p1, const Vec3& p2, const Vec3& p3) {
    const Vec3 n = normalized(cross(p1 - p2, p3 - p2));  // eq. 1, 4
    return Plane{n, -dot(n, p1)};                        // eq. 3, 5
  };
  const auto facing = [](const Plane& plane, const Vec3& ahead, double way) {
    return way * plane.distance(ahead) >= 0 ? plane : Plane{-plane.n, -plane.p};
  };
  const Vec3 &ahead = farther_end(front, back), &behind = farther_end(back, front);
  const double negligible = kOnPlane_h * h;
  if (distance(back.heel, back.tip) <= negligible || distance(front.heel, front.tip) <= negligible ||
      distance_to_line(ahead, back) <= negligible || distance_to_line(behind, front) <= negligible) {
    return false;
  }
  sweep.cut = plane_through(back.heel, back.tip, ahead);
  // Perpendicular to the cut plane, through the two lines (eq. 7).
  sweep.back = facing(plane_through(back.heel, back.tip, back.heel + sweep.cut.n), ahead, 1);
  sweep.front = facing(plane_through(front.heel, front.tip, front.heel + sweep.cut.n), behind, -1);
  return true;
}

void CrollCutter::add_segment(const BladeLine& back, const BladeLine& front) {
  const double h = mesh_.mean_edge_length();
  Sweep sweep;
  if (make_sweep(back, front, h, sweep)) {
    const double off =
        std::max(std::abs(sweep.cut.distance(front.heel)), std::abs(sweep.cut.distance(front.tip)));
    // Lines that cross between heel and tip have no one side that is ahead: they too are cut as two
    // triangles.
    const double ahead = std::min(sweep.back.distance(front.heel), sweep.back.distance(front.tip));
    if (off <= kCoplanar_h * h && ahead >= -kOnPlane_h * h) {
      sweeps_.push_back(sweep);
      return;
    }
  }
  const BladeLine diagonal{back.heel, front.tip};
  if (make_sweep(back, diagonal, h, sweep)) sweeps_.push_back(sweep);
  if (make_sweep(diagonal, front, h, sweep)) sweeps_.push_back(sweep);
}

void CrollCutter::begin(const Batch& batch) {
  counts_ = {};
  sweeps_.clear();
  next_ = 0;
  for (std::size_t i = 1; i < batch.lines.size(); ++i) add_segment(batch.lines[i - 1], batch.lines[i]);
}

CrollCutter::Progress CrollCutter::advance(WorkBudget& budget) {
  for (; next_ < sweeps_.size(); ++next_) {
    if (budget.spent()) return Progress::kSpent;
    budget.charge(static_cast<std::int64_t>(mesh_.vertex_slots()) + mesh_.tet_slots());
    cut(sweeps_[next_]);
  }
  return Progress::kDone;
}

void CrollCutter::cut(const Sweep& sweep) {
  distances_.resize(mesh_.vertex_slots());
  moved_.assign(mesh_.vertex_slots(), 0);
  side_.assign(mesh_.tet_slots(), 0);
  for (VertexId v = 0; v < mesh_.vertex_slots(); ++v) distances_[v] = classify(sweep, mesh_.position(v));
  choose_moves();
  move_to_cut_plane(sweep);
  move_to_ends(sweep);
  split(sweep);
  remove_flat();
}

// ---------------------------------------------------------------------- 3.2 Determine which tetrahedra
// intersect

CrollCutter::Distances CrollCutter::classify(const Sweep& sweep, const Vec3& v) const {
  const double on_plane = kOnPlane_h * mesh_.mean_edge_length();
  const auto rounded = [&](const Plane& plane) {
    const double d = plane.distance(v);  // eq. 8
    return std::abs(d) <= on_plane ? 0.0 : d;
  };
  return {rounded(sweep.cut), rounded(sweep.back), rounded(sweep.front)};
}

// Alpha of eq. 9: the side of the cut plane on which the vertex farthest from it lies; ties go to the first.
int CrollCutter::side(TetId t) const {
  double farthest = 0;
  for (VertexId v : mesh_.vertices(t)) {
    if (std::abs(distances_[v].cut) > std::abs(farthest)) farthest = distances_[v].cut;
  }
  return sign(farthest);
}

void CrollCutter::choose_moves() {
  for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
    if (!mesh_.alive(t)) continue;
    const auto& vertices = mesh_.vertices(t);
    int lowest = 1, highest = -1;
    bool affected = false;
    for (VertexId v : vertices) {
      lowest = std::min(lowest, sign(distances_[v].cut));
      highest = std::max(highest, sign(distances_[v].cut));
      affected |= between(v);
    }
    if (!affected) continue;
    side_[t] = static_cast<std::int8_t>(side(t));
    if (lowest == highest && lowest != 0) continue;
    counts_.events += lowest < 0 && highest > 0 ? 1 : 0;
    for (VertexId v : vertices) {
      if (between(v) && (sign(distances_[v].cut) != side_[t] || distances_[v].cut == 0)) moved_[v] = 1;
    }
  }
}

// ---------------------------------------------------------------------- 3.3 Move the vertices

// The outward normal of the surface at v: s of eq. 11. Zero for an interior vertex and at a crack front.
Vec3 CrollCutter::surface_normal(VertexId v) {
  Vec3 outer, cut;
  double outer_area = 0, cut_area = 0;
  mesh_.star(v, star_);
  for (std::uint32_t corner : star_) {
    const TetId t = tet_of(corner);
    for (int f = 0; f < 4; ++f) {
      if (f == index_of(corner) || mesh_.opposite(half_face(t, f)) != kNone) continue;
      const Vec3 area = mesh_.twice_area(half_face(t, f));
      const bool is_cut = (mesh_.cut_mask(t) >> f & 1) != 0;
      (is_cut ? cut : outer) += area;
      (is_cut ? cut_area : outer_area) += length(area);
    }
  }
  const Vec3& s = outer_area > 0 ? outer : cut;
  const double area = outer_area > 0 ? outer_area : cut_area;
  return length(s) > 1e-6 * area ? normalized(s) : Vec3{};
}

// Where v goes on a plane.
Vec3 CrollCutter::moved_to(const Plane& plane, VertexId v) {
  const Vec3& at = mesh_.position(v);
  const double d = plane.distance(at);
  const Vec3 s = surface_normal(v);
  const Vec3 a = cross(s, plane.n);  // eq. 11, with c = plane.n
  if (length(a) < kParallel)
    return at - d * plane.n;  // eq. 10: D has the side's sign, the move goes against it
  // p1: from v within the surface, square to the line, up to the plane.
  const Vec3 within = cross(a, s);
  const Vec3 p1 = at - (d / dot(plane.n, within)) * within;
  const Vec3 p2 = p1 + a;                                             // eq. 12
  const double t = -dot(p1 - at, p2 - p1) / squared_length(p2 - p1);  // eq. 13
  return p1 + t * (p2 - p1);                                          // eq. 14
}

void CrollCutter::move_to_cut_plane(const Sweep& sweep) {
  moves_.clear();
  targets_.clear();
  for (VertexId v = 0; v < mesh_.vertex_slots(); ++v) {
    if (moved_[v] == 0 || distances_[v].cut == 0) continue;
    moves_.push_back(v);
    targets_.push_back(moved_to(sweep.cut, v));
  }
  for (std::size_t i = 0; i < moves_.size(); ++i) {
    mesh_.move_vertex(moves_[i], targets_[i]);
    const double cut = distances_[moves_[i]].cut;  // alpha stays that of the unmoved tetrahedron
    distances_[moves_[i]] = classify(sweep, targets_[i]);
    distances_[moves_[i]].cut = cut;
  }
  counts_.snaps += static_cast<std::uint32_t>(moves_.size());
}

// The second move: so that the cut ends at the front and the back line instead of ragged, the moved vertices
// of a tetrahedron that the front or the back plane passes through go to that plane.
void CrollCutter::move_to_ends(const Sweep& sweep) {
  enum : std::uint8_t { kStay = 1, kToBack = 2, kToFront = 4 };  // moved_[v] is 1 so far, for moved vertices
  for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
    if (!mesh_.alive(t) || side_[t] == 0) continue;
    int back_low = 1, back_high = -1, front_low = 1, front_high = -1;
    for (VertexId v : mesh_.vertices(t)) {
      back_low = std::min(back_low, sign(distances_[v].back));
      back_high = std::max(back_high, sign(distances_[v].back));
      front_low = std::min(front_low, sign(distances_[v].front));
      front_high = std::max(front_high, sign(distances_[v].front));
    }
    const int ends =
        (back_low < 0 && back_high > 0 ? kToBack : 0) | (front_low < 0 && front_high > 0 ? kToFront : 0);
    if (ends == 0) continue;
    for (VertexId v : mesh_.vertices(t)) {
      if (moved_[v] != 0) moved_[v] = static_cast<std::uint8_t>(moved_[v] | ends);
    }
  }
  moves_.clear();
  targets_.clear();
  for (VertexId v = 0; v < mesh_.vertex_slots(); ++v) {
    if (moved_[v] <= kStay) continue;
    const Distances& d = distances_[v];
    const bool to_front = moved_[v] == (kStay | kToFront) || (moved_[v] == (kStay | kToFront | kToBack) &&
                                                              std::abs(d.front) <= std::abs(d.back));
    if ((to_front ? d.front : d.back) == 0) continue;
    moves_.push_back(v);
    targets_.push_back(moved_to(to_front ? sweep.front : sweep.back, v));
  }
  for (std::size_t i = 0; i < moves_.size(); ++i) mesh_.move_vertex(moves_[i], targets_[i]);
}

// ---------------------------------------------------------------------- 3.4 Split the vertices

void CrollCutter::split(const Sweep& sweep) {
  faces_.clear();
  for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
    if (!mesh_.alive(t) || side_[t] <= 0) continue;
    for (int f = 0; f < 4; ++f) {
      const TetId other = mesh_.neighbor(t, f);
      if (other == kNone || side_[other] >= 0) continue;
      const auto face = mesh_.face_vertices(half_face(t, f));
      if (moved_[face[0]] == 0 || moved_[face[1]] == 0 || moved_[face[2]] == 0) continue;
      faces_.push_back(half_face(t, f));
      counts_.cut_area += 0.5 * length(mesh_.twice_area(half_face(t, f)));
      for (VertexId v : face) {
        const double off = std::abs(sweep.cut.distance(mesh_.position(v)));
        const double h = mesh_.local_h(v);
        if (h > 0) counts_.max_deviation_h = std::max(counts_.max_deviation_h, off / h);
      }
    }
  }
  counts_.cut_faces += mesh_.open_faces(faces_);
}

// ---------------------------------------------------------------------- 3.5 Remove degenerate tetrahedra

void CrollCutter::remove_flat() {
  // The copies that the split made were moved as their originals were: those have the lower ids.
  const VertexId originals = static_cast<VertexId>(moved_.size());
  const TetId slots = mesh_.tet_slots();
  const auto was_moved = [&](VertexId v) { return v >= originals || moved_[v] != 0; };
  for (TetId t = 0; t < slots; ++t) {
    if (!mesh_.alive(t)) continue;
    const auto& v = mesh_.vertices(t);
    if (!was_moved(v[0]) || !was_moved(v[1]) || !was_moved(v[2]) || !was_moved(v[3])) continue;
    mesh_.remove_tet(t);
    ++counts_.removed_tets;
  }
}

}  // namespace incise::core
