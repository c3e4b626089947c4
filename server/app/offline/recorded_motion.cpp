#include "server/app/offline/recorded_motion.hpp"

#include <algorithm>
#include <array>
#include <istream>

#include "protocol/motion.hpp"
#include "server/mesh_io/mesh_io.hpp"

namespace incise::app {
namespace {

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

std::unique_ptr<std::istream> open_file(const std::string& name) {
  std::error_code error;
  if (std::filesystem::is_directory(name, error))
    throw std::runtime_error(name + ": is a directory; accepted is a file");
  return protocol::open_motion(name);
}

[[noreturn]] void refuse_damaged(const std::string& damage) {
  throw std::runtime_error(damage +
                           "; incise replay and export use what is before it with --until-damage, and incise "
                           "convert --until-damage makes a whole capture of that for all else");
}

RecordedMotion read_capture(std::istream& in, const std::string& name, IfDamaged if_damaged,
                            const CaptureStart* start = nullptr,
                            BeforeResets before_resets = BeforeResets::kDrop) {
  try {
    return replay::read_capture(in, name, start, if_damaged, before_resets);
  } catch (const replay::DamagedCapture& damage) {
    refuse_damaged(damage.what());
  }
}

}  // namespace

RecordedMotion read_recorded_motion(const std::filesystem::path& path, protocol::Times times,
                                    IfDamaged if_damaged) {
  const std::string name = path.string();
  const std::unique_ptr<std::istream> in = open_file(name);
  if (replay::begins_as_capture(*in, name)) {
    RecordedMotion motion = read_capture(*in, name, if_damaged);
    if (times == protocol::Times::kRefuse) refuse_unless_rising(motion, name);
    return motion;
  }
  if (mesh_io::is_mesh_input(path) || mesh_io::is_surface_file(path) || mesh_io::is_surface_input(path)) {
    throw std::runtime_error(name + ": is a mesh by its ending; accepted is a motion: a capture, TUM or CSV");
  }
  const protocol::Motion text = protocol::read_motion(*in, name, times);
  RecordedMotion motion;
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
    motion.events.push_back({MotionEvent::Kind::kPose, 0, replay::to_core(sample), sample.source_ns});
  }
  if (!text.warning.empty()) motion.warnings.push_back(text.warning);
  if (!text.has_orientation) {
    motion.warnings.push_back(name +
                              ": no orientations (columns qw, qx, qy, qz): the blade keeps its direction");
  }
  return motion;
}

RecordedMotion read_whole_capture(const std::filesystem::path& path, IfDamaged if_damaged,
                                  BeforeResets before_resets) {
  const std::string name = path.string();
  const std::unique_ptr<std::istream> in = open_file(name);
  if (!replay::begins_as_capture(*in, name)) {
    throw std::runtime_error(name +
                             ": is not a capture; incised records one (capture.path), and incise convert "
                             "makes one of a motion");
  }
  return read_capture(*in, name, if_damaged, nullptr, before_resets);
}

std::optional<RecordedMotion> read_capture_from(const std::filesystem::path& path,
                                                const CaptureStart& start) {
  const std::unique_ptr<std::istream> in = open_file(path.string());
  RecordedMotion motion = read_capture(*in, path.string(), IfDamaged::kRefuse, &start);
  if (!motion.header) return std::nullopt;
  return motion;
}

void check_capture_before(const std::filesystem::path& path, const CaptureStart& start) {
  using Status = protocol::CaptureReader::Status;
  const std::unique_ptr<std::istream> in = open_file(path.string());
  protocol::CaptureReader reader(*in);
  protocol::CaptureRecord record;
  Status status = Status::Record;
  while (reader.good_bytes() <= start.offset && (status = reader.next(record)) == Status::Record) {
  }
  // What looks torn, because nothing good is near behind it, is damage as well: the start's own record is behind it.
  if (status != Status::Record) refuse_damaged(path.string() + ": " + reader.error());
  const auto* checkpoint = std::get_if<protocol::CheckpointRecord>(&record);
  if (checkpoint != nullptr && checkpoint->id == start.checkpoint) return;
  refuse_damaged(path.string() + ": offset " + std::to_string(start.offset) +
                 ": not the record of a checkpoint that begins there, counted from the beginning");
}

protocol::CaptureHeader read_capture_header(const std::filesystem::path& path) {
  const std::unique_ptr<std::istream> in = open_file(path.string());
  const bool torn = protocol::capture_beginning(*in) == protocol::CaptureBeginning::Torn;  // or empty
  protocol::CaptureReader reader(*in);
  if (reader.header_ok()) return reader.header();
  protocol::CaptureRecord none;
  if (torn || reader.next(none) == protocol::CaptureReader::Status::Torn)
    throw std::runtime_error(replay::ends_in_its_header(path.string()));
  throw std::runtime_error(path.string() + ": is not a capture of incised: " + reader.error());
}

const core::Blade& blade_of(const Config& config, std::uint32_t source) {
  return source < config.sources.size() ? config.sources[source].blade : config.cut.blade;
}

Config config_of(const protocol::CaptureHeader& header, const std::string& name) {
  return parse_config(header.config_json, name + " (the configuration in its header)");
}

void apply(core::CutSession& session, const MotionEvent& event, const Config& config) {
  replay::apply(session, event, blade_of(config, event.source));
}

}  // namespace incise::app
