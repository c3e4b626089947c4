#include "server/core/cut/conforming/conforming_cutter.hpp"

#include <algorithm>
#include <cmath>

#include "server/base/check.hpp"
#include "server/core/mesh/validate.hpp"

namespace incise::core {
namespace {

// A crossing this near to an end that is on the surface already, by the edge's length, is that vertex.
constexpr double kAtVertex = 0.25;
// A tetrahedron with all vertices on the surface and at most this thick, in h, is flat.
constexpr double kFlat_h = 0.03;
// And its barycentre is this near to the surface, in h.
constexpr double kFlatOff_h = 0.1;
// A vertex of a boundary along the surface, this near to it, in h, may stay and stand for it.
constexpr double kStay_h = 0.08;
// A rim vertex this near to where the rim pierces a face, by the local mesh width, stands for it.
constexpr double kRim_h = 0.5;
// Where exactness is preferred, an edge that is crossed farther from its ends than this, by its length, is split.
constexpr double kExactNear = 0.05;
// Tetrahedra to prefetch: what is active as a rule, and some layers around it. 30 us.
constexpr std::size_t kMostPrefetched = 1024;
// How far from the blade's line, by the local edge length, a vertex waits.
constexpr double kHot = 1.5;

}  // namespace

ConformingCutter::ConformingCutter(TetMesh& mesh, CutWorkspace& workspace, const CutConfig& config)
    : mesh_(mesh),
      workspace_(workspace),
      config_(config),
      h_(mesh.mean_edge_length()),
      clear_(1e-6 * mesh.mean_edge_length()) {
  retraced_.reserve(kMostRetraced);
  prefetched_.reserve(kMostPrefetched);
}

void ConformingCutter::begin(const Batch& batch) {
  INCISE_CHECK(phase_ == Phase::kIdle);
  counts_ = {};
  if (batch.stroke != stroke_) {
    stroke_ = batch.stroke;
    heading_ = {};
    events_.clear();
    rim_events_.clear();
    surface_.clear();
    active_.clear();
    swept_.clear();
    retraced_.clear();
    travel_ = widest_ = 0;
  }
  batch_ = batch.number;
  swept_.push_back({batch_, travel_});

  first_latest_ = surface_.size();
  // Cells somewhat larger than tetrahedra, and flat to within the tolerance.
  const double cell_m = 4 * h_;
  const double blade_m = distance(batch.lines[0].heel, batch.lines[0].tip);
  const int columns = static_cast<int>(std::clamp(std::ceil(blade_m / cell_m), 1.0, 256.0));
  const auto sweep = [&](const BladeLine& from, const BladeLine& to) {
    const double travel_m = travel(from, to);
    const double twist_m = length((to.tip - to.heel) - (from.tip - from.heel));
    const double rows =
        std::max(travel_m / cell_m, 0.25 * twist_m / (columns * config_.chord_tolerance_h * h_));
    surface_.add_quad(from, to, static_cast<int>(std::clamp(std::ceil(rows), 1.0, 1024.0)), columns, batch_,
                      turns_sharply(from, to), workspace_.grid.low(), workspace_.grid.high());
  };
  const auto sweep_retraced = [&] {
    for (std::size_t k = 0; k + 1 < retraced_.size(); ++k) sweep(retraced_[k], retraced_[k + 1]);
    retraced_.clear();
  };
  for (std::size_t i = 0; i + 1 < batch.lines.size(); ++i) {
    const BladeLine &from = batch.lines[i], &to = batch.lines[i + 1];
    travel_ += travel(from, to);
    if (!retrace(from, to)) {
      sweep_retraced();
      sweep(from, to);
    }
  }
  if (batch.ends_stroke) sweep_retraced();
  forget_surface();
  oldest_ = swept_.front().batch;
  surface_.build(first_latest_);
  front_ = batch.lines.back();
  has_front_ = !batch.ends_stroke;
  changed_.clear();
  next_changed_ = 0;
  collection_ = ++workspace_.serial;
  for (std::uint32_t e = 0; e < events_.size(); ++e) {
    const VertexId a = events_[e].a;
    events_[e].next =
        workspace_.vertices[a].event_stamp == collection_ ? workspace_.vertices[a].event_head : kNone;
    workspace_.vertices[a].event_stamp = collection_;
    workspace_.vertices[a].event_head = e;
  }
  work_ += static_cast<std::int64_t>(surface_.size() / 4 + events_.size() / 8 + active_.size() / 16);
  search_ = ++workspace_.serial;
  queue_.clear();
  queue_next_ = 0;
  candidates_.clear();
  next_candidate_ = 0;
  seed_ = Seed::kActive;
  next_seed_ = 0;
  phase_ = Phase::kSeed;
}

// Drops the triangles that nothing active can need any more. What becomes active now, by a split or a flip, may reach some
// edge lengths farther back than what has been so for longest.
void ConformingCutter::forget_surface() {
  constexpr double kBehind = 8;
  double oldest = swept_.back().travel;
  for (const Active& a : active_) oldest = std::min(oldest, a.since);
  const double limit = oldest - kBehind * widest_;
  std::size_t first = 0;
  while (first + 1 < swept_.size() && swept_[first + 1].travel <= limit) ++first;
  if (first == 0) return;
  swept_.erase(swept_.begin(), swept_.begin() + static_cast<std::ptrdiff_t>(first));
  first_latest_ -= surface_.drop_before(swept_.front().batch);
}

// A blade that trembles in place, or goes back in its own cut, sweeps again what it has swept: where the surface covers all
// between the two lines to within the tolerance, that is left out, or the surface would grow for as long as it goes on.
// What leads to a line that lies straight above or below the surface throughout is left out for good, for what follows
// overlaps there; what comes after the last such line is swept if the blade leaves the surface from there: no gap is left.
bool ConformingCutter::retrace(const BladeLine& from, const BladeLine& to) {
  constexpr double kTolerance_h = 0.05;
  // In a body that deforms, other tissue may have come to where the blade has been.
  if (mesh_.deformed() || retraced_.size() == kMostRetraced) return false;
  const double reach = kTolerance_h * h_;
  const double travel_m = travel(from, to);
  const int rows = static_cast<int>(std::clamp(std::ceil(travel_m / reach), 1.0, 16.0));
  const int columns = static_cast<int>(std::clamp(std::ceil(distance(to.heel, to.tip) / h_), 1.0, 1024.0));
  const Vec3 low = workspace_.grid.low(), high = workspace_.grid.high();
  bool over = true;
  for (int row = rows; row > 0; --row) {
    const Vec3 heel = lerp(from.heel, to.heel, static_cast<double>(row) / rows);
    const Vec3 tip = lerp(from.tip, to.tip, static_cast<double>(row) / rows);
    for (int column = 0; column <= columns; ++column) {
      const Vec3 p = lerp(heel, tip, static_cast<double>(column) / columns);
      if (p.x < low.x || p.y < low.y || p.z < low.z || p.x > high.x || p.y > high.y || p.z > high.z) continue;
      Vec3 closest;
      std::uint32_t triangle = 0;
      work_ += 1;
      if (!surface_.closest(p, reach, closest, triangle)) return false;
      const double off = surface_[triangle].signed_distance(p);
      over = over && (row < rows || squared_length(p - closest) - off * off <= clear_ * clear_);
    }
  }
  if (over) {
    retraced_.clear();
  } else if (retraced_.empty()) {
    retraced_.push_back(from);
  }
  retraced_.push_back(to);
  return true;
}

// Whether the sweep begins or bends sharply at the line `from`: that line has to be met as exactly as a rim.
bool ConformingCutter::turns_sharply(const BladeLine& from, const BladeLine& to) {
  constexpr double kSharp =
      0.9;  // cosine of some 26 degrees, all turns since the last sharp one taken together
  const Vec3 motion = 0.5 * ((to.heel - from.heel) + (to.tip - from.tip));
  const Vec3 normal = normalized(cross(from.tip - from.heel, motion));
  const bool begins = squared_length(heading_) == 0;
  if (squared_length(normal) == 0) return begins;
  // Straight back is no bend: the surface lies on itself.
  if (!begins && std::abs(dot(normal, heading_)) > kSharp) return false;
  heading_ = normal;
  return true;
}

bool ConformingCutter::advance(WorkBudget& budget) {
  while (phase_ != Phase::kIdle) {
    charge(budget);
    if (budget.spent()) return false;
    switch (phase_) {
      case Phase::kSeed:
        seed(budget);
        break;
      case Phase::kSearch:
        search(budget);
        break;
      case Phase::kRim:
        work_rim(budget);
        break;
      case Phase::kOrder:
        order(budget);
        break;
      case Phase::kEvents:
        work_events(budget);
        break;
      case Phase::kRepair:
        repair(budget);
        break;
      case Phase::kVerify:
        verify(budget);
        break;
      case Phase::kSelect:
        select(budget);
        break;
      case Phase::kSpare:
        spare_islands(budget);
        break;
      case Phase::kOpen:
        open(budget);
        break;
      case Phase::kIdle:
        break;
    }
  }
  charge(budget);
  return true;
}

void ConformingCutter::prefetch() {
  prefetched_.clear();
  // The last ones are nearest to the blade.
  for (std::size_t i = active_.size(); i > 0 && prefetched_.size() < kMostPrefetched; --i) {
    if (mesh_.alive(active_[i - 1].tet)) prefetched_.push_back(active_[i - 1].tet);
  }
  mesh_.prefetch_around(prefetched_, kMostPrefetched);
  for (TetId t : prefetched_) {
    __builtin_prefetch(&workspace_.tets[t]);
    for (VertexId v : mesh_.vertices(t)) __builtin_prefetch(&workspace_.vertices[v]);
  }
}

// ------------------------------------------------------------------------------------------------ search

void ConformingCutter::activate(TetId t) {
  if (workspace_.tets[t].active == stroke_) return;
  workspace_.tets[t].active = stroke_;
  active_.push_back({t, swept_.back().travel, 0});
  for (VertexId v : mesh_.vertices(t)) widest_ = std::max(widest_, mesh_.local_h(v));
}

// A crossing at v could not be dealt with: ragged faces may open around it.
void ConformingCutter::fail(VertexId v) {
  if (workspace_.vertices[v].failed == stroke_) return;
  workspace_.vertices[v].failed = stroke_;
  mesh_.star(v, star_ids_);
  work_ += static_cast<std::int64_t>(star_ids_.size());
  for (std::uint32_t corner : star_ids_) activate(corner >> 2);
}

// v was moved: the surface may cross other edges of its tetrahedra now, and which side of it they are on may be another.
// That matters where ragged faces open.
void ConformingCutter::judge_again(const VertexStar& star, VertexId v) {
  const auto failed = [this](VertexId w) { return workspace_.vertices[w].failed == stroke_; };
  const bool at_v = failed(v);
  for (const VertexStar::Corner& c : star.corners()) {
    look_again(c.tet);
    if (at_v || std::ranges::any_of(c.others, failed)) activate(c.tet);
  }
}

void ConformingCutter::enqueue(TetId t) {
  if (workspace_.tets[t].seen == search_) return;
  workspace_.tets[t].seen = search_;
  work_ += 3;
  if (mesh_.alive(t) && probe(t)) queue_.push_back(t);
}

void ConformingCutter::add_event(VertexId a, VertexId b, TetId t, std::uint32_t triangle, double at) {
  if (b < a) {
    std::swap(a, b);
    at = 1 - at;
  }
  if (workspace_.vertices[a].event_stamp != collection_) {
    workspace_.vertices[a].event_stamp = collection_;
    workspace_.vertices[a].event_head = kNone;
  }
  for (std::uint32_t e = workspace_.vertices[a].event_head; e != kNone; e = events_[e].next) {
    if (events_[e].b == b) return;
  }
  events_.push_back(
      {std::min(at, 1 - at), at, a, b, t, triangle, workspace_.vertices[a].event_head, batch_, false});
  workspace_.vertices[a].event_head = static_cast<std::uint32_t>(events_.size() - 1);
}

// Whether the tetrahedron meets what this batch has swept, to within what the flood needs: it may say yes to one
// that passes close by a corner of a triangle. Adds the crossings of its edges to the events.
bool ConformingCutter::probe(TetId t) {
  const auto& v = mesh_.vertices(t);
  const FourPoints p([&](std::size_t i) { return mesh_.position(v[i]); });
  bool meets = false;
  surface_.any_latest_overlapping(p, [&](std::uint32_t index) {
    const SweptTriangle& triangle = surface_[index];
    for (int k = 0; k < 3; ++k) {
      if (triangle.rim >> k & 1) probe_rim(t, triangle.corners[k], triangle.corners[(k + 1) % 3]);
    }
    double d[4];
    p.along(triangle.normal, triangle.offset, d);
    if ((FourPoints::least(d) >= 0) || FourPoints::most(d) < 0) return false;
    // How far inside each of the triangle's edges; outside one with all corners is outside.
    double inside[3][4];
    for (int k = 0; k < 3; ++k) {
      p.along(triangle.inward[k], triangle.inward_offset[k], inside[k]);
      if (FourPoints::most(inside[k]) < -clear_) return false;
    }
    // The same for the corners of the section with the plane.
    bool beside[3] = {true, true, true};
    for (const auto& edge : kEdgeVertices) {
      const int i = edge[0], j = edge[1];
      if ((d[i] >= 0) == (d[j] >= 0)) continue;
      const double at = d[i] / (d[i] - d[j]);
      double least = INFINITY;
      for (int k = 0; k < 3; ++k) {
        const double x = inside[k][i] + at * (inside[k][j] - inside[k][i]);
        beside[k] = beside[k] && x < 0;
        least = std::min(least, x);
      }
      if (least < -clear_) continue;
      if ((on_surface(v[i]) && std::abs(d[i]) <= clear_) || (on_surface(v[j]) && std::abs(d[j]) <= clear_))
        continue;
      const bool sure = least > clear_ && std::abs(d[i]) > clear_ && std::abs(d[j]) > clear_;
      if (sure || crosses(mesh_.position(v[i]), mesh_.position(v[j]), triangle))
        add_event(v[i], v[j], t, index, at);
    }
    meets = meets || !(beside[0] || beside[1] || beside[2]);
    return false;
  });
  return meets;
}

// Where the flood begins: at the tetrahedra that are active, and at the boundary near what this batch has swept.
void ConformingCutter::seed(WorkBudget& budget) {
  const auto work_left = [&] {
    charge(budget);
    return !budget.spent();
  };
  switch (seed_) {
    case Seed::kActive:
      while (next_seed_ < active_.size() && work_left()) enqueue(active_[next_seed_++].tet);
      if (next_seed_ < active_.size()) return;
      seed_ = has_front_ ? Seed::kBoundary : Seed::kLastLine;
      next_seed_ = has_front_ ? first_latest_ : 0;
      break;
    case Seed::kLastLine:
      // The stroke's last line is a rim, too; all that is near it is still active.
      while (next_seed_ < active_.size() && work_left()) {
        const TetId t = active_[next_seed_++].tet;
        if (mesh_.alive(t)) probe_rim(t, front_.heel, front_.tip);
      }
      if (next_seed_ < active_.size()) return;
      seed_ = Seed::kBoundary;
      next_seed_ = first_latest_;
      break;
    case Seed::kBoundary:
      while (work_left()) {
        if (next_candidate_ < candidates_.size()) {
          enqueue(candidates_[next_candidate_++]);
        } else if (next_seed_ < surface_.size()) {
          candidates_.clear();
          next_candidate_ = 0;
          const SweptTriangle& triangle = surface_[next_seed_++];
          workspace_.grid.near(mesh_, triangle, search_, candidates_);
          work_ += 10 + static_cast<std::int64_t>(candidates_.size() / 8);
        } else {
          seed_ = Seed::kInside;
          break;
        }
      }
      break;
    case Seed::kInside:
      if (queue_.empty() && surface_.size() > first_latest_) {
        // The sweep meets no boundary: all of it is inside the tissue, or all of it outside.
        const auto& c = surface_[surface_.size() - 1].corners;
        const TetId t = workspace_.grid.locate(mesh_, (1.0 / 3.0) * (c[0] + c[1] + c[2]), &work_);
        if (t != kNone) {
          workspace_.tets[t].seen = search_;
          queue_.push_back(t);
        }
        work_ += 50;
      }
      next_seed_ = 0;
      phase_ = Phase::kSearch;
      break;
  }
}

void ConformingCutter::search(WorkBudget& budget) {
  while (queue_next_ < queue_.size()) {
    charge(budget);
    if (budget.spent()) return;
    const TetId t = queue_[queue_next_++];
    activate(t);
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(t, f);
      if (n != kNone) enqueue(n);
    }
  }
  while (!has_front_ && next_seed_ < queue_.size()) {
    charge(budget);
    if (budget.spent()) return;
    probe_rim(queue_[next_seed_++], front_.heel, front_.tip);
  }
  round_ = 0;
  next_rim_ = 0;
  phase_ = Phase::kRim;
}

