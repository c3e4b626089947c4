#pragma once

#include "client/cli/commands.hpp"
#include "protocol/motion.hpp"

namespace incise::app {

// The motion that `incise stream` plays; prints its warnings. Of a capture: the poses of one source, the one that was asked for, else the
// first that has some, as far as they count: a replay takes the same. Throws MotionError, UsageError, std::runtime_error.
protocol::Motion read_streamed_motion(const client::StreamCommand& command);

}  // namespace incise::app
