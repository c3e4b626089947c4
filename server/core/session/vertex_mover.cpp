#include "server/core/session/vertex_mover.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <span>

#include "server/core/geometry/predicates.hpp"
#include "server/core/session/in_chunks.hpp"
#include "server/core/util/room.hpp"

namespace incise::core {
namespace {

// Six times the volume below which a tetrahedron is flat, in cubes of the local edge length, or of its own longest edge if that is shorter. A regular one
// has 0.7.
constexpr double kThinnest = 1e-3;
// One that is flat already, or at rest, as cuts leave some, may lose this part of its volume in a step, or of its thickness at rest: it is strained with the body around it,
// and all of that would be held back with it.
constexpr double kLoses = 0.5;
// A tetrahedron that would be thick enough where edges are this many times the mean length is thick enough anywhere: then the
// local length is not looked up.
constexpr double kLocallyAtMost = 4;
// Longer edges than this many mean lengths are left to exact arithmetic.
constexpr double kLongest = 8;
// The longest edge of a tetrahedron may be this many mean lengths, or this many times what it is at rest. A longer one is no tissue any more,
// and the boundary grid would list it in each cell of its box.
constexpr double kStretched = 16, kStretchedAtRest = 4;
// What elements cost, in quarters of a unit of work: a number or a tetrahedron, and a star.
constexpr std::int64_t kSmall = 1, kStar = 20;

double six_volumes(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  return dot(cross(b - a, c - a), d - a);
}

double squared_longest_edge(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  return std::max({squared_length(b - a), squared_length(c - a), squared_length(d - a), squared_length(c - b),
                   squared_length(d - b), squared_length(d - c)});
}

}  // namespace

VertexMover::VertexMover(TetMesh& mesh, CutWorkspace& workspace, const TetClusters& clusters,
                         bool stays_valid)
    : mesh_(mesh),
      workspace_(workspace),
      stays_valid_(stays_valid),
      late_(mesh),
      pass_(workspace),
      tets_(mesh, clusters),
      grid_(mesh, workspace) {}

void VertexMover::note_cut(const Delta& delta) {
  for (const VertexId v : delta.moved) {
    if (v >= target_.size()) continue;
    const Vec3 before = target_[v];
    vertices_hash_ ^= TetMesh::hash_at(std::span(&v, 1), std::span(&before, 1)) ^ mesh_.hash_of_vertex(v);
    target_.set(v, mesh_.position(v));
  }
  late_.note_cut(delta);
  tets_.follow(delta);
}

void VertexMover::begin(const VertexPositions& positions, std::span<const VertexPlace> clinging,
                        const std::vector<GaveWay>* known) {
  positions_ = &positions;
  phase_ = Phase::kGather;
  next_ = 0;
  serial_ = workspace_.next_serial();
  const std::size_t vertices = mesh_.vertex_slots();
  wanted_.resize(vertices, 0);
  gives_way_.resize(vertices, 0);
  reach_.resize(vertices, kStays);
  clinging_ = clinging;
  next_clinging_ = next_late_ = 0;
  next_given_ = 0;
  clinging_gives_way_ = false;
  clinging_gave_way_ = known != nullptr && !known->empty() && known->back().vertex == kNone;
  first_round_ = true;
  known_ = known;
  gave_way_.clear();
  any_stay_ = false;
  to_check_.clear();
  boundary_.clear();
  too_far_.clear();
  passed_over_ = 0;
  held_.clear();
  moved_.clear();
  moved_positions_.clear();
  hash_change_ = 0;
  moves_most_ = 2 * positions.positions.size() > vertices;
  grid_.begin();
  late_.begin(positions, clinging);
  const double h = kLocallyAtMost * mesh_.mean_edge_length();
  surely_thick_ = kThinnest * h * h * h;
}

void VertexMover::begin_again(const VertexPositions& positions, std::span<const VertexPlace> clinging) {
  begin(positions, clinging);
  clinging_gave_way_ = true;
}

bool VertexMover::advance(WorkBudget& budget) {
  while (phase_ != Phase::kReady) {
    if (budget.spent()) return false;
    switch (phase_) {
      case Phase::kGather:
        gather(budget);
        break;
      case Phase::kLead:
        if (late_.advance(budget)) phase_ = Phase::kTake;
        break;
      case Phase::kTake:
        take(budget);
        break;
      case Phase::kLook:
        look(budget);
        break;
      case Phase::kCheck:
        check(budget);
        break;
      case Phase::kYield:
        yield(budget);
        break;
      case Phase::kSettle:
        settle(budget);
        break;
      case Phase::kLeaveOut:
        if (leave_out(budget)) phase_ = Phase::kHash;
        break;
      case Phase::kHash:
        if (!moves_most_ || leave_out_of_hash(budget)) begin_following();
        break;
      case Phase::kFollow:
        if (grid_.advance(grid_step(), budget)) phase_ = Phase::kReady;
        break;
      case Phase::kReady:
        break;
    }
  }
  return true;
}

// ------------------------------------------------------------------------------------------------ which

// What the mesh has got since the last step; all that it has, before the first one.
void VertexMover::gather(WorkBudget& budget) {
  if (target_.size() == 0) target_.reserve(room_for(mesh_.vertex_slots()));
  std::size_t next = target_.size();
  const auto take_in = [this](std::size_t i) {
    const auto v = static_cast<VertexId>(i);
    target_.push_back(mesh_.position(v));
    vertices_hash_ ^= mesh_.hash_of_vertex(v);
  };
  if (in_chunks(next, mesh_.vertex_slots(), budget, kSmall, take_in) && tets_.catch_up(budget))
    phase_ = Phase::kLead;
}

bool VertexMover::may_move(VertexId v, const Vec3& to) {
  if (wanted(v) || (!moved_.empty() && v < moved_.back())) return false;
  if (to == mesh_.position(v)) return false;
  if (is_place(to)) return true;
  held_.push_back(v);
  return false;
}

void VertexMover::want(VertexId v, const Vec3& to) {
  wanted_[v] = serial_;
  reach_[v] = kFull;
  moved_.push_back(v);
  moved_positions_.push_back(to);
}

// The next one. `wanted`: where the simulation wants it, if it says so.
void VertexMover::take_clinging(const Vec3* wanted) {
  const auto [v, place] = clinging_[next_clinging_++];
  if (wanted != nullptr && *wanted != mesh_.position(v) &&
      !(squared_length(*wanted - place) <=
        kSamePlace_h * kSamePlace_h * mesh_.mean_edge_length() * mesh_.mean_edge_length()))
    held_.push_back(v);
  if (place != mesh_.position(v) && is_place(place) && (moved_.empty() || moved_.back() < v)) want(v, place);
}

// What goes to a place that no entry gives: what clings, and what the simulation does not know, before v.
void VertexMover::take_before(VertexId v) {
  while (next_given_ < v) {
    const VertexId clings = next_clinging_ < clinging_.size() ? clinging_[next_clinging_].vertex : kNone;
    const VertexId late = next_late_ < late_.places().size() ? late_.places()[next_late_].vertex : kNone;
    next_given_ = std::min(clings, late);
    if (next_given_ >= v) return;
    if (clings < late) {
      take_clinging(nullptr);
    } else {
      take_late();
    }
  }
}

void VertexMover::take_late() {
  const auto [v, place] = late_.places()[next_late_++];
  if (may_move(v, place)) want(v, place);
}

// Whether these entries follow each other, and none of their vertices clings or is late: all of these have a place that is given.
bool VertexMover::is_plain(std::size_t first, std::size_t stop) {
  if (!positions_->ids.empty()) return false;
  const VertexId v = positions_->id(first), last = positions_->id(stop - 1);
  if (v > last || last >= mesh_.vertex_slots() || (!moved_.empty() && v <= moved_.back())) return false;
  if (next_given_ < v) take_before(v);
  return next_given_ > last;
}

void VertexMover::take_plain(std::size_t first, std::size_t stop) {
  std::array<VertexId, kChunk> vertices;
  std::array<Vec3, kChunk> places;
  std::size_t count = 0;
  VertexId v = positions_->id(first);
  for (std::size_t i = first; i < stop; ++i, ++v) {
    const Vec3& to = positions_->positions[i];
    if (!mesh_.is_used(v)) {
      ++passed_over_;
    } else if (to != mesh_.position(v)) {
      if (!is_place(to)) {
        held_.push_back(v);
        continue;
      }
      wanted_[v] = serial_;
      reach_[v] = kFull;
      vertices[count] = v;
      places[count++] = to;
    }
  }
  moved_.insert(moved_.end(), vertices.begin(), vertices.begin() + count);
  moved_positions_.insert(moved_positions_.end(), places.begin(), places.begin() + count);
}

void VertexMover::take(WorkBudget& budget) {
  const auto& entries = positions_->positions;
  if (next_ == 0) {
    // With room, since cuts add some vertices between any two steps.
    const std::size_t most = entries.size() + entries.size() / 4;
    if (moved_.capacity() < entries.size()) moved_.reserve(most);
    if (moved_positions_.capacity() < entries.size()) moved_positions_.reserve(most);
  }
  const bool done =
      chunk_by_chunk(next_, entries.size(), budget, kSmall, [&](std::size_t first, std::size_t stop) {
        const std::size_t before = moved_.size();
        const bool plain = is_plain(first, stop);
        if (plain) take_plain(first, stop);
        for (std::size_t i = plain ? stop : first; i < stop; ++i) {
          const VertexId v = positions_->id(i);
          if (next_given_ < v) take_before(v);
          if (!late_.is_known(*positions_, v)) {
            ++passed_over_;
          } else if (next_clinging_ < clinging_.size() && clinging_[next_clinging_].vertex == v) {
            take_clinging(&entries[i]);
          } else if (may_move(v, entries[i])) {
            want(v, entries[i]);
          }
        }
        note_moved(before);
      });
  if (!done) return;
  const std::size_t before = moved_.size();
  take_before(kNone);
  note_moved(before);
  // One pass over all tetrahedra is faster than visiting the stars of most vertices, which reach each tetrahedron four times.
  all_tets_ = moved_.size() > mesh_.tet_slots() / 16;
  pass_.begin();
  held_at_blades_ = held_.size();
  phase_ = all_tets_ ? Phase::kCheck : Phase::kLook;
  if (all_tets_ && known_) take_known();
}

void VertexMover::take_known() {
  for (const auto& [v, stays] : *known_) {
    if (v >= wanted_.size() || !wanted(v) || reach_[v] != kFull)
      continue;  // then the hash will not be the same
    target_.set(v, stays ? mesh_.position(v) : lerp(mesh_.position(v), target_[v], 0.5));
    reach_[v] = stays ? kStays : kHalf;
    held_.push_back(v);
  }
  begin_settling();
}

// What the moved vertices from `first` on do to the hash and to the grid, while they are in the caches. settle() corrects it
// where one gives way.
void VertexMover::note_moved(std::size_t first) {
  const std::span vertices = std::span(moved_).subspan(first);
  const std::span places = std::span(moved_positions_).subspan(first);
  Vec3 low{INFINITY, INFINITY, INFINITY}, high{-INFINITY, -INFINITY, -INFINITY};
  for (const Vec3& p : places) extend(p, low, high);
  target_.set(vertices, places, low, high);
  grid_.look_at(vertices, places, low, high);
  hash_change_ ^= hash_of_move(vertices, places);
}

std::uint64_t VertexMover::hash_of_move(std::span<const VertexId> vertices, std::span<const Vec3> to) const {
  return moves_most_ ? TetMesh::hash_at(vertices, to) : mesh_.hash_change(vertices, to);
}

// Takes out of the hash what the vertices were that have moved: all but those that have not.
bool VertexMover::leave_out_of_hash(WorkBudget& budget) {
  if (next_ == 0) {
    next_in_moved_ = 0;
    hash_change_ ^= vertices_hash_;
  }
  return chunk_by_chunk(next_, mesh_.vertex_slots(), budget, 0, [&](std::size_t first, std::size_t stop) {
    const std::size_t count = stop - first, last = next_in_moved_ + count - 1;
    if (last < moved_.size() && moved_[next_in_moved_] == first && moved_[last] == stop - 1) {
      next_in_moved_ += count;
      return;
    }
    budget.charge(static_cast<std::int64_t>(count) / 4);
    for (std::size_t i = first; i < stop; ++i) {
      const auto v = static_cast<VertexId>(i);
      if (next_in_moved_ < moved_.size() && moved_[next_in_moved_] == v) {
        ++next_in_moved_;
      } else {
        hash_change_ ^= mesh_.hash_of_vertex(v);
      }
    }
  });
}

// ------------------------------------------------------------------------------------------------ how far

// The tetrahedra around v are to be checked, each once.
void VertexMover::look_around(VertexId v) {
  mesh_.star(v, star_);
  for (const std::uint32_t corner : star_) {
    const TetId t = tet_of(corner);
    if (!pass_.insert(t)) continue;
    to_check_.push_back(t);
  }
}

void VertexMover::look(WorkBudget& budget) {
  if (in_chunks(next_, moved_.size(), budget, kStar, [this](std::size_t i) { look_around(moved_[i]); }))
    phase_ = Phase::kCheck;
}

void VertexMover::check(WorkBudget& budget) {
  if (first_round_ && all_tets_) {
    if (next_ == 0) target_.begin_looking(surely_thick_, kLongest * mesh_.mean_edge_length());
    check_all(budget);
  } else {
    check_listed(budget);
  }
}

void VertexMover::check_all(WorkBudget& budget) {
  const std::size_t count = tets_.size();
  static_assert(kChunk == 64, "StepTets::alive_64");
  const bool done =
      chunk_by_chunk(next_, count, budget, kSmall, [this, count](std::size_t first, std::size_t stop) {
        std::uint64_t look =
            tets_.alive_64(first) & ~target_.surely_thick(&tets_.vertices(first), stop - first, count - stop);
        for (; look != 0; look &= look - 1)
          check_tet(tets_.vertices(first + static_cast<std::size_t>(std::countr_zero(look))));
      });
  if (!done) return;
  checked_ += count;
  checked_round();
}

void VertexMover::check_listed(WorkBudget& budget) {
  const bool done = in_chunks(next_, to_check_.size(), budget, kSmall, [this](std::size_t i) {
    const TetId t = to_check_[i];
    if (!mesh_.alive(t)) return;
    check_tet(mesh_.vertices(t));
    if (first_round_ && mesh_.on_boundary(t)) boundary_.push_back(t);
  });
  if (!done) return;
  checked_ += to_check_.size();
  checked_round();
}

void VertexMover::checked_round() {
  first_round_ = false;
  to_check_.clear();
  pass_.begin();
  if (too_far_.empty()) {
    begin_settling();
  } else {
    phase_ = Phase::kYield;
  }
}

void VertexMover::check_tet(const std::array<VertexId, 4>& v) {
  if (!stretches(v) && !flattens(v)) return;
  for (const VertexId w : v) {
    if (!wanted(w) || reach_[w] == kStays || gives_way_[w] == pass_.serial()) continue;
    gives_way_[w] = pass_.serial();
    too_far_.push_back(w);
  }
}

bool VertexMover::stretches(const std::array<VertexId, 4>& v) const {
  const auto longest = [&](const auto& place) {
    return squared_longest_edge(place(v[0]), place(v[1]), place(v[2]), place(v[3]));
  };
  const double then = longest([this](VertexId w) { return target_[w]; });
  const double most_m = kStretched * mesh_.mean_edge_length();
  return then > most_m * most_m && then > longest([this](VertexId w) { return mesh_.position(w); }) &&
         then > kStretchedAtRest * kStretchedAtRest *
                    longest([this](VertexId w) { return mesh_.rest_position(w); });
}

bool VertexMover::flattens(const std::array<VertexId, 4>& v) const {
  const Vec3 &a = target_[v[0]], &b = target_[v[1]], &c = target_[v[2]], &d = target_[v[3]];
  const double then = six_volumes(a, b, c, d);
  if (then >= surely_thick_) return false;
  const bool is_valid = orient3d(a, b, c, d) > 0;
  // Small ones beside cuts are not flat by being small, and where vertices lie close the limit is only lower. Most end here, before
  // anything else of the mesh is fetched.
  const double longest_m = std::sqrt(squared_longest_edge(a, b, c, d));
  if (is_valid && then >= kThinnest * longest_m * longest_m * longest_m) return false;
  const double now =
      six_volumes(mesh_.position(v[0]), mesh_.position(v[1]), mesh_.position(v[2]), mesh_.position(v[3]));
  if (then >= now && is_valid) return false;
  const double h = std::min(longest_m, mesh_.local_h(v[0])), flat = kThinnest * h * h * h;
  if (then >= flat && is_valid) return false;
  if (now < flat && (!stays_valid_ || (then >= (1 - kLoses) * now && is_valid))) return false;
  // A solver has the shape at rest for sound, however flat it is.
  const Vec3 &ra = mesh_.rest_position(v[0]), &rb = mesh_.rest_position(v[1]),
             &rc = mesh_.rest_position(v[2]), &rd = mesh_.rest_position(v[3]);
  const double at_rest = six_volumes(ra, rb, rc, rd), rest_m2 = squared_longest_edge(ra, rb, rc, rd);
  return !(is_valid &&
           then * rest_m2 * std::sqrt(rest_m2) >= (1 - kLoses) * at_rest * longest_m * longest_m * longest_m);
}

void VertexMover::yield(WorkBudget& budget) {
  const bool done = in_chunks(next_, too_far_.size(), budget, kStar, [this](std::size_t i) {
    const VertexId v = too_far_[i];
    const bool full = reach_[v] == kFull;
    if (full) held_.push_back(v);
    target_.set(v, full ? lerp(mesh_.position(v), target_[v], 0.5) : mesh_.position(v));
    --reach_[v];
    look_around(v);
  });
  if (!done) return;
  too_far_.clear();
  phase_ = Phase::kCheck;
}

// All is known: where each vertex goes.
void VertexMover::begin_settling() {
  clinging_gives_way_ = std::ranges::any_of(
      clinging_, [this](const VertexPlace& c) { return wanted(c.vertex) && reach_[c.vertex] != kFull; });
  if (clinging_gives_way_) {
    for (const VertexId v : moved_) target_.set(v, mesh_.position(v));
    phase_ = Phase::kReady;
    return;
  }
  for (std::size_t i = held_at_blades_; i < held_.size(); ++i)
    gave_way_.push_back({held_[i], reach_[held_[i]] == kStays});
  std::sort(gave_way_.begin(), gave_way_.end(),
            [](const GaveWay& a, const GaveWay& b) { return a.vertex < b.vertex; });
  if (clinging_gave_way_) gave_way_.push_back({kNone, true});
  // What clings may be held already.
  std::sort(held_.begin(), held_.end());
  held_.erase(std::unique(held_.begin(), held_.end()), held_.end());
  phase_ = Phase::kSettle;
}

void VertexMover::settle(WorkBudget& budget) {
  if (!in_chunks(next_, gave_way_.size(), budget, kStar, [this](std::size_t i) { give_way(gave_way_[i]); }))
    return;
  if (any_stay_) {
    left_in_ = 0;
    phase_ = Phase::kLeaveOut;
  } else {
    phase_ = Phase::kHash;
  }
}

// Corrects what was noted when the vertex was taken.
void VertexMover::give_way(const GaveWay& gave) {
  const VertexId v = gave.vertex;
  if (v == kNone) return;
  const auto at =
      static_cast<std::size_t>(std::lower_bound(moved_.begin(), moved_.end(), v) - moved_.begin());
  const auto change = [&](const Vec3& to) { return hash_of_move(std::span(&v, 1), std::span(&to, 1)); };
  hash_change_ ^= change(moved_positions_[at]);
  if (!gave.stays) hash_change_ ^= change(target_[v]);
  grid_.look_again(v, moved_positions_[at], target_[v], gave.stays);
  moved_positions_[at] = target_[v];
  any_stay_ = any_stay_ || gave.stays;
}

// Takes those that stay out of what has moved.
bool VertexMover::leave_out(WorkBudget& budget) {
  const bool done = in_chunks(next_, moved_.size(), budget, kSmall, [this](std::size_t i) {
    if (reach_[moved_[i]] == kStays) return;
    moved_[left_in_] = moved_[i];
    moved_positions_[left_in_++] = moved_positions_[i];
  });
  if (!done) return false;
  moved_.resize(left_in_);
  moved_positions_.resize(left_in_);
  return true;
}

void VertexMover::begin_following() {
  grid_.settle(grid_step());
  phase_ = Phase::kFollow;
}

void VertexMover::commit(Delta& delta) {
  delta.deformation.frame = positions_->frame;
  delta.deformation.moved = static_cast<std::uint32_t>(moved_.size());
  delta.deformation.passed_over = passed_over_;
  std::swap(delta.deformation.held, held_);
  vertices_hash_ ^= hash_change_;
  mesh_.deform(moved_, moved_positions_, hash_change_, delta);
  grid_.commit();
  positions_ = nullptr;
}

void VertexMover::archive(Archive& io) {
  late_.archive(io);
}

}  // namespace incise::core