// ------------------------------------------------------------------------------------------------ the rim

// Whether v is the rim's vertex where the rim pierces a face of v's at `point`.
bool ConformingCutter::stands_for(VertexId v, const Vec3& point) const {
  return on_rim(v) && distance(mesh_.position(v), point) < kRim_h * mesh_.local_h(v);
}

// Adds the faces of t that the stretch of the rim pierces.
void ConformingCutter::probe_rim(TetId t, const Vec3& from, const Vec3& to) {
  work_ += 1;
  for (int f = 0; f < 4; ++f) {
    const auto face = mesh_.face_vertices(half_face(t, f));
    const Vec3 &a = mesh_.position(face[0]), &b = mesh_.position(face[1]), &c = mesh_.position(face[2]);
    const Vec3 normal = cross(b - a, c - a);
    const double above = dot(normal, from - a), below = dot(normal, to - a);
    if ((above >= 0) == (below >= 0)) continue;
    const Vec3 x = lerp(from, to, above / (above - below));
    if (dot(cross(b - a, x - a), normal) < 0 || dot(cross(c - b, x - b), normal) < 0 ||
        dot(cross(a - c, x - c), normal) < 0) {
      continue;
    }
    if (stands_for(face[0], x) || stands_for(face[1], x) || stands_for(face[2], x)) continue;
    rim_events_.push_back({t, face, x, from, to, false, false});
  }
}

