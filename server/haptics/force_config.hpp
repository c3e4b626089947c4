#pragma once

#include "server/haptics/material.hpp"
#include "server/haptics/safety_chain.hpp"

namespace incise::haptics {

struct ForceConfig {
  Materials materials;
  double stiffest_n_m = 2000;  // of any spring: the virtual coupling's
  double damping_n_s_m = 0.5;  // of contact, along the surface's normal
  SafetyLimits limits;
  double most_torque_n_m = 0.2;  // magnitude of the torque; 0: none is made

  // An engaged blade does not cut before the tissue yields, and again once it is withdrawn.
  bool resists = false;

  // The torque's: the same but for magnitude, and change in proportion.
  SafetyLimits torque_limits() const {
    SafetyLimits torque = limits;
    torque.most_n = most_torque_n_m > 0 ? most_torque_n_m : 1e-6;
    torque.slew_n_s = limits.slew_n_s * torque.most_n / limits.most_n;
    return torque;
  }
};

}  // namespace incise::haptics
