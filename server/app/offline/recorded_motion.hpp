#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "protocol/capture.hpp"
#include "server/app/config.hpp"
#include "server/core/cut_session.hpp"

namespace incise::app {

// One thing that was done to a session, in its order.
struct MotionEvent {
  enum class Kind : std::uint8_t { kPose, kEndStroke, kOpened };
  Kind kind = Kind::kPose;
  std::uint32_t source = 0;
  core::Pose pose;
  std::int64_t arrival_ns = 0;  // at the server that recorded it, its clock; of a text motion the pose's own time
};

// A motion from a file, whatever its format.
struct RecordedMotion {
  std::string format;  // "capture", "CSV" or "TUM"
  std::vector<MotionEvent> events;
  bool has_orientation = true;
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
  std::string end_error;         // where it is torn: at which byte and how

  std::size_t poses() const;
};

// Reads a capture, a TUM trajectory or a CSV motion, told apart by their contents. A capture is read up to a torn end,
// which is a warning; wrong bytes before the end, and gaps, are errors. Throws protocol::MotionError or
// std::runtime_error: one line.
RecordedMotion read_recorded_motion(const std::filesystem::path& path);

// The configuration that a capture was recorded with. Throws ConfigError.
Config config_of(const protocol::CaptureHeader& header, const std::string& name);

// Does to a session what an event says. The blade of a source that is opened is the configuration's.
void apply(core::CutSession& session, const MotionEvent& event, const Config& config);

}  // namespace incise::app
