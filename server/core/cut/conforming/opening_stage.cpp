#include "server/core/cut/conforming/opening_stage.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace incise::core {

using namespace tolerance;

namespace {

// Whether the tetrahedra at a face are so large that what crosses the way between them close by its middle, for them, may be far off it.
bool reach_far(const CutContext& cut, HalfFace h) {
  const Vec3 middle = cut.mesh.face_middle(h);
  const double far_m = kChord_h / kPass * cut.h;
  return std::max(squared_length(reference_point(cut, tet_of(h)) - middle),
                  squared_length(reference_point(cut, tet_of(cut.mesh.opposite(h))) - middle)) >
         far_m * far_m;
}

}  // namespace

void OpeningStage::begin(bool may_refine) {
  phase_ = Phase::kSelect;
  may_refine_ = may_refine;
  next_ = kept_ = 0;
  faces_.clear();
  chords_.clear();
  opened_.clear();
  selected_.begin();
}

bool OpeningStage::advance(WorkBudget& budget) {
  switch (phase_) {
    case Phase::kSelect:
      if (!select(budget)) return false;
      islands_.begin();
      phase_ = chords_.empty() ? Phase::kSpare : Phase::kRefine;
      next_ = 0;
      return false;
    case Phase::kRefine:
      return refine(budget);
    case Phase::kSpare:
      if (!spare_islands(budget)) return false;
      phase_ = Phase::kOpen;
      next_ = 0;
      return false;
    case Phase::kOpen:
      return open(budget);
  }
  return true;
}

// ------------------------------------------------------------------------------------------------ which

// Scans the active tetrahedra; those that stay are compacted to the front as the scan goes.
bool OpeningStage::select(WorkBudget& budget) {
  while (next_ < active_.size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    const std::size_t i = next_++;
    active_.fetch_ahead(i);
    const TetId t = active_[i].tet;
    cut_.work += cost::kLook;
    if (!mesh_.alive(t)) continue;
    if (!active_.ripe(active_[i]) || select_faces(t)) {
      active_.keep(kept_, i);
    } else {
      active_.drop(i);
    }
  }
  active_.resize(kept_);
  return true;
}

// Returns whether one that separates has to wait for the blade to leave what is behind it.
bool OpeningStage::select_faces(TetId t) {
  bool waits = false;
  selected_.add(t);
  auto& marks = cut_.workspace.tets;
  const unsigned faces = may_separate(t) & ~unsigned{marks[t].pending};
  if (faces == 0) return false;
  for (int f = 0; f < 4; ++f) {
    const HalfFace h = half_face(t, f), o = mesh_.opposite(h);
    // From the other side it looks the same.
    if (!(faces >> f & 1) || o == kNone || selected_.has(tet_of(o))) continue;
    const Way way = separates(h);
    if (way == Way::kFree) continue;
    if (cut_.hot(mesh_.vertices(tet_of(o))[face_of(o)])) {
      waits = true;
      continue;
    }
    marks[t].pending |= static_cast<std::uint8_t>(1u << f);
    marks[tet_of(o)].pending |= static_cast<std::uint8_t>(1u << face_of(o));
    faces_.push_back(h);
    if (may_refine_ && (way == Way::kCrossedAside || reach_far(cut_, h)) && is_chord(h))
      chords_.push_back(mesh_.face_vertices(h));
  }
  return waits;
}

// Whether a face on the surface is far off it between its vertices: in an element that is large beside the bend, or beside where the sweep meets an older cut,
// whose corner it would cut off. An older cut is where it is. Nearly all faces are crossed close by their middle, and are none, unless their tetrahedra reach far.
bool OpeningStage::is_chord(HalfFace h) const {
  const auto standing =
      std::ranges::count_if(mesh_.face_vertices(h), [this](VertexId w) { return cut_.stands(w); });
  if (standing == 3 || !cut_.face_on_surface(h)) return false;
  const Vec3 middle = mesh_.face_middle(h);
  const auto is_within = [&](double reach_h) {
    cut_.work += cost::kNearby;
    return cut_.surface().is_within(middle, reach_h * cut_.h);
  };
  if (is_within(kChord_h)) return false;
  if (is_within(kChordBeside_h)) return standing == 0 && is_alone(middle);
  if (standing == 0) return true;
  std::size_t looked_at = 0;
  const bool has_other = cut_.workspace.swept.stroke_at(middle, kChord_h * cut_.h, looked_at) != 0;
  cut_.work.add(looked_at, cost::kQuadsAUnit);
  return !has_other;
}