void ConformingCutter::work_rim(WorkBudget& budget) {
  while (next_rim_ < rim_events_.size()) {
    charge(budget);
    if (budget.spent()) return;
    work_ += 1;
    const std::size_t i = next_rim_++;
    const RimEvent event = rim_events_[i];
    if (hot(event.face[0]) || hot(event.face[1]) || hot(event.face[2])) continue;
    rim_events_[i].done = true;
    handle(event);
    if (event.again) continue;
    // Other events here may have changed the faces that the rim pierces: look once more.
    const std::size_t first = rim_events_.size();
    for (VertexId v : event.face) {
      mesh_.star(v, star_ids_);
      for (std::uint32_t corner : star_ids_) probe_rim(corner >> 2, event.from, event.to);
    }
    for (std::size_t k = first; k < rim_events_.size(); ++k) rim_events_[k].again = true;
  }
  std::erase_if(rim_events_, [](const RimEvent& e) { return e.done; });
  begin_order();
}

// Puts a vertex of the pierced face on the rim, where it is pierced or nearer.
void ConformingCutter::handle(const RimEvent& event) {
  if (!mesh_.alive(event.tet)) return;
  for (VertexId v : event.face) {
    if (mesh_.local_index(event.tet, v) < 0) return;
  }
  std::array<VertexId, 3> nearest = event.face;
  std::sort(nearest.begin(), nearest.end(), [&](VertexId v, VertexId w) {
    const double dv = squared_length(mesh_.position(v) - event.point);
    const double dw = squared_length(mesh_.position(w) - event.point);
    return dv != dw ? dv < dw : v < w;
  });
  for (VertexId v : nearest) {
    if (stands_for(v, event.point)) return;
  }
  const Vec3 direction = normalized(event.to - event.from);
  const double length_m = distance(event.from, event.to);
  const auto put = [&](VertexId v, double limit) {
    gather(star_, v);
    const double middle = dot(star_.position() - event.from, direction);
    const double pierced = dot(event.point - event.from, direction);
    const double h = star_.local_h();
    for (const double along : {middle, pierced, pierced - 0.15 * h, pierced + 0.15 * h}) {
      const Vec3 target = event.from + std::clamp(along, 0.0, length_m) * direction;
      if (distance(target, star_.position()) > 0.75 * h) continue;
      if (!star_.keeps_boundary(target)) continue;
      if (worst_at(star_, target, limit, kFlat_h * h) > limit) continue;
      workspace_.vertices[v].rim = stroke_;
      snap(star_, v, target);
      return true;
    }
    return false;
  };
  for (const double limit : {kGood, kSnapFloor}) {
    for (VertexId v : nearest) {
      if (!on_rim(v) && put(v, limit)) return;
    }
  }
  if (config_.prefer == Preference::kNoGrowth) return;
  // A new vertex, then, on the face's edge nearest to the rim.
  VertexId a = kNone, b = kNone;
  double best = INFINITY, at = 0;
  for (int k = 0; k < 3; ++k) {
    const Vec3 &p = mesh_.position(event.face[k]), &q = mesh_.position(event.face[(k + 1) % 3]);
    const double t = std::clamp(dot(event.point - p, q - p) / squared_length(q - p), 0.2, 0.8);
    const double d2 = squared_length(lerp(p, q, t) - event.point);
    if (d2 < best) {
      best = d2;
      at = t;
      a = event.face[k];
      b = event.face[(k + 1) % 3];
    }
  }
  if (split_worst(event.tet, a, b, at, kSnapFloor) > kSnapFloor) return;
  split(event.tet, a, b, at);
  const VertexId m = mesh_.vertex_slots() - 1;
  workspace_.vertices[m].surface = 0;
  put(m, kSnapFloor);
}

