#pragma once

#include <string>

#include "server/relay/session.hpp"

namespace incise::app {

// What a relay's session reports about itself, from any thread.

// The origin's newest statistics, with this relay's own ports and peers instead of the origin's, and "relay": where they come from.
std::string relay_stats_json(const relay::Session& session);
// Prometheus text format 0.0.4.
std::string relay_metrics(const relay::Session& session);

}  // namespace incise::app
