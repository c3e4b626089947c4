#include "server/loop/frame_loop.hpp"

#include <sys/prctl.h>

#include <algorithm>
#include <cerrno>
#include <ctime>
#include <limits>
#include <span>
#include <utility>

#include "server/base/clock.hpp"

namespace incise::loop {
namespace {

// The clock is read after this many poses (some 100 ns each), and after a slice of cutting of this length.
constexpr std::uint32_t kPosesPerLook = 64;
constexpr std::int64_t kSlice_ns = 20'000;
// A sleep ends some 10 us late; the last stretch is spent looking at the clock.
constexpr std::int64_t kSpin_ns = 20'000;
// Poses begin no frame earlier than this after the last one began, so that a flood of them leaves time to others.
constexpr std::int64_t kShortest_ns = 100'000;
// The part of what budget_fraction leaves of a frame that a body's deformation may use as well, and the cuts that it waits for: it takes
// several frames, and the simulation's next one is on its way.
constexpr double kStepPart = 0.3;
// What moving all vertices of a step at once is expected to take at most.
constexpr std::int64_t kLongestStep_ns = 400'000;
// After a frame that poses began, the next ones may be so much later than a period before a frame begins without them, as
// part of it: so a source's jitter makes no additional frames.
constexpr std::int64_t kJitterPart = 4;
// No slice begins that would, judging by the last ones, end after this part of the frame.
constexpr double kLatest = 0.95;
// The part of a frame's budget that draining poses may use: after a burst the rest is for cutting.
constexpr double kInputShare = 0.5;
// After an undo so many cuts a frame are entered for the forces.
constexpr std::size_t kCutsNoted = 512;

void sleep_until(std::int64_t ns) {
  const timespec at{ns / 1'000'000'000, ns % 1'000'000'000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, nullptr) == EINTR) {
  }
}

}  // namespace

FrameLoop::FrameLoop(core::CutSession& session, input::PoseSources& input, DeltaSink& sink, Journal* journal,
                     const LoopOptions& options)
    : session_(&session),
      undos_(input, journal, options.undo_patience_ns),
      input_(input),
      sink_(sink),
      journal_(journal),
      options_(options),
      period_ns_(static_cast<std::int64_t>(1e9 / options.rate_hz)),
      for_cuts_(options.budget_fraction, period_ns_),
      for_steps_(options.budget_fraction + kStepPart * (1 - options.budget_fraction), period_ns_),
      pool_(64, options.most_unread_deltas) {
  ready_.reserve(1024);
  state_.revision = session.revision();
  state_.state_hash = session.mesh().state_hash();
  state_.live_tets = session.mesh().live_tets();
  state_.vertices = session.mesh().vertex_slots();
  count_first_cuts();
  stats_.state.store(state_);
}

void FrameLoop::count_first_cuts() {
  const core::TetMesh& mesh = session_->mesh();
  first_cut_faces_ = 0;
  first_cut_area_m2_ = 0;
  if (session_->revision() == 0 && !mesh.came_cut()) return;
  std::uint64_t sides = 0;
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    for (int face = 0; face < 4; ++face) {
      if ((mesh.cut_mask(t) >> face & 1) == 0) continue;
      ++sides;
      first_cut_area_m2_ += 0.25 * length(mesh.twice_area(core::half_face(t, face)));
    }
  }
  first_cut_faces_ = (sides + 1) / 2;
  state_.cut_faces = first_cut_faces_;
  state_.cut_area_m2 = first_cut_area_m2_;
}

void FrameLoop::run(const std::stop_token& stop) noexcept {
  prctl(PR_SET_TIMERSLACK, 1);  // the kernel may otherwise end a sleep 50 us late, to save power
  std::int64_t deadline = monotonic_ns() + period_ns_;
  while (!stop.stop_requested()) {
    if (wait(deadline)) {
      const std::int64_t now = monotonic_ns();
      frame(std::min(now, deadline));
      const bool idle = state_.backlog_batches == 0 && state_.backlog_events == 0;
      deadline = now + period_ns_ + (idle ? period_ns_ / kJitterPart : 0);
      continue;
    }
    frame(deadline);
    deadline += period_ns_;
    if (const std::int64_t behind = monotonic_ns() - deadline; behind > 0) {
      const std::int64_t skipped = behind / period_ns_ + 1;
      state_.skipped_frames += static_cast<std::uint64_t>(skipped);
      deadline += skipped * period_ns_;
    }
  }
  finish();
}

