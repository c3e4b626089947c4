#pragma once

#include "server/haptics/material.hpp"
#include "server/haptics/safety_chain.hpp"

namespace incise::haptics {

struct ForceConfig {
  Materials materials;
  double stiffest_n_m = 2000;  // of any spring: the virtual coupling's
  double damping_n_s_m = 0.5;  // of contact, along the surface's normal
  SafetyLimits limits;
};

}  // namespace incise::haptics
