#pragma once

#include <cstdint>
#include <iosfwd>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "protocol/capture.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::replay {

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
  std::vector<std::size_t> events_before;  // each of marks
  std::vector<protocol::CheckpointRecord> checkpoints;
  struct Note {
    std::string json;
    std::size_t events = 0;  // before it
  };
  std::vector<Note> notes;    // as events: since the last reset, without those of what was undone
  std::uint64_t session = 0;  // its id, after the last reset
  std::uint64_t resets = 0;
  std::uint64_t undos = 0;  // since then: what was undone is not among events and marks
  // It was read from a place in the midst, and an undo led back to before that: nothing of this is of use.
  bool undone_before_start = false;
  // What resets have ended, in order, where that was asked for (BeforeResets).
  struct Run {
    std::vector<MotionEvent> events;
    std::vector<protocol::BatchMark> marks;
  };
  std::vector<Run> earlier;
  // Marks of the whole capture that are in none of these: of strokes that were undone, and behind a gap.
  std::uint64_t marks_undone = 0, marks_behind_gaps = 0;
  bool closed = false;           // it was ended properly, not cut off
  std::uint64_t records = 0;     // all kinds
  std::uint64_t good_bytes = 0;  // up to the end of these
  // Records are missing: events and marks end there, unless a reset follows.
  struct Gap {
    std::string text;  // how many, where, and why
  };
  std::optional<Gap> gap;
  std::string end_error;  // if it is torn or damaged: at which byte and how

  std::size_t poses() const { return count(MotionEvent::Kind::kPose); }
  std::size_t count(MotionEvent::Kind kind) const;
};

// Where to start reading a capture: the record of a checkpoint.
struct CaptureStart {
  std::uint64_t offset = 0, records = 0;  // its place; records before it
  std::uint64_t checkpoint = 0;           // its id
  std::uint64_t session = 0;              // there
};
// Wrong bytes before the end of a capture: an error, or the end, with a warning that says how much is before them.
enum class IfDamaged : std::uint8_t { kRefuse, kEndThere };
// Such an error; what is before can be read.
struct DamagedCapture : std::runtime_error {
  using std::runtime_error::runtime_error;
};
// What came before the last reset: only who checks all of a capture needs it.
enum class BeforeResets : std::uint8_t { kDrop, kKeep };
// What every reader says of a capture that ends within its header: nothing else is known of it.
std::string ends_in_its_header(const std::string& name);
// Whether that is a capture. Throws std::runtime_error where it ends within its first bytes; an empty file is one by its ending.
bool begins_as_capture(std::istream& in, const std::string& name);
// Reads a capture up to a torn end, which is a warning; from `start`, if given: then header is empty if there is no such record. `name`
// is the capture in messages. Throws std::runtime_error: wrong bytes before the end, DamagedCapture if the header is good.
RecordedMotion read_capture(std::istream& in, const std::string& name, const CaptureStart* start = nullptr,
                            IfDamaged if_damaged = IfDamaged::kRefuse,
                            BeforeResets before_resets = BeforeResets::kDrop);

core::Pose to_core(const protocol::PoseSample& sample);
core::Blade to_core(const protocol::BladeEdge& blade);

// Positions from their record.
std::shared_ptr<const core::VertexPositions> positions_of(const protocol::PositionsRecord& record);

// Applies an event to a session. `blade`: of a source that is opened without one.
void apply(core::CutSession& session, const MotionEvent& event, const core::Blade& blade);

}  // namespace incise::replay