// Until the deadline, or until poses have arrived: true.
bool FrameLoop::wait(std::int64_t deadline_ns) noexcept {
  input::Doorbell& bell = input_.doorbell();
  bool rung = bell.wait_until(deadline_ns - kSpin_ns);
  while (!rung && monotonic_ns() < deadline_ns) rung = bell.rung();
  if (!rung) return false;
  if (monotonic_ns() < last_start_ns_ + kShortest_ns) sleep_until(last_start_ns_ + kShortest_ns);
  return true;
}

void FrameLoop::frame(std::int64_t deadline_ns) noexcept {
  const std::int64_t start = monotonic_ns();
  if (last_start_ns_ != 0) {
    for_cuts_.pass(start - last_start_ns_);
    for_steps_.pass(start - last_start_ns_);
  }
  input_.doorbell().forget();
  state_.flags = 0;
  if (reset_wanted_.load(std::memory_order_relaxed)) reset();
  if (auto undone = undos_.advance(*session_, start)) go_back(std::move(*undone));
  drain(start, start + static_cast<std::int64_t>(kInputShare * static_cast<double>(for_cuts_.left_ns())));
  start_deformation(start);
  const std::int64_t drained = monotonic_ns();
  // A long frame makes the next one late, even if that one meets the deadline that it got after the skipped ones.
  const std::int64_t waited = last_start_ns_ == 0 ? 0 : start - last_start_ns_ - period_ns_;
  last_start_ns_ = start;
  const std::int64_t felt = feel(drained, std::max(start - deadline_ns, waited));
  cut(start + for_cuts_.left_ns(), start + for_steps_.left_ns(),
      start + static_cast<std::int64_t>(kLatest * static_cast<double>(period_ns_)));
  const std::int64_t cut_done = monotonic_ns();
  for_cuts_.use(cut_done - start);
  for_steps_.use(cut_done - start);
  publish();
  account(deadline_ns, start, drained, felt, cut_done, monotonic_ns());
}

void FrameLoop::finish() noexcept {
  input_.close();
  positions_ = nullptr;  // a simulation that goes on would never let it end
  while (input_.waiting() > 0) drain(monotonic_ns(), INT64_MAX);
  drain(monotonic_ns(), INT64_MAX);  // sources that have closed end their strokes
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    if (session_->in_stroke(source)) {
      const std::int64_t now = monotonic_ns();
      handle(source, {input::InputEvent::Kind::kEndStroke, {{}, now}, {}, 0, nullptr}, now);
    }
  }
  // A reader that has stopped must not keep the server from ending: what it has not read by then is
  // lost.
  const std::int64_t begin = monotonic_ns();
  const std::int64_t latest =
      begin + std::min(options_.longest_finish_ns, std::numeric_limits<std::int64_t>::max() - begin);
  do {
    state_.flags &= ~std::uint64_t{kDeltasBlocked};
    cut(latest, latest, latest);
    publish();
  } while (session_->backlog_batches() > 0 && (state_.flags & kDeltasBlocked) == 0 &&
           monotonic_ns() < latest);
  const std::int64_t now = monotonic_ns();
  account(now, now, now, now, now, now);
}

// ------------------------------------------------------------------------------------------------ input

void FrameLoop::drain(std::int64_t now_ns, std::int64_t until_ns) {
  std::uint32_t handled = 0;
  input_.drain([&](std::uint32_t source, const input::InputEvent& event) {
    handle(source, event, now_ns);
    if (++handled % kPosesPerLook != 0) return true;
    now_ns = monotonic_ns();
    if (now_ns < until_ns) return true;
    state_.flags |= kInputCarried;
    return false;
  });
}

