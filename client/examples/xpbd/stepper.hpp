#pragma once

#include "client/examples/xpbd/soft_body.hpp"

namespace incise::xpbd {

// A soft body, when it steps, what it sends and when it rests: all of a host simulation but its network and its clock.
// Thread: one, at a time.
class Stepper {
 public:
  Stepper(const Material& material, double rate_hz, int substeps)
      : body_(material, 1 / rate_hz, substeps), dt_s_(1 / rate_hz) {}

  // What the server says; each wakes the body if it has to move. `mesh` is the state after it.
  void load(const protocol::Replica& mesh);
  void apply(const protocol::Replica& mesh, const protocol::Delta& delta);
  void press(const protocol::BladeLoad& load);
  void hold(const protocol::Replica& mesh, std::span<const std::uint32_t> held) { body_.hold(mesh, held); }
  void release_blades();

  // One step of 1 / rate. True: the positions are to be sent, and note_sent() follows where they were.
  bool step();
  bool awake() const { return awake_; }
  // x y z of all vertices.
  std::span<const float> positions() { return body_.positions(); }
  void note_sent() { body_.note_sent(); }
  std::uint32_t tets() const { return body_.tets(); }

 private:
  void wake();
  void retry_held();

  SoftBody body_;
  const double dt_s_;
  bool awake_ = false;
  double still_s_ = 0;
  int tries_ = 0;  // of what the server holds back
  double held_s_ = 0;
};

}  // namespace incise::xpbd
