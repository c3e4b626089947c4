#pragma once

#include <cstdint>

#include "server/app/body.hpp"
#include "server/app/config.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/replay/session_view.hpp"
#include "server/stream/server.hpp"

namespace incise::app {

// What the stream is made from, in its own terms.

// Its configuration, with the tokens read from their file. Throws ConfigError.
stream::StreamConfig stream_config(const Config& config);
// What the server says about itself in Welcome.
stream::ServerFacts server_facts(const Config& config, const Body& body, const core::TetMesh& mesh);
using replay::initial_state;
// A random number that names a run of ids. Never 0.
std::uint64_t fresh_session_id();

}  // namespace incise::app
