#include "server/core/session/vertex_mover.hpp"

#include <algorithm>
#include <cmath>
#include <span>

#include "server/core/geometry/predicates.hpp"
#include "server/core/session/in_chunks.hpp"
#include "server/core/stroke/stroke_builder.hpp"

namespace incise::core {
namespace {

// Six times the volume below which a tetrahedron is flat, in cubes of the local edge length. A regular one has 0.7.
constexpr double kThinnest = 1e-3;
// A flat one that keeps this much of its volume gets no thinner: it turns with the body, and the rest is rounding.
constexpr double kAsThick = 1 - 1e-6;
// A tetrahedron that would be thick enough where edges are this many times the mean length is thick enough anywhere: then the
// local length is not looked up.
constexpr double kLocallyAtMost = 4;
// Longer edges than this many mean lengths are left to exact arithmetic.
constexpr double kLongest = 8;
constexpr TetId kAhead = 12;  // tetrahedra, of what is to be fetched
// What elements cost, in quarters of a unit of work: a number or a tetrahedron, and a star.
constexpr std::int64_t kSmall = 1, kStar = 20;

double six_volumes(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  return dot(cross(b - a, c - a), d - a);
}

}  // namespace

VertexMover::VertexMover(TetMesh& mesh, CutWorkspace& workspace)
    : mesh_(mesh), workspace_(workspace), pass_(workspace), grid_(mesh, workspace) {
  known_since_.reserve(mesh.vertex_slots() + mesh.vertex_slots() / 4 + 65536);
  known_since_.resize(mesh.vertex_slots(), 0);
}

void VertexMover::note_cut(const Delta& delta) {
  for (const VertexId v : delta.moved) {
    known_since_[v] = delta.revision;
    if (v < target_.size()) target_.set(v, mesh_.position(v));
  }
  known_since_.resize(mesh_.vertex_slots(), delta.revision);
}

void VertexMover::begin(const VertexPositions& positions, const std::vector<VertexId>& clinging) {
  positions_ = &positions;
  phase_ = Phase::kTake;
  next_ = 0;
  serial_ = workspace_.next_serial();
  const std::size_t vertices = mesh_.vertex_slots();
  wanted_.resize(vertices, 0);
  clinging_.resize(vertices, 0);
  gives_way_.resize(vertices, 0);
  reach_.resize(vertices, kStays);
  while (target_.size() < vertices) target_.push_back(mesh_.position(static_cast<VertexId>(target_.size())));
  for (const VertexId v : clinging) clinging_[v] = serial_;
  moving_.clear();
  first_round_ = true;
  to_check_.clear();
  boundary_.clear();
  too_far_.clear();
  passed_over_ = 0;
  held_.clear();
  moved_.clear();
  moved_positions_.clear();
  hash_change_ = 0;
  grid_.begin();
  const double h = kLocallyAtMost * mesh_.mean_edge_length();
  surely_thick_ = kThinnest * h * h * h;
}

bool VertexMover::advance(WorkBudget& budget) {
  while (phase_ != Phase::kReady) {
    if (budget.spent()) return false;
    switch (phase_) {
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

void VertexMover::take(WorkBudget& budget) {
  const auto& entries = positions_->positions;
  const bool done = in_chunks(next_, entries.size(), budget, kSmall, [&](std::size_t i) {
    const VertexId v = positions_->id(i);
    const Vec3& p = entries[i];
    if (v >= mesh_.vertex_slots() || mesh_.vertex_tet(v) == kNone || known_since_[v] > positions_->revision) {
      ++passed_over_;
      return;
    }
    if (wanted(v) || (!moving_.empty() && v < moving_.back())) return;
    const Vec3& now = mesh_.position(v);
    if (p.x == now.x && p.y == now.y && p.z == now.z) return;
    if (clinging_[v] == serial_ || !is_finite(p) || length(p) > kFarthest_m) {
      held_.push_back(v);
      return;
    }
    wanted_[v] = serial_;
    reach_[v] = kFull;
    target_.set(v, p);
    moving_.push_back(v);
  });
  if (!done) return;
  // One pass over all tetrahedra is faster than visiting the stars of most vertices, which reach each tetrahedron four times.
  all_tets_ = moving_.size() > mesh_.tet_slots() / 16;
  pass_.begin();
  phase_ = all_tets_ ? Phase::kCheck : Phase::kLook;
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
  if (in_chunks(next_, moving_.size(), budget, kStar, [this](std::size_t i) { look_around(moving_[i]); }))
    phase_ = Phase::kCheck;
}

void VertexMover::check(WorkBudget& budget) {
  if (next_ == 0) target_.begin_looking(surely_thick_, kLongest * mesh_.mean_edge_length());
  const std::size_t count = all_tets_ ? mesh_.tet_slots() : to_check_.size();
  const bool done = in_chunks(next_, count, budget, kSmall, [this, count](std::size_t i) {
    const TetId t = all_tets_ ? static_cast<TetId>(i) : to_check_[i];
    // In a mesh file neighbours lie anywhere, and a large one's vertices are not in the nearer caches.
    if (all_tets_ && i + kAhead < count && mesh_.alive(t + kAhead)) {
      for (const VertexId v : mesh_.vertices(t + kAhead)) target_.prefetch(v);
    }
    if (!mesh_.alive(t)) return;
    if (!target_.surely_thick(mesh_.vertices(t))) check_tet(t);
    if (first_round_ && mesh_.on_boundary(t)) boundary_.push_back({t, mesh_.vertices(t)});
  });
  if (!done) return;
  all_tets_ = false;
  first_round_ = false;
  to_check_.clear();
  pass_.begin();
  phase_ = too_far_.empty() ? Phase::kSettle : Phase::kYield;
}

void VertexMover::check_tet(TetId t) {
  const auto& v = mesh_.vertices(t);
  const Vec3 &a = target_[v[0]], &b = target_[v[1]], &c = target_[v[2]], &d = target_[v[3]];
  const double then = six_volumes(a, b, c, d);
  if (then >= surely_thick_) return;
  // Thicker than before is good enough; the local length takes a walk around the vertex.
  const double now =
      six_volumes(mesh_.position(v[0]), mesh_.position(v[1]), mesh_.position(v[2]), mesh_.position(v[3]));
  if (then >= kAsThick * now && orient3d(a, b, c, d) > 0) return;
  const double h = mesh_.local_h(v[0]);
  if (then >= kThinnest * h * h * h) return;
  for (const VertexId w : v) {
    if (!wanted(w) || reach_[w] == kStays || gives_way_[w] == pass_.serial()) continue;
    gives_way_[w] = pass_.serial();
    too_far_.push_back(w);
  }
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

void VertexMover::settle(WorkBudget& budget) {
  if (next_ == 0) {
    // With room, since cuts add some vertices between any two steps.
    const std::size_t most = moving_.size() + moving_.size() / 4;
    if (moved_.capacity() < moving_.size()) moved_.reserve(most);
    if (moved_positions_.capacity() < moving_.size()) moved_positions_.reserve(most);
  }
  const auto settle_some = [this](std::size_t first, std::size_t stop) {
    const std::size_t before = moved_.size();
    for (std::size_t i = first; i < stop; ++i) {
      const VertexId v = moving_[i];
      if (reach_[v] == kStays) continue;
      moved_.push_back(v);
      moved_positions_.push_back(target_[v]);
      grid_.look_at(target_[v]);
    }
    hash_change_ ^=
        mesh_.hash_change(std::span(moved_).subspan(before), std::span(moved_positions_).subspan(before));
  };
  const bool done = chunk_by_chunk(next_, moving_.size(), budget, kSmall, settle_some);
  if (!done) return;
  std::sort(held_.begin(), held_.end());
  grid_.settle(grid_step());
  phase_ = Phase::kFollow;
}

void VertexMover::commit(Delta& delta) {
  delta.deformation.frame = positions_->frame;
  delta.deformation.moved = static_cast<std::uint32_t>(moved_.size());
  delta.deformation.passed_over = passed_over_;
  std::swap(delta.deformation.held, held_);
  mesh_.deform(moved_, moved_positions_, hash_change_, delta);
  grid_.commit();
  positions_ = nullptr;
}

void VertexMover::archive(Archive& io) {
  io.list(known_since_, 8, [&](std::uint64_t& revision) { io(revision); });
  io.demand(known_since_.size() == mesh_.vertex_slots(), "revisions and vertices differ in number");
  if (io.reads() && !io.failed()) grow_to(known_since_, mesh_.vertex_slots());
}

}  // namespace incise::core