// ------------------------------------------------------------------------------------------------ events

// Whether v is near the blade, and by how much.
bool ConformingCutter::hot(VertexId v, double* by_m) const {
  if (!has_front_) return false;
  const double reach = kHot * mesh_.local_h(v);
  const double d2 = squared_distance_to_segment(mesh_.position(v), front_.heel, front_.tip);
  if (d2 >= reach * reach) return false;
  if (by_m != nullptr) *by_m = reach - std::sqrt(d2);
  return true;
}

// Whether none of its vertices is near the blade. Neither can be while the blade has come less far than they were away.
// No vertex moves while a collection is under way, so each is looked at once.
bool ConformingCutter::ripe(Active& entry) {
  if (!has_front_) return true;
  if (travel_ < entry.ripe_at) return false;
  work_ += 1;
  for (VertexId v : mesh_.vertices(entry.tet)) {
    auto& marks = workspace_.vertices[v];
    double by_m;
    if (marks.looked_at != collection_) {
      marks.looked_at = collection_;
      marks.hot = hot(v);
    }
    if (!marks.hot || !hot(v, &by_m)) continue;
    entry.ripe_at = travel_ + by_m;
    return false;
  }
  return true;
}

bool ConformingCutter::find_crossing(const Vec3& a, bool a_on, const Vec3& b, bool b_on,
                                     std::uint32_t& triangle, double& t) const {
  work_ += 2;
  const Vec3 low{std::min(a.x, b.x), std::min(a.y, b.y), std::min(a.z, b.z)};
  const Vec3 high{std::max(a.x, b.x), std::max(a.y, b.y), std::max(a.z, b.z)};
  return surface_.any_overlapping(low, high, [&](std::uint32_t i) {
    const SweptTriangle& s = surface_[i];
    const double da = s.signed_distance(a), db = s.signed_distance(b);
    // An end on the surface is where the edge meets it.
    if ((a_on && std::abs(da) <= clear_) || (b_on && std::abs(db) <= clear_)) return false;
    double at;
    if (!crosses(a, b, da, db, s, clear_, at)) return false;
    triangle = i;
    t = at;
    return true;
  });
}

