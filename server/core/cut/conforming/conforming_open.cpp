#include <algorithm>
#include <cmath>

#include "server/core/cut/conforming/conforming_cutter.hpp"

// ConformingCutter, the last phases: which faces separate, and opening them.
namespace incise::core {
namespace {

// What reaches no farther than this from the surface, by the local edge length, is no part of the tissue.
constexpr double kThin_h = 0.1;

}  // namespace

// A point that stands for the tetrahedron's side of the surface: amid its vertices off the surface, since the barycentre
// of one that lies in a bend may be beyond it.
Vec3 ConformingCutter::reference(TetId t) const {
  Vec3 sum{};
  int count = 0;
  for (VertexId v : mesh_.vertices(t)) {
    if (on_surface(v)) continue;
    sum += mesh_.position(v);
    ++count;
  }
  return count == 0 ? mesh_.barycentre(t) : (1.0 / count) * sum;
}

// Whether the surface separates the two tetrahedra at an interior face, so that it has to open: whether it crosses the
// way from one reference point to the other. Any choice of ways, one for each face, separates what the surface
// separates. A face on the surface is passed close by its middle, so that none opens beyond the rim; another one by its
// own vertices off the surface, and only where a crossing near it could not be dealt with: better ragged than a bridge.
bool ConformingCutter::separates(HalfFace h) const {
  const TetId a = tet_of(h), b = tet_of(mesh_.opposite(h));
  Vec3 middle{}, off{};
  int off_count = 0;
  for (VertexId v : mesh_.face_vertices(h)) {
    middle += (1.0 / 3.0) * mesh_.position(v);
    if (on_surface(v)) continue;
    off += mesh_.position(v);
    ++off_count;
  }
  std::uint32_t triangle;
  double t;
  const Vec3 from = reference(a), to = reference(b);
  if (off_count > 0) {
    const Vec3 by = (1.0 / off_count) * off;
    return find_crossing(from, false, by, false, triangle, t) ||
           find_crossing(by, false, to, false, triangle, t);
  }
  constexpr double kClose = 0.25;
  const Vec3 near_a = lerp(middle, from, kClose), near_b = lerp(middle, to, kClose);
  return find_crossing(near_a, false, near_b, false, triangle, t) ||
         find_crossing(from, false, near_a, false, triangle, t) ||
         find_crossing(near_b, false, to, false, triangle, t);
}

// The faces of t that may separate: those with all vertices on the surface, or one at which a crossing could not be dealt
// with. Bit f: face f.
unsigned ConformingCutter::may_separate(TetId t) const {
  const auto& v = mesh_.vertices(t);
  unsigned off = 0, failed = 0;
  for (unsigned i = 0; i < 4; ++i) {
    off |= (on_surface(v[i]) ? 0u : 1u) << i;
    failed |= (workspace_.vertices[v[i]].failed == stroke_ ? 1u : 0u) << i;
  }
  unsigned faces = 0;
  for (unsigned f = 0; f < 4; ++f) {
    const unsigned others = 0xfu & ~(1u << f);
    faces |= ((off & others) == 0 || (failed & others) != 0 ? 1u : 0u) << f;
  }
  return faces;
}

// Which faces of ripe tetrahedra open; a tetrahedron all of whose faces are decided leaves the active ones.
void ConformingCutter::select(WorkBudget& budget) {
  if (next_active_ == 0) {
    // What survives is compacted to the front as the scan goes.
    to_open_.clear();
    next_open_ = 0;
    search_ = ++workspace_.serial;
  }
  while (next_active_ < active_.size()) {
    charge(budget);
    if (budget.spent()) return;
    Active& entry = active_[next_active_++];
    const TetId t = entry.tet;
    work_ += 1;
    if (!mesh_.alive(t)) continue;
    if (!ripe(entry) || select_faces(t)) {
      active_[next_open_++] = entry;
    } else {
      workspace_.tets[t].active = 0;
    }
  }
  active_.resize(next_open_);
  next_open_ = 0;
  spared_ = ++workspace_.serial;
  phase_ = Phase::kSpare;
}

// Returns whether one that separates has to wait for the blade to leave what is behind it.
bool ConformingCutter::select_faces(TetId t) {
  bool waits = false;
  workspace_.tets[t].seen = search_;
  const unsigned faces = may_separate(t) & ~unsigned{workspace_.tets[t].pending};
  for (int f = 0; f < 4; ++f) {
    const HalfFace h = half_face(t, f), o = mesh_.opposite(h);
    // From the other side it looks the same.
    if (!(faces >> f & 1) || o == kNone || workspace_.tets[tet_of(o)].seen == search_) continue;
    if (!separates(h)) continue;
    if (hot(mesh_.vertices(tet_of(o))[face_of(o)])) {
      waits = true;
      continue;
    }
    workspace_.tets[t].pending |= static_cast<std::uint8_t>(1u << f);
    workspace_.tets[tet_of(o)].pending |= static_cast<std::uint8_t>(1u << face_of(o));
    to_open_.push_back(h);
  }
  return waits;
}

// Tetrahedra that the sweep would cut off on all sides, though no part of the tissue lies there, stay with their
// neighbours: some that hang together by ragged faces, or a sheet of them between two layers of the surface.
void ConformingCutter::spare_islands(WorkBudget& budget) {
  while (next_open_ < to_open_.size()) {
    charge(budget);
    if (budget.spent()) return;
    const HalfFace h = to_open_[next_open_++];
    spare_island(h);
    spare_island(mesh_.opposite(h));
  }
  std::erase_if(to_open_,
                [this](HalfFace h) { return !(workspace_.tets[tet_of(h)].pending >> face_of(h) & 1); });
  next_open_ = 0;
  phase_ = Phase::kOpen;
}

// Looks at what lies behind a face that is about to open.
void ConformingCutter::spare_island(HalfFace side) {
  constexpr std::size_t kRagged = 8, kSheet = 64;
  work_ += 1;
  if (!(workspace_.tets[tet_of(side)].pending >> face_of(side) & 1) || stands_clear(side)) return;
  // The component behind the faces that are about to open. Where part of it was looked at from another face already,
  // it was found to be no island.
  TetId members[kSheet];
  std::size_t size = 1, most = kSheet;
  members[0] = tet_of(side);
  bool clean = true, thin = true, island = workspace_.tets[members[0]].seen != spared_;
  for (std::size_t i = 0; i < size && island; ++i) {
    const TetId t = members[i];
    if (thin && !is_thin(t)) {
      thin = false;
      most = kRagged;
    }
    work_ += 2;
    for (int f = 0; f < 4; ++f) {
      if (workspace_.tets[t].pending >> f & 1) {
        for (VertexId v : mesh_.face_vertices(half_face(t, f))) clean = clean && on_surface(v);
        continue;
      }
      const TetId n = mesh_.neighbor(t, f);
      if (n == kNone) {
        clean = clean && !is_ragged(half_face(t, f));
        continue;
      }
      if (std::find(members, members + size, n) != members + size) continue;
      island = size < most && workspace_.tets[n].seen != spared_;
      if (!island) break;
      members[size++] = n;
    }
    island = island && size <= most;
  }
  if (island && (!clean || thin)) {
    join_larger_side(std::span(members, size));
  } else {
    for (std::size_t i = 0; i < size; ++i) workspace_.tets[members[i]].seen = spared_;
  }
}

// Keeps a group of tetrahedra together with those of its neighbours that are on one side of the surface: with both it would
// be a bridge.
void ConformingCutter::join_larger_side(std::span<const TetId> members) {
  const auto is_above = [this](HalfFace h) {
    const auto face = mesh_.face_vertices(h);
    const Vec3 middle =
        (1.0 / 3.0) * (mesh_.position(face[0]) + mesh_.position(face[1]) + mesh_.position(face[2]));
    Vec3 closest;
    std::uint32_t triangle = 0;
    return surface_.closest(middle, 4 * h_, closest, triangle) &&
           surface_[triangle].signed_distance(reference(tet_of(mesh_.opposite(h)))) >= 0;
  };
  int above = 0, below = 0;
  for (const bool decided : {false, true}) {
    for (TetId t : members) {
      for (int f = 0; f < 4; ++f) {
        if (!(workspace_.tets[t].pending >> f & 1)) continue;
        const HalfFace o = mesh_.opposite(half_face(t, f));
        const bool up = is_above(half_face(t, f));
        if (!decided) {
          ++(up ? above : below);
        } else if (up == (above >= below)) {
          workspace_.tets[t].pending &= static_cast<std::uint8_t>(~(1u << f));
          workspace_.tets[tet_of(o)].pending &= static_cast<std::uint8_t>(~(1u << face_of(o)));
        }
      }
    }
  }
}

// Whether behind a face on the surface its tetrahedron reaches well away from it: the common case, no island.
bool ConformingCutter::stands_clear(HalfFace h) const {
  const auto face = mesh_.face_vertices(h);
  if (!on_surface(face[0]) || !on_surface(face[1]) || !on_surface(face[2])) return false;
  const VertexId apex = mesh_.vertices(tet_of(h))[face_of(h)];
  if (on_surface(apex)) return false;
  for (int f = 0; f < 4; ++f) {
    if (is_ragged(half_face(tet_of(h), f))) return false;
  }
  const Vec3 n = mesh_.twice_area(h);
  return std::abs(dot(n, mesh_.position(apex) - mesh_.position(face[0]))) >
         kThin_h * mesh_.local_h(apex) * length(n);
}

// Whether a face has been opened beside the surface, where a crossing could not be dealt with.
bool ConformingCutter::is_ragged(HalfFace h) const {
  if (!(mesh_.cut_mask(tet_of(h)) >> face_of(h) & 1)) return false;
  const auto face = mesh_.face_vertices(h);
  return !std::ranges::all_of(face, [this](VertexId v) { return on_surface(v); }) &&
         std::ranges::any_of(face, [this](VertexId v) { return workspace_.vertices[v].failed == stroke_; });
}

// Whether all of a tetrahedron is near the surface.
bool ConformingCutter::is_thin(TetId t) const {
  work_ += 6;
  for (VertexId v : mesh_.vertices(t)) {
    if (!on_surface(v) && !surface_.is_within(mesh_.position(v), kThin_h * mesh_.local_h(v))) return false;
  }
  return true;
}

void ConformingCutter::open(WorkBudget& budget) {
  constexpr std::size_t kChunk = 16;
  while (next_open_ < to_open_.size()) {
    charge(budget);
    if (budget.spent()) return;
    const std::size_t end = std::min(next_open_ + kChunk, to_open_.size());
    const std::span<const HalfFace> chunk(to_open_.data() + next_open_, end - next_open_);
    for (HalfFace h : chunk) note_opening(h);
    counts_.cut_faces += mesh_.open_faces(chunk);
    workspace_.grow(mesh_);
    work_ += static_cast<std::int64_t>(40 * chunk.size());
    next_open_ = end;
  }
  finish();
}

void ConformingCutter::note_opening(HalfFace h) {
  const HalfFace o = mesh_.opposite(h);
  workspace_.tets[tet_of(h)].pending &= static_cast<std::uint8_t>(~(1u << face_of(h)));
  workspace_.tets[tet_of(o)].pending &= static_cast<std::uint8_t>(~(1u << face_of(o)));
  workspace_.grid.add(mesh_, tet_of(h));
  workspace_.grid.add(mesh_, tet_of(o));
  const auto v = mesh_.face_vertices(h);
  counts_.cut_area += 0.5 * length(mesh_.twice_area(h));
  for (VertexId w : v) {
    if (on_surface(w)) continue;
    std::uint32_t triangle;
    Vec3 closest = mesh_.position(w);
    work_ += 4;
    surface_.closest(mesh_.position(w), 4 * h_, closest, triangle);
    counts_.max_deviation_h = std::max(counts_.max_deviation_h, distance(closest, mesh_.position(w)) / h_);
  }
}

void ConformingCutter::clinging(std::vector<VertexId>& out) const {
  for (const Active& active : active_) {
    if (!mesh_.alive(active.tet)) continue;
    out.insert(out.end(), mesh_.vertices(active.tet).begin(), mesh_.vertices(active.tet).end());
    // And what is beside it: else it could slip past the blade, in between two batches.
    for (int f = 0; f < 4; ++f) {
      const HalfFace o = mesh_.opposite(half_face(active.tet, f));
      if (o != kNone) out.push_back(mesh_.vertices(tet_of(o))[face_of(o)]);
    }
  }
  for (const Event& event : events_) out.insert(out.end(), {event.a, event.b});
  for (const RimEvent& event : rim_events_) out.insert(out.end(), event.face.begin(), event.face.end());
}

void ConformingCutter::finish() {
  std::erase_if(events_, [](const Event& e) { return e.done; });
  counts_.pending = static_cast<std::uint32_t>(active_.size());
  if (!has_front_) {
    active_.clear();
    surface_.clear();
    events_.clear();
    rim_events_.clear();
  }
  phase_ = Phase::kIdle;
}

}  // namespace incise::core
