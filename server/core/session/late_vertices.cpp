#include "server/core/session/late_vertices.hpp"

#include <algorithm>
#include <utility>

#include "server/core/mesh/vertex_samples.hpp"
#include "server/core/session/in_chunks.hpp"
#include "server/core/stroke/affine_motion.hpp"
#include "server/core/util/room.hpp"

namespace incise::core {
namespace {

constexpr std::size_t kBlock = 64;  // vertices
// So many numbers are left for a step that begins.
constexpr std::uint32_t kLastSerial = 1u << 31;
// Of so many others it is told well enough how a vertex goes; else their neighbours are asked, too.
constexpr std::size_t kEnough = 6;
// How far the body may be strained from what it is at rest; what seems to be more is an accident of a few points.
constexpr double kMostFromRest = 4;
// Where none is known: so many of all vertices are looked at.
constexpr std::size_t kPartSamples = 512;
// What a block costs, in quarters of a unit of work, what a motion does, in units, and how many vertices that are looked at make one.
constexpr std::int64_t kBlockCost = 1, kPlaceCost = 20, kVerticesAUnit = 4;

}  // namespace

LateVertices::LateVertices(const TetMesh& mesh) : mesh_(mesh) {
  const std::size_t vertices = mesh.vertex_slots(), room = vertices + vertices / 4 + 65536;
  known_since_.reserve(room);
  known_since_.resize(vertices, 0);
  latest_.reserve(room / kBlock + 1);
  latest_.resize((vertices + kBlock - 1) / kBlock, 0);
}

void LateVertices::note_cut(const Delta& delta) {
  for (const VertexId v : delta.moved) {
    known_since_[v] = delta.revision;
    latest_[v / kBlock] = delta.revision;
  }
  const std::size_t before = known_since_.size(), now = mesh_.vertex_slots();
  if (now == before) return;
  known_since_.resize(now, delta.revision);
  latest_.resize((now + kBlock - 1) / kBlock, delta.revision);
  latest_[before / kBlock] = delta.revision;
}

bool LateVertices::is_known(const VertexPositions& positions, VertexId v) const {
  return v < mesh_.vertex_slots() && mesh_.vertex_tet(v) != kNone && known_since_[v] <= positions.revision;
}

const Vec3* LateVertices::wanted_place(const VertexPositions& positions, VertexId v) const {
  return is_known(positions, v) ? given_place(positions, v) : nullptr;
}

const Vec3* LateVertices::given_place(const VertexPositions& positions, VertexId v) const {
  std::size_t at = 0;
  if (positions.ids.empty()) {
    if (v < positions.first) return nullptr;
    at = v - positions.first;
  } else {
    const auto found = std::lower_bound(positions.ids.begin(), positions.ids.end(), v);
    if (found == positions.ids.end() || *found != v) return nullptr;
    at = static_cast<std::size_t>(found - positions.ids.begin());
  }
  return at < positions.positions.size() && is_place(positions.positions[at]) ? &positions.positions[at]
                                                                              : nullptr;
}

void LateVertices::begin(const VertexPositions& positions, std::span<const VertexPlace> clinging) {
  positions_ = &positions;
  clinging_ = clinging.size();
  phase_ = Phase::kFind;
  next_ = 0;
  late_.clear();
  front_.clear();
  placed_.clear();
  places_.assign(clinging.begin(), clinging.end());
  place_at_.resize(mesh_.vertex_slots(), 0);
  rings_.clear();
  ring_vertices_.clear();
  ring_at_.resize(mesh_.vertex_slots(), 0);
  // After hours.
  if (serial_ > kLastSerial) {
    met_.assign(met_.size(), 0);
    serial_ = 0;
  }
  met_.resize(mesh_.vertex_slots(), 0);
  note_places(0);
}

bool LateVertices::advance(WorkBudget& budget) {
  while (phase_ != Phase::kDone) {
    if (budget.spent()) return false;
    switch (phase_) {
      case Phase::kFind:
        if (!in_chunks(next_, latest_.size(), budget, kBlockCost, [this](std::size_t i) { find_in(i); }))
          break;
        front_ = late_;
        phase_ = Phase::kPlace;
        break;
      case Phase::kPlace:
        if (one_by_one(front_.size(), budget, [&](std::size_t i) { place(front_[i], budget); }))
          begin_spreading();
        break;
      case Phase::kSpread:
        if (one_by_one(placed_.size(), budget,
                       [&](std::size_t i) { ask_around(placed_[i].vertex, budget); })) {
          placed_.clear();
          phase_ = Phase::kPlace;
        }
        break;
      case Phase::kParts:
        if (one_by_one(late_.size(), budget, [&](std::size_t i) { place_part(late_[i], budget); })) finish();
        break;
      case Phase::kDone:
        break;
    }
  }
  return true;
}

template <class Work>
bool LateVertices::one_by_one(std::size_t count, WorkBudget& budget, Work work) {
  while (next_ < count) {
    if (budget.spent()) return false;
    budget.charge(1);
    work(next_++);
  }
  next_ = 0;
  return true;
}

void LateVertices::find_in(std::size_t block) {
  if (latest_[block] <= positions_->revision) return;
  const std::size_t stop = std::min((block + 1) * kBlock, known_since_.size());
  for (std::size_t i = block * kBlock; i < stop; ++i) {
    const auto v = static_cast<VertexId>(i);
    if (is_late(v) && mesh_.vertex_tet(v) != kNone && !has_place(v)) late_.push_back(v);
  }
}

// By what hangs on v and is known; where nothing is, v waits until something is.
void LateVertices::place(VertexId v, WorkBudget& budget) {
  around_.assign(1, v);
  look_farther(budget);
  if (from_.empty()) return;
  if (from_.size() < kEnough) look_farther(budget);
  placed_.push_back(
      {v, moves_ ? AffineMotion::fit(from_, to_, kMostFromRest)(mesh_.rest_position(v)) : mesh_.position(v)});
}

// Takes in the neighbours of what is around, and how those go that are known: from their places at rest, so that no step leaves an error to the next one.
void LateVertices::look_farther(WorkBudget& budget) {
  const std::size_t inner = around_.size();
  // Before the marks of this look, since a ring that is made needs its own.
  for (std::size_t i = 0; i < inner; ++i) ring_of(around_[i], budget);
  ++serial_;
  for (const VertexId w : around_) met_[w] = serial_;
  std::size_t looked_at = 0;
  for (std::size_t i = 0; i < inner; ++i) {
    const std::span<const VertexId> ring = ring_of(around_[i], budget);
    looked_at += ring.size();
    for (const VertexId w : ring) {
      if (std::exchange(met_[w], serial_) != serial_) around_.push_back(w);
    }
  }
  budget.charge(kPlaceCost + static_cast<std::int64_t>(looked_at) / kVerticesAUnit);
  std::sort(around_.begin(), around_.end());
  begin_fit();
  for (const VertexId w : around_) add_to_fit(w);
}

// Until the next one is asked for.
std::span<const VertexId> LateVertices::ring_of(VertexId v, WorkBudget& budget) {
  if (ring_at_[v] >= rings_.size() || rings_[ring_at_[v]].vertex != v) {
    ring_at_[v] = static_cast<std::uint32_t>(rings_.size());
    rings_.push_back({v, static_cast<std::uint32_t>(ring_vertices_.size())});
    met_[v] = ++serial_;
    ring_vertices_.push_back(v);
    mesh_.star(v, star_);
    budget.charge(static_cast<std::int64_t>(star_.size()));
    for (const std::uint32_t corner : star_) {
      for (const VertexId w : mesh_.vertices(tet_of(corner))) {
        if (std::exchange(met_[w], serial_) != serial_) ring_vertices_.push_back(w);
      }
    }
  }
  const std::size_t at = ring_at_[v], first = rings_[at].first;
  const std::size_t stop = at + 1 < rings_.size() ? rings_[at + 1].first : ring_vertices_.size();
  return std::span(ring_vertices_).subspan(first, stop - first);
}

void LateVertices::begin_fit() {
  from_.clear();
  to_.clear();
  moves_ = false;
}

void LateVertices::add_to_fit(VertexId w) {
  const Vec3* const to = place_of(w);
  if (to == nullptr) return;
  from_.push_back(mesh_.rest_position(w));
  to_.push_back(*to);
  moves_ = moves_ || *to != mesh_.position(w);
}

const Vec3* LateVertices::place_of(VertexId v) const {
  if (has_place(v)) return &places_[place_at_[v]].place;
  if (!is_known(*positions_, v)) return nullptr;
  const Vec3* const given = given_place(*positions_, v);
  return given != nullptr ? given : &mesh_.position(v);
}

void LateVertices::note_places(std::size_t first) {
  for (std::size_t i = first; i < places_.size(); ++i)
    place_at_[places_[i].vertex] = static_cast<std::uint32_t>(i);
}

// What has been placed counts from now on; who waited for it is asked next.
void LateVertices::begin_spreading() {
  const std::size_t before = places_.size();
  places_.insert(places_.end(), placed_.begin(), placed_.end());
  note_places(before);
  front_.clear();
  ++serial_;
  phase_ = placed_.empty() ? Phase::kParts : Phase::kSpread;
}

void LateVertices::ask_around(VertexId v, WorkBudget& budget) {
  // It has been placed, so its ring is there, and asking for it leaves the marks alone.
  const std::span<const VertexId> ring = ring_of(v, budget);
  budget.charge(static_cast<std::int64_t>(ring.size()) / kVerticesAUnit);
  for (const VertexId w : ring) {
    if (!is_late(w) || met_[w] == serial_ || has_place(w)) continue;
    met_[w] = serial_;
    front_.push_back(w);
  }
}

// A part of the body in which nothing is known goes as one, with what is known near it.
void LateVertices::place_part(VertexId v, WorkBudget& budget) {
  if (has_place(v)) return;
  const Vec3& middle = mesh_.rest_position(v);
  near_.clear();
  each_vertex_sample(mesh_, kPartSamples, [&](VertexId w) {
    if (is_known(*positions_, w)) near_.push_back({squared_length(mesh_.rest_position(w) - middle), w});
  });
  const auto last = near_.begin() + static_cast<std::ptrdiff_t>(std::min(near_.size(), kEnough));
  std::partial_sort(near_.begin(), last, near_.end());
  begin_fit();
  for (auto near = near_.begin(); near != last; ++near) add_to_fit(near->second);
  const AffineMotion motion = AffineMotion::fit(from_, to_, kMostFromRest);
  const std::size_t first = places_.size();
  const auto take = [&](VertexId w) {
    place_at_[w] = static_cast<std::uint32_t>(places_.size());
    places_.push_back({w, moves_ ? motion(mesh_.rest_position(w)) : mesh_.position(w)});
  };
  take(v);
  for (std::size_t i = first; i < places_.size(); ++i) {
    mesh_.star(places_[i].vertex, star_);
    for (const std::uint32_t corner : star_) {
      for (const VertexId w : mesh_.vertices(tet_of(corner))) {
        if (!has_place(w)) take(w);
      }
    }
  }
  budget.charge(static_cast<std::int64_t>(kPartSamples) / kVerticesAUnit +
                kPlaceCost * static_cast<std::int64_t>(places_.size() - first));
}

void LateVertices::finish() {
  std::ranges::sort(places_.begin() + static_cast<std::ptrdiff_t>(clinging_), places_.end(), {},
                    &VertexPlace::vertex);
  phase_ = Phase::kDone;
}

void LateVertices::archive(Archive& io) {
  io.list(known_since_, 8, [&](std::uint64_t& revision) { io(revision); });
  io.demand(known_since_.size() == mesh_.vertex_slots(), "revisions and vertices differ in number");
  if (!io.reads() || io.failed()) return;
  grow_to(known_since_, mesh_.vertex_slots());
  latest_.assign((known_since_.size() + kBlock - 1) / kBlock, 0);
  for (std::size_t v = 0; v < known_since_.size(); ++v)
    latest_[v / kBlock] = std::max(latest_[v / kBlock], known_since_[v]);
}

}  // namespace incise::core
