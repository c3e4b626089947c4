#include "server/core/cut/conforming/search_stage.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

namespace incise::core {

using namespace tolerance;

namespace {

// So many tetrahedra ahead of the search memory is fetched.
constexpr std::size_t kAhead = 8;

}  // namespace

void SearchStage::begin() {
  searched_.begin();
  queue_.clear();
  queue_next_ = 0;
  candidates_.clear();
  next_candidate_ = 0;
  plane_ = find_plane();
  // Where nothing new was swept there is nothing to find, but for the rim at the stroke's end.
  const bool sweeps = cut_.surface().size() > cut_.path.first_latest();
  go(sweeps || !cut_.has_front ? Phase::kActive : Phase::kRim, 0);
}

bool SearchStage::advance(WorkBudget& budget) {
  switch (phase_) {
    case Phase::kActive:
      from_active(budget);
      return false;
    case Phase::kLines:
      from_lines(budget);
      return false;
    case Phase::kBoundary:
      from_boundary(budget);
      return false;
    case Phase::kInside:
      from_inside();
      return false;
    case Phase::kSpread:
      spread(budget);
      return false;
    case Phase::kRim:
      return end_of_rim(budget);
  }
  return true;
}

void SearchStage::from_active(WorkBudget& budget) {
  while (next_ < active_.size() && work_left(budget)) enqueue(active_[next_++].tet);
  if (next_ < active_.size()) return;
  go(Phase::kLines, 0);
}

// Lines that are known to be rims only now, and the stroke's last one; all that is near them is still active.
void SearchStage::from_lines(WorkBudget& budget) {
  const auto turns = cut_.path.late_turns();
  const std::size_t count = active_.size(), end = (turns.size() + (cut_.has_front ? 0 : 1)) * count;
  while (next_ < end && work_left(budget)) {
    const std::size_t i = next_ / count;
    const bool turn = i < turns.size();
    const BladeLine& line = turn ? turns[i] : cut_.front;
    const TetId t = active_[next_++ % count].tet;
    if (mesh_.alive(t)) rim_.probe(t, line.heel, line.tip, turn ? Rim::kTurn : Rim::kLine);
  }
  if (next_ == end) go(Phase::kBoundary, cut_.path.first_latest());
}

void SearchStage::from_boundary(WorkBudget& budget) {
  while (work_left(budget)) {
    if (next_candidate_ < candidates_.size()) {
      enqueue(candidates_[next_candidate_++]);
    } else if (next_ < cut_.surface().size()) {
      candidates_.clear();
      next_candidate_ = 0;
      const SweptTriangle& triangle = cut_.surface()[next_++];
      cut_.workspace.grid.near(mesh_, triangle, searched_.serial(), candidates_);
      cut_.work += cost::kGridCells;
      cut_.work.add(candidates_.size(), cost::kGridEntriesAUnit);
    } else {
      go(Phase::kInside, 0);
      return;
    }
  }
}

// A sweep that meets no boundary: all of it is inside the tissue, or all of it outside.
void SearchStage::from_inside() {
  const SweptSurface& surface = cut_.surface();
  if (queue_.empty() && surface.size() > cut_.path.first_latest()) {
    const auto& c = surface[surface.size() - 1].corners;
    std::int64_t looked_at = 0;
    const TetId t = cut_.workspace.grid.locate(mesh_, (1.0 / 3.0) * (c[0] + c[1] + c[2]), &looked_at);
    if (t != kNone) {
      searched_.add(t);
      queue_.push_back(t);
    }
    cut_.work += cost::kLocate + looked_at;
  }
  go(Phase::kSpread, 0);
}

void SearchStage::spread(WorkBudget& budget) {
  while (queue_next_ < queue_.size()) {
    if (!work_left(budget)) return;
    const TetId t = queue_[queue_next_++];
    // What lies beside those that come next is in no cache, as a rule.
    if (queue_next_ + kAhead < queue_.size()) {
      for (int f = 0; f < 4; ++f) {
        const HalfFace beyond = mesh_.opposite(half_face(queue_[queue_next_ + kAhead], f));
        const HalfFace beside = mesh_.opposite(half_face(queue_[queue_next_ + kAhead / 2], f));
        if (beyond != kNone) {
          __builtin_prefetch(&cut_.workspace.tets[tet_of(beyond)]);
          __builtin_prefetch(&mesh_.vertices(tet_of(beyond)));
        }
        if (beside != kNone)
          __builtin_prefetch(&mesh_.position(mesh_.vertices(tet_of(beside))[face_of(beside)]));
      }
    }
    active_.add(t);
    // What it opens itself it leaves behind.
    cut_.meets_cut = cut_.meets_cut || mesh_.cut_mask(t) != 0;
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(t, f);
      if (n != kNone) enqueue(n);
    }
  }
  go(Phase::kRim, 0);
}

