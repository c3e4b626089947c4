#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "server/app/body.hpp"
#include "server/app/config.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/replay/session_view.hpp"
#include "server/stream/mirror.hpp"
#include "server/stream/server.hpp"

namespace incise::app {

// What the stream is made from, in its own terms.

// Its configuration, with the tokens read from their file. Throws ConfigError.
stream::StreamConfig stream_config(const Config& config);
// Raises the limit on open files as far as the system allows: each client takes one, and shells and services begin with 1024. Call it before the server is made.
void raise_descriptor_limit();
// What the server says about itself in Welcome.
stream::ServerFacts server_facts(const Config& config, const Body& body, const core::TetMesh& mesh);
// A mirror of a session of a body with these origins (InitialState::origins), made off the loop and the stream's thread: both only copy
// it. O(mesh).
std::shared_ptr<const stream::Mirror> mirror_of(const core::CutSession& session,
                                                std::shared_ptr<const protocol::OriginTree> origins);
// The same of a state.
std::shared_ptr<const stream::Mirror> mirror_of(stream::InitialState state,
                                                std::shared_ptr<const protocol::OriginTree> origins);
// What viewers are shown when the loop goes on with the session that `mirror` and `fields` are of: another epoch.
std::shared_ptr<stream::InitialState> shown_again(std::shared_ptr<const stream::Mirror> mirror,
                                                  std::shared_ptr<const std::vector<core::Field>> fields);
// A random number that names a run of ids. Never 0.
std::uint64_t fresh_session_id();

}  // namespace incise::app
