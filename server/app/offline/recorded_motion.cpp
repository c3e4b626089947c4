#include "server/app/offline/recorded_motion.hpp"

#include <algorithm>
#include <array>
#include <fstream>

#include "protocol/motion.hpp"
#include "server/mesh_io/mesh_io.hpp"

namespace incise::app {
namespace {

core::Pose pose_of(const protocol::PoseSample& sample) {
  const protocol::Vec3& p = sample.position;
  const protocol::Quat& q = sample.orientation;
  return {sample.source_ns, {p.x, p.y, p.z}, {q.w, q.x, q.y, q.z}, sample.buttons};
}

struct RecordReader {
  RecordedMotion& motion;
  const std::string& name;

  void operator()(const protocol::PoseRecord& record) {
    check_source(record.source);
    if (motion.gap) return;
    motion.events.push_back(
        {MotionEvent::Kind::kPose, record.source, pose_of(record.pose), record.arrival_ns});
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
    if (!motion.gap) motion.marks.push_back(record);
  }
  void operator()(const protocol::NoteRecord&) {}
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
    motion.events.clear();
    motion.marks.clear();
    motion.checkpoints.clear();
    motion.gap.reset();
    motion.session = record.session;
    ++motion.resets;
  }
  void operator()(const protocol::EndRecord&) {}

  void check_source(std::uint32_t source) const {
    if (source < core::kMaxSources) return;
    throw std::runtime_error(name + ": record " + std::to_string(motion.records) + ": source " +
                             std::to_string(source) + "; accepted are 0 to " +
                             std::to_string(core::kMaxSources - 1));
  }
};

void read_capture(std::istream& in, const std::string& name, const CaptureStart* start,
                  RecordedMotion& motion) {
  motion.format = "capture";
  protocol::CaptureReader reader(in);
  protocol::CaptureRecord record;
  RecordReader read{motion, name};
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
      return;
    }
    motion.session = start->session;
  }
  while ((status = reader.next(record)) == Status::Record) {
    motion.records = reader.records();
    std::visit(read, record);
  }
  if (status == Status::Corrupt || !motion.header) throw std::runtime_error(name + ": " + reader.error());
  if (status == Status::Torn) {
    motion.end_error = reader.error();
    motion.warnings.push_back(name + ": cut off at its end (" + reader.error() +
                              "); all before that is used");
  }
  if (motion.gap) motion.warnings.push_back(name + ": " + motion.gap->text + "; all before that is used");
  if (motion.resets > 0) {
    motion.warnings.push_back(name + ": the mesh was reset " +
                              (motion.resets == 1 ? "once" : std::to_string(motion.resets) + " times") +
                              "; what came after the last reset is used");
  }
  motion.records = reader.records();
  motion.good_bytes = reader.good_bytes();
  motion.closed = reader.closed();
}

bool begins_as_capture(std::istream& in) {
  std::array<char, 8> head{};
  in.read(head.data(), head.size());
  const auto got = in.gcount();
  in.clear();
  in.seekg(0);
  return std::string_view(head.data(), static_cast<std::size_t>(got)) == "INCISCAP";
}

// Throws if a pose is not later than the one before of the same source; a source that is opened again has a new
// clock.
void refuse_unless_rising(const RecordedMotion& motion, const std::string& name) {
  std::array<std::optional<std::int64_t>, core::kMaxSources> last_ns;
  for (const MotionEvent& event : motion.events) {
    std::optional<std::int64_t>& last = last_ns[event.source];
    if (event.kind == MotionEvent::Kind::kOpened) last.reset();
    if (event.kind != MotionEvent::Kind::kPose) continue;
    if (last && event.pose.t_ns <= *last) {
      throw std::runtime_error(name + ": time " + protocol::seconds_text(event.pose.t_ns) + " after " +
                               protocol::seconds_text(*last) + ", accepted are rising times");
    }
    last = event.pose.t_ns;
  }
}

std::ifstream open_file(const std::string& name) {
  std::error_code error;
  if (std::filesystem::is_directory(name, error))
    throw std::runtime_error(name + ": is a directory; accepted is a file");
  std::ifstream in(name, std::ios::binary);
  if (!in) throw std::runtime_error(name + ": cannot be opened: " + std::generic_category().message(errno));
  return in;
}

}  // namespace

