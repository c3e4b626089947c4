#include "server/app/recording.hpp"

#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <optional>
#include <vector>

#include "server/app/offline/recorded_motion.hpp"
#include "server/app/stream_setup.hpp"
#include "server/app/version.hpp"
#include "server/base/clock.hpp"
#include "server/base/directory_probe.hpp"
#include "server/core/session/session_state.hpp"
#include "server/loop/checkpoint_file.hpp"
#include "server/mesh_io/tetgen_files.hpp"

namespace incise::app {
namespace {

// The parts of a configuration on which a session's state depends.
bool same_cut(const Config& a, const Config& b) {
  const auto cut_only = [](const Config& config) {
    Config kept;
    kept.cut = config.cut;
    kept.sources = config.sources;
    return compact(kept);
  };
  return cut_only(a) == cut_only(b);
}

// Throws if the capture does not belong to this mesh and configuration.
void require_same(const Config& config, const Body& body, const protocol::CaptureHeader& header,
                  const std::string& path) {
  if (!body.loaded.has_hash(header.mesh_content_hash)) {
    throw std::runtime_error(path + ": was recorded with another mesh: its hash is " +
                             header.mesh_content_hash + ", that of " + body.name + " is " +
                             body.loaded.content_hash);
  }
  if (!same_cut(config, config_of(header, path))) {
    throw std::runtime_error(path +
                             ": was recorded with other values of cut, blade or sources; a session goes on "
                             "only with those it began with (incise info " +
                             path + " --json shows them)");
  }
}

bool same_fields(const std::vector<core::Field>& a, const std::vector<core::Field>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const core::Field& x, const core::Field& y) {
    return x.name == y.name && x.on == y.on && x.components == y.components &&
           x.values.index() == y.values.index();
  });
}

// Wall-clock time, not processor time: what matters is how long a start takes, also on a busy machine.
double seconds_since(std::int64_t ns) {
  return static_cast<double>(monotonic_ns() - ns) * 1e-9;
}

// A place in the capture from which to continue.
struct Start {
  std::unique_ptr<core::CutSession> session;
  RecordedMotion rest;  // the capture after that place
  double read_s = 0;    // time for reading that
  int next_checkpoint = 0;
};

std::optional<Start> from_checkpoint(const Config& config, const std::string& path) {
  struct Found {
    int number;
    loop::Checkpoint checkpoint;
  };
  std::vector<Found> found;
  for (int number = 0; number < loop::kCheckpointFiles; ++number) {
    std::string error;
    auto checkpoint = loop::read_checkpoint(loop::checkpoint_path(path, number), error);
    if (!error.empty()) spdlog::warn("{}; it is passed over", error);
    if (checkpoint) found.push_back({number, std::move(*checkpoint)});
  }
  std::sort(found.begin(), found.end(),
            [](const Found& a, const Found& b) { return a.checkpoint.offset > b.checkpoint.offset; });
  for (const auto& [number, checkpoint] : found) {
    const std::string name = loop::checkpoint_path(path, number);
    Start start;
    start.next_checkpoint = (number + 1) % loop::kCheckpointFiles;
    const std::int64_t before = monotonic_ns();
    const CaptureStart place{checkpoint.offset, checkpoint.records, checkpoint.id, checkpoint.session};
    auto rest = read_capture_from(path, place);
    start.read_s = seconds_since(before);
    if (!rest) {
      spdlog::warn(
          "{}: belongs to another capture, or to a part of this one that was lost; it is passed over", name);
      continue;
    }
    if (rest->undone_before_start) continue;
    start.rest = std::move(*rest);
    std::string error;
    start.session = core::restore_session(checkpoint.state, config.cut, error);
    if (!start.session || start.session->revision() != checkpoint.revision ||
        start.session->mesh().state_hash() != checkpoint.state_hash) {
      spdlog::warn("{}: cannot be used: {}; it is passed over", name,
                   start.session ? "revision or hash is another" : error);
      continue;
    }
    // Else what is recorded from here on could be read by no tool: they begin at the beginning.
    check_capture_before(path, place);
    return start;
  }
  return std::nullopt;
}

