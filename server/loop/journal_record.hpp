#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "server/core/mesh/delta.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/core/session/vertex_positions.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/core/stroke/stroke_builder.hpp"

namespace incise::loop {

// One thing that the loop did that its state depends on (kOpened, kPose, kEndStroke, kDeform), or a mark to check it
// by.
struct JournalRecord {
  enum class Kind : std::uint8_t {
    kOpened,     // source, arrival_ns, blade, name: the source has another owner
    kPose,       // source, owner, arrival_ns, pose, verdict
    kEndStroke,  // source, arrival_ns
    kDeform,     // arrival_ns, positions
    kCommit,  // source, stroke, batch, revision, state_hash, frame, positions (a step's, if at hand): the batch that led there is done
    kReset,   // session, arrival_ns: the mesh is as loaded again
    kUndo,  // session, arrival_ns, source, pose.t_ns, posed_ns, revision: all is as before this pose, which began a stroke
    kUndoWanted,  // request, name: asks the checkpointer for the state before the last stroke of that blade, or of any; not in the capture
    kGap,         // lost: so many records are missing here
    kCheckpoint,  // checkpoint: the one of this id has the state that all before leads to
  };
  Kind kind = Kind::kPose;
  std::uint32_t source = 0;
  std::uint32_t owner = 0;  // number of the source's owner; not in the capture
  std::int64_t arrival_ns = 0;
  std::shared_ptr<const std::string> name;
  core::Pose pose;
  core::Blade blade;
  core::PoseVerdict verdict = core::PoseVerdict::kAccepted;
  bool begins_stroke = false;
  std::uint32_t stroke = 0, batch = 0;
  bool stroke_ended = false;
  std::uint64_t revision = 0;
  std::uint64_t state_hash = 0;
  std::uint64_t frame = 0;  // of the loop, since it started
  std::uint64_t session = 0;
  std::int64_t posed_ns = 0;
  std::uint64_t request = 0;
  std::uint64_t lost = 0;
  std::uint64_t checkpoint = 0;
  std::shared_ptr<const core::VertexPositions> positions;
};

// Does to a session what the loop did to its own. No effect: records that say nothing of the session's inputs.
inline void apply(core::CutSession& session, const JournalRecord& record) {
  using Kind = JournalRecord::Kind;
  if (record.kind == Kind::kOpened) session.set_blade(record.source, record.blade);
  if (record.kind == Kind::kPose) session.push(record.source, record.pose);
  if (record.kind == Kind::kEndStroke) session.end_stroke(record.source);
  if (record.kind == Kind::kDeform) session.deform(record.positions);
}

// The mark of a finished batch.
inline JournalRecord commit_record(const core::Delta& delta) {
  JournalRecord record;
  record.kind = JournalRecord::Kind::kCommit;
  record.source = delta.source;
  record.stroke = delta.stroke;
  record.batch = delta.batch;
  record.stroke_ended = delta.stroke_ended;
  record.revision = delta.revision;
  record.state_hash = delta.state_hash;
  return record;
}

}  // namespace incise::loop
