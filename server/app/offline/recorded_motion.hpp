#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "protocol/capture.hpp"
#include "protocol/motion.hpp"
#include "server/app/config.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::app {

// One event of a session, in order.
struct MotionEvent {
  enum class Kind : std::uint8_t { kPose, kEndStroke, kOpened, kDeform };
  Kind kind = Kind::kPose;
  std::uint32_t source = 0;
  core::Pose pose;
  std::int64_t arrival_ns =
      0;  // when it reached the server, by its clock; for a text motion the pose's own time
  std::optional<core::Blade> blade = std::nullopt;  // of kOpened; without one: the configuration's
  std::shared_ptr<const core::VertexPositions> positions = nullptr;  // of kDeform
};

// A motion from a file of any format.
struct RecordedMotion {
  std::string format;  // "capture", "CSV" or "TUM"
  std::vector<MotionEvent> events;
  bool has_orientation = true;
  bool has_buttons = true;
  std::vector<std::string> warnings;
  // For a capture:
  std::optional<protocol::CaptureHeader> header;
  std::vector<protocol::BatchMark> marks;
  std::vector<protocol::CheckpointRecord> checkpoints;
  std::uint64_t session = 0;  // its id, after the last reset
  std::uint64_t resets = 0;
  bool closed = false;           // it was ended properly, not cut off
  std::uint64_t records = 0;     // all kinds
  std::uint64_t good_bytes = 0;  // up to the end of these
  // Records are missing: events and marks end there, unless a reset follows.
  struct Gap {
    std::string text;  // how many, where, and why
  };
  std::optional<Gap> gap;
  std::string end_error;  // if it is torn: at which byte and how

  std::size_t poses() const { return count(MotionEvent::Kind::kPose); }
  std::size_t count(MotionEvent::Kind kind) const;
};

// Reads a capture, a TUM trajectory or a CSV motion; their contents decide which. A capture is read up to a torn end,
// which is a warning; wrong bytes before the end are an error. `times`: what to do with poses whose time does not
// rise. kSkip keeps those of a capture, since a replay needs everything that was recorded. Throws
// protocol::MotionError or std::runtime_error: one line.
RecordedMotion read_recorded_motion(const std::filesystem::path& path,
                                    protocol::Times times = protocol::Times::kSkip);
// The same for a capture; throws if it is not one.
RecordedMotion read_whole_capture(const std::filesystem::path& path);

// Where to start reading a capture: the record of a checkpoint.
struct CaptureStart {
  std::uint64_t offset = 0, records = 0;  // its place; records before it
  std::uint64_t checkpoint = 0;           // its id
  std::uint64_t session = 0;              // there
};
// The rest of a capture after that record; nothing if there is no such record. The cost does not depend on what lies
// before it. Throws std::runtime_error.
std::optional<RecordedMotion> read_capture_from(const std::filesystem::path& path, const CaptureStart& start);

// Throws std::runtime_error if it is not a capture.
protocol::CaptureHeader read_capture_header(const std::filesystem::path& path);

// The configuration that a capture was recorded with. Throws ConfigError.
Config config_of(const protocol::CaptureHeader& header, const std::string& name);

// The blade of a source: its own, or the common one.
const core::Blade& blade_of(const Config& config, std::uint32_t source);

core::Blade to_core(const protocol::BladeEdge& blade);

// Positions from their record.
std::shared_ptr<const core::VertexPositions> positions_of(const protocol::PositionsRecord& record);

// Applies an event to a session.
void apply(core::CutSession& session, const MotionEvent& event, const Config& config);

}  // namespace incise::app
