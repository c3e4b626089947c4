#pragma once

#include <filesystem>

#include "server/app/body.hpp"
#include "server/app/config.hpp"
#include "server/app/offline/recorded_motion.hpp"

namespace incise::app {

// A capture and what its replay needs.
struct Replayable {
  RecordedMotion motion;
  Config config;
  Body body;
};

// Adds a warning to a capture that ends well, but without its end mark. Of one that is torn or damaged the reader has warned. `name`:
// the capture in messages.
void warn_if_not_closed(RecordedMotion& motion, const std::string& name);

// Reads a capture, and the mesh that it was recorded with: `mesh`, or where the capture says, or beside it. Throws std::runtime_error, also
// where that is another mesh. `fields`: with the mesh's fields.
Replayable open_capture(const std::filesystem::path& capture, const std::filesystem::path& mesh,
                        IfDamaged if_damaged, bool fields = false,
                        BeforeResets before_resets = BeforeResets::kDrop);

}  // namespace incise::app