// Applies the rest of the capture after the start, and compares the hashes. Returns how many of the records that this led to
// could not be written to the disk.
std::uint64_t replay(const Config& config, const std::string& path, Start& start, CaptureJournal& journal,
                     ReplayTail& tail) {
  const std::uint64_t records = journal.position().records;
  core::CutSession* session = start.session.get();
  const RecordedMotion& motion = start.rest;
  const std::uint64_t begin = session->revision();
  auto mark = std::find_if(motion.marks.begin(), motion.marks.end(),
                           [&](const protocol::BatchMark& m) { return m.revision > begin; });
  core::Delta delta;
  core::WorkBudget budget = core::WorkBudget::unlimited();
  const auto commit_all = [&] {
    while (session->advance(budget, delta) == core::CutSession::Progress::kCommitted) {
      tail.note(*session, delta);
      if (mark == motion.marks.end()) {  // this mark was lost in the crash, or the batch never happened
        journal.write(loop::commit_record(delta));
        continue;
      }
      if (mark->revision != delta.revision || mark->state_hash != delta.state_hash) {
        throw std::runtime_error(
            path + ": revision " + std::to_string(delta.revision) +
            " replays with another hash than it was recorded with: written by other software (" +
            motion.header->software + ")? incise replay --verify says more");
      }
      ++mark;
    }
  };
  for (const MotionEvent& event : motion.events) {
    apply(*session, event, config);
    commit_all();
  }
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    if (!session->in_stroke(source)) continue;
    loop::JournalRecord end;
    end.kind = loop::JournalRecord::Kind::kEndStroke;
    end.source = source;
    end.arrival_ns = monotonic_ns();
    session->end_stroke(source);
    journal.write(end);
    commit_all();
  }
  const std::uint64_t more = journal.position().records - records;
  try {
    journal.flush();
    journal.sync();
  } catch (const std::system_error& error) {
    spdlog::error("the capture cannot be written: {}; cutting goes on, poses are not recorded", error.what());
  }
  return records + more - journal.position().records;
}

// A file that is not a capture and that a start would move away or write over: which, and what to do. Empty: there is none.
std::string foreign_file(const std::filesystem::path& path) {
  std::error_code error;
  std::filesystem::path old = path;
  old += ".old";
  for (const std::filesystem::path& file : {path, old}) {
    if (!std::filesystem::is_regular_file(file, error)) continue;
    std::ifstream in(file, std::ios::binary);
    if (protocol::capture_beginning(in) != protocol::CaptureBeginning::Other) continue;
    return file.string() + " is not a capture" +
           (file == old ? ", and the next start would write the last one there" : "") +
           "; name a file that does not exist, or move this one away";
  }
  return {};
}

// The file that the configuration reads under this path, by its key; empty if there is none.
std::string read_under(const Config& config, const std::string& config_file,
                       const std::filesystem::path& path) {
  const auto same = [&](const std::filesystem::path& other) {
    std::error_code error;
    return std::filesystem::equivalent(path, other, error);
  };
  if (same(config_file)) return "the configuration itself";
  if (!config.mesh.path.empty()) {
    const std::filesystem::path mesh = config.resolve(config.mesh.path);
    const auto [node, ele] = mesh_io::tetgen_paths(mesh);
    if (same(mesh) || same(node) || same(ele)) return "a file of mesh.path";
  }
  const Config::Listen& listen = config.listen;
  const Config::Cluster& cluster = config.cluster;
  for (const auto& [key, value] :
       {std::pair<const char*, const std::string&>{"mesh.image", config.mesh.image},
        {"listen.token_file", listen.token_file},
        {"listen.certificate_file", listen.certificate_file},
        {"listen.private_key_file", listen.private_key_file},
        {"cluster.credentials_file", cluster.credentials_file},
        {"cluster.ca_file", cluster.ca_file},
        {"cluster.certificate_file", cluster.certificate_file},
        {"cluster.private_key_file", cluster.private_key_file}}) {
    if (!value.empty() && same(config.resolve(value))) return std::string("the file of ") + key;
  }
  return {};
}