void FrameLoop::handle(std::uint32_t source, const input::InputEvent& event, std::int64_t now_ns) {
  using Kind = input::InputEvent::Kind;
  const std::size_t batches = session_->backlog_batches();
  JournalRecord record;
  record.source = source;
  record.arrival_ns = event.pose.arrival_ns;
  switch (event.kind) {
    case Kind::kOpened:
      record.kind = JournalRecord::Kind::kOpened;
      record.blade = event.blade;
      session_->set_blade(source, event.blade);
      blades_[source] = event.blade;
      owners_[source] = event.owner;
      record.name = names_[source] = event.name;
      undos_.note_owner(source, event.name);
      blades_now_[source].strokes = blades_now_[source].cut_faces = 0;
      blades_moved_ = true;
      if (forces_) forces_->opened(source, event.blade);
      break;
    case Kind::kPose: {
      record.kind = JournalRecord::Kind::kPose;
      record.pose = event.pose.pose;
      // Whether tissue yields is decided here and recorded as released buttons, so a replay needs no forces.
      if (forces_ && forces_->holds_back(source, event.pose.pose))
        record.pose.buttons &= ~session_->config().engage_buttons;
      record.owner = owners_[source];
      const bool stroking = session_->in_stroke(source);
      const core::PoseVerdict verdict = session_->push(source, record.pose);
      if (core::accepted(verdict)) {
        const core::Blade& blade = blades_[source] ? *blades_[source] : session_->config().blade;
        BladeNow& now = blades_now_[source];
        now.arrival_ns = event.pose.arrival_ns;
        undos_.note_pose(source, event.pose.arrival_ns);
        now.cutting = session_->in_stroke(source) ? 1 : 0;
        now.line = core::blade_line(blade, event.pose.pose);
        blades_moved_ = true;
      }
      record.begins_stroke =
          session_->in_stroke(source) && (!stroking || verdict == core::PoseVerdict::kNewStroke);
      if (record.begins_stroke) {
        ++state_.strokes;
        ++blades_now_[source].strokes;
        undos_.note_stroke(source);
      }
      record.verdict = verdict;
      input_.count(source, verdict);
      if (forces_ && accepted(verdict)) {
        forces_->posed(source, event.pose.pose, event.pose.arrival_ns,
                       verdict == core::PoseVerdict::kNewStroke);
      }
      bump(stats_.verdicts[static_cast<std::size_t>(verdict)]);
      break;
    }
    case Kind::kEndStroke:
      record.kind = JournalRecord::Kind::kEndStroke;
      session_->end_stroke(source);
      blades_now_[source].cutting = 0;
      blades_moved_ = true;
      break;
  }
  const bool recorded = write(record);
  // The journal acknowledges the poses that it has written.
  if (!recorded && event.kind == Kind::kPose) input_.acknowledge(source, record.verdict, record.pose.t_ns);
  for (std::size_t i = batches; i < session_->backlog_batches(); ++i)
    times_.push({event.pose.arrival_ns, now_ns});
}

void FrameLoop::start_deformation(std::int64_t now_ns) {
  if (!positions_ || session_->deformation_waits()) return;
  JournalRecord record;
  record.positions = positions_->pop_newest();
  if (!record.positions) return;
  record.kind = JournalRecord::Kind::kDeform;
  record.arrival_ns = record.positions->arrival_ns;
  session_->deform(record.positions);
  deforming_ = record.positions;
  times_.push({record.arrival_ns, now_ns});
  write(record);
}

bool FrameLoop::write(const JournalRecord& record) {
  if (!journal_) return false;
  if (journal_->record(record)) return true;
  state_.flags |= kJournalBlocked;
  bump(stats_.journal_lost);
  return false;
}

// ------------------------------------------------------------------------------------------------ forces

