#include "server/app/offline/motion_run.hpp"

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "server/base/wording.hpp"
#include "server/core/stroke/jump.hpp"

namespace incise::app {
namespace {

using core::PoseVerdict;

// If more than this share of the steps would be jumps, a limit is raised to so many times the usual step.
constexpr double kMaxJumps = 0.1, kTimesUsualSpeed = 20, kTimesUsualGap = 5;
// A larger body is probably not in metres, and a hand's speed means nothing: use so many bodies a second instead.
constexpr double kMaxBody_m = 1, kBodiesPerSecond = 10;
// If a motion spans so many times the body, or the other way round, one of them is probably in millimetres.
constexpr double kMinUnitError = 150, kMaxUnitError = 7000;
// So many times: the body may be in centimetres.
constexpr double kMinCentimetres = 50, kMaxCentimetres = 700;
// How far the surface that the blade is said to have swept may be from where it was, in h.
constexpr double kSweepTolerance_h = 0.001;
// Of the body's diagonal; the protocol limits operators' blades to the same. With one of about 500 nothing is cut any more.
constexpr double kMostBladeLengths = 100;

double middle(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

struct Steps {
  std::vector<double> gaps_s, speeds_m_s;  // of all steps; of those with motion
};

// The steps of a motion while the blade is engaged.
Steps steps_of(const Config& config, const RecordedMotion& motion) {
  Steps steps;
  std::array<const core::Pose*, core::kMaxSources> last{};
  for (const MotionEvent& event : motion.events) {
    if (event.kind != MotionEvent::Kind::kPose) continue;
    const core::Pose* previous = std::exchange(last[event.source], &event.pose);
    if (!previous || event.pose.t_ns <= previous->t_ns || !config.cut.engages(previous->buttons)) continue;
    const core::Blade& blade = blade_of(config, event.source);
    const double way_m = travel(core::blade_line(blade, *previous), core::blade_line(blade, event.pose));
    steps.gaps_s.push_back(static_cast<double>(core::elapsed_ns(*previous, event.pose)) * 1e-9);
    if (way_m > 0) steps.speeds_m_s.push_back(way_m / steps.gaps_s.back());
  }
  return steps;
}

double share_beyond(const std::vector<double>& values, double limit) {
  const auto beyond = std::count_if(values.begin(), values.end(), [limit](double v) { return v > limit; });
  return values.empty() ? 0 : static_cast<double>(beyond) / static_cast<double>(values.size());
}

std::string raised(const char* key, double from, double to, const char* unit) {
  return std::string(key) + " from " + short_number(from) + " to " + short_number(to) + " " + unit;
}

// In enough digits to tell `low` from `high` on its axis, also far from the origin.
std::string coordinate(double x, double low, double high) {
  constexpr int kFewest = 4, kMost = 12;
  const double share = (high - low) / std::max(std::abs(low), std::abs(high));
  const int digits =
      share > 0 ? std::clamp(3 + static_cast<int>(std::ceil(-std::log10(share))), kFewest, kMost) : kFewest;
  return short_number(x, digits);
}

// What unit a mesh seems to be in whose size is so many times the tool's way, and what makes metres of it; empty: none.
std::string scale_hint(double times, double body_size_m) {
  const bool centimetres = times > kMinCentimetres && times < kMaxCentimetres;
  const bool millimetres = times > kMinUnitError && times < kMaxUnitError;
  const auto choose = [&](const std::string& first, const std::string& second) {
    return (centimetres ? first : "") + (centimetres && millimetres ? " or " : "") +
           (millimetres ? second : "");
  };
  if (!centimetres && !millimetres) return {};
  return "this mesh looks like " + choose("centimetres", "millimetres") +
         R"(; give --config a file with {"mesh": {"scale_to_metres": )" + choose("0.01", "0.001") +
         "}}, which makes it " +
         choose(short_number(0.01 * body_size_m) + " m", short_number(0.001 * body_size_m) + " m") + " long";
}

// Where a body is too small for a blade or a motion: the other reason.
std::string or_scaled_already(const Config& config) {
  const double scale = config.mesh.scale_to_metres;
  if (scale >= 1) return {};
  return ", or leave out mesh.scale_to_metres (" + short_number(scale) + ") if the mesh is in metres already";
}

}  // namespace

std::string Box::text() const {
  const auto point = [this](const core::Vec3& p) {
    return "(" + coordinate(p.x, low.x, high.x) + ", " + coordinate(p.y, low.y, high.y) + ", " +
           coordinate(p.z, low.z, high.z) + ")";
  };
  return point(low) + " to " + point(high);
}

Box box_of(const core::MeshData& mesh) {
  Box box;
  for (const core::Vec3& p : mesh.positions) box.add(p);
  return box;
}

Box box_of(const core::TetMesh& mesh) {
  Box box;
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    for (const core::VertexId v : mesh.vertices(t)) box.add(mesh.position(v));
  }
  return box;
}

void hold_button(RecordedMotion& motion, const Config& config) {
  if (motion.has_buttons || config.cut.always_engaged) return;
  for (MotionEvent& event : motion.events) {
    if (event.kind != MotionEvent::Kind::kPose) continue;
    event.pose.buttons |= 1u << std::countr_zero(config.cut.engage_buttons);
  }
}

std::string suit_limits(Config& config, const RecordedMotion& motion, double body_size_m) {
  if (motion.header) return {};
  const core::CutConfig defaults;
  core::CutConfig& cut = config.cut;
  const Steps steps = steps_of(config, motion);
  std::string text;
  if (cut.gap_limit_s == defaults.gap_limit_s && share_beyond(steps.gaps_s, cut.gap_limit_s) > kMaxJumps) {
    cut.gap_limit_s = std::max(cut.gap_limit_s, kTimesUsualGap * middle(steps.gaps_s));
    text = raised("cut.gap_limit_s", defaults.gap_limit_s, cut.gap_limit_s, "s");
  }
  double speed = defaults.speed_limit_m_s;
  if (body_size_m > kMaxBody_m) speed = std::max(speed, kBodiesPerSecond * body_size_m);
  if (share_beyond(steps.speeds_m_s, speed) > kMaxJumps) {
    speed = std::max(speed, kTimesUsualSpeed * middle(steps.speeds_m_s));
  }
  if (cut.speed_limit_m_s == defaults.speed_limit_m_s &&
      share_beyond(steps.speeds_m_s, cut.speed_limit_m_s) > 0 && speed > cut.speed_limit_m_s) {
    cut.speed_limit_m_s = speed;
    text += (text.empty() ? "" : " and ") +
            raised("cut.speed_limit_m_s", defaults.speed_limit_m_s, cut.speed_limit_m_s, "m/s");
  }
  return text;
}

std::string blade_fault(const core::Blade& blade, const Config& config, double body_size_m) {
  const double length_m = core::distance(blade.heel, blade.tip), most_m = kMostBladeLengths * body_size_m;
  if (length_m <= most_m) return {};
  return "is " + short_number(length_m) + " m long, the body " + short_number(body_size_m) + " m: " +
         (length_m <= 1000 * most_m
              ? "this looks like millimetres; divide by 1000" + or_scaled_already(config)
              : "accepted is at most 100 times the body");
}

std::string blade_fault(const Config& config, const RecordedMotion& motion, double body_size_m) {
  core::Blade longest{{}, {}};
  for (const MotionEvent& event : motion.events) {
    const core::Blade& blade = event.blade ? *event.blade : blade_of(config, event.source);
    if (core::distance(blade.heel, blade.tip) > core::distance(longest.heel, longest.tip)) longest = blade;
  }
  return blade_fault(longest, config, body_size_m);
}

void check_blade(const Config& config, const RecordedMotion& motion, double body_size_m) {
  if (const std::string fault = blade_fault(config, motion, body_size_m); !fault.empty())
    throw std::runtime_error("the blade " + fault);
}

std::string explained(PoseVerdict verdict) {
  if (verdict != PoseVerdict::kNotFinite) return core::to_string(verdict);
  return "not finite or more than " + short_number(core::kFarthest_m / 1000) + " km from the origin";
}

void MotionRun::run(const Options& options, Progress& progress) {
  std::array<bool, core::kMaxSources> used{};
  const auto& events = motion_.events;
  for (std::size_t i = 0; i < events.size(); ++i) {
    const MotionEvent& event = events[i];
    const bool deforms = event.kind == MotionEvent::Kind::kDeform;
    if (deforms && !options.deformations) {
      ++left_out_;
      continue;
    }
    used[event.source] = used[event.source] || !deforms;
    handle(event, options);
    progress.show(static_cast<double>(i) / static_cast<double>(events.size()));
  }
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    if (used[source]) handle({MotionEvent::Kind::kEndStroke, source, {}, 0}, options);
  }
  swept_.build();
}

