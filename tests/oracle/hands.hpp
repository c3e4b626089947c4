#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "protocol/messages.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::oracle {

// A blade that goes where a hand or a tool was recorded to go.
struct Hand {
  std::vector<core::Pose> poses;
  core::CutConfig config;  // always engaged, with a blade of its own
};

// A recorded motion, or `most` poses of it from anywhere, turned, scaled and laid into the body. Depends on the body, the motion and the seed
// alone.
Hand place_hand(std::span<const protocol::PoseSample> samples, const core::MeshData& mesh, std::uint64_t seed,
                std::size_t most);

}  // namespace incise::oracle