void FrameLoop::offer_forces(const haptics::ForceConfig& config, std::unique_ptr<haptics::Tissue> tissue,
                             haptics::ForceSink* sink, haptics::ForceSlots* slots,
                             haptics::SimulationLink* link) {
  forces_ = std::make_unique<haptics::ForceStage>(config, session_->config(), std::move(tissue), sink, slots);
  forces_->follow(session_->mesh(), session_->revision());
  if (link) forces_->join(*link);
}

std::int64_t FrameLoop::feel(std::int64_t now_ns, std::int64_t late_ns) {
  if (!forces_) return now_ns;
  if (!cuts_to_note_.empty()) {
    const std::size_t count = std::min(kCutsNoted, cuts_to_note_.size());
    forces_->note_cuts(session_->mesh(), std::span(cuts_to_note_).last(count));
    cuts_to_note_.resize(cuts_to_note_.size() - count);
  }
  forces_->frame(now_ns, late_ns);
  for (std::uint32_t source = 0; source < blades_now_.size(); ++source) {
    if (blades_now_[source].force == forces_->acting(source)) continue;
    blades_now_[source].force = forces_->acting(source);
    blades_moved_ = true;
  }
  const std::int64_t done_ns = monotonic_ns();
  for (const std::int64_t arrival_ns : forces_->felt_ns()) stats_.pose_to_force.record(done_ns - arrival_ns);
  state_.forces_cut_short = forces_->cut_short();
  return done_ns;
}

// ------------------------------------------------------------------------------------------------ reset, undo

void FrameLoop::offer_reset(Restart restart, ResetDone done) {
  restart_ = std::move(restart);
  reset_done_ = std::move(done);
}

bool FrameLoop::request_reset() {
  if (!restart_) return false;
  reset_wanted_.store(true, std::memory_order_relaxed);
  return true;
}

void FrameLoop::reset() {
  // Before, so that one who asks from here on gets another.
  reset_wanted_.store(false, std::memory_order_relaxed);
  auto fresh = restart_();
  if (!fresh) {
    reset_wanted_.store(true, std::memory_order_relaxed);
    return;
  }
  undos_.reset();
  cuts_to_note_.clear();
  JournalRecord record;
  record.kind = JournalRecord::Kind::kReset;
  replace(std::move(fresh), {}, {}, record, reset_done_);
  count_first_cuts();
}

void FrameLoop::offer_undo(TakeUndone take, UndoDone done) {
  undos_.offer(std::move(take));
  undo_done_ = std::move(done);
}

bool FrameLoop::request_undo(UndoWish wish, UndoAnswered answered) {
  return undos_.request(std::move(wish), std::move(answered));
}

void FrameLoop::go_back(Undone undone) {
  JournalRecord record;
  record.kind = JournalRecord::Kind::kUndo;
  record.source = undone.before.source;
  record.pose.t_ns = undone.before.t_ns;
  record.posed_ns = undone.before.arrival_ns;
  record.revision = undone.before.revision;
  LoopState state;
  state.revision = undone.before.revision;
  state.cut_faces = first_cut_faces_ + undone.before.cut_faces;
  state.cut_area_m2 = first_cut_area_m2_ + undone.before.cut_area_m2;
  cuts_to_note_ = std::move(undone.cuts);
  replace(std::move(undone.session), state, undone.before.blades, record, undo_done_);
}

