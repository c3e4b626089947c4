#include "server/core/session/cut_session.hpp"

#include <algorithm>
#include <string>
#include <utility>

#include "server/base/check.hpp"
#include "server/core/cut/conforming/conforming_cutter.hpp"
#include "server/core/cut/croll/croll_cutter.hpp"
#include "server/core/cut/cut_ends.hpp"
#include "server/core/cut/cut_memory.hpp"
#include "server/core/geometry/quality.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/core/mesh/vertex_samples.hpp"
#include "server/core/session/session_state.hpp"

namespace incise::core {
namespace {

// A blade that stands holds the tissue at it. What is at one that moves goes no farther in a step than this many times as far as the blade since the last one: a hand
// that follows the body while it cuts against its way goes less far than that.
constexpr double kFollows = 4;
// So many steps are known that tissue at a blade has followed: when it stands, it may be as many before its last lines are cut.
constexpr std::size_t kMostSteps = 256;
// By so many of its vertices it is known how a body moves as a whole.
constexpr std::size_t kSamples = 64;

}  // namespace

CutSession::CutSession(const MeshData& mesh, const CutConfig& config, std::span<const Field> fields)
    : mesh_(mesh),
      config_(config),
      workspace_(mesh_),
      pieces_(mesh_),
      fields_(fields, mesh, mesh_),
      measured_(workspace_),
      mover_(mesh_, workspace_, pieces_.clusters(), config.policy != Policy::kCroll),
      follower_(mesh_, workspace_) {
  recall(has_its_cut_memory(mesh) ? std::span(mesh.cut_memory) : std::span<const std::byte>());
}

CutSession::CutSession(const LoadedBody& body, const CutConfig& config)
    : mesh_(body.mesh()),
      config_(config),
      workspace_(mesh_, body.grid()),
      pieces_(mesh_, body.clusters()),
      fields_(body.fields()),
      measured_(workspace_),
      mover_(mesh_, workspace_, pieces_.clusters(), config.policy != Policy::kCroll),
      follower_(mesh_, workspace_) {
  recall(body.cut_memory());
}

CutSession::~CutSession() = default;

// What blades have left in the body that it begins with.
void CutSession::recall(std::span<const std::byte> cut_memory) {
  if (!cut_memory.empty() && restore_cut_memory(cut_memory, mesh_, workspace_, stroke_counter_)) return;
  if (!mesh_.came_cut()) return;
  workspace_.swept.lack_what_was_before();
  remember_cut_ends(mesh_, workspace_.swept);
}

MeshData CutSession::export_data() const {
  MeshData data = mesh_.export_data();
  data.cut_memory = save_cut_memory(workspace_, mesh_, stroke_counter_, data);
  return data;
}

CutSession::Source& CutSession::source(std::uint32_t number) {
  if (!sources_[number]) set_blade(number, config_.blade);
  return *sources_[number];
}

void CutSession::set_blade(std::uint32_t number, const Blade& blade) {
  INCISE_CHECK(number < kMaxSources, number);
  if (sources_[number]) end_stroke(number);
  CutConfig config = config_;
  config.blade = blade;
  std::unique_ptr<Cutter> cutter;
  std::vector<Followed> followed;
  if (sources_[number]) {
    cutter = std::move(sources_[number]->cutter);
    followed = std::move(sources_[number]->followed);
  } else if (config_.policy == Policy::kCroll) {
    cutter = std::make_unique<CrollCutter>(mesh_);
  } else {
    cutter = std::make_unique<ConformingCutter>(mesh_, workspace_, config_);
  }
  sources_[number].reset(new Source{StrokeBuilder(number, config, mesh_.mean_edge_length(), stroke_counter_),
                                    std::move(cutter), std::move(followed)});
}

PoseVerdict CutSession::push(std::uint32_t number, const Pose& pose) {
  if (number >= kMaxSources) return PoseVerdict::kUnknownSource;
  return source(number).builder.push(pose, queue_, deformed_ + deformations_);
}

void CutSession::end_stroke(std::uint32_t number) {
  if (number < kMaxSources && sources_[number]) sources_[number]->builder.end_stroke(queue_);
}

bool CutSession::in_stroke(std::uint32_t number) const {
  return number < kMaxSources && sources_[number] && sources_[number]->builder.in_stroke();
}

CutCounts CutSession::running_counts() const {
  return stage_ == Stage::kWaiting ? CutCounts{} : sources_[queue_.front().source]->cutter->counts();
}

void CutSession::prefetch() {
  if (!queue_.empty()) return;
  for (const auto& source : sources_) {
    if (source && source->builder.in_stroke()) source->cutter->prefetch();
  }
}

void CutSession::deform(std::shared_ptr<const VertexPositions> positions) {
  Batch& batch = deformation_;
  batch.source = batch.stroke = batch.number = 0;
  batch.ends_stroke = false;
  batch.lines.assign(1, {});
  batch.from_t_ns = batch.to_t_ns = positions->source_ns;
  batch.deformation = std::move(positions);
  batch.ways_m.assign(kMaxSources, 0);
  for (std::uint32_t number = 0; number < kMaxSources; ++number) {
    if (sources_[number]) batch.ways_m[number] = sources_[number]->builder.take_way();
  }
  queue_.push(batch);
  batch.deformation.reset();
  ++deformations_;
}

// What clings to the blades, and where it goes.
void CutSession::find_clinging(bool may_follow) {
  clinging_.clear();
  // Croll's cut relies on no place.
  if (config_.policy == Policy::kCroll) return;
  for (std::uint32_t number = 0; number < kMaxSources; ++number) {
    follows_[number].reset();
    std::vector<VertexId>& vertices = at_blade_[number];
    vertices.clear();
    if (!sources_[number]) continue;
    sources_[number]->cutter->clinging(vertices);
    // Each once before they are sorted: most are there many times, and this can not be interrupted.
    const std::uint32_t serial = workspace_.next_serial();
    std::erase_if(vertices, [&](VertexId v) {
      return std::exchange(workspace_.vertices[v].looked_at, serial) == serial;
    });
    std::ranges::sort(vertices);
  }
  for (std::uint32_t number = 0; number < kMaxSources; ++number) {
    if (!at_blade_[number].empty()) cling(number, queue_.front().ways_m, may_follow);
  }
  std::ranges::sort(clinging_, {}, &VertexPlace::vertex);
  const auto same = [](const VertexPlace& a, const VertexPlace& b) { return a.vertex == b.vertex; };
  clinging_.erase(std::unique(clinging_.begin(), clinging_.end(), same), clinging_.end());
}

// How far places go by a motion, in the mean.
double CutSession::way_of(const AffineMotion& motion, std::span<const Vec3> places) {
  double way_m = 0;
  for (const Vec3& p : places) way_m += distance(motion(p), p) / static_cast<double>(places.size());
  return way_m;
}

// How the body goes as a whole in the step that is about to be made, whatever the simulation wanted.
AffineMotion CutSession::motion_of_body() {
  from_.clear();
  to_.clear();
  each_vertex_sample(mesh_, kSamples, [this](VertexId v) {
    from_.push_back(mesh_.position(v));
    to_.push_back(mover_.place_after(v));
  });
  const AffineMotion motion = AffineMotion::fit(from_, to_);
  return follows(way_of(motion, from_)) ? motion : AffineMotion();
}

// A blade at which nothing clings may just have come upon the tissue by a way that is not cut yet: that goes along with the body as a whole.
void CutSession::lead_free_blades() {
  std::optional<AffineMotion> as_a_whole;
  for (std::uint32_t number = 0; number < kMaxSources; ++number) {
    if (!sources_[number] || follows_[number]) continue;
    if (!as_a_whole) as_a_whole = motion_of_body();
    follows_[number] = as_a_whole;
  }
}

// What clings to a blade, and to others that have some of it at them, goes as the simulation wants it to, but what is straight in it stays so.
void CutSession::cling(std::uint32_t first, const std::vector<double>& ways_m, bool may_follow) {
  std::vector<VertexId>& vertices = at_blade_[first];
  std::array<bool, kMaxSources> together{};
  together[first] = true;
  double most_m = kFollows * ways_m[first];
  const auto shares = [&](VertexId v) { return std::ranges::binary_search(vertices, v); };
  for (bool more = true; more;) {
    more = false;
    for (std::uint32_t other = first + 1; other < kMaxSources; ++other) {
      if (together[other] || std::ranges::none_of(at_blade_[other], shares)) continue;
      together[other] = more = true;
      most_m = std::min(most_m, kFollows * ways_m[other]);
      vertices.insert(vertices.end(), at_blade_[other].begin(), at_blade_[other].end());
      at_blade_[other].clear();
      std::ranges::sort(vertices);
    }
  }
  from_.clear();
  to_.clear();
  for (const VertexId v : vertices) {
    const Vec3* const wanted = mover_.wanted_place(*queue_.front().deformation, v);
    if (wanted == nullptr) continue;
    from_.push_back(mesh_.position(v));
    to_.push_back(*wanted);
  }
  AffineMotion motion = AffineMotion::fit(from_, to_);
  const double way_m = way_of(motion, from_), by_m = may_follow ? std::min(way_m, most_m) : 0;
  if (!follows(by_m)) {
    motion = {};
  } else if (by_m < way_m) {
    motion = motion.part(by_m / way_m);
  }
  for (std::uint32_t number = first; number < kMaxSources; ++number) {
    if (together[number]) follows_[number] = motion;
  }
  for (const VertexId v : vertices)
    clinging_.push_back({v, motion.moves() ? motion(mesh_.position(v)) : mesh_.position(v)});
}

// A batch as the blade has gone through the tissue, which has moved since the blade was at its lines.
const Batch& CutSession::where_tissue_is(const Batch& batch, std::vector<Followed>& followed) {
  if (followed.empty()) return batch;
  batch_ = batch;
  for (std::size_t i = 0; i < batch_.lines.size(); ++i) {
    for (const Followed& step : followed) {
      if (step.number > batch_.steps[i]) batch_.lines[i] = step.motion(batch_.lines[i]);
    }
  }
  if (batch.ends_stroke) followed.clear();
  std::erase_if(followed, [&](const Followed& step) { return step.number <= batch.steps.back(); });
  return batch_;
}

void CutSession::begin_moving(const std::vector<GaveWay>* known) {
  find_clinging(known == nullptr || known->empty() || known->back().vertex != kNone);
  mover_.begin(*queue_.front().deformation, clinging_, known);
}

CutSession::Progress CutSession::advance_deformation(WorkBudget& budget, Delta& delta,
                                                     const std::vector<GaveWay>* known) {
  if (!begun_) {
    begin_moving(known);
    follower_.begin();
    begun_ = true;
  }
  if (!follower_.advance(budget)) return Progress::kSpent;
  if (!mover_.advance(budget)) return Progress::kSpent;
  if (mover_.clinging_gives_way()) {
    find_clinging(false);
    mover_.begin_again(*queue_.front().deformation, clinging_);
    if (!mover_.advance(budget)) return Progress::kSpent;
  }
  if (!follower_.work_out(mover_.places_after(), budget)) return Progress::kSpent;
  // Moving them takes some 2 ns a vertex and cannot be interrupted: the caller may want to start it at a better time.
  if (!moves_next_ && budget.left < static_cast<std::int64_t>(mover_.moving())) {
    moves_next_ = true;
    return Progress::kSpent;
  }
  begun_ = moves_next_ = false;
  --deformations_;
  queue_.pop(committed_);
  committed_counts_ = {};
  describe(delta);
  follower_.note();
  if (config_.policy != Policy::kCroll) lead_free_blades();
  mover_.commit(delta);
  follower_.follow();
  ++deformed_;
  for (std::uint32_t number = 0; number < kMaxSources; ++number) {
    if (!follows_[number] || !follows_[number]->moves()) continue;
    sources_[number]->cutter->follow(*follows_[number]);
    std::vector<Followed>& followed = sources_[number]->followed;
    if (followed.size() == kMostSteps) followed.erase(followed.begin());
    followed.push_back({deformed_, *follows_[number]});
  }
  committed_.deformation.reset();
#ifdef INCISE_VALIDATE
  const std::string problem = validate(mesh_, config_.policy != Policy::kCroll);
  INCISE_CHECK(problem.empty(), problem, revision_);
#endif
  delta.min_dihedral_deg = 180;
  return Progress::kCommitted;
}

// The oldest batch, or a part of it: the first one has the motion, the last one may end the stroke.
void CutSession::take_committed() {
  if (is_whole_) {
    queue_.pop(committed_);
  } else {
    committed_ = queue_.front();
    committed_.ends_stroke = false;
  }
  if (parts_ > 0) {
    committed_.lines.assign(1, BladeLine(committed_.lines.back()));
    committed_.from_t_ns = committed_.to_t_ns;
  }
  parts_ = is_whole_ ? 0 : parts_ + 1;
}

// The identifying fields of a delta.
void CutSession::describe(Delta& delta) {
  delta.revision = ++revision_;
  delta.source = committed_.source;
  delta.stroke = committed_.stroke;
  delta.batch = committed_.number;
  delta.stroke_ended = committed_.ends_stroke;
  delta.from = committed_.lines.front();
  delta.to = committed_.lines.back();
  delta.from_t_ns = committed_.from_t_ns;
  delta.to_t_ns = committed_.to_t_ns;
  delta.snaps = committed_counts_.snaps;
  delta.splits = committed_counts_.splits;
  delta.max_deviation_h = committed_counts_.max_deviation_h;
}

CutSession::Progress CutSession::advance(WorkBudget& budget, Delta& delta,
                                         const std::vector<GaveWay>* known) {
  if (queue_.empty()) return Progress::kIdle;
  if (queue_.front().deformation) return advance_deformation(budget, delta, known);
  Cutter& cutter = *sources_[queue_.front().source]->cutter;
  if (stage_ == Stage::kWaiting) {
    cutter.begin(where_tissue_is(queue_.front(), sources_[queue_.front().source]->followed));
    stage_ = Stage::kCutting;
  }
  if (stage_ == Stage::kCutting) {
    const Cutter::Progress progress = cutter.advance(budget);
    if (progress == Cutter::Progress::kSpent) return Progress::kSpent;
    is_whole_ = progress == Cutter::Progress::kDone;
    workspace_.grow(mesh_);
#ifdef INCISE_VALIDATE
    const std::string problem = validate_near(mesh_, mesh_.touched_tets(), config_.policy != Policy::kCroll);
    INCISE_CHECK(problem.empty(), problem, revision_);
#endif
    pieces_.begin();
    stage_ = Stage::kPieces;
  }
  if (!finish(budget)) return Progress::kSpent;
  stage_ = is_whole_ ? Stage::kWaiting : Stage::kCutting;
  take_committed();
  committed_counts_ = cutter.counts();
  describe(made_);
  const double worst = worst_.worst();
  made_.min_dihedral_deg = worst > -kInverted ? measure_to_degrees(worst) : 180.0;
  mover_.note_cut(made_);
  fields_.apply(made_);
  std::swap(made_, delta);
  return Progress::kCommitted;
}

// What a cut batch still needs, in portions.
bool CutSession::finish(WorkBudget& budget) {
  if (stage_ == Stage::kPieces) {
    if (!pieces_.advance(budget, made_)) return false;
    stage_ = Stage::kCommitting;
  }
  if (stage_ == Stage::kCommitting) {
    if (!mesh_.commit(made_, budget)) return false;
    next_upserted_ = next_moved_ = 0;
    worst_.begin();
    measured_.begin();
    stage_ = Stage::kMeasuring;
  }
  return measure(budget);
}

// The worst angle of the tetrahedra that the delta names and of those around vertices that moved.
bool CutSession::measure(WorkBudget& budget) {
  const auto look_at = [this](TetId t) {
    if (!measured_.insert(t)) return;
    const auto& v = mesh_.vertices(t);
    worst_.add(mesh_.position(v[0]), mesh_.position(v[1]), mesh_.position(v[2]), mesh_.position(v[3]));
  };
  for (; next_upserted_ < made_.upserted.size(); ++next_upserted_) {
    if (budget.spent()) return false;
    budget.charge(2);
    const TetState& tet = made_.upserted[next_upserted_];
    if (next_upserted_ + 4 < made_.upserted.size()) {
      const TetState& soon = made_.upserted[next_upserted_ + 4];
      __builtin_prefetch(&workspace_.tets[soon.id]);
      mesh_.prefetch(soon.id);
      for (VertexId v : soon.vertices) mesh_.prefetch_position(v);
    }
    look_at(tet.id);
    // The policy `croll` does not use the grid itself.
    if (config_.policy == Policy::kCroll && tet.boundary_mask != 0) workspace_.grid.add(mesh_, tet.id);
  }
  for (; next_moved_ < made_.moved.size(); ++next_moved_) {
    if (budget.spent()) return false;
    if (next_moved_ + 4 < made_.moved.size()) {
      mesh_.prefetch_position(made_.moved[next_moved_ + 4]);
      mesh_.prefetch_star(made_.moved[next_moved_ + 2]);
    }
    mesh_.star(made_.moved[next_moved_], star_);
    budget.charge(static_cast<std::int64_t>(star_.size() + 1));
    for (std::uint32_t corner : star_) look_at(tet_of(corner));
  }
  return true;
}

void CutSession::archive(Archive& io) {
  std::uint32_t version = kSessionStateVersion;
  io(version);
  io.demand(version == kSessionStateVersion, "it is of another version");
  auto policy = static_cast<std::uint8_t>(config_.policy);
  io(policy);
  io.demand(policy == static_cast<std::uint8_t>(config_.policy), "it is of another policy");
  if (io.failed()) return;
  io(revision_);
  io(stroke_counter_);
  io(deformed_);
  mesh_.archive(io);
  if (io.failed()) return;
  pieces_.archive(io);
  workspace_.archive(io, mesh_);
  mover_.archive(io);
  for (std::uint32_t number = 0; number < kMaxSources; ++number) archive_source(io, number);
  fields_.archive(io, mesh_);
}

void CutSession::archive_source(Archive& io, std::uint32_t number) {
  bool exists = sources_[number] != nullptr;
  io(exists);
  if (!exists) return;
  Blade blade;
  if (!io.reads()) blade = sources_[number]->builder.blade();
  io(blade.heel);
  io(blade.tip);
  if (io.failed()) return;
  if (io.reads()) set_blade(number, blade);
  StrokeBuilder& builder = sources_[number]->builder;
  Cutter& cutter = *sources_[number]->cutter;
  builder.archive(io);
  cutter.archive(io);
  std::vector<Followed>& followed = sources_[number]->followed;
  io.list(followed, 160, [&](Followed& step) {
    io(step.number);
    step.motion.archive(io);
  });
  io.demand(followed.size() <= kMostSteps, "more steps than are kept");
  const BatchNumber made = builder.last_batch(), cut = cutter.last();
  io.demand(cut.stroke <= stroke_counter_, "a stroke that is not counted");
  io.demand(cut.stroke != made.stroke || cut.batch == made.batch, "batches that were not cut");
}

}  // namespace incise::core
