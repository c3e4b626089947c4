#include "server/replay/recorded_motion.hpp"

#include <algorithm>
#include <istream>
#include <iterator>
#include <stdexcept>
#include <utility>

namespace incise::replay {
namespace {

struct RecordReader {
  RecordedMotion& motion;
  const std::string& name;
  const bool from_the_midst;
  const BeforeResets before_resets;

  void operator()(const protocol::PoseRecord& record) {
    check_source(record.source);
    if (motion.gap) return;
    motion.events.push_back(
        {MotionEvent::Kind::kPose, record.source, to_core(record.pose), record.arrival_ns});
  }
  void operator()(const protocol::StrokeRecord& record) {
    check_source(record.source);
    if (motion.gap) return;
    // HandOver: the blade has a new owner from here on. Other actions do not matter: the poses carry the buttons.
    if (record.action == protocol::StrokeAction::End) {
      motion.events.push_back({MotionEvent::Kind::kEndStroke, record.source, {}, record.arrival_ns});
    } else if (record.action == protocol::StrokeAction::HandOver) {
      motion.events.push_back({MotionEvent::Kind::kOpened, record.source, {}, record.arrival_ns});
    }
  }
  void operator()(const protocol::BladeRecord& record) {
    check_source(record.source);
    if (motion.gap) return;
    motion.events.push_back(
        {MotionEvent::Kind::kOpened, record.source, {}, record.arrival_ns, to_core(record.blade)});
  }
  void operator()(const protocol::BatchMark& record) {
    if (motion.gap) {
      ++motion.marks_behind_gaps;
      return;
    }
    motion.marks.push_back(record);
    motion.events_before.push_back(motion.events.size());
  }
  void operator()(const protocol::NoteRecord& record) {
    if (!motion.gap) motion.notes.push_back({record.json, motion.events.size()});
  }
  void operator()(const protocol::GapRecord& record) {
    if (motion.gap) return;
    motion.gap.emplace();
    motion.gap->text = std::to_string(record.records) + " records are missing after record " +
                       std::to_string(motion.records - 1) + " (" + record.reason + ")";
  }
  void operator()(const protocol::CheckpointRecord& record) { motion.checkpoints.push_back(record); }
  void operator()(const protocol::PositionsRecord& record) {
    if (motion.gap) return;
    motion.events.push_back({MotionEvent::Kind::kDeform, 0, {}, record.arrival_ns, {}, positions_of(record)});
  }
  // A replay is of one session: the one after the last reset.
  void operator()(const protocol::ResetRecord& record) {
    if (before_resets == BeforeResets::kKeep)
      motion.earlier.push_back({std::move(motion.events), std::move(motion.marks)});
    motion.events.clear();
    motion.notes.clear();
    motion.marks.clear();
    motion.events_before.clear();
    motion.checkpoints.clear();
    motion.gap.reset();
    motion.session = record.session;
    ++motion.resets;
    motion.undos = 0;
    motion.undone_before_start = false;
  }
  // As if what was undone had never been.
  void operator()(const protocol::UndoRecord& record) {
    check_source(record.source);
    const auto began =
        std::find_if(motion.events.rbegin(), motion.events.rend(), [&](const MotionEvent& event) {
          return event.kind == MotionEvent::Kind::kPose && event.source == record.source &&
                 event.pose.t_ns == record.pose_source_ns && event.arrival_ns == record.pose_arrival_ns;
        });
    motion.session = record.session;
    ++motion.undos;
    if (began == motion.events.rend()) {
      if (motion.gap) return;
      if (!from_the_midst) {
        throw std::runtime_error(name + ": record " + std::to_string(motion.records) +
                                 ": an undo to before a stroke that the capture does not have");
      }
      motion.undone_before_start = true;
      return;
    }
    motion.events.erase(std::next(began).base(), motion.events.end());
    std::erase_if(motion.notes,
                  [&](const RecordedMotion::Note& note) { return note.events > motion.events.size(); });
    const auto later = [&](const protocol::BatchMark& mark) { return mark.revision > record.revision; };
    for (std::size_t i = motion.marks.size(); i-- > 0;) {
      if (!later(motion.marks[i])) continue;
      ++motion.marks_undone;
      motion.marks.erase(motion.marks.begin() + static_cast<std::ptrdiff_t>(i));
      motion.events_before.erase(motion.events_before.begin() + static_cast<std::ptrdiff_t>(i));
    }
    motion.gap.reset();
  }
  void operator()(const protocol::EndRecord&) {}

  // "12 poses, with marks up to revision 3". The poses may lead on to more: a mark comes after its batch is cut.
  std::string text() const {
    const std::size_t poses = motion.poses();
    return std::to_string(poses) + (poses == 1 ? " pose" : " poses") + ", with marks up to revision " +
           std::to_string(motion.marks.empty() ? 0 : motion.marks.back().revision);
  }