// Adds the crossings of the tetrahedron's edges. Returns whether there is none.
bool ConformingCutter::collect_from(TetId t) {
  bool clear = true;
  const auto& v = mesh_.vertices(t);
  const FourPoints p([&](std::size_t i) { return mesh_.position(v[i]); });
  bool on[4];
  for (int i = 0; i < 4; ++i) on[i] = on_surface(v[i]);
  Vec3 low, high;
  p.bounds(low, high);
  surface_.any_overlapping(low, high, [&](std::uint32_t index) {
    const SweptTriangle& triangle = surface_[index];
    double d[4];
    p.along(triangle.normal, triangle.offset, d);
    if (FourPoints::least(d) > clear_ || FourPoints::most(d) < -clear_) return false;
    int above = 0, below = 0;
    for (int i = 0; i < 4; ++i) {
      above += d[i] > clear_ || (d[i] >= -clear_ && !on[i]);
      below += d[i] < -clear_ || (d[i] <= clear_ && !on[i]);
    }
    if (above == 0 || below == 0) return false;
    for (const auto& edge : kEdgeVertices) {
      const int i = edge[0], j = edge[1];
      if (on[i] && on[j]) continue;
      // An end on the surface is where the edge meets it.
      if ((on[i] && std::abs(d[i]) <= clear_) || (on[j] && std::abs(d[j]) <= clear_)) continue;
      double at;
      if (!crosses(mesh_.position(v[i]), mesh_.position(v[j]), d[i], d[j], triangle, clear_, at)) continue;
      clear = false;
      if ((on[i] && at < kAtVertex) || (on[j] && at > 1 - kAtVertex)) {
        // A vertex on another part of the surface is as near as can be had.
        fail(v[i]);
        fail(v[j]);
      } else {
        add_event(v[i], v[j], t, index, at);
      }
    }
    return false;
  });
  return clear;
}

