#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "protocol/motion.hpp"
#include "server/app/config.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/replay/recorded_motion.hpp"

namespace incise::app {

using replay::BeforeResets;
using replay::CaptureStart;
using replay::IfDamaged;
using replay::MotionEvent;
using replay::RecordedMotion;

// Reads a capture, a TUM trajectory or a CSV motion; their contents decide which. A capture is read up to a torn end,
// which is a warning; wrong bytes before the end are an error. `times`: what to do with poses whose time does not
// rise. kSkip keeps those of a capture, since a replay needs everything that was recorded. Throws
// protocol::MotionError or std::runtime_error: one line.
RecordedMotion read_recorded_motion(const std::filesystem::path& path,
                                    protocol::Times times = protocol::Times::kSkip,
                                    IfDamaged if_damaged = IfDamaged::kRefuse);
// The same for a capture; throws if it is not one.
RecordedMotion read_whole_capture(const std::filesystem::path& path, IfDamaged if_damaged,
                                  BeforeResets before_resets = BeforeResets::kDrop);

// The rest of a capture after that place; nothing if there is no such record. The cost does not depend on what lies
// before it. Throws std::runtime_error.
std::optional<RecordedMotion> read_capture_from(const std::filesystem::path& path, const CaptureStart& start);

// Checks what a start from there does not read: throws std::runtime_error, with the place, if wrong bytes are before it.
void check_capture_before(const std::filesystem::path& path, const CaptureStart& start);

// Throws std::runtime_error if it is not a capture.
protocol::CaptureHeader read_capture_header(const std::filesystem::path& path);

// The configuration that a capture was recorded with. Throws ConfigError.
Config config_of(const protocol::CaptureHeader& header, const std::string& name);

// The blade of a source: its own, or the common one.
const core::Blade& blade_of(const Config& config, std::uint32_t source);

// Applies an event to a session.
void apply(core::CutSession& session, const MotionEvent& event, const Config& config);

}  // namespace incise::app
