#include <cinttypes>
#include <cstdio>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <system_error>

#include "client/cli/commands.hpp"
#include "client/cli/usage.hpp"
#include "server/app/body.hpp"
#include "server/app/capture_journal.hpp"
#include "server/app/capture_lock.hpp"
#include "server/app/look.hpp"
#include "server/app/offline/commands.hpp"
#include "server/app/offline/cut_file.hpp"
#include "server/app/offline/motion_run.hpp"
#include "server/app/offline/open_capture.hpp"
#include "server/app/version.hpp"
#include "server/base/hex.hpp"
#include "server/base/unfinished_file.hpp"
#include "server/base/wording.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;

// Replays the events, and calls `committed` after each batch until it returns false.
void replay(core::CutSession& session, const std::vector<MotionEvent>& events, const Config& config,
            const std::function<bool(const core::Delta&)>& committed) {
  core::Delta delta;
  core::WorkBudget budget = core::WorkBudget::unlimited();
  Progress progress("replaying");
  for (std::size_t i = 0; i <= events.size(); ++i) {
    if (i < events.size()) apply(session, events[i], config);
    while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
      if (!committed(delta)) return;
    }
    if (i % 64 == 0) progress.show(static_cast<double>(i) / static_cast<double>(events.size()));
  }
}

// What a replay says of the marks of one run: of what was cut from a reset, or the start, to the next reset or the end.
struct Comparison {
  std::uint64_t compared = 0;
  Json difference;                        // the first; null: none
  std::optional<std::uint64_t> short_of;  // the last mark's revision, to which the replay did not come
  bool same() const { return difference.is_null() && !short_of; }
};

Comparison compare(core::CutSession& session, const std::vector<MotionEvent>& events,
                   const std::vector<protocol::BatchMark>& batch_marks, const Config& config, bool go_on) {
  std::map<std::uint64_t, protocol::BatchMark> marks;
  for (const protocol::BatchMark& mark : batch_marks) marks[mark.revision] = mark;
  Comparison found;
  replay(session, events, config, [&](const core::Delta& delta) {
    const auto mark = marks.find(delta.revision);
    if (mark == marks.end()) return true;
    ++found.compared;
    if (mark->second.state_hash == delta.state_hash) return true;
    if (found.difference.is_null()) {
      found.difference = {{"revision", delta.revision},
                          {"source", delta.source},
                          {"stroke", delta.stroke},
                          {"batch", delta.batch},
                          {"recorded_hash", hex(mark->second.state_hash)},
                          {"replayed_hash", hex(delta.state_hash)}};
    }
    return go_on;
  });
  if (found.difference.is_null() && !marks.empty() && session.revision() < marks.rbegin()->first)
    found.short_of = marks.rbegin()->first;
  return found;
}

// Says on stderr what is wrong with a run. `where`: which run that is, such as " before reset 1"; empty for the last one.
void print_trouble(const std::string& capture, const std::string& where, const Comparison& found,
                   std::uint64_t revision) {
  if (const Json& difference = found.difference; !difference.is_null()) {
    std::fprintf(stderr,
                 "%s: batch %u of stroke %u of source %u is the first that differs%s: revision %" PRIu64
                 " was recorded with hash %s and replays with %s\n",
                 capture.c_str(), difference["batch"].get<unsigned>(), difference["stroke"].get<unsigned>(),
                 difference["source"].get<unsigned>(), where.c_str(),
                 difference["revision"].get<std::uint64_t>(),
                 difference["recorded_hash"].get<std::string>().c_str(),
                 difference["replayed_hash"].get<std::string>().c_str());
  } else if (found.short_of) {
    std::fprintf(stderr,
                 "%s: the replay ends at revision %" PRIu64 "%s, but a mark is of revision %" PRIu64 "\n",
                 capture.c_str(), revision, where.c_str(), *found.short_of);
  }
}

// How many batches a capture has marks of, and what became of these.
struct Marks {
  std::uint64_t compared = 0, before_resets = 0, undone = 0, behind_gaps = 0, all = 0;