  void check_source(std::uint32_t source) const {
    if (source < core::kMaxSources) return;
    throw std::runtime_error(name + ": record " + std::to_string(motion.records) + ": source " +
                             std::to_string(source) + "; accepted are 0 to " +
                             std::to_string(core::kMaxSources - 1));
  }
};

}  // namespace

std::string ends_in_its_header(const std::string& name) {
  return name +
         ": is a capture that ends within its header, as a full disk leaves it: there is nothing in it to "
         "read, replay or resume";
}

bool begins_as_capture(std::istream& in, const std::string& name) {
  using Beginning = protocol::CaptureBeginning;
  const Beginning beginning = protocol::capture_beginning(in);
  const bool empty = in.peek() == std::istream::traits_type::eof();
  in.clear();
  if (beginning == Beginning::Torn && (!empty || name.ends_with(".capture")))
    throw std::runtime_error(ends_in_its_header(name));
  return beginning == Beginning::Whole;
}

RecordedMotion read_capture(std::istream& in, const std::string& name, const CaptureStart* start,
                            IfDamaged if_damaged, BeforeResets before_resets) {
  RecordedMotion motion;
  motion.format = "capture";
  protocol::CaptureReader reader(in);
  protocol::CaptureRecord record;
  RecordReader read{motion, name, start != nullptr, before_resets};
  motion.session = reader.header().session;
  if (reader.good_bytes() > 0) motion.header = reader.header();
  using Status = protocol::CaptureReader::Status;
  Status status = Status::Record;
  if (start != nullptr) {
    reader.skip_to(start->offset, start->records);
    status = reader.next(record);
    const auto* checkpoint = std::get_if<protocol::CheckpointRecord>(&record);
    if (status != Status::Record || checkpoint == nullptr || checkpoint->id != start->checkpoint) {
      motion.header.reset();
      return motion;
    }
    motion.session = start->session;
  }
  while ((status = reader.next(record)) == Status::Record) {
    motion.records = reader.records();
    std::visit(read, record);
  }
  if (!motion.header)
    throw std::runtime_error(status == Status::Torn ? ends_in_its_header(name)
                                                    : name + ": " + reader.error());
  if (status == Status::Corrupt) {
    if (if_damaged == IfDamaged::kRefuse) throw DamagedCapture(name + ": " + reader.error());
    motion.end_error = reader.error();
    motion.warnings.push_back(name + ": damaged (" + reader.error() +
                              "); what is before is used: " + read.text());
  }
  if (status == Status::Torn) {
    motion.end_error = reader.error();
    motion.warnings.push_back(name + ": cut off at its end (" + reader.error() +
                              "); all before that is used");
  }
  if (motion.gap) motion.warnings.push_back(name + ": " + motion.gap->text + "; all before that is used");
  if (motion.resets > 0) {
    motion.warnings.push_back(name + ": the mesh was reset " +
                              (motion.resets == 1 ? "once" : std::to_string(motion.resets) + " times") +
                              (before_resets == BeforeResets::kKeep
                                   ? "; what came before each is checked, too"
                                   : "; what came after the last reset is used"));
  }
  if (motion.undos > 0) {
    motion.warnings.push_back(
        name + ": " + (motion.undos == 1 ? "a stroke was" : std::to_string(motion.undos) + " strokes were") +
        " undone; the others are used");
  }
  motion.records = reader.records();
  motion.good_bytes = reader.good_bytes();
  motion.closed = reader.closed();
  return motion;
}

std::size_t RecordedMotion::count(MotionEvent::Kind kind) const {
  return static_cast<std::size_t>(
      std::count_if(events.begin(), events.end(), [kind](const MotionEvent& e) { return e.kind == kind; }));
}

core::Pose to_core(const protocol::PoseSample& sample) {
  const protocol::Vec3& p = sample.position;
  const protocol::Quat& q = sample.orientation;
  return {sample.source_ns, {p.x, p.y, p.z}, {q.w, q.x, q.y, q.z}, sample.buttons};
}

core::Blade to_core(const protocol::BladeEdge& blade) {
  const auto& [heel, tip] = blade;
  return {{heel.x, heel.y, heel.z}, {tip.x, tip.y, tip.z}};
}

std::shared_ptr<const core::VertexPositions> positions_of(const protocol::PositionsRecord& record) {
  auto positions = std::make_shared<core::VertexPositions>();
  positions->frame = record.frame;
  positions->revision = record.revision;
  positions->source_ns = record.source_ns;
  positions->arrival_ns = record.arrival_ns;
  positions->ids = record.ids;
  positions->first = record.first;
  positions->single = record.single;
  positions->positions.reserve(record.positions.size() / 3);
  for (std::size_t i = 0; i + 2 < record.positions.size(); i += 3)
    positions->positions.push_back({record.positions[i], record.positions[i + 1], record.positions[i + 2]});
  return positions;
}

void apply(core::CutSession& session, const MotionEvent& event, const core::Blade& blade) {
  switch (event.kind) {
    case MotionEvent::Kind::kPose:
      session.push(event.source, event.pose);
      break;
    case MotionEvent::Kind::kEndStroke:
      session.end_stroke(event.source);
      break;
    case MotionEvent::Kind::kOpened:
      session.set_blade(event.source, event.blade ? *event.blade : blade);
      break;
    case MotionEvent::Kind::kDeform:
      session.deform(event.positions);
      break;
  }
}

}  // namespace incise::replay
