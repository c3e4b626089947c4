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

// One thing that was done to a session, in its order.
struct MotionEvent {
  enum class Kind : std::uint8_t { kPose, kEndStroke, kOpened, kDeform };
  Kind kind = Kind::kPose;
  std::uint32_t source = 0;
  core::Pose pose;
  std::int64_t arrival_ns =
      0;  // at the server that recorded it, its clock; of a text motion the pose's own time
  std::optional<core::Blade> blade = std::nullopt;  // of kOpened: its own, else the configuration's
  std::shared_ptr<const core::VertexPositions> positions = nullptr;  // of kDeform
};

// A motion from a file, whatever its format.
struct RecordedMotion {
  std::string format;  // "capture", "CSV" or "TUM"
  std::vector<MotionEvent> events;
  bool has_orientation = true;
  bool has_buttons = true;
  std::vector<std::string> warnings;
  // Of a capture:
  std::optional<protocol::CaptureHeader> header;
  std::vector<protocol::BatchMark> marks;
  std::vector<protocol::CheckpointRecord> checkpoints;
  std::uint64_t session = 0;  // its id, after the last reset
  std::uint64_t resets = 0;
  bool closed = false;           // it was ended, not cut off
  std::uint64_t records = 0;     // all kinds
  std::uint64_t good_bytes = 0;  // up to where they end
  // Records are missing: events and marks end there, unless a reset comes after.
  struct Gap {
    std::string text;  // how many, where, and why
  };
  std::optional<Gap> gap;
  std::string end_error;  // where it is torn: at which byte and how

  std::size_t poses() const { return count(MotionEvent::Kind::kPose); }
  std::size_t count(MotionEvent::Kind kind) const;
};

// Reads a capture, a TUM trajectory or a CSV motion, told apart by their contents. A capture is read up to a torn end,
// which is a warning; wrong bytes before the end are an error. `times` says what becomes of poses whose time does not
// rise; a capture keeps those that are not refused, since a replay needs all that was recorded. Throws
// protocol::MotionError or std::runtime_error: one line.
RecordedMotion read_recorded_motion(const std::filesystem::path& path,
                                    protocol::Times times = protocol::Times::kSkip);
// The same of a capture; throws where it is none.
RecordedMotion read_whole_capture(const std::filesystem::path& path);

// Where a capture is read from: the record of a checkpoint.
struct CaptureStart {
  std::uint64_t offset = 0, records = 0;  // of it; before it
  std::uint64_t checkpoint = 0;           // its id
  std::uint64_t session = 0;              // there
};
// What a capture holds behind that record; nothing where no such record is there. Costs what is read, not what lies
// before. Throws std::runtime_error.
std::optional<RecordedMotion> read_capture_from(const std::filesystem::path& path, const CaptureStart& start);

// Throws std::runtime_error where it is no capture.
protocol::CaptureHeader read_capture_header(const std::filesystem::path& path);

// The configuration that a capture was recorded with. Throws ConfigError.
Config config_of(const protocol::CaptureHeader& header, const std::string& name);

// The blade of a source: its own, or the one for all.
const core::Blade& blade_of(const Config& config, std::uint32_t source);

core::Blade to_core(const protocol::BladeEdge& blade);

// Positions as they were recorded.
std::shared_ptr<const core::VertexPositions> positions_of(const protocol::PositionsRecord& record);

// Does to a session what an event says.
void apply(core::CutSession& session, const MotionEvent& event, const Config& config);

}  // namespace incise::app