void ConformingCutter::begin_order() {
  order_.clear();
  next_event_ = 0;
  phase_ = Phase::kOrder;
}

// Takes the events that need not wait any more, nearest first.
void ConformingCutter::order(WorkBudget& budget) {
  while (next_event_ < events_.size()) {
    if (budget.spent()) return;
    budget.charge(1);
    const auto i = static_cast<std::uint32_t>(next_event_++);
    const Event& event = events_[i];
    if (!event.done && !hot(event.a) && !hot(event.b)) order_.push({event.nearness, event.a, event.b, i});
  }
  order_.seal();
  next_event_ = 0;
  pass_ = 0;
  again_.clear();
  retry_.clear();
  phase_ = Phase::kEvents;
}

void ConformingCutter::work_events(WorkBudget& budget) {
  for (;;) {
    while (pass_ == 0 ? !order_.empty() : next_event_ < again_.size()) {
      charge(budget);
      if (budget.spent()) return;
      handle(pass_ == 0 ? order_.take().index : again_[next_event_++]);
    }
    if (retry_.empty()) break;
    ++pass_;
    again_.swap(retry_);
    retry_.clear();
    next_event_ = 0;
  }
  begin_repairs();
}

// A snap may leave an edge that crosses another part of a bent surface, and so may a repair.
void ConformingCutter::verify(WorkBudget& budget) {
  if (next_active_ == 0) {
    collection_ = ++workspace_.serial;
    first_leftover_ = events_.size();
    if (round_ == 0) verified_ = ++workspace_.serial;
  }
  while (next_active_ < active_.size()) {
    charge(budget);
    if (budget.spent()) return;
    Active& entry = active_[next_active_++];
    work_ += 1;
    if (!mesh_.alive(entry.tet) || workspace_.tets[entry.tet].seen == verified_ || !ripe(entry)) continue;
    work_ += 2;
    if (collect_from(entry.tet)) workspace_.tets[entry.tet].seen = verified_;
  }
  next_active_ = 0;
  if (events_.size() > first_leftover_ && ++round_ < 3) {
    begin_order();
  } else {
    for (std::size_t i = first_leftover_; i < events_.size(); ++i) {
      fail(events_[i].a);
      fail(events_[i].b);
      events_[i].done = true;
      ++counts_.failed;
    }
    phase_ = Phase::kSelect;
  }
}

// VertexStar::worst_at(), into flat_; kInverted where one of these lies across a bend, between two parts of the surface:
// what is removed must be part of it.
double ConformingCutter::worst_at(const VertexStar& star, const Vec3& p, double limit, double thickness) {
  work_ += 1 + static_cast<std::int64_t>(star.corners().size() / 8);
  const double worst = star.worst_at(p, limit, thickness, flat_);
  for (TetId t : flat_) {
    work_ += 1;
    if (!surface_.is_within(mesh_.barycentre(t) + 0.25 * (p - star.position()), kFlatOff_h * h_))
      return kInverted;
  }
  return worst;
}

