#pragma once

// A server's part and the example soft body on one virtual clock, without a network: what happens is a function of the mesh and the hand.

#include <cmath>
#include <deque>
#include <functional>
#include <memory>
#include <vector>

#include "client/examples/xpbd/stepper.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/haptics/force_stage.hpp"
#include "server/stream/delta_arrays.hpp"

namespace incise::tests {

class SoftBench {
 public:
  static constexpr std::int64_t kTick_ns = 1'000'000;
  static constexpr int kRate_hz = 60;
  // Messages take so many ticks each way.
  static constexpr int kWay = 2;
  static constexpr int kLoadEvery = 4;

  SoftBench(const core::MeshData& mesh, const core::Blade& blade, const haptics::ForceConfig& forces,
            const xpbd::Material& material = {})
      : data(mesh), cut_config(make_cut(blade)), force_config(forces), stepper(material, kRate_hz, 10) {
    restart();
  }
  static core::CutConfig make_cut(const core::Blade& blade) {
    core::CutConfig config;
    config.blade = blade;
    return config;
  }
  // As a server does at a reset.
  void restart() {
    session = std::make_unique<core::CutSession>(data, cut_config);
    stage = std::make_unique<haptics::ForceStage>(force_config, cut_config,
                                                  std::make_unique<haptics::Tissue>(data), nullptr, &slots);
    stage->follow(session->mesh(), session->revision());
    stage->join(link);
    stage->opened(0, cut_config.blade);
    link.wanted_until_ns = INT64_MAX;
    reload();
  }
  void reload() {
    stream::InitialState initial;
    initial.epoch = ++epoch;
    initial.revision = session->revision();
    const core::TetMesh& mesh = session->mesh();
    for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) {
      initial.positions.push_back(mesh.position(v));
      if (mesh.deformed()) initial.rest.push_back(mesh.rest_position(v));
    }
    for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
      if (mesh.alive(t))
        initial.tets.push_back(
            {t, mesh.vertices(t), mesh.region(t), mesh.cut_mask(t), mesh.boundary_mask(t)});
    }
    replica = protocol::Replica();
    const std::string trouble = stream::load_initial(initial, replica);
    if (!trouble.empty()) throw std::runtime_error(trouble);
    to_server.clear();
    stepper.load(replica);
  }

  // A millisecond: the hand is there, if it is anywhere.
  void tick(const core::Pose* pose) {
    now_ns += kTick_ns;
    ++ticks;
    if (pose) {
      core::Pose p = *pose;
      p.t_ns = now_ns;
      core::Pose cutting = p;
      if (stage->holds_back(0, p)) cutting.buttons = 0;
      const core::PoseVerdict verdict = session->push(0, cutting);
      if (core::accepted(verdict)) stage->posed(0, p, now_ns, verdict == core::PoseVerdict::kNewStroke);
    }
    while (!to_server.empty() && to_server.front().due <= ticks) {
      session->deform(to_server.front().positions);
      to_server.pop_front();
    }
    stage->frame(now_ns, 0);
    haptics::ForceCommand command;
    if (slots[0].read(command)) force = {command.newtons[0], command.newtons[1], command.newtons[2]};
    auto budget = core::WorkBudget::unlimited();
    while (session->advance(budget, published.delta) == core::CutSession::Progress::kCommitted) {
      stage->cut(session->mesh(), published.delta);
      take(published);
    }
    if (ticks % kLoadEvery == 0) take_load();
    if (static_cast<std::int64_t>(ticks) * kRate_hz / 1000 == steps_due) return;
    steps_due = static_cast<std::int64_t>(ticks) * kRate_hz / 1000;
    if (stepper.awake()) step();
  }

  void take(const stream::PublishedDelta& step) {
    const protocol::Delta& delta = arrays.assign(step, replica);
    const auto result = replica.apply(delta);
    if (!result) throw std::runtime_error(result.text);
    stepper.apply(replica, delta);
    if (step.delta.stroke != 0) {
      last_cut_tick = ticks;
    } else {
      held_now = step.delta.deformation.held.size();
      held += held_now;
      stepper.hold(replica, step.delta.deformation.held);
    }
  }
  void take_load() {
    haptics::BladeLoad load;
    if (!link.loads[0].read(load)) return;
    const auto wire = [](const core::Vec3& v) { return protocol::Vec3{v.x, v.y, v.z}; };
    protocol::BladeLoad message;
    message.force_n = wire(load.force);
    message.center = wire(load.loads.center);
    std::vector<std::uint32_t> ids(load.loads.ids.begin(), load.loads.ids.begin() + load.loads.count);
    std::vector<double> forces;
    for (std::size_t i = 0; i < ids.size(); ++i)
      for (const double f : {load.loads.forces[i].x, load.loads.forces[i].y, load.loads.forces[i].z})
        forces.push_back(f);
    message.ids = ids;
    message.forces = forces;
    stepper.press(message);
  }
  void step() {
    ++steps;
    const bool send = stepper.step();
    if (on_step) on_step();
    if (!send) return;
    ++sent;
    last_sent_tick = ticks;
    auto positions = std::make_shared<core::VertexPositions>();
    positions->revision = session->revision();
    const auto numbers = stepper.positions();
    for (std::size_t i = 0; i + 2 < numbers.size(); i += 3)
      positions->positions.push_back({numbers[i], numbers[i + 1], numbers[i + 2]});
    positions->single = true;
    stepper.note_sent();
    to_server.push_back({ticks + kWay, positions});
  }

  struct Sent {
    int due;
    std::shared_ptr<const core::VertexPositions> positions;
  };
  const core::MeshData data;
  const core::CutConfig cut_config;
  const haptics::ForceConfig force_config;
  std::unique_ptr<core::CutSession> session;
  std::unique_ptr<haptics::ForceStage> stage;
  haptics::ForceSlots slots;
  haptics::SimulationLink link;
  protocol::Replica replica;
  stream::DeltaArrays arrays;
  stream::PublishedDelta published;
  xpbd::Stepper stepper;
  std::deque<Sent> to_server;
  std::uint64_t epoch = 0;
  std::int64_t now_ns = 1'000'000'000, steps_due = 0;
  int ticks = 0, steps = 0, sent = 0, last_sent_tick = 0, last_cut_tick = 0;
  std::size_t held = 0, held_now = 0;
  core::Vec3 force;
  std::function<void()> on_step;  // after each
};

}  // namespace incise::tests
