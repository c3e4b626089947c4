#include "client/examples/xpbd/stepper.hpp"

namespace incise::xpbd {
namespace {

// The body rests when no vertex has moved by more than this part of its size for so long.
constexpr double kStill = 5e-5, kRest_s = 0.3;
// After this time a vertex that the server held is tried again, after twice that once more, and so on, so many times.
constexpr double kRetry_s = 0.1;
constexpr int kRetries = 2;

}  // namespace

void Stepper::load(const protocol::Replica& mesh) {
  body_.load(mesh);
  wake();
}

void Stepper::apply(const protocol::Replica& mesh, const protocol::Delta& delta) {
  if (body_.apply(mesh, delta)) wake();
}

void Stepper::press(const protocol::BladeLoad& load) {
  if (body_.press(load, !awake_)) wake();
}

void Stepper::release_blades() {
  body_.release_blades();
  wake();
}

void Stepper::wake() {
  awake_ = true;
  still_s_ = 0;
  tries_ = 0;
}

// What the server held back is tried again, less and less often: at a blade that stays where it is, or where a tetrahedron
// is as flat as it may be, it would be held for ever.
void Stepper::retry_held() {
  held_s_ = body_.holds() ? held_s_ + dt_s_ : 0;
  if (held_s_ < kRetry_s * (1 << tries_)) return;
  body_.let_go();
  held_s_ = 0;
  ++tries_;
}

bool Stepper::step() {
  body_.step();
  const bool moves = body_.unsent_m() > kStill * body_.size_m();
  still_s_ = moves ? 0 : still_s_ + dt_s_;
  if (tries_ < kRetries) retry_held();
  if (still_s_ > kRest_s && (!body_.holds() || tries_ == kRetries)) {
    body_.stop();
    awake_ = false;
  }
  return moves;
}

}  // namespace incise::xpbd