// Whether the file may be worth keeping: it has poses, or a capture's beginning with wrong bytes behind it.
bool worth_keeping(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  protocol::CaptureReader reader(in);
  protocol::CaptureRecord record;
  using Status = protocol::CaptureReader::Status;
  Status status = Status::Record;
  while ((status = reader.next(record)) == Status::Record) {
    if (std::holds_alternative<protocol::PoseRecord>(record) ||
        std::holds_alternative<protocol::PositionsRecord>(record))
      return true;
  }
  return status == Status::Corrupt;
}

// Writes a checkpoint of the session as it is now, at the end of its capture. False if that fails.
bool write_checkpoint(const std::string& path, Recording& recording) {
  loop::JournalRecord mark;
  mark.kind = loop::JournalRecord::Kind::kCheckpoint;
  mark.checkpoint = fresh_session_id();
  loop::Checkpoint checkpoint;
  checkpoint.id = mark.checkpoint;
  checkpoint.session = recording.session_id;
  checkpoint.offset = recording.journal->position().bytes;
  checkpoint.records = recording.journal->position().records;
  checkpoint.revision = recording.session->revision();
  checkpoint.state_hash = recording.session->mesh().state_hash();
  checkpoint.state = core::save_session(*recording.session);
  try {
    recording.journal->write(mark);
    recording.journal->flush();
    loop::write_checkpoint(loop::checkpoint_path(path, recording.next_checkpoint), checkpoint);
    recording.next_checkpoint = (recording.next_checkpoint + 1) % loop::kCheckpointFiles;
    return true;
  } catch (const std::exception& error) {
    spdlog::warn("a checkpoint cannot be written: {}", error.what());
    return false;
  }
}

}  // namespace

void check_recording(const Config& config, const std::string& file) {
  if (config.capture.path.empty()) return;
  const auto refuse = [&](const std::string& what) { throw ConfigError(file + ": capture.path: " + what); };
  const std::filesystem::path path = config.resolve(config.capture.path);
  const auto parent = path.has_parent_path() ? path.parent_path() : std::filesystem::path(".");
  std::error_code error;
  if (!std::filesystem::is_directory(parent, error)) {
    refuse("the directory " + parent.string() + " does not exist; make it first (mkdir -p " +
           parent.string() + "), or set capture.path to \"\" to record nothing");
  }
  if (std::filesystem::is_directory(path, error))
    refuse(path.string() + " is a directory; name a file in it");
  if (access(parent.c_str(), W_OK | X_OK) != 0) {
    refuse(parent.string() + ": " + std::generic_category().message(errno) +
           "; a directory that this user may write is accepted");
  }
  if (const std::error_code why = why_no_file_can_be_made(parent))
    refuse(parent.string() + ": files cannot be made there (" + why.message() +
           "); choose another directory");
  if (const std::string other = read_under(config, file, path); !other.empty())
    refuse(path.string() + " is " + other + "; name a file of the capture's own");
  if (const std::string foreign = foreign_file(path); !foreign.empty()) refuse(foreign);
}

