#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "server/haptics/force_stage.hpp"
#include "server/haptics/simulation_link.hpp"
#include "server/loop/delta_pool.hpp"
#include "server/stream/server.hpp"

namespace incise::app {

// Sends the loop's deltas to the stream.
class StreamOutput final : public loop::DeltaSink {
 public:
  explicit StreamOutput(stream::Server& server) : server_(server) {}
  void publish(std::shared_ptr<const loop::PublishedDelta> delta) noexcept override {
    server_.publish(std::move(delta));
  }

 private:
  stream::Server& server_;
};

// Sends the loop's forces to the operators who hold the blades.
class ForceOutput final : public haptics::ForceSink {
 public:
  // `valid_ns`: how long a contact may be rendered after it was received. `torques`: whether any are made.
  ForceOutput(stream::Server& server, std::int64_t valid_ns, bool torques)
      : server_(server), valid_ns_(valid_ns), torques_(torques) {}
  void feel(const haptics::BladeForce& force) noexcept override;

 private:
  stream::Server& server_;
  const std::int64_t valid_ns_;
  const bool torques_;
};

// Joins simulators on the network to the loop: what blades do to the body, and their own models of it. Thread: the stream's.
class SimulationOutput {
 public:
  // For the loop; wait-free on both sides.
  haptics::SimulationLink& link() { return link_; }
  // For Providers. A call asks the loop for loads for the next second.
  std::span<const protocol::BladeLoad> loads();
  std::string use(const protocol::BladeModel& model);

 private:
  haptics::SimulationLink link_;
  std::array<haptics::BladeLoad, core::kMaxSources> newest_;
  std::array<std::array<double, 3 * haptics::VertexLoads::kMost>, core::kMaxSources> forces_{};
  std::vector<protocol::BladeLoad> messages_;
  std::uint64_t models_ = 0;
};

}  // namespace incise::app