  Json json() const {
    return {{"in_capture", all},
            {"compared", compared},
            {"compared_before_resets", before_resets},
            {"undone", undone},
            {"behind_gaps", behind_gaps}};
  }
  std::string text() const {
    std::string text = std::to_string(compared) + " of " + std::to_string(all) + " batches";
    if (before_resets > 0) text += ", " + std::to_string(before_resets) + " of them before a reset";
    if (undone > 0) text += "; " + std::to_string(undone) + " were undone, and a replay leaves them out";
    if (behind_gaps > 0)
      text +=
          "; " + std::to_string(behind_gaps) + " cannot be compared, since records are missing before them";
    return text;
  }
};

}  // namespace

int run_replay(const ReplayCommand& command) {
  const Replayable opened = open_capture(command.capture, command.mesh, command.if_damaged, false,
                                         command.verify ? BeforeResets::kKeep : BeforeResets::kDrop);
  const RecordedMotion& motion = opened.motion;
  Marks marks;
  marks.undone = motion.marks_undone;
  marks.behind_gaps = motion.marks_behind_gaps;
  marks.all = motion.marks.size() + marks.undone + marks.behind_gaps;
  bool earlier_same = true;
  for (std::size_t run = 0; run < motion.earlier.size(); ++run) {
    const RecordedMotion::Run& before = motion.earlier[run];
    core::CutSession session(opened.body.loaded.mesh, opened.config.cut);
    const Comparison found = compare(session, before.events, before.marks, opened.config, false);
    marks.all += before.marks.size();
    marks.before_resets += found.compared;
    earlier_same = earlier_same && found.same();
    print_trouble(command.capture.string(), " before reset " + std::to_string(run + 1), found,
                  session.revision());
  }
  core::CutSession session(opened.body.loaded.mesh, opened.config.cut);
  const Comparison found = compare(session, motion.events, motion.marks, opened.config, !command.verify);
  marks.compared = marks.before_resets + found.compared;
  // All that was cut was undone, or reset: what is left is the body as loaded.
  const bool nothing_left = session.revision() == 0 && motion.resets + motion.undos > 0;
  const bool nothing_compared = marks.compared == 0 && !nothing_left;
  const bool verified = found.same() && earlier_same && !motion.gap;

  Json result;
  result["capture"] = command.capture.string();
  result["poses"] = motion.poses();
  result["batches"] = session.revision();
  result["compared"] = found.compared;
  if (command.verify) result["marks"] = marks.json();
  result["closed"] = motion.closed;
  result["state_hash"] = hex(session.mesh().state_hash());
  result["tets"] = session.mesh().live_tets();
  result["verified"] = verified;
  result["first_difference"] = found.difference;
  std::vector<std::string> warnings = motion.warnings;
  if (nothing_compared)
    warnings.push_back(command.capture.string() + ": has no batch marks; nothing was compared");
  else if (command.verify && found.compared < session.revision())
    warnings.push_back(command.capture.string() + ": " +
                       counted(session.revision() - found.compared, "batch has", "batches have") +
                       " no mark to compare with, since records are missing");
  result["warnings"] = warnings;
  print_warnings(warnings);
  if (command.json) {
    std::printf("%s\n", result.dump(2).c_str());
  } else {
    print_row("poses", std::to_string(motion.poses()));
    print_row("batches",
              std::to_string(session.revision()) + ", " + std::to_string(found.compared) + " with a mark");
    print_row("state hash", hex(session.mesh().state_hash()));
  }
  print_trouble(command.capture.string(), "", found, session.revision());
  if (motion.gap)
    std::fprintf(stderr, "%s: has a gap; revisions after %" PRIu64 " cannot be verified\n",
                 command.capture.c_str(), session.revision());
  if (command.verify && verified && !command.json && !nothing_compared) {
    std::printf("verified: %s\n",
                marks.compared > 0 ? marks.text().c_str()
                                   : "all strokes were undone or reset; what is left is the body as loaded");
  }
  return command.verify && (!verified || nothing_compared) ? 1 : 0;
}

