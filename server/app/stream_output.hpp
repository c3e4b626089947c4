#pragma once

#include <cstdint>
#include <memory>

#include "server/haptics/force_stage.hpp"
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
  // `valid_ns`: how long a contact may be rendered after it was received.
  ForceOutput(stream::Server& server, std::int64_t valid_ns) : server_(server), valid_ns_(valid_ns) {}
  void feel(const haptics::BladeForce& force) noexcept override;

 private:
  stream::Server& server_;
  const std::int64_t valid_ns_;
};

}  // namespace incise::app
