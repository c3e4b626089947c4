#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "server/app/body.hpp"
#include "server/app/config.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/input/pose_sources.hpp"
#include "server/input/positions_slot.hpp"
#include "server/loop/frame_loop.hpp"
#include "server/stream/server.hpp"

namespace incise::app {

// Joins the parts, which do not know each other, in the terms of each.

// The stream's configuration, tokens read from their file. Throws ConfigError.
stream::StreamConfig stream_config(const Config& config);
// What the server says of itself in Welcome.
stream::ServerFacts server_facts(const Config& config, const Body& body, const core::TetMesh& mesh);
// The state that clients start from. O(mesh).
stream::InitialState initial_state(const core::CutSession& session, std::uint64_t session_id);
// A number that no other run has: names a run of ids. Never 0.
std::uint64_t fresh_session_id();

// Gives each operator a pose source, and a simulator the slot for its positions.
class StreamInput final : public stream::PeerInput {
 public:
  // All must outlive this. A source without a name is called "blade".
  StreamInput(input::PoseSources& sources, input::PositionsSlot& positions, const Config& config)
      : sources_(sources), positions_(positions), config_(config) {}
  // The loop that takes the poses, for its backlog and for resets; before the first session.
  void join(loop::FrameLoop& loop) { loop_ = &loop; }
  std::unique_ptr<stream::PoseInput> open(std::string_view source_name,
                                          const std::optional<protocol::BladeEdge>& blade) override;
  std::unique_ptr<stream::PositionsInput> open_positions() override;
  bool reset() override { return loop_ && loop_->request_reset(); }

 private:
  input::PoseSources& sources_;
  input::PositionsSlot& positions_;
  bool positions_open_ = false;  // the stream thread's
  const Config& config_;
  loop::FrameLoop* loop_ = nullptr;
};

// The loop's deltas, to the stream.
class StreamOutput final : public loop::DeltaSink {
 public:
  explicit StreamOutput(stream::Server& server) : server_(server) {}
  void publish(std::shared_ptr<const loop::PublishedDelta> delta) noexcept override {
    server_.publish(std::move(delta));
  }

 private:
  stream::Server& server_;
};

// The loop's forces, to the operators who hold the blades.
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