void FrameLoop::replace(std::unique_ptr<core::CutSession> other, const LoopState& state,
                        const BladesSums& blades, JournalRecord record, const ResetDone& done) {
  session_ = other.get();
  std::swap(own_session_, other);
  if (forces_) {
    forces_->restart();
    forces_->follow(session_->mesh(), session_->revision());
  }
  if (positions_) positions_->pop_newest();  // drops those of the old mesh
  deforming_.reset();
  times_.clear();
  batch_work_ns_ = delta_work_ns_ = 0;
  const LoopState before = std::exchange(state_, state);
  state_.frames = before.frames;
  state_.skipped_frames = before.skipped_frames;
  state_.strokes = before.strokes;
  state_.forces_cut_short = before.forces_cut_short;
  state_.state_hash = session_->mesh().state_hash();
  state_.live_tets = session_->mesh().live_tets();
  state_.vertices = session_->mesh().vertex_slots();
  record.session = done(std::move(other));
  record.arrival_ns = monotonic_ns();
  write(record);
  record.kind = JournalRecord::Kind::kOpened;
  blades_moved_ = true;
  for (record.source = 0; record.source < core::kMaxSources; ++record.source) {
    if (!blades_[record.source]) continue;
    BladeNow& now = blades_now_[record.source];
    now.cutting = 0;
    // Who has come since had done nothing then.
    const BladeSums& sums = blades[record.source];
    const bool was_there = sums.name == names_[record.source];
    now.strokes = was_there ? sums.strokes : 0;
    now.cut_faces = was_there ? sums.cut_faces : 0;
    record.blade = *blades_[record.source];
    record.name = names_[record.source];
    const std::size_t batches = session_->backlog_batches();
    session_->set_blade(record.source,
                        record.blade);  // ends a stroke that was under way before the one that was undone
    for (std::size_t i = batches; i < session_->backlog_batches(); ++i)
      times_.push({record.arrival_ns, record.arrival_ns});
    write(record);
  }
}

// ------------------------------------------------------------------------------------------------ cutting

void FrameLoop::cut(std::int64_t cuts_until_ns, std::int64_t steps_until_ns, std::int64_t latest_ns) {
  session_->prefetch();
  std::int64_t units_left = options_.units_per_frame > 0 ? options_.units_per_frame : INT64_MAX;
  std::int64_t now = monotonic_ns();
  // At least one slice, however late it is: a frame that never cuts would never end the backlog.
  std::shared_ptr<PublishedDelta> out;
  bool any_slice = false;
  while (session_->backlog_batches() > 0) {
    if (!out && !(out = pool_.next_free())) {
      state_.flags |= kDeltasBlocked;
      return;
    }
    const bool moves = session_->moves_next();
    if (moves && any_slice && now + step_ns_ > latest_ns) {
      state_.flags |= kBudgetSpent;
      return;
    }
    any_slice = true;
    const std::int64_t until_ns = deforming_ ? steps_until_ns : cuts_until_ns;
    const std::int64_t slice = std::min(kSlice_ns, until_ns - now);
    std::int64_t units = cost_.units_in(std::max<std::int64_t>(slice, 0));
    if (options_.units_per_frame > 0) units = units_left;
    core::WorkBudget budget{units};
    const std::size_t segments = session_->backlog_segments();
    const auto progress = session_->advance(budget, out->delta);
    const std::int64_t then = now, used = units - budget.left;
    now = monotonic_ns();
    cost_.observe(used, now - then, batch_work_ns_ > 0 && progress == core::CutSession::Progress::kSpent);
    if (moves) step_ns_ = std::min(now - then, kLongestStep_ns);
    units_left -= used;
    batch_work_ns_ += now - then;
    delta_work_ns_ += now - then;
    if (progress == core::CutSession::Progress::kCommitted) {
      const std::size_t done = segments - session_->backlog_segments();
      if (session_->committed_whole()) {
        if (out->delta.stroke != 0) {
          ns_per_segment_ += 0.1 * (static_cast<double>(batch_work_ns_) /
                                        static_cast<double>(std::max<std::size_t>(1, done)) -
                                    ns_per_segment_);
        }
        batch_work_ns_ = 0;
      }
      commit(*out, now);
      pool_.published();
      ready_.push_back(std::exchange(out, nullptr));
      start_deformation(now);
    }
    // Poses that have arrived meanwhile are felt first.
    const bool poses = input_.doorbell().rung() && now >= last_start_ns_ + kShortest_ns;
    if (poses || now >= until_ns || now > latest_ns - cost_.longest_ns() || units_left <= 0) {
      if (session_->backlog_batches() > 0) state_.flags |= kBudgetSpent;
      return;
    }
  }
}