void MotionRun::handle(const MotionEvent& event, const Options& options) {
  auto verdict = PoseVerdict::kAccepted;
  if (event.kind == MotionEvent::Kind::kPose) {
    core::Pose pose = event.pose;
    if (options.holds_back && options.holds_back(event)) pose.buttons &= ~config_.cut.engage_buttons;
    verdict = session_.push(event.source, pose);
    ++verdicts_[static_cast<std::size_t>(verdict)];
    engaged_ = engaged_ || config_.cut.engages(event.pose.buttons);
    tool_.add(event.pose.position);
  } else {
    apply(session_, event, config_);
  }
  if (options.event) options.event(event, verdict);
  commit_all(options);
}

void MotionRun::commit_all(const Options& options) {
  using std::chrono::steady_clock;
  core::WorkBudget budget = core::WorkBudget::unlimited();
  for (;;) {
    const auto start = steady_clock::now();
    if (session_.advance(budget, delta_) != core::CutSession::Progress::kCommitted) return;
    const std::chrono::duration<double, std::micro> us = steady_clock::now() - start;
    const core::Batch& batch = session_.committed_batch();
    if (batch.stroke > 0) {
      ++batches_;
      for (const core::BladeLine& line : batch.lines) {
        lines_.add(line.heel);
        lines_.add(line.tip);
      }
    }
    crossed_an_edge_ = crossed_an_edge_ || session_.committed_counts().events > 0;
    changed_ = changed_ || (batch.stroke > 0 &&
                            !(delta_.moved.empty() && delta_.upserted.empty() && delta_.removed.empty()));
    core::add_sweep(swept_, batch.lines, kSweepTolerance_h * h_m_);
    options.commit(delta_, us.count());
  }
}

