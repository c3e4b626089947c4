// Cutting by a whole motion: incise.cut() and Session.cut().
#include "server/app/python/arrays.hpp"
#include "server/app/python/session.hpp"

namespace incise::python {
namespace {

using app::MotionEvent;

// Draws nothing.
struct Silent : app::Progress {
  Silent() : Progress("", stderr, false, {}) {}
};

// Every source of the motion begins with a clock and the configured blade of its own, like one that connects.
app::RecordedMotion opened(const Motion& motion, const app::Config& config) {
  app::RecordedMotion out = *motion.recorded;
  std::uint32_t used = 0;
  for (const MotionEvent& event : out.events) used |= 1u << event.source;
  std::vector<MotionEvent> first;
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    if (used >> source & 1u) first.push_back({MotionEvent::Kind::kOpened, source, {}, 0, config.cut.blade});
  }
  out.events.insert(out.events.begin(), first.begin(), first.end());
  app::hold_button(out, config);
  return out;
}

// What is pushed after a motion has a clock and the configured blade of its own, too.
void reopen(Session& session, core::CutSession& core, const app::RecordedMotion& motion) {
  std::uint32_t used = 0;
  for (const MotionEvent& event : motion.events) used |= 1u << event.source;
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    if ((used >> source & 1u) == 0) continue;
    const core::Blade& blade = session.config.cut.blade;
    core.set_blade(source, blade);
    if (session.forces)
      session.forces->event(session.config, {MotionEvent::Kind::kOpened, source, {}, 0, blade});
  }
}

bool brings_blade(const app::RecordedMotion& motion) {
  return !motion.header && motion.count(MotionEvent::Kind::kOpened) > 0;
}

}  // namespace

void Recorder::event(const MotionEvent& event) {
  if (forces_) forces_->event(config_, event);
  constexpr std::uint32_t kBetweenLooks = 64;
  if (++events_ % kBetweenLooks != 0) return;
  const py::gil_scoped_acquire acquire;
  if (PyErr_CheckSignals() != 0) throw py::error_already_set();
}

void Recorder::commit(const core::CutSession& session, const core::Delta& delta) {
  if (forces_) forces_->commit(session, delta);
  if (wanted_) deltas_.push_back(std::make_shared<core::Delta>(delta));
}

void Recorder::finish(Cut& cut) {
  cut.deltas = std::move(deltas_);
  if (forces_) cut.forces = owned(forces_->take());
}

Cut cut_session(const std::shared_ptr<Session>& session, const Motion& motion, bool deltas) {
  const Use use(*session);
  Cut cut;
  cut.session = session;
  Recorder recorder(session->config, session->forces.get(), deltas);
  {
    const py::gil_scoped_release release;
    const app::RecordedMotion events = opened(motion, session->config);
    const app::Box body = app::box_of(session->body->loaded->mesh);
    app::check_blade(session->config, events, body.diagonal());
    app::MotionRun run(use.core(), events, session->config, motion.name);
    Silent progress;
    std::uint32_t cut_faces = 0;
    run.run({.deformations = false,  // they name vertices of another mesh
             .event = [&](const MotionEvent& event, core::PoseVerdict) { recorder.event(event); },
             .commit =
                 [&](const core::Delta& delta, double) {
                   cut_faces += delta.cut_faces;
                   recorder.commit(use.core(), delta);
                 }},
            progress);
    reopen(*session, use.core(), events);
    cut.warnings = events.warnings;
    for (std::string& warning : run.warnings(cut_faces, body)) cut.warnings.push_back(std::move(warning));
  }
  recorder.finish(cut);
  return cut;
}

Cut cut_body(const py::object& given_body, const py::object& poses, const py::object& given_config,
             const Choices& choices, bool strict, bool deltas, bool forces) {
  const std::shared_ptr<const Motion> motion = motion_from(poses, strict);
  app::RecordedMotion recorded = *motion->recorded;
  app::Config config = given_config.is_none() && recorded.header
                           ? app::config_of(*recorded.header, motion->name)
                           : config_from(given_config);
  if (const auto blade = choose(config, choices)) {
    if (brings_blade(recorded))
      throw py::value_error("blade: the lines of this motion have their own; leave it out");
    app::set_blade(*blade, config, recorded);
  }
  const std::shared_ptr<const Body> body = body_from(given_body, config);
  Cut cut;
  py::str report;
  auto session = std::make_shared<Session>();
  session->body = body;
  {
    const py::gil_scoped_release release;
    const app::CutInput in =
        app::cut_input(body->name, motion->name, std::move(recorded), std::move(config), body->loaded);
    session->config = in.config;
    if (forces) session->forces = std::make_unique<ForceTrace>(in.config, body->loaded->mesh);
    Recorder recorder(session->config, session->forces.get(), deltas);
    Silent progress;
    app::CutOutcome out =
        app::cut(in, in.config, progress,
                 {.event = [&](const core::CutSession&, const MotionEvent& event) { recorder.event(event); },
                  .commit = [&](const core::CutSession& core,
                                const core::Delta& delta) { recorder.commit(core, delta); }});
    session->core = std::move(out.session);
    reopen(*session, *session->core, in.motion);
    cut.warnings = out.report["warnings"].get<std::vector<std::string>>();
    const std::string text = out.report.dump();
    const py::gil_scoped_acquire acquire;
    recorder.finish(cut);
    cut.report = py::module_::import("json").attr("loads")(text);
  }
  cut.session = std::move(session);
  return cut;
}

}  // namespace incise::python
