#include "server/app/capture_journal.hpp"

#include <sys/statvfs.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <system_error>

#include "server/loop/checkpoint_file.hpp"
#include "server/replay/session_view.hpp"

namespace incise::app {
namespace {

using replay::to_protocol;

// How many bytes are written between two checks of the free space.
constexpr std::uint64_t kLook_bytes = 1u << 20;
// So much beyond the reserve must be free before recording resumes, or it would stop again at once.
constexpr double kRoomAgain = 0.01;

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
    case Kind::kUndo:
      return protocol::UndoRecord{record.session,   record.arrival_ns, record.source,
                                  record.pose.t_ns, record.posed_ns,   record.revision};
    case Kind::kGap:
      return protocol::GapRecord{record.lost, 0, record.arrival_ns, record.arrival_ns,
                                 "the disk was full or too slow"};
    case Kind::kCheckpoint:
      return protocol::CheckpointRecord{record.checkpoint};
    case Kind::kDeform:
      return to_capture(*record.positions);
    case Kind::kPose:
    case Kind::kUndoWanted:  // never comes here
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
  if (record.kind != loop::JournalRecord::Kind::kOpened || !record.name) return;
  const nlohmann::ordered_json note{{"source", record.source}, {"name", *record.name}};
  // A name is what a client has sent.
  writer_.append(
      protocol::NoteRecord{note.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace)});
}

// After a gap a replay can go on only from a checkpoint. A gap that just fits into a full disk, with no checkpoint behind it, would take
// even what the capture had before.
std::uint64_t CaptureJournal::room_to_go_on() const {
  std::uint64_t largest = 0;
  for (int number = 0; number < loop::kCheckpointFiles; ++number) {
    std::error_code none;
    const auto size = std::filesystem::file_size(loop::checkpoint_path(path_, number), none);
    if (!none) largest = std::max<std::uint64_t>(largest, size);
  }
  return (64u << 10) + 2 * largest;
}

bool CaptureJournal::has_room() {
  if (failure_) {
    struct statvfs files {};
    return ::statvfs(path_.c_str(), &files) != 0 ||
           std::uint64_t{files.f_bavail} * files.f_frsize >= room_to_go_on();
  }
  if (keep_free_ == 0 || (!low_ && writer_.written_bytes() < next_look_)) return true;
  struct statvfs files {};
  if (::statvfs(path_.c_str(), &files) != 0 || files.f_blocks == 0) return true;
  const double free = static_cast<double>(files.f_bavail) / static_cast<double>(files.f_blocks);
  low_ = free < keep_free_ + (low_ ? kRoomAgain : 0);
  next_look_ = writer_.written_bytes() + kLook_bytes;
  return !low_;
}

void CaptureJournal::flush() {
  if (may_write_ && !may_write_()) {
    writer_.drop_pending();
    throw std::runtime_error(path_ + ": another instance may have the session");
  }
  if (!has_room()) {
    writer_.drop_pending();
    if (failure_) throw std::system_error(failure_, path_);
    throw std::runtime_error(path_ + ": less than " + std::to_string(std::lround(100 * keep_free_)) +
                             " % of its file system is free (capture.keep_free_percent)");
  }
  failure_ = writer_.flush();
  if (failure_) {
    writer_.drop_pending();
    throw std::system_error(failure_, path_);
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