std::size_t RecordedMotion::count(MotionEvent::Kind kind) const {
  return static_cast<std::size_t>(
      std::count_if(events.begin(), events.end(), [kind](const MotionEvent& e) { return e.kind == kind; }));
}

RecordedMotion read_recorded_motion(const std::filesystem::path& path, protocol::Times times) {
  const std::string name = path.string();
  std::ifstream in = open_file(name);
  RecordedMotion motion;
  if (begins_as_capture(in)) {
    read_capture(in, name, nullptr, motion);
    if (times == protocol::Times::kRefuse) refuse_unless_rising(motion, name);
    return motion;
  }
  if (mesh_io::is_mesh_input(path) || mesh_io::is_surface_file(path)) {
    throw std::runtime_error(name + ": is a mesh by its ending; accepted is a motion: a capture, TUM or CSV");
  }
  const protocol::Motion text = protocol::read_motion(in, name, times);
  motion.format = text.csv ? "CSV" : "TUM";
  motion.has_orientation = text.has_orientation;
  motion.has_buttons = text.has_buttons;
  auto restart = text.restarts.begin();
  for (std::size_t i = 0; i < text.samples.size(); ++i) {
    const protocol::PoseSample& sample = text.samples[i];
    if (restart != text.restarts.end() && *restart == i) {
      motion.events.push_back({MotionEvent::Kind::kEndStroke, 0, {}, sample.source_ns});
      ++restart;
    }
    motion.events.push_back({MotionEvent::Kind::kPose, 0, pose_of(sample), sample.source_ns});
  }
  if (!text.warning.empty()) motion.warnings.push_back(text.warning);
  if (!text.has_orientation) {
    motion.warnings.push_back(name +
                              ": no orientations (columns qw, qx, qy, qz): the blade keeps its direction");
  }
  return motion;
}

RecordedMotion read_whole_capture(const std::filesystem::path& path) {
  const std::string name = path.string();
  std::ifstream in = open_file(name);
  if (!begins_as_capture(in)) {
    throw std::runtime_error(name +
                             ": is not a capture; incised records one (capture.path), and incise convert "
                             "makes one of a motion");
  }
  RecordedMotion motion;
  read_capture(in, name, nullptr, motion);
  return motion;
}

std::optional<RecordedMotion> read_capture_from(const std::filesystem::path& path,
                                                const CaptureStart& start) {
  std::ifstream in = open_file(path.string());
  RecordedMotion motion;
  read_capture(in, path.string(), &start, motion);
  if (!motion.header) return std::nullopt;
  return motion;
}

protocol::CaptureHeader read_capture_header(const std::filesystem::path& path) {
  std::ifstream in = open_file(path.string());
  const protocol::CaptureReader reader(in);
  if (!reader.header_ok())
    throw std::runtime_error(path.string() + ": is not a capture of incised: " + reader.error());
  return reader.header();
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

const core::Blade& blade_of(const Config& config, std::uint32_t source) {
  return source < config.sources.size() ? config.sources[source].blade : config.cut.blade;
}

Config config_of(const protocol::CaptureHeader& header, const std::string& name) {
  return parse_config(header.config_json, name + " (the configuration in its header)");
}

core::Blade to_core(const protocol::BladeEdge& blade) {
  const auto& [heel, tip] = blade;
  return {{heel.x, heel.y, heel.z}, {tip.x, tip.y, tip.z}};
}

void apply(core::CutSession& session, const MotionEvent& event, const Config& config) {
  switch (event.kind) {
    case MotionEvent::Kind::kPose:
      session.push(event.source, event.pose);
      break;
    case MotionEvent::Kind::kEndStroke:
      session.end_stroke(event.source);
      break;
    case MotionEvent::Kind::kOpened:
      session.set_blade(event.source, event.blade ? *event.blade : blade_of(config, event.source));
      break;
    case MotionEvent::Kind::kDeform:
      session.deform(event.positions);
      break;
  }
}

}  // namespace incise::app
