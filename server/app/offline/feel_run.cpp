#include "server/app/offline/feel_run.hpp"

#include <algorithm>
#include <utility>

#include "server/base/wording.hpp"

namespace incise::app {
namespace {

// Longer ones than these, some 30 and 250 years, come from wrong clocks; so times cannot overflow.
constexpr std::uint64_t kLongest_ns = 1'000'000'000'000'000'000;
constexpr std::int64_t kLatest_ns = 8'000'000'000'000'000'000;

// From `a` to `b`, at least 0.
std::int64_t elapsed_ns(std::int64_t a, std::int64_t b) {
  if (b <= a) return 0;
  return static_cast<std::int64_t>(
      std::min(static_cast<std::uint64_t>(b) - static_cast<std::uint64_t>(a), kLongest_ns));
}

// A ramp of two seconds from the first contact on would hide the tissue in a short motion.
haptics::ForceConfig without_ramp(haptics::ForceConfig config) {
  config.limits.ramp_s = 0;
  return config;
}

}  // namespace

FeelRun::FeelRun(const CutInput& input, std::string motion_name)
    : input_(input),
      session_(input.loaded->mesh, input.config.cut),
      stage_(without_ramp(input.config.haptics.force), input.config.cut,
             std::make_unique<haptics::Tissue>(input.loaded->mesh), this, nullptr),
      motion_run_(session_, input.motion, input.config, std::move(motion_name)) {
  poses_.reserve(input.motion.poses());
}

void FeelRun::run(Progress& progress) {
  // As the server does. What it decided is in a capture already, as released buttons.
  std::function<bool(const MotionEvent&)> holds_back;
  if (!input_.motion.header)
    holds_back = [this](const MotionEvent& event) { return stage_.holds_back(event.source, event.pose); };
  motion_run_.run(
      {.deformations = false,  // they name vertices of another mesh
       .holds_back = holds_back,
       .event = [this](const MotionEvent& event, core::PoseVerdict verdict) { handle(event, verdict); },
       .commit = [this](const core::Delta& delta, double) { stage_.cut(session_.mesh(), delta); }},
      progress);
}

void FeelRun::open(std::uint32_t source, const core::Blade& blade) {
  blades_[source] = blade;
  clocks_[source] = {};
  was_inside_[source].reset();
  stage_.opened(source, blade);
}

// All sources share one clock, which begins with the first pose. A source's time goes on in it as in its own poses, from where
// its first pose arrived; only a source on a network has arrival times that differ.
void FeelRun::advance_clock(const MotionEvent& event) {
  Clock& clock = clocks_[event.source];
  if (!first_arrival_ns_) first_arrival_ns_ = event.arrival_ns;
  if (!std::exchange(clock.runs, true)) {
    clock.first_t_ns = event.pose.t_ns;
    clock.start_ns = std::max(now_ns_, elapsed_ns(*first_arrival_ns_, event.arrival_ns));
  }
  const std::int64_t time_ns = clock.start_ns + elapsed_ns(clock.first_t_ns, event.pose.t_ns);
  now_ns_ = std::clamp(time_ns, now_ns_, kLatest_ns);
}

void FeelRun::handle(const MotionEvent& event, core::PoseVerdict verdict) {
  const std::uint32_t source = event.source;
  if (event.kind == MotionEvent::Kind::kOpened)
    open(source, event.blade ? *event.blade : blade_of(input_.config, source));
  if (event.kind != MotionEvent::Kind::kPose || !core::accepted(verdict)) return;
  if (!blades_[source]) open(source, input_.config.cut.blade);
  advance_clock(event);
  stage_.posed(source, event.pose, now_ns_, verdict == core::PoseVerdict::kNewStroke);
  current_ = &event;
  current_force_.reset();
  stage_.frame(now_ns_, 0);

  const core::CutConfig& cut = input_.config.cut;
  FeltPose felt;
  felt.source = source;
  felt.time_ns = now_ns_;
  felt.pose_t_ns = event.pose.t_ns;
  felt.position = event.pose.position;
  felt.engaged = cut.engages(event.pose.buttons);
  if (current_force_) {
    const haptics::BladeForce& force = *current_force_;
    const auto& contact = force.feel.contact;
    felt.hand = force.newtons;
    felt.tissue = force.feel.force;
    felt.edge = force.feel.engagement;
    felt.limited = (force.flags & haptics::kForceLimited) != 0;
    felt.latched = (force.flags & haptics::kForceLatchedOff) != 0;
    felt.jumped = force.jumped;
    felt.faults = force.faults;
    felt.contact = contact.has_value();
    felt.inside = contact && contact->penetrated;
    if (contact) {
      felt.depth_m = dot(contact->point - felt.position, contact->normal);
      felt.resistance_n = contact->resistance_n;
    }
  }
  const bool uncut = felt.edge.uncut_m >= 0.5 * felt.edge.length_m;
  felt.entered = felt.inside && was_inside_[source] == false && felt.engaged && uncut && !felt.jumped;
  was_inside_[source] = felt.inside;
  const core::BladeLine line = core::blade_line(*blades_[source], event.pose);
  reach_.add(line.heel);
  reach_.add(line.tip);
  poses_.push_back(felt);
}

void FeelRun::feel(const haptics::BladeForce& force) noexcept {
  if (current_ && force.source == current_->source) current_force_ = force;
}

bool FeelRun::touched() const {
  return std::any_of(poses_.begin(), poses_.end(), [](const FeltPose& pose) { return pose.contact; });
}

std::vector<std::string> FeelRun::warnings() const {
  std::vector<std::string> all = motion_run_.pose_warnings();
  if (!touched()) all.push_back("no contact: " + why_no_contact());
  if (std::string hint = motion_run_.units_hint(!touched(), input_.body); !hint.empty())
    all.push_back(std::move(hint));
  return all;
}

std::string FeelRun::why_no_contact() const {
  if (poses_.empty()) return "no pose was accepted";
  if (!reach_.meets(input_.body)) {
    return "the blade was in " + reach_.text() + ", the mesh fills " + input_.body.text() +
           " (metres); check the blade, units and frames";
  }
  std::int64_t longest_ns = 0;
  std::array<const FeltPose*, core::kMaxSources> last{};
  for (const FeltPose& pose : poses_) {
    if (const FeltPose* before = std::exchange(last[pose.source], &pose))
      longest_ns = std::max(longest_ns, pose.time_ns - before->time_ns);
  }
  return "the blade came near the body, but at no pose is it in there; forces are computed at poses, and "
         "these are up to " +
         short_number(static_cast<double>(longest_ns) * 1e-9) + " s apart";
}

}  // namespace incise::app