bool SearchStage::end_of_rim(WorkBudget& budget) {
  while (!cut_.has_front && next_ < queue_.size()) {
    if (!work_left(budget)) return false;
    rim_.probe(queue_[next_++], cut_.front.heel, cut_.front.tip, Rim::kLine);
  }
  return true;
}

void SearchStage::enqueue(TetId t) {
  if (!searched_.insert(t)) return;
  cut_.work += cost::kProbe;
  if (mesh_.alive(t) && probe(t)) queue_.push_back(t);
}

// Whether the tetrahedron meets what this batch has swept, to within what the flood needs: it may say yes to one
// that passes close by a corner of a triangle. Adds the crossings of its edges.
bool SearchStage::probe(TetId t) {
  const auto& v = mesh_.vertices(t);
  const FourPoints p(
      {mesh_.position(v[0]), mesh_.position(v[1]), mesh_.position(v[2]), mesh_.position(v[3])});
  const double slack_m = (mesh_.cut_mask(t) != 0 ? kOne_h : kLies_h) * cut_.h;
  if (plane_ != nullptr) {
    const Meets known = probe_plane(t, p, slack_m);
    if (known != Meets::kUnsure) return known == Meets::kYes;
  }
  bool meets = false;
  cut_.surface().any_latest_between(p, slack_m, [&](std::uint32_t index) {
    meets = probe_triangle(t, p, slack_m, index) || meets;
    return false;
  });
  return meets;
}

const SweptTriangle* SearchStage::find_plane() const {
  const SweptSurface& surface = cut_.surface();
  const SweptTriangle* const plane = surface.flat(0.5 * cut_.clear_m);
  if (plane == nullptr) return nullptr;
  for (std::size_t i = cut_.path.first_latest(); i < surface.size(); ++i) {
    if ((surface[i].rim & (SweptTriangle::kRims | SweptTriangle::kTurns)) != 0) return nullptr;
  }
  return plane;
}

// The same in the midst of a flat sweep: nearly all tetrahedra there are crossed clearly or not at all, and what crosses their edges is known from others.
SearchStage::Meets SearchStage::probe_plane(TetId t, const FourPoints& p, double slack_m) {
  double off[4];
  p.along(plane_->normal, plane_->offset, off);
  if (FourPoints::nearest(off) <= slack_m + cut_.clear_m) return Meets::kUnsure;
  const auto& v = mesh_.vertices(t);
  unsigned edges = kEdgesAcross[FourPoints::from(off, 0)];
  if (edges == 0) return Meets::kNo;
  for (; edges != 0; edges &= edges - 1) {
    const auto& edge = kEdgeVertices[std::countr_zero(edges)];
    const VertexId a = v[edge[0]], b = v[edge[1]];
    if (!crossings_.is_inside(a, b) && !find_inside(t, a, b)) return Meets::kUnsure;
  }
  return Meets::kYes;
}

// Adds the crossing of an edge that crosses the plane, if it is clearly amid a triangle, and beside those before it.
bool SearchStage::find_inside(TetId t, VertexId a, VertexId b) {
  const Vec3 &p = mesh_.position(a), &q = mesh_.position(b);
  const double clear = 2 * cut_.clear_m;
  bool inside = false;
  cut_.surface().any_latest_between(Points<2>({p, q}), clear, [&](std::uint32_t index) {
    const SweptTriangle& triangle = cut_.surface()[index];
    const double p_off = triangle.signed_distance(p), q_off = triangle.signed_distance(q);
    const double at = p_off / (p_off - q_off);
    double least = INFINITY;
    for (std::size_t k = 0; k < 3; ++k) {
      const double from = dot(triangle.inward[k], p) - triangle.inward_offset[k];
      const double to = dot(triangle.inward[k], q) - triangle.inward_offset[k];
      least = std::min(least, from + at * (to - from));
    }
    if (least < -clear) return false;
    inside = least > clear;
    if (inside) crossings_.add(a, b, t, index, at, true);
    return true;
  });
  return inside;
}

// How far the corners of a tetrahedron are above the plane of a swept triangle, and inside each of its sides.
struct SearchStage::Beside {
  double off[4], inside[3][4];
};