int run_export(const ExportCommand& command) {
  const Output out{command.out, "--out", Output::Kind::kMesh};
  require_outputs({out}, {command.capture, command.mesh, command.config});
  Replayable opened = open_capture(command.capture, command.mesh, command.if_damaged, true);
  const std::string without_fields = fields_left_out(command.out, opened.body.loaded.fields);
  if (!without_fields.empty()) opened.body.loaded.fields.clear();
  require_not_read(out, {opened.config.mesh.path});
  std::vector<RegionMaterials> regions;
  if (keeps_materials(command.out)) {
    const bool other = !command.config.empty();
    Config look = other ? load_config(command.config) : opened.config;
    if (!other && drop_look_files(look)) opened.motion.warnings.push_back(kLookFilesLeftOut);
    regions = region_materials(look, opened.body.loaded.mesh, command.config.string());
  }
  core::CutSession session(opened.body.loaded.mesh, opened.config.cut, opened.body.loaded.fields);
  if (!command.revision || *command.revision > 0) {
    replay(session, opened.motion.events, opened.config,
           [&](const core::Delta& delta) { return !command.revision || delta.revision < *command.revision; });
  }
  if (command.revision && session.revision() != *command.revision) {
    throw std::runtime_error("--revision: found " + std::to_string(*command.revision) +
                             "; accepted are 0 to " + std::to_string(session.revision()) +
                             ", which is where " + command.capture.string() + " ends");
  }
  write_cut_mesh(command.out, session, opened.body.loaded.surface.get(), &regions);
  std::vector<std::string> warnings = opened.motion.warnings;
  const std::vector<std::string>& of_fields = opened.body.loaded.warnings;
  if (keeps_fields(command.out)) {
    warnings.insert(warnings.end(), of_fields.begin(), of_fields.end());
  } else if (session.mesh().deformed()) {
    warnings.push_back(command.out.string() +
                       ": has the body as a simulation has deformed it, not where it was at rest; .vtu and "
                       ".vtk have both");
  }
  if (!without_fields.empty()) warnings.push_back(without_fields);
  if (std::string warning = cuts_left_out(command.out, session.mesh()); !warning.empty())
    warnings.push_back(std::move(warning));
  print_warnings(warnings);
  if (command.json) {
    std::printf("%s\n", Json{{"out", command.out.string()},
                             {"revision", session.revision()},
                             {"tets", session.mesh().live_tets()},
                             {"state_hash", hex(session.mesh().state_hash())},
                             {"warnings", warnings}}
                            .dump(2)
                            .c_str());
    return 0;
  }
  print_row("revision", std::to_string(session.revision()));
  print_row("tetrahedra", std::to_string(session.mesh().live_tets()));
  print_row("state hash", hex(session.mesh().state_hash()));
  print_written(files_of_mesh(command.out));
  return 0;
}