Recording begin_recording(const Config& config, const Body& body, const stream::InitialState& shown) {
  Recording recording;
  recording.session_id = fresh_session_id();
  recording.session = body.session(config.cut);
  recording.shown.before = shown;
  recording.shown.before.epoch = recording.session_id;
  if (config.capture.path.empty()) return recording;
  const std::filesystem::path path = config.resolve(config.capture.path);
  // Again: an instance that stood by may have done so for days since check_recording().
  if (const std::string foreign = foreign_file(path); !foreign.empty())
    throw ConfigError("capture.path: " + foreign);
  std::error_code error;
  // A recording is somebody's work, so the last one is kept under another name. But not one without a pose: a server that is
  // started again and again must not replace the last good recording by empty ones.
  if (std::filesystem::exists(path, error) && worth_keeping(path)) {
    std::filesystem::path old = path;
    old += ".old";
    std::filesystem::rename(path, old, error);
    if (error)
      throw std::runtime_error(path.string() + ": cannot be moved to " + old.string() + ": " +
                               error.message());
    for (int number = 0; number < loop::kCheckpointFiles; ++number) {
      std::filesystem::remove(loop::checkpoint_path(old.string(), number), error);
      std::filesystem::rename(loop::checkpoint_path(path.string(), number),
                              loop::checkpoint_path(old.string(), number), error);
    }
    spdlog::warn("{} is there already; it is now {} (incised --resume would have gone on with it)",
                 path.string(), old.string());
  }
  protocol::CaptureHeader header;
  header.mesh_path = config.mesh.path.empty()
                         ? config.mesh.phantom
                         : std::filesystem::absolute(config.resolve(config.mesh.path)).string();
  header.mesh_content_hash = body.loaded.content_hash;
  header.session = recording.session_id;
  header.created_unix_ns = unix_ns();
  header.software = kSoftware;
  header.config_json = compact(config);
  recording.journal = std::make_unique<CaptureJournal>(path.string(), header);
  recording.journal->keep_free(config.capture.keep_free_percent / 100);
  return recording;
}

Recording resume_recording(const Config& config, const Body& body) {
  if (config.capture.path.empty()) {
    throw ConfigError(
        "capture.path: found \"\"; accepted with --resume is the path of the capture to go on with");
  }
  const std::string path = config.resolve(config.capture.path).string();
  const auto began = monotonic_ns();
  require_same(config, body, read_capture_header(path), path);
  std::optional<Start> start = from_checkpoint(config, path);
  const bool checkpointed = start.has_value() && start->rest.resets == 0;
  if (!start) {
    start.emplace();
    const std::int64_t before = monotonic_ns();
    start->rest = read_recorded_motion(path);
    start->read_s = seconds_since(before);
  }
  RecordedMotion& motion = start->rest;
  for (const std::string& warning : motion.warnings) spdlog::warn("{}", warning);
  if (motion.gap) {
    throw std::runtime_error(
        path + ": " + motion.gap->text +
        ", and no usable checkpoint after that: the session cannot be resumed. incise export " + path +
        " --out MESH saves the mesh as it was before; without --resume a new session begins, "
        "and this capture is kept");
  }
  if (!checkpointed) {
    start->session = body.session(config.cut);
  }
  Recording recording;
  recording.session_id = motion.session;
  recording.next_checkpoint = start->next_checkpoint;
  recording.journal = std::make_unique<CaptureJournal>(path, motion.good_bytes, motion.records);
  const std::uint64_t from = start->session->revision();
  const std::int64_t before = monotonic_ns();
  ReplayTail tail(*start->session, motion.session, config.stream.ring_bytes);
  recording.lost = replay(config, path, *start, *recording.journal, tail);
  recording.session = std::move(start->session);
  recording.shown = tail.finish(*recording.session);
  if (!motion.events.empty() || motion.resets > 0) recording.debt_s = start->read_s + seconds_since(before);
  if (checkpointed && !same_fields(recording.session->fields().all(), body.loaded.fields)) {
    spdlog::warn("{}: the body's fields are those that the session began with; a reset brings those of now",
                 path);
  }
  // A server that crashes soon after each start would have more to replay each time. Less work than this counts towards the
  // next checkpoint.
  const double most_s = config.capture.checkpoint_replay_s;
  const bool due = most_s > 0 && recording.debt_s > most_s && recording.lost == 0;
  if (due && write_checkpoint(path, recording)) recording.debt_s = 0;
  recording.journal->keep_free(config.capture.keep_free_percent / 100);
  const std::string begin = checkpointed        ? fmt::format("from the checkpoint at revision {}", from)
                            : motion.resets > 0 ? "from the last reset"
                                                : "from the beginning";
  spdlog::info("resumed {} at revision {} in {:.2f} s: {}, {} poses replayed", path,
               recording.session->revision(), seconds_since(began), begin, motion.poses());
  return recording;
}

}  // namespace incise::app