// Where the sweep's rim, and where it turns, may pass through the tetrahedron.
void SearchStage::probe_rims(TetId t, const SweptTriangle& triangle, const Beside& at) {
  const unsigned turns = (triangle.rim & SweptTriangle::kTurns) != 0 ? 1 : 0, sides = triangle.rim | turns;
  if ((sides & 7) == 0 || FourPoints::least(at.off) > cut_.clear_m ||
      FourPoints::most(at.off) < -cut_.clear_m)
    return;
  for (int k = 0; k < 3; ++k) {
    // All of it may be on one side of the line through the triangle's side.
    if ((sides >> k & 1) == 0 || FourPoints::least(at.inside[k]) > cut_.clear_m) continue;
    const Rim rim = k > 0 ? Rim::kWay : turns != 0 ? Rim::kTurn : Rim::kLine;
    rim_.probe(t, triangle.corners[k], triangle.corners[(k + 1) % 3], rim);
  }
}

// Vertices that lie in the sweep already, since no edge crosses there, and those of an older cut's faces that run along it so near
// that they are one with it.
void SearchStage::note_standing(TetId t, const SweptTriangle& triangle, const Beside& at, double reach_m) {
  const auto& v = mesh_.vertices(t);
  const unsigned cut_faces = mesh_.cut_mask(t);
  for (int i = 0; i < 4; ++i) {
    const double off_m = std::abs(at.off[i]);
    const bool over =
        std::ranges::all_of(at.inside, [&](const auto& inside) { return inside[i] >= -cut_.clear_m; });
    if (off_m > reach_m || !over || cut_.on_surface(v[i])) continue;
    bool stands = off_m <= (cut_faces != 0 ? kLiesAtCut_h : kLies_h) * cut_.h;
    // Around a crossing that this stroke could not deal with, faces open off its own surface.
    for (int f = 0; f < 4 && cut_faces != 0 && !stands && !cut_.failed(v[i]); ++f) {
      if (f == i || !(cut_faces >> f & 1)) continue;
      const Vec3 n = mesh_.twice_area(half_face(t, f));
      const double along = dot(n, triangle.normal);
      stands = along * along > kCosAlong * kCosAlong * squared_length(n);
    }
    if (stands && (cut_faces & ~(1u << i)) != 0) cut_.workspace.vertices[v[i]].stands = cut_.stroke;
    if (stands) editor_.stand(v[i]);
  }
}

bool SearchStage::probe_triangle(TetId t, const FourPoints& p, double slack_m, std::uint32_t index) {
  const auto& v = mesh_.vertices(t);
  const SweptTriangle& triangle = cut_.surface()[index];
  const double clear = cut_.clear_m;
  Beside beside;
  for (int k = 0; k < 3; ++k) {
    p.along(triangle.inward[k], triangle.inward_offset[k], beside.inside[k]);
    // Most of what lies behind the blade.
    if (FourPoints::most(beside.inside[k]) < -clear) return false;
  }
  p.along(triangle.normal, triangle.offset, beside.off);
  probe_rims(t, triangle, beside);
  const double(&d)[4] = beside.off;
  if (FourPoints::nearest(d) <= slack_m) note_standing(t, triangle, beside, slack_m);
  unsigned edges = kEdgesAcross[FourPoints::from(d, 0)];
  if (edges == 0) return false;
  // It misses the triangle if all places where its edges cross the plane are outside one side. That is for what reaches with its corners over the line
  // that the sweep went on from, where its section with the plane does not.
  int ends[4][2], count = 0;
  double at[4], least[4];  // where on the edge, and how far inside the nearest side
  for (; edges != 0; edges &= edges - 1, ++count) {
    const int i = kEdgeVertices[std::countr_zero(edges)][0], j = kEdgeVertices[std::countr_zero(edges)][1];
    ends[count][0] = i;
    ends[count][1] = j;
    at[count] = d[i] / (d[i] - d[j]);
    least[count] = INFINITY;
  }
  bool passes_beside = false;
  for (const auto& inside : beside.inside) {
    // Where all corners are inside, so are all places between them.
    if (FourPoints::least(inside) > 2 * clear) continue;
    double most = -INFINITY;
    for (int e = 0; e < count; ++e) {
      const double from = inside[ends[e][0]], x = from + at[e] * (inside[ends[e][1]] - from);
      least[e] = std::min(least[e], x);
      most = std::max(most, x);
    }
    if (most < -clear) return false;
    passes_beside = passes_beside || most < 0;
  }
  for (int e = 0; e < count; ++e) {
    if (least[e] < -clear) continue;
    const int i = ends[e][0], j = ends[e][1];
    if ((cut_.on_surface(v[i]) && std::abs(d[i]) <= clear) ||
        (cut_.on_surface(v[j]) && std::abs(d[j]) <= clear))
      continue;
    const bool sure = least[e] > clear && std::abs(d[i]) > clear && std::abs(d[j]) > clear;
    if (sure || crosses(mesh_.position(v[i]), mesh_.position(v[j]), triangle))
      crossings_.add(v[i], v[j], t, index, at[e]);
  }
  return !passes_beside;
}

}  // namespace incise::core