// Where on the surface v would best go: its closest point, or the crossing; a boundary vertex slides along the
// boundary. `search`: also looks around, until `limit` is reached.
ConformingCutter::Placement ConformingCutter::place(VertexStar& star, VertexId v, const Event& event,
                                                    const Vec3& crossing, double limit, bool search) {
  gather(star, v);
  Vec3 targets[2];
  int count = 0;
  std::uint32_t triangle = event.triangle;
  const Vec3& p = star.position();
  const double reach = 0.75 * distance(mesh_.position(event.a), mesh_.position(event.b));
  Vec3 closest;
  work_ += 4;
  const bool near = surface_.near(p, reach, closest, triangle);
  const Vec3 normal = surface_[triangle].normal;
  if (!star.on_boundary()) {
    if (near) targets[count++] = closest;
  } else {
    // Along the line in which the boundary meets the surface (Croll 2007, equations 11 to 14); where two boundary
    // planes meet at v, along their crease.
    Vec3 basis[3];
    const int directions = freedom(star, nullptr, basis);
    Vec3 direction{};
    for (int i = 0; i < directions; ++i) direction += dot(normal, basis[i]) * basis[i];
    const double slope = dot(normal, direction);
    if (slope > 1e-3) {
      const Vec3 target = p + (-surface_[triangle].signed_distance(p) / slope) * direction;
      if (surface_.near(target, 1e-3 * h_, closest, triangle)) targets[count++] = target;
    }
  }
  targets[count] = crossing;
  if (star.on_boundary()) {
    // As near to the crossing as the body keeps its volume, within the surface.
    const SweptTriangle& crossed = surface_[event.triangle];
    const Vec3& area = star.wall_area();
    const Vec3 steepest = area - dot(area, crossed.normal) * crossed.normal;
    const double slope = squared_length(steepest);
    if (slope > 1e-3 * squared_length(area)) {
      const Vec3 target = crossing + (-dot(area, crossing - p) / slope) * steepest;
      if (surface_.near(target, 1e-3 * h_, closest, triangle)) targets[count] = target;
    }
  }
  ++count;
  Placement best{p, kInverted};
  for (int i = 0; i < count && best.worst > limit; ++i) {
    if (distance(targets[i], p) > reach) continue;
    if (!star.keeps_boundary(targets[i])) continue;
    const double worst = worst_at(star, targets[i], search ? best.worst : std::min(best.worst, limit),
                                  kFlat_h * star.local_h());
    if (worst < best.worst) best = {targets[i], worst};
  }
  if (search && best.worst > limit && best.worst < kInverted)
    search_placement(star, true, triangle, limit, kFlat_h * star.local_h(), best);
  return best;
}

// Whether a vertex may stand for the surface where it is, and better than where it could go: at a boundary that runs along
// the surface, or where an older cut does that ends at the body's own boundary. Where this meets the surface at an angle, as at
// a bump, that would cut off what is to be moved.
bool ConformingCutter::stay(const VertexStar& star, Placement& placement) {
  const Vec3& p = star.position();
  Vec3 closest;
  std::uint32_t triangle = 0;
  work_ += 2;
  if (!star.on_boundary() || !surface_.near(p, kStay_h * std::min(h_, star.local_h()), closest, triangle))
    return false;
  constexpr double kAlong = 0.94;  // cosine of 20 degrees
  const auto runs_along = [&](const VertexStar::Wall& wall) {
    return std::abs(dot(wall.normal, surface_[triangle].normal)) > kAlong;
  };
  const auto cut_along = [&](const VertexStar::Wall& wall) { return wall.cut && runs_along(wall); };
  if (!std::ranges::all_of(star.walls(), runs_along) && !std::ranges::any_of(star.walls(), cut_along))
    return false;
  const double worst = worst_at(star, p, placement.worst, kFlat_h * star.local_h());
  if (worst >= placement.worst) return false;
  placement = {p, worst};
  return true;
}

void ConformingCutter::remove_flat(TetId t) {
  TetId neighbors[4];
  for (int f = 0; f < 4; ++f) neighbors[f] = mesh_.neighbor(t, f);
  const VertexId first_copy = mesh_.vertex_slots();
  mesh_.remove_tet(t);
  work_ += 60;
  ++counts_.removed_tets;
  for (TetId n : neighbors) {
    if (n != kNone) workspace_.grid.add(mesh_, n);
  }
  workspace_.grow(mesh_);
  // What is poor may be at a copy now, of a vertex that was put on the surface before.
  for (VertexId copy = first_copy; copy < mesh_.vertex_slots(); ++copy) changed_.push_back({copy});
}

void ConformingCutter::snap(const VertexStar& star, VertexId v, const Vec3& target) {
  const double worst = worst_at(star, target, kInverted, kFlat_h * star.local_h());
  mesh_.move_vertex(v, target);
  mark_on_surface(v);
  ++counts_.snaps;
  // What has three vertices on the surface only now may have a face to open.
  for (const VertexStar::Corner& c : star.corners()) {
    if (on_surface(c.others[0]) + on_surface(c.others[1]) + on_surface(c.others[2]) >= 2) activate(c.tet);
  }
  judge_again(star, v);
  if (worst > kGood || !flat_.empty()) changed_.push_back({v});
  for (TetId t : flat_) remove_flat(t);
}