// Whether nothing was swept near p, which is near the surface, but what is nearest to it.
bool OpeningStage::is_alone(const Vec3& p) const {
  Vec3 closest;
  std::uint32_t nearest = 0;
  cut_.work += cost::kNearby;
  if (!cut_.closest_on_surface(p, closest, nearest)) return false;
  const double travel_m = cut_.path.travel_before_m(cut_.surface()[nearest].batch);
  const double reach = kAlone_h * cut_.h;
  const Box around = Box::around({p}).widened(reach);
  std::size_t looked_at = 0;
  const bool has_other = cut_.workspace.swept.any_in(around, looked_at, [&](const SweptMemory::Quad& quad) {
    const double after_m = quad.travel_m - travel_m, before_m = -after_m - travel(quad.from, quad.to);
    if (quad.stroke == cut_.stroke && std::max(after_m, before_m) < kOwnSweep_h * cut_.h) return false;
    return quad.squared_distance(p) < reach * reach;
  });
  cut_.work.add(looked_at, cost::kQuadsAUnit);
  return !has_other;
}

// Takes back the selection, and splits the chords where they are farthest off the surface: what then crosses it is dealt with like other
// crossings.
bool OpeningStage::refine(WorkBudget& budget) {
  for (; next_ < faces_.size(); ++next_) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    const HalfFace h = faces_[next_], o = mesh_.opposite(h);
    cut_.clear_pending(h);
    cut_.clear_pending(o);
    active_.add(tet_of(h));
    active_.add(tet_of(o));
  }
  for (; next_ < faces_.size() + chords_.size(); ++next_) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    split_chord(chords_[next_ - faces_.size()]);
  }
  return true;
}

// Splits the edge that is farthest off the surface, or the next one where that leaves too flat a tetrahedron.
void OpeningStage::split_chord(const std::array<VertexId, 3>& face) {
  struct Edge {
    double off_m;
    std::size_t first;  // its first vertex, in the face
    bool operator<(const Edge& other) const {
      return off_m != other.off_m ? off_m > other.off_m : first < other.first;
    }
  };
  std::array<Edge, 3> edges;
  for (std::size_t k = 0; k < 3; ++k) {
    Vec3 closest;
    std::uint32_t triangle = 0;
    const Vec3 middle = lerp(mesh_.position(face[k]), mesh_.position(face[(k + 1) % 3]), 0.5);
    cut_.work += cost::kNearby;
    const double off_m = cut_.closest_on_surface(middle, closest, triangle) ? distance(middle, closest) : 0;
    edges[k] = {off_m, k};
  }
  std::sort(edges.begin(), edges.end());
  for (const auto& [off_m, first] : edges) {
    const VertexId a = face[first], b = face[(first + 1) % 3];
    if (off_m <= kChordEdge_h * cut_.h) return;
    if (cut_.stands(a) && cut_.stands(b)) continue;
    // Another chord may have been split there.
    const TetId t = mesh_.find_edge(a, b);
    cut_.work += cost::kFindEdge;
    if (t == kNone) return;
    if (cut_.worst_after_split(t, a, b, 0.5, kSnapFloor) > kSnapFloor) continue;
    editor_.split(t, a, b, 0.5, MeshEditor::NewVertex::kInBend);
    return;
  }
}

// The faces of t that may separate: those with all vertices on the surface, or put on what was swept before, or one at which a crossing could not
// be dealt with. Bit f: face f.
unsigned OpeningStage::may_separate(TetId t) const {
  const auto& v = mesh_.vertices(t);
  unsigned off = 0, failed = 0;
  for (unsigned i = 0; i < 4; ++i) {
    off |= (cut_.was_on_surface(v[i]) ? 0u : 1u) << i;
    failed |= (cut_.failed(v[i]) ? 1u : 0u) << i;
  }
  if (failed == 0 && (off & (off - 1)) != 0) return 0;
  unsigned faces = 0;
  for (unsigned f = 0; f < 4; ++f) {
    const unsigned others = 0xfu & ~(1u << f);
    faces |= ((off & others) == 0 || (failed & others) != 0 ? 1u : 0u) << f;
  }
  return faces;
}