std::vector<std::string> MotionRun::pose_warnings() const {
  std::vector<std::string> all;
  for (std::size_t i = 0; i < verdicts_.size(); ++i) {
    const auto verdict = static_cast<PoseVerdict>(i);
    if (verdicts_[i] == 0 || core::accepted(verdict)) continue;
    all.push_back(name_ + ": " + counted(verdicts_[i], "pose was", "poses were") +
                  " rejected: " + explained(verdict));
  }
  if (jumps() > 0) {
    all.push_back(name_ + ": " + counted(jumps(), "jump", "jumps") + " began a new stroke: faster than " +
                  "cut.speed_limit_m_s = " + short_number(config_.cut.speed_limit_m_s) +
                  " or after more than cut.gap_limit_s = " + short_number(config_.cut.gap_limit_s));
  }
  if (left_out_ > 0) {
    all.push_back(name_ + ": the simulation's positions in the capture were left out (" +
                  counted(left_out_, "step", "steps") + "): they do not move the body");
  }
  return all;
}

std::vector<std::string> MotionRun::warnings(std::uint32_t cut_faces, const Box& body) const {
  std::vector<std::string> all = pose_warnings();
  if (cut_faces == 0) {
    all.push_back(std::string("nothing was cut") +
                  (changed_ ? ", though the mesh has changed (vertices were moved): " : ": ") +
                  why_nothing_was_cut());
  }
  if (const std::string hint = units_hint(cut_faces == 0, body); !hint.empty()) all.push_back(hint);
  return all;
}

std::string MotionRun::why_nothing_was_cut() const {
  if (motion_.poses() == 0) return "there is no pose in " + name_;
  if (!engaged_) {
    return "no pose of " + name_ + " holds a button that engages the blade (cut.engage_buttons = " +
           std::to_string(config_.cut.engage_buttons) + "); \"cut\": {\"engage\": \"always\"} needs none";
  }
  if (batches_ == 0 && jumps() > 0) {
    return "every step of " + name_ + " counts as a jump; raise the limits in the configuration";
  }
  std::uint64_t rejected = 0;
  for (std::size_t i = 0; i < verdicts_.size(); ++i)
    if (!core::accepted(static_cast<PoseVerdict>(i))) rejected += verdicts_[i];
  if (batches_ == 0 && rejected > 0)
    return "the poses of " + name_ + " that were not rejected do not move the blade";
  if (batches_ == 0) return "the blade of " + name_ + " never moved";
  if (met_the_body()) {
    return "the blade of " + name_ +
           " met the body, but what it swept is cut already, is less than a tetrahedron deep, or is where "
           "the body is only one tetrahedron thick, which is not parted";
  }
  return "the blade swept " + lines_.text() + ", the mesh fills " + box_of(session_.mesh()).text() +
         " (metres); check the blade, units and frames";
}

// Whether the blade crossed an edge, or a vertex lies where it swept, as those of an earlier cut there do.
bool MotionRun::met_the_body() const {
  if (crossed_an_edge_) return true;
  const core::TetMesh& mesh = session_.mesh();
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    for (const core::VertexId v : mesh.vertices(t)) {
      core::Vec3 closest;
      std::uint32_t triangle = 0;
      if (swept_.closest(mesh.position(v), 2 * kSweepTolerance_h * h_m_, closest, triangle)) return true;
    }
  }
  return false;
}

std::string MotionRun::units_hint(bool nothing_met, const Box& body) const {
  const double times = tool_.diagonal() / std::max(body.diagonal(), 1e-300);
  const std::string spans = name_ + ": the tool's way spans " + short_number(tool_.diagonal()) +
                            " m, the body " + short_number(body.diagonal()) + " m: ";
  if (times > kMinUnitError && times < kMaxUnitError)
    return spans + "these poses look like millimetres; divide x, y and z by 1000" +
           or_scaled_already(config_);
  if (!nothing_met) return {};
  const std::string scale = scale_hint(1 / times, body.diagonal());
  return scale.empty() ? scale : spans + scale;
}

}  // namespace incise::app