namespace {

// The record of an event in a capture.
loop::JournalRecord record_of(const MotionEvent& event, const Config& config) {
  loop::JournalRecord record;
  record.source = event.source;
  record.arrival_ns = event.arrival_ns;
  record.pose = event.pose;
  switch (event.kind) {
    case MotionEvent::Kind::kPose:
      break;
    case MotionEvent::Kind::kEndStroke:
      record.kind = loop::JournalRecord::Kind::kEndStroke;
      break;
    case MotionEvent::Kind::kOpened:
      record.kind = loop::JournalRecord::Kind::kOpened;
      record.blade = event.blade ? *event.blade : blade_of(config, event.source);
      break;
    case MotionEvent::Kind::kDeform:
      record.kind = loop::JournalRecord::Kind::kDeform;
      record.positions = event.positions;
      break;
  }
  return record;
}

struct Conversion {
  std::vector<std::string> warnings;
  std::optional<bool> closed;  // of a capture: whether it was
  std::size_t poses = 0;
  std::uint64_t batches = 0, state_hash = 0;
};

Config convert_config(const ConvertCommand& command, const RecordedMotion& motion) {
  Config config;
  if (!command.config.empty()) {
    config = load_config(command.config);
  } else if (motion.header) {
    config = config_of(*motion.header, command.motion.string());
  } else {
    config.cut.always_engaged = true;
  }
  if (!command.mesh.empty()) {
    config.mesh.phantom.clear();
    config.mesh.path = command.mesh.string();
    config.directory.clear();
  }
  if (config.mesh.path.empty() && config.mesh.phantom.empty()) {
    throw client::UsageError(
        "no mesh to cut: give --mesh, or a configuration with mesh.path or mesh.phantom (--config)");
  }
  return config;
}

// Runs a motion and records it. A capture that was there stays until the new one is whole; an interruption leaves no part of that. Throws
// std::system_error if it cannot be written.
void write_capture(const std::filesystem::path& out, const protocol::CaptureHeader& header,
                   const Config& config, MotionRun& run, bool deformations, Progress& progress) {
  client::interrupted();  // from here on a signal does not end the process
  UnfinishedFile file(out);
  CaptureJournal capture(file.temporary().string(), header);
  std::uint64_t written = 0;
  run.run({.deformations = deformations,
           .event =
               [&](const MotionEvent& event, core::PoseVerdict) {
                 if (client::interrupted())
                   throw std::runtime_error("interrupted: " + out.string() + " was not written");
                 capture.write(record_of(event, config));
                 if (++written % 64 == 0) capture.flush();
               },
           .commit = [&](const core::Delta& delta, double) { capture.write(loop::commit_record(delta)); }},
          progress);
  capture.close();
  if (const std::error_code error = file.finish()) throw std::system_error(error);
}

Conversion convert(const ConvertCommand& command, const Output& out, Progress& progress) {
  RecordedMotion motion = read_recorded_motion(command.motion, command.times, command.if_damaged);
  warn_if_not_closed(motion, command.motion.string());
  Config config = convert_config(command, motion);
  if (!config.mesh.path.empty()) require_not_read(out, {config.resolve(config.mesh.path)});
  progress.stage("loading the mesh");
  const Body body = load_body(config, [&](std::string_view stage, double) { progress.show(-1, stage); });
  const Box box = box_of(body.loaded.mesh);
  check_blade(config, motion, box.diagonal());
  hold_button(motion, config);
  const std::string raised = suit_limits(config, motion, box.diagonal());

  protocol::CaptureHeader header;
  header.mesh_path =
      config.mesh.path.empty() ? config.mesh.phantom : config.resolve(config.mesh.path).string();
  header.mesh_content_hash = body.loaded.content_hash;
  header.session = 1;
  header.software = kSoftware;
  header.config_json = compact(config);
  core::CutSession session(body.loaded.mesh, config.cut);
  MotionRun run(session, motion, config, command.motion.string());
  // A simulation's positions name vertices of the mesh that they were recorded with.
  const bool deformations = motion.header && body.loaded.has_hash(motion.header->mesh_content_hash);
  progress.stage("converting");
  try {
    write_capture(command.out, header, config, run, deformations, progress);
  } catch (const std::system_error& error) {
    throw std::runtime_error(command.out.string() + ": cannot be written: " + error.code().message());
  }

  Conversion done{motion.warnings, {}, motion.poses(), session.revision(), session.mesh().state_hash()};
  if (motion.header) done.closed = motion.closed;
  for (std::string& warning : run.warnings(core::measure(session.mesh()).cut_faces, box))
    done.warnings.push_back(std::move(warning));
  if (!raised.empty()) {
    done.warnings.push_back(
        command.motion.string() + ": raised " + raised +
        " to suit the motion; a server with this configuration treats its steps as jumps: "
        "set the same there");
  }
  return done;
}

}  // namespace

int run_convert(const ConvertCommand& command) {
  const Output out{command.out, "--out", Output::Kind::kFile};
  require_outputs({out}, {command.motion, command.mesh, command.config});
  const CaptureLock lock(command.out, CaptureLock::IfHeld::kRefuse, "--out");
  const Conversion done = [&] {
    Progress progress("reading " + command.motion.filename().string());
    return convert(command, out, progress);
  }();
  print_warnings(done.warnings);
  if (command.json) {
    Json result{{"out", command.out.string()},
                {"poses", done.poses},
                {"batches", done.batches},
                {"state_hash", hex(done.state_hash)}};
    if (done.closed) result["closed"] = *done.closed;
    result["warnings"] = done.warnings;
    std::printf("%s\n", result.dump(2).c_str());
    return 0;
  }
  if (done.closed == false) print_row("closed", "no: the session may have gone on after this");
  print_row("poses", std::to_string(done.poses));
  print_row("batches", std::to_string(done.batches));
  print_row("state hash", hex(done.state_hash));
  print_row("written", command.out.string());
  return 0;
}

}  // namespace incise::app
