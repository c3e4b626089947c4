#include "server/core/session/late_vertices.hpp"

#include <algorithm>

#include "server/core/session/in_chunks.hpp"
#include "server/core/stroke/affine_motion.hpp"
#include "server/core/util/room.hpp"

namespace incise::core {
namespace {

constexpr std::size_t kBlock = 64;  // vertices
// Of so many others it is told well enough how a vertex goes; else their neighbours are asked, too.
constexpr std::size_t kEnough = 8;
// What elements cost, in quarters of a unit of work: a block, and a vertex whose motion is fitted.
constexpr std::int64_t kLook = 1, kFit = 80;

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
  if (!is_known(positions, v)) return nullptr;
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
  clinging_ = clinging;
  finds_ = true;
  next_ = 0;
  late_.clear();
  later_.clear();
  places_.clear();
  placed_.clear();
}

bool LateVertices::advance(WorkBudget& budget) {
  if (finds_ && !in_chunks(next_, latest_.size(), budget, kLook, [this](std::size_t i) { find_in(i); }))
    return false;
  finds_ = false;
  while (!late_.empty()) {
    if (!in_chunks(next_, late_.size(), budget, kFit, [this](std::size_t i) { place(late_[i]); }))
      return false;
    // What hangs on nothing that is known stays.
    if (placed_.empty()) break;
    places_.insert(places_.end(), placed_.begin(), placed_.end());
    std::ranges::sort(places_, {}, &VertexPlace::vertex);
    placed_.clear();
    std::swap(late_, later_);
    later_.clear();
  }
  return true;
}

void LateVertices::find_in(std::size_t block) {
  if (latest_[block] <= positions_->revision) return;
  const std::size_t stop = std::min((block + 1) * kBlock, known_since_.size());
  for (std::size_t i = block * kBlock; i < stop; ++i) {
    const auto v = static_cast<VertexId>(i);
    if (known_since_[v] <= positions_->revision || mesh_.vertex_tet(v) == kNone) continue;
    if (!std::ranges::binary_search(clinging_, v, {}, &VertexPlace::vertex)) late_.push_back(v);
  }
}

void LateVertices::place(VertexId v) {
  around_.assign(1, v);
  from_.clear();
  for (int ring = 0; ring < 2 && from_.size() < kEnough; ++ring) look_farther();
  if (from_.empty()) {
    later_.push_back(v);
    return;
  }
  placed_.push_back({v, moves_ ? AffineMotion::fit(from_, to_)(mesh_.rest_position(v)) : mesh_.position(v)});
}

// Takes in the neighbours of what is around, and how those go that are known: from their places at rest, so that no step leaves an error to the next one.
void LateVertices::look_farther() {
  const std::size_t inner = around_.size();
  for (std::size_t i = 0; i < inner; ++i) {
    mesh_.star(around_[i], star_);
    for (const std::uint32_t corner : star_) {
      const auto& all = mesh_.vertices(tet_of(corner));
      around_.insert(around_.end(), all.begin(), all.end());
    }
  }
  std::sort(around_.begin(), around_.end());
  around_.erase(std::unique(around_.begin(), around_.end()), around_.end());
  from_.clear();
  to_.clear();
  moves_ = false;
  for (const VertexId w : around_) {
    const Vec3* const to = place_of(w);
    if (to == nullptr) continue;
    from_.push_back(mesh_.rest_position(w));
    to_.push_back(*to);
    moves_ = moves_ || *to != mesh_.position(w);
  }
}

const Vec3* LateVertices::place_of(VertexId v) const {
  for (const std::span<const VertexPlace> given : {clinging_, std::span<const VertexPlace>(places_)}) {
    const auto found = std::ranges::lower_bound(given, v, {}, &VertexPlace::vertex);
    if (found != given.end() && found->vertex == v) return &found->place;
  }
  if (!is_known(*positions_, v)) return nullptr;
  const Vec3* const wanted = wanted_place(*positions_, v);
  return wanted != nullptr ? wanted : &mesh_.position(v);
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
