#include "protocol/box_follow.hpp"

#include <algorithm>
#include <cmath>

#include "protocol/apply_checks.hpp"

namespace incise::protocol {
namespace {

// How many steps like the last a shell lasts. More: fewer looks at the whole mesh, but more elements at each step.
constexpr double kStepsAhead = 16;
// Rounding, of doubles and of a surface's floats: relative to the box's coordinates, and in metres.
constexpr double kRounding = 1e-6, kRounding_m = 1e-9;

template <class T>
void append(std::vector<T>& out, std::span<const T> more) {
  out.insert(out.end(), more.begin(), more.end());
}

double largest_coordinate(const Box& box) {
  double largest = 0;
  for (const Vec3& p : {box.min, box.max})
    largest = std::max({largest, std::abs(p.x), std::abs(p.y), std::abs(p.z)});
  return largest;
}

Box widened(const Box& box, double by) {
  return {{box.min.x - by, box.min.y - by, box.min.z - by}, {box.max.x + by, box.max.y + by, box.max.z + by}};
}

bool inside(const Box& box, const Vec3& p) {
  return p.x >= box.min.x && p.x <= box.max.x && p.y >= box.min.y && p.y <= box.max.y && p.z >= box.min.z &&
         p.z <= box.max.z;
}

}  // namespace

bool meets(const Box& box, std::span<const Vec3> corners) {
  const auto apart = [&](double Vec3::*k) {
    double low = corners[0].*k, high = low;
    for (const Vec3& p : corners.subspan(1)) {
      low = std::min(low, p.*k);
      high = std::max(high, p.*k);
    }
    return high < box.min.*k || low > box.max.*k;
  };
  return !apart(&Vec3::x) && !apart(&Vec3::y) && !apart(&Vec3::z);
}

// ---- The tetrahedra at a vertex ----

void TetIndex::link(std::uint32_t vertex, std::uint32_t corner) {
  next_[corner] = first_[vertex];
  first_[vertex] = corner;
}

void TetIndex::unlink(std::uint32_t vertex, std::uint32_t corner) {
  std::uint32_t* place = &first_[vertex];
  while (*place != corner) place = &next_[*place];
  *place = next_[corner];
}

void TetIndex::load(const Replica& mesh) {
  first_.assign(mesh.vertex_count(), kNoId);
  next_.assign(4 * std::size_t{mesh.tet_slots()}, kNoId);
  mesh.for_each_tet([&](std::uint32_t t) {
    for (std::uint32_t k = 0; k < 4; ++k) link(mesh.vertices(t)[k], 4 * t + k);
  });
}

void TetIndex::follow(const Replica& before, const Delta& delta) {
  first_.resize(delta.vertex_count, kNoId);
  if (!delta.tets.ids.empty()) {
    const std::size_t corners = 4 * (delta.tets.ids.back() + std::size_t{1});
    if (corners > next_.size()) next_.resize(corners, kNoId);
  }
  for (const std::uint32_t t : delta.removed_tets)
    for (std::uint32_t k = 0; k < 4; ++k) unlink(before.vertices(t)[k], 4 * t + k);
  for (std::size_t i = 0; i < delta.tets.ids.size(); ++i) {
    const std::uint32_t t = delta.tets.ids[i];
    const bool was = before.alive(t);
    for (std::uint32_t k = 0; k < 4; ++k) {
      const std::uint32_t now = delta.tets.vertices[4 * i + k];
      if (was && before.vertices(t)[k] == now) continue;
      if (was) unlink(before.vertices(t)[k], 4 * t + k);
      link(now, 4 * t + k);
    }
  }
}

void TetIndex::append_tets(std::uint32_t vertex, std::vector<std::uint32_t>& out) const {
  for (std::uint32_t corner = first_[vertex]; corner != kNoId; corner = next_[corner])
    out.push_back(corner / 4);
}

// ---- What changed ----

MeshChange::MeshChange(const Replica& before, const Delta& d)
    : base_revision(d.base_revision),
      revision(d.revision),
      steps(d.steps),
      first_added(d.vertex_count - static_cast<std::uint32_t>(d.provenance_t.size())),
      first_new_tet(d.first_new_tet),
      provenance_a(d.provenance_a.begin(), d.provenance_a.end()),
      provenance_b(d.provenance_b.begin(), d.provenance_b.end()),
      provenance_t(d.provenance_t.begin(), d.provenance_t.end()),
      vertex_count(d.vertex_count),
      live_tets(d.live_tets),
      state_hash(d.state_hash) {
  for (const auto ids : {d.tets.ids, d.removed_tets}) protocol::append(tets, ids);
  const auto cuts = [](const Step& step) { return step.stroke != 0; };
  deformed = !std::all_of(steps.begin(), steps.end(), cuts);
  if (!deformed || std::any_of(steps.begin(), steps.end(), cuts)) protocol::append(cut_moved, d.moved_ids);
  if (!deformed) return;
  for (std::size_t i = 0; i < d.moved_ids.size(); ++i) {
    const Vec3 p = before.position(d.moved_ids[i]);
    const double* to = &d.moved_positions[3 * i];
    travel_m = std::max({travel_m, std::abs(to[0] - p.x), std::abs(to[1] - p.y), std::abs(to[2] - p.z)});
  }
}

void MeshChange::append(const MeshChange& next) {
  revision = next.revision;
  protocol::append<Step>(steps, next.steps);
  protocol::append<std::uint32_t>(tets, next.tets);
  protocol::append<std::uint32_t>(cut_moved, next.cut_moved);
  deformed = deformed || next.deformed;
  travel_m += next.travel_m;
  protocol::append<std::uint32_t>(provenance_a, next.provenance_a);
  protocol::append<std::uint32_t>(provenance_b, next.provenance_b);
  protocol::append<double>(provenance_t, next.provenance_t);
  vertex_count = next.vertex_count;
  live_tets = next.live_tets;
  state_hash = next.state_hash;
}

std::size_t MeshChange::bytes() const {
  return sizeof *this + steps.size() * sizeof(Step) + 16 * provenance_t.size() +
         4 * (tets.size() + cut_moved.size());
}

// ---- The faces of a box ----

bool BoxShell::covers(double travel_m) {
  left_m_ -= travel_m;
  return left_m_ >= 0;
}

void BoxShell::begin(const Box& box, double travel_m) {
  left_m_ = kStepsAhead * travel_m;
  const double margin = left_m_ + kRounding * largest_coordinate(box) + kRounding_m;
  outer_ = widened(box, margin);
  inner_ = widened(box, -margin);
  ids_.clear();
  compact_at_ = 0;
}

void BoxShell::add(std::uint32_t id, std::span<const Vec3> corners) {
  if (left_m_ < 0 || !meets(outer_, corners)) return;
  // A corner that stays in the box keeps the element there.
  for (const Vec3& p : corners)
    if (inside(inner_, p)) return;
  ids_.push_back(id);
  if (ids_.size() < 2 * compact_at_ + 1024) return;
  sort_unique(ids_);
  compact_at_ = ids_.size();
}

}  // namespace incise::protocol