void FrameLoop::commit(PublishedDelta& out, std::int64_t now_ns) {
  const core::Delta& delta = out.delta;
  const bool is_whole = session_->committed_whole();
  const BatchTimes times = times_.oldest();
  if (is_whole) times_.pop();
  out.arrival_ns = times.arrival_ns;
  out.drain_ns = times.drain_ns;
  out.cut_ns = now_ns;

  if (delta.stroke != 0) {
    stats_.batch_cut.record(delta_work_ns_);
    stats_.pose_to_drain.record(times.drain_ns - times.arrival_ns);
    stats_.pose_to_cut.record(now_ns - times.arrival_ns);
    if (is_whole) bump(stats_.batches);
  } else {
    stats_.deform.record(delta_work_ns_);
    bump(stats_.deformations);
    stats_.vertices_moved.fetch_add(delta.deformation.moved, std::memory_order_relaxed);
    stats_.vertices_held.fetch_add(delta.deformation.held.size(), std::memory_order_relaxed);
  }
  delta_work_ns_ = 0;
  state_.revision = delta.revision;
  state_.state_hash = delta.state_hash;
  state_.live_tets = session_->mesh().live_tets();
  state_.vertices = session_->mesh().vertex_slots();
  state_.cut_faces += delta.cut_faces;
  if (delta.cut_faces > 0) {
    blades_now_[delta.source].cut_faces += delta.cut_faces;
    blades_moved_ = true;
  }
  state_.cut_area_m2 += delta.cut_area;
  if (forces_) forces_->cut(session_->mesh(), delta);

  JournalRecord record = commit_record(delta);
  record.arrival_ns = now_ns;
  record.frame = state_.frames;
  if (delta.stroke == 0 && deforming_) {
    if (deforming_->outcome) *deforming_->outcome = session_->gave_way();
    record.positions = std::move(deforming_);
  }
  write(record);
}

void FrameLoop::publish() {
  for (auto& delta : ready_) sink_.publish(std::move(delta));
  ready_.clear();
}

// ------------------------------------------------------------------------------------------------ accounts

void FrameLoop::account(std::int64_t deadline_ns, std::int64_t start_ns, std::int64_t drained_ns,
                        std::int64_t felt_ns, std::int64_t cut_ns, std::int64_t end_ns) {
  ++state_.frames;
  stats_.wake_late.record(start_ns - deadline_ns);
  stats_.frame_work.record(end_ns - start_ns);
  stats_.drain.record(drained_ns - start_ns);
  if (forces_) stats_.force.record(felt_ns - drained_ns);
  stats_.cut.record(cut_ns - felt_ns);
  stats_.publish.record(end_ns - cut_ns);
  if (end_ns > deadline_ns + period_ns_) {
    // The stage that most exceeded its share is the cause.
    const auto share = [&](double part) {
      return static_cast<std::int64_t>(part * static_cast<double>(for_cuts_.whole_ns()));
    };
    const std::int64_t excess[kLateCauses] = {
        start_ns - deadline_ns - share(0.1), drained_ns - start_ns - share(kInputShare),
        cut_ns - std::max(drained_ns, start_ns + for_cuts_.whole_ns()), end_ns - cut_ns};
    bump(stats_.late[static_cast<std::size_t>(std::max_element(excess, excess + kLateCauses) - excess)]);
  }
  state_.backlog_events = input_.waiting();
  state_.backlog_batches = session_->backlog_batches();
  state_.backlog_segments = session_->backlog_segments();
  const double backlog_ns = ns_per_segment_ * static_cast<double>(state_.backlog_segments);
  state_.backlog_ns = static_cast<std::uint64_t>(backlog_ns);
  state_.recovery_ns = static_cast<std::uint64_t>(backlog_ns / options_.budget_fraction);
  state_.ns_per_unit = cost_.ns_per_unit();
  stats_.state.store(state_);
  if (std::exchange(blades_moved_, false)) stats_.blades.store(blades_now_);
}

}  // namespace incise::loop
