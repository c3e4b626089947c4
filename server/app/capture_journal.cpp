#include "server/app/capture_journal.hpp"

#include <system_error>

namespace incise::app {
namespace {

protocol::Vec3 to_protocol(const core::Vec3& p) {
  return {p.x, p.y, p.z};
}

protocol::PositionsRecord to_capture(const core::VertexPositions& positions) {
  protocol::PositionsRecord record{positions.frame,
                                   positions.revision,
                                   positions.source_ns,
                                   positions.arrival_ns,
                                   positions.first,
                                   positions.ids,
                                   {},
                                   positions.single};
  record.positions.reserve(3 * positions.positions.size());
  for (const core::Vec3& p : positions.positions)
    record.positions.insert(record.positions.end(), {p.x, p.y, p.z});
  return record;
}

protocol::CaptureRecord to_capture(const loop::JournalRecord& record) {
  using Kind = loop::JournalRecord::Kind;
  switch (record.kind) {
    case Kind::kOpened:
      return protocol::BladeRecord{
          record.source, record.arrival_ns, {to_protocol(record.blade.heel), to_protocol(record.blade.tip)}};
    case Kind::kEndStroke:
      return protocol::StrokeRecord{record.source, protocol::StrokeAction::End, 0, record.arrival_ns};
    case Kind::kCommit:
      return protocol::BatchMark{record.revision, record.state_hash,   record.source, record.stroke,
                                 record.batch,    record.stroke_ended, record.frame};
    case Kind::kReset:
      return protocol::ResetRecord{record.session, record.arrival_ns};
    case Kind::kGap:
      return protocol::GapRecord{record.lost, 0, record.arrival_ns, record.arrival_ns,
                                 "the disk was full or too slow"};
    case Kind::kCheckpoint:
      return protocol::CheckpointRecord{record.checkpoint};
    case Kind::kDeform:
      return to_capture(*record.positions);
    case Kind::kPose:
      break;
  }
  const core::Pose& pose = record.pose;
  const core::Vec3& p = pose.position;
  const core::Quat& q = pose.orientation;
  return protocol::PoseRecord{
      record.source, {pose.t_ns, {p.x, p.y, p.z}, {q.w, q.x, q.y, q.z}, pose.buttons, 0}, record.arrival_ns};
}

}  // namespace

CaptureJournal::CaptureJournal(const std::string& path, const protocol::CaptureHeader& header)
    : path_(path), sink_(path, true), writer_(sink_, header) {
  flush();
  sync();
}

CaptureJournal::CaptureJournal(const std::string& path, std::uint64_t offset, std::uint64_t records)
    : path_(path), sink_(path, false), writer_(sink_, offset, records) {}

void CaptureJournal::write(const loop::JournalRecord& record) {
  writer_.append(to_capture(record));
}

void CaptureJournal::flush() {
  if (const std::error_code error = writer_.flush()) {
    writer_.drop_pending();
    throw std::system_error(error, path_);
  }
}

void CaptureJournal::sync() {
  if (const std::error_code error = writer_.sync()) throw std::system_error(error, path_);
}

loop::JournalSink::Position CaptureJournal::position() const {
  return {writer_.written_bytes(), writer_.records()};
}

void CaptureJournal::close() {
  writer_.append(protocol::EndRecord{writer_.records()});
  flush();
  sync();
}

}  // namespace incise::app