// Whether the surface separates the two tetrahedra at an interior face, so that it has to open: whether it crosses the
// way from one reference point to the other. Any choice of ways, one for each face, separates what the surface
// separates. A face on the surface is passed close by its middle, so that none opens beyond the rim; another one by its
// own vertices off the surface, and only where a crossing near it could not be dealt with: better ragged than a bridge. A face larger than the blade
// has some of its vertices where this sweep has not been: what all sweeps together have swept separates its sides.
OpeningStage::Way OpeningStage::separates(HalfFace h) const {
  const TetId a = tet_of(h), b = tet_of(mesh_.opposite(h));
  Vec3 middle{}, off{};
  int off_count = 0;
  bool all_on = true;
  for (VertexId v : mesh_.face_vertices(h)) {
    middle += (1.0 / 3.0) * mesh_.position(v);
    all_on = all_on && cut_.on_surface(v);
    if (cut_.was_on_surface(v)) continue;
    off += mesh_.position(v);
    ++off_count;
  }
  const Vec3 from = reference_point(cut_, a), to = reference_point(cut_, b);
  if (off_count > 0) {
    const Vec3 by = (1.0 / off_count) * off;
    return way_along({from, by, by, to});
  }
  if (all_on) return way_along({from, lerp(middle, from, kPass), lerp(middle, to, kPass), to});
  return was_swept_across(middle, from, to) && lies_in_what_was_swept(h) ? Way::kCrossedHere : Way::kFree;
}

// Whether a blade has gone across the way from one reference point to the other, close by the middle of the face.
bool OpeningStage::was_swept_across(const Vec3& middle, const Vec3& from, const Vec3& to) const {
  const auto close_by = [&](const Vec3& end) {
    return lerp(middle, end, std::max(kPass, std::min(1.0, kChord_h * cut_.h / distance(middle, end))));
  };
  std::size_t looked_at = 0;
  const bool crossed = cut_.workspace.swept.crosses(close_by(from), close_by(to), looked_at);
  cut_.work.add(looked_at, cost::kQuadsAUnit);
  return crossed;
}

// Whether those of its vertices are there that this sweep has not put where they are: they may have been moved since.
bool OpeningStage::lies_in_what_was_swept(HalfFace h) const {
  return std::ranges::all_of(mesh_.face_vertices(h), [this](VertexId v) {
    if (cut_.on_surface(v)) return true;
    std::size_t looked_at = 0;
    const bool lies =
        cut_.workspace.swept.stroke_at(mesh_.position(v), kLiesInSwept_h * cut_.h, looked_at) != 0;
    cut_.work.add(looked_at, cost::kQuadsAUnit);
    return lies;
  });
}

// Where the surface crosses a way of three parts: in the middle one, if it does so there. All are looked at together.
OpeningStage::Way OpeningStage::way_along(const std::array<Vec3, 4>& way) const {
  bool here = false, aside = false;
  const FourPoints points(way);
  const double clear_m = cut_.clear_m;
  cut_.work += cost::kFindCrossing;
  cut_.surface().any_between(points, clear_m, [&](std::uint32_t i) {
    const SweptTriangle& triangle = cut_.surface()[i];
    double off[4], at;
    points.along(triangle.normal, triangle.offset, off);
    const auto crossed = [&](std::size_t k) {
      return crosses(way[k], way[k + 1], off[k], off[k + 1], triangle, clear_m, at);
    };
    here = crossed(1);
    aside = aside || crossed(0) || crossed(2);
    return here;
  });
  return here ? Way::kCrossedHere : aside ? Way::kCrossedAside : Way::kFree;
}

bool OpeningStage::spare_islands(WorkBudget& budget) {
  while (next_ < faces_.size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    const HalfFace h = faces_[next_++];
    islands_.spare(h);
    islands_.spare(mesh_.opposite(h));
    if (next_ == faces_.size() && islands_.look_again()) next_ = 0;
  }
  std::erase_if(faces_, [this](HalfFace h) { return !cut_.is_pending(h); });
  return true;
}

// ------------------------------------------------------------------------------------------------ opening

bool OpeningStage::open(WorkBudget& budget) {
  while (next_ < faces_.size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    const std::size_t end = std::min(next_ + kOpenChunk, faces_.size());
    for (std::size_t i = next_; i < end; ++i) {
      opened_.push_back(faces_[i]);
      opened_.push_back(mesh_.opposite(faces_[i]));
    }
    for (std::size_t i = end; i < std::min(end + kOpenChunk, faces_.size()); ++i) {
      const TetId one = tet_of(faces_[i]), other = tet_of(mesh_.opposite(faces_[i]));
      mesh_.prefetch_to_change(one);
      mesh_.prefetch_to_change(other);
      __builtin_prefetch(&cut_.workspace.tets[one]);
      __builtin_prefetch(&cut_.workspace.tets[other]);
      for (VertexId v : mesh_.face_vertices(faces_[i])) mesh_.prefetch_star(v);
    }
    editor_.open(std::span<const HalfFace>(faces_.data() + next_, end - next_));
    next_ = end;
  }
  return true;
}

}  // namespace incise::core