// What the worst of the tetrahedra would be that splitting the edge makes; stops beyond `limit`.
double ConformingCutter::split_worst(TetId tet, VertexId a, VertexId b, double t, double limit) {
  mesh_.ring(tet, a, b, ring_);
  work_ += 2 * static_cast<std::int64_t>(ring_.size());
  const Vec3 x = lerp(mesh_.position(a), mesh_.position(b), t);
  double worst = -1;
  for (TetId r : ring_) {
    const auto& v = mesh_.vertices(r);
    Vec3 near[4], far[4];
    for (int i = 0; i < 4; ++i) {
      near[i] = v[i] == b ? x : mesh_.position(v[i]);
      far[i] = v[i] == a ? x : mesh_.position(v[i]);
    }
    worst = std::max({worst, worst_dihedral(near[0], near[1], near[2], near[3]),
                      worst_dihedral(far[0], far[1], far[2], far[3])});
    if (worst > limit) break;
  }
  return worst;
}

// Splits the edge whose ring ring_ holds.
void ConformingCutter::split(TetId tet, VertexId a, VertexId b, double t) {
  const TetId first = mesh_.tet_slots();
  const VertexId m = mesh_.split_edge(tet, a, b, t);
  work_ += 8 * static_cast<std::int64_t>(ring_.size());
  workspace_.grow(mesh_);
  mark_on_surface(m);
  changed_.push_back({m});
  for (TetId r : ring_) {
    look_again(r);
    activate(r);
  }
  for (TetId n = first; n < mesh_.tet_slots(); ++n) {
    if (mesh_.boundary_mask(n) != 0) workspace_.grid.add(mesh_, n);
    activate(n);
  }
  ++counts_.splits;
}

void ConformingCutter::handle(std::uint32_t index) {
  events_[index].done = true;
  Event event = events_[index];
  const VertexId a = event.a, b = event.b;
  const bool a_on = on_surface(a), b_on = on_surface(b);
  work_ += 1;
  // Dealt with by a snap of one end, as a rule; verify() finds the exceptions.
  if (round_ == 0 && (a_on || b_on)) return;
  if (!mesh_.alive(event.tet) || mesh_.local_index(event.tet, a) < 0 || mesh_.local_index(event.tet, b) < 0) {
    event.tet = mesh_.find_edge(a, b);
    work_ += 10;
    if (event.tet == kNone) return;
  }
  if (round_ > 0 || event.batch != batch_) {
    if (!find_crossing(mesh_.position(a), a_on, mesh_.position(b), b_on, event.triangle, event.at)) return;
    if ((a_on && event.at < kAtVertex) || (b_on && event.at > 1 - kAtVertex)) return;
  }
  const Vec3 crossing = lerp(mesh_.position(a), mesh_.position(b), event.at);
  const VertexId ends[2] = {event.at <= 0.5 ? a : b, event.at <= 0.5 ? b : a};
  VertexStar* stars[2] = {&star_, &other_star_};
  Placement best[2];
  const bool exact = config_.prefer == Preference::kExact;
  const double floor = exact ? kExactFloor : kFloor;
  if (exact && std::min(event.at, 1 - event.at) > kExactNear &&
      split_worst(event.tet, a, b, event.at, floor) <= floor) {
    ++counts_.events;
    split(event.tet, a, b, event.at);
    return;
  }
  for (int i = 0; i < 2; ++i) {
    if (on_surface(ends[i])) continue;
    best[i] = place(*stars[i], ends[i], event, crossing, kGood, pass_ > 0);
    if (best[i].worst <= kGood) {
      ++counts_.events;
      snap(*stars[i], ends[i], best[i].target);
      return;
    }
  }
  if (pass_ == 0) {
    events_[index].done = false;
    retry_.push_back(index);
    return;
  }
  ++counts_.events;
  int i = best[1].worst < best[0].worst ? 1 : 0;
  if (best[i].worst > kSnapFloor && !exact) {
    // At a boundary that runs along the surface, that of an older cut above all, a split makes but splinters.
    for (int k = 0; k < 2; ++k) {
      if (!on_surface(ends[k]) && stay(*stars[k], best[k])) i = best[k].worst < best[i].worst ? k : i;
    }
  }
  const bool may_split = config_.prefer != Preference::kNoGrowth;
  const double by_split =
      best[i].worst <= kSnapFloor || !may_split ? kInverted : split_worst(event.tet, a, b, event.at, floor);
  if (best[i].worst <= kSnapFloor || (best[i].worst <= by_split && best[i].worst <= floor)) {
    snap(*stars[i], ends[i], best[i].target);
  } else if (by_split <= floor) {
    split(event.tet, a, b, event.at);
  } else {
    fail(a);
    fail(b);
    ++counts_.failed;
  }
}

}  // namespace incise::core
