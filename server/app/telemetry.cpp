#include "server/app/telemetry.hpp"

#include <cinttypes>
#include <cstdio>

#include "server/app/version.hpp"
#include "server/base/hex.hpp"

namespace incise::app {

using Json = nlohmann::ordered_json;

namespace {

using loop::LoopStats;

// The stages of a pose and of a frame, with the names used everywhere.
struct Stage {
  const char* name;
  const char* meaning;
  Histogram LoopStats::*histogram;
};
constexpr Stage kStages[] = {
    {"wake_late", "start of a frame after its deadline", &LoopStats::wake_late},
    {"frame_work", "work of a frame", &LoopStats::frame_work},
    {"drain", "taking poses, in a frame", &LoopStats::drain},
    {"force", "updating the forces, in a frame", &LoopStats::force},
    {"cut", "cutting, in a frame", &LoopStats::cut},
    {"publish", "handing deltas on, in a frame", &LoopStats::publish},
    {"batch_cut", "cutting a batch, over all its frames", &LoopStats::batch_cut},
    {"pose_to_force", "arrival of a blade's newest pose until its force was there",
     &LoopStats::pose_to_force},
    {"deform", "taking a simulation's positions, over all its frames", &LoopStats::deform},
    {"pose_to_drain", "from a batch's last pose arriving until the loop drained it",
     &LoopStats::pose_to_drain},
    {"pose_to_cut", "arrival of a batch's last pose until the batch was cut", &LoopStats::pose_to_cut},
};
constexpr double kQuantiles[] = {0.5, 0.9, 0.99, 0.999};
constexpr const char* kQuantileNames[] = {"p50", "p90", "p99", "p99.9"};

double us(std::uint64_t ns) {
  return static_cast<double>(ns) * 1e-3;
}

Json device_json(const input::DeviceStatus& device) {
  const input::DeviceFigures& figures = device.figures;
  const input::ReportCounts& reports = figures.reports;
  Json json{
      {"device", device.identity}, {"path", device.path}, {"name", device.name}, {"profile", device.profile}};
  json["sources"] = device.sources;
  if (!device.why.empty()) json["not_read"] = device.why;
  json["connections"] = device.connections;
  json["reports"] = {{"count", reports.reports},     {"lost", reports.lost},
                     {"short", reports.short_ones},  {"other", reports.other},
                     {"repeated", reports.repeated}, {"bad_values", reports.bad_values},
                     {"restarts", reports.restarts}};
  json["clock_drift_ppm"] = figures.drift_ppm;
  json["full_queue_ms"] = figures.full_queue_ms;
  json["forces"] = {{"written", figures.forces_written},
                    {"failed", figures.forces_failed},
                    {"pose_to_report_us",
                     {{"p50", figures.pose_to_report.p50_us},
                      {"p99", figures.pose_to_report.p99_us},
                      {"p99.9", figures.pose_to_report.p999_us},
                      {"max", figures.pose_to_report.max_us}}}};
  return json;
}

Json network_json(const input::NetworkStatus& status) {
  Json json{{"peers", Json::array()}};
  for (const input::NetworkStatus::Peer& peer : status.peers) {
    json["peers"].push_back({{"peer", peer.name}, {"connected", peer.connected}, {"sources", peer.sources}});
  }
  for (const auto& [what, count] : status.counts) json[what] = count;
  return json;
}

std::string number(double value) {
  return Json(value).dump();
}

}  // namespace

Json access_json(const stream::StreamCounters& c) {
  return {{"peers", c.peers},
          {"sessions", c.peers},  // the older name of peers
          {"connections", c.connections},
          {"accepted", c.accepted},
          {"refused", c.refused},
          {"wrong_tokens", c.wrong_tokens},
          {"tokens_not_looked_at", c.tokens_not_looked_at},
          {"resets", c.resets},
          {"undos", c.undos},
          {"takeovers", c.takeovers},
          {"handovers", c.handovers}};
}

Json stream_json(const stream::StreamCounters& c) {
  Json json{{"sessions", c.peers},  // the older name of access.peers
            {"deltas", c.deltas},
            {"coalesced", c.coalesced},
            {"snapshots", c.snapshots},
            {"slow_snapshots", c.slow_snapshots},
            {"slow_disconnects", c.slow_disconnects},
            {"resumed", c.resumed}};
  json["boxes"] = {{"deltas", c.box_turns},
                   {"coalesced", c.box_coalesced},
                   {"refused", c.boxes_refused},
                   {"work_ms", static_cast<double>(c.box_turns_ns) * 1e-6},
                   {"bytes", c.part_bytes}};
  return json;
}

Telemetry::Telemetry(const loop::LoopStats& stats, const input::PoseSources& sources,
                     const loop::Journal* journal, double rate_hz)
    : stats_(stats), sources_(sources), journal_(journal), rate_hz_(rate_hz) {}

std::string Telemetry::json() const {
  const loop::LoopState state = stats_.state.load();
  Json root;
  root["software"] = kSoftware;
  root["revision"] = state.revision;
  root["state_hash"] = hex(state.state_hash);
  root["live_tets"] = state.live_tets;
  root["vertices"] = state.vertices;
  root["strokes"] = state.strokes;
  root["batches"] = stats_.batches.load(std::memory_order_relaxed);
  root["deformations"] = {{"count", stats_.deformations.load(std::memory_order_relaxed)},
                          {"vertices_moved", stats_.vertices_moved.load(std::memory_order_relaxed)},
                          {"vertices_held", stats_.vertices_held.load(std::memory_order_relaxed)}};
  root["cut_faces"] = state.cut_faces;
  root["cut_area_m2"] = state.cut_area_m2;
  root["sources"] = sources_.open_count();
  root["blades"] = Json::array();
  const loop::BladesNow blades = stats_.blades.load();
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    const std::string name = sources_.name_of(source);
    if (name.empty()) continue;
    const input::PoseSources::Tally tally = sources_.tally(source);
    const protocol::BladeStats blade = blade_stats(source, blades[source], tally);
    root["blades"].push_back({{"source", source},
                              {"name", name},
                              {"held", tally.open},
                              {"poses", blade.poses},
                              {"rejected", blade.rejected},
                              {"strokes", blade.strokes},
                              {"cut_faces", blade.cut_faces},
                              {"in_stroke", blade.in_stroke}});
  }
  Json poses;
  for (int i = 0; i < core::kPoseVerdicts; ++i) {
    poses[core::to_string(static_cast<core::PoseVerdict>(i))] =
        stats_.verdicts[static_cast<std::size_t>(i)].load(std::memory_order_relaxed);
  }
  root["poses"] = poses;
  Json late;
  for (int i = 0; i < loop::kLateCauses; ++i) {
    late[to_string(static_cast<loop::LateCause>(i))] =
        stats_.late[static_cast<std::size_t>(i)].load(std::memory_order_relaxed);
  }
  root["frames"] = {
      {"rate_hz", rate_hz_}, {"count", state.frames}, {"skipped", state.skipped_frames}, {"late", late}};
  root["backlog"] = {{"poses", state.backlog_events},
                     {"batches", state.backlog_batches},
                     {"segments", state.backlog_segments},
                     {"work_ms", static_cast<double>(state.backlog_ns) * 1e-6},
                     {"recovery_ms", static_cast<double>(state.recovery_ns) * 1e-6}};
  root["limits"] = {{"budget_spent", (state.flags & loop::kBudgetSpent) != 0},
                    {"input_carried", (state.flags & loop::kInputCarried) != 0},
                    {"deltas_blocked", (state.flags & loop::kDeltasBlocked) != 0},
                    {"journal_blocked", (state.flags & loop::kJournalBlocked) != 0}};
  root["ns_per_work_unit"] = state.ns_per_unit;
  root["forces_cut_short"] = state.forces_cut_short;
  if (journal_) {
    root["journal"] = {{"waiting", journal_->waiting()},
                       {"lost", journal_->lost()},
                       {"failing", journal_->failing()},
                       {"trouble", journal_->trouble()}};
    if (const loop::Checkpointer* checkpoints = journal_->checkpointer()) {
      root["checkpoints"] = {{"written", checkpoints->written()},
                             {"last_revision", checkpoints->last_revision()},
                             {"behind", checkpoints->behind()},
                             {"following", checkpoints->following()}};
    }
  }
  if (devices_) {
    root["devices"] = Json::array();
    for (const input::DeviceStatus& device : devices_()) {
      if (!device.profile.empty()) root["devices"].push_back(device_json(device));
    }
  }
  if (network_) {
    for (const input::NetworkStatus& status : network_()) root[status.protocol] = network_json(status);
  }
  if (stream_) {
    const stream::StreamCounters c = stream_();
    root["pieces"] = c.pieces;
    root["access"] = access_json(c);
    root["stream"] = stream_json(c);
  }
  if (cluster_) {
    const cluster::PublisherCounters c = cluster_();
    root["cluster"] = {{"connected", c.connected},     {"trouble", c.trouble},
                       {"connections", c.connections}, {"failures", c.failures},
                       {"messages", c.messages},       {"bytes", c.bytes},
                       {"deltas", c.deltas},           {"snapshots", c.snapshots},
                       {"dropped", c.dropped},         {"queued_bytes", c.queued_bytes}};
  }
  Json stages;
  for (const Stage& stage : kStages) {
    const Histogram& histogram = stats_.*stage.histogram;
    Json figures{{"count", histogram.count()}, {"sum", us(histogram.sum_ns())}};
    for (std::size_t q = 0; q < std::size(kQuantiles); ++q) {
      figures[kQuantileNames[q]] = us(histogram.quantile_ns(kQuantiles[q]));
    }
    figures["max"] = us(histogram.max_ns());
    stages[stage.name] = figures;
  }
  root["stages_us"] = stages;
  // Names are what clients have sent.
  return root.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::string Telemetry::metrics() const {
  const loop::LoopState state = stats_.state.load();
  std::string out;
  const auto family = [&](const std::string& name, const char* type, const std::string& help) {
    out += "# HELP incise_" + name + ' ' + help + "\n# TYPE incise_" + name + ' ' + type + '\n';
  };
  const auto one = [&](const std::string& name, const char* type, const std::string& help, double value) {
    family(name, type, help);
    out += "incise_" + name + ' ' + number(value) + '\n';
  };
  one("revision", "gauge", "Committed batches and deformations since the mesh was loaded.",
      static_cast<double>(state.revision));
  one("live_tets", "gauge", "Tetrahedra.", static_cast<double>(state.live_tets));
  one("strokes_total", "counter", "Strokes begun, those that were undone as well.",
      static_cast<double>(state.strokes));
  one("deformations_total", "counter", "Steps in which a simulation has moved vertices.",
      static_cast<double>(stats_.deformations.load(std::memory_order_relaxed)));
  one("vertices_held_total", "counter", "Vertices that could not move where a simulation wanted them.",
      static_cast<double>(stats_.vertices_held.load(std::memory_order_relaxed)));
  one("cut_faces", "gauge", "Cut faces of the body, as they opened.", static_cast<double>(state.cut_faces));
  one("cut_area_square_metres", "gauge", "Their area, one side.", state.cut_area_m2);
  one("sources", "gauge", "Pose sources that are open.", sources_.open_count());
  one("frames_total", "counter", "Frames of the loop.", static_cast<double>(state.frames));
  one("frames_skipped_total", "counter",
      "Frames skipped because their time had passed before they could begin.",
      static_cast<double>(state.skipped_frames));
  one("backlog_poses", "gauge", "Poses in the queues.", static_cast<double>(state.backlog_events));
  one("backlog_segments", "gauge", "Segments to be cut.", static_cast<double>(state.backlog_segments));
  one("backlog_seconds", "gauge", "Work that these stand for, estimated.",
      static_cast<double>(state.backlog_ns) * 1e-9);
  if (journal_) {
    one("journal_lost_total", "counter", "Records that the journal could not take.",
        static_cast<double>(journal_->lost()));
    one("journal_failing", "gauge", "1 while the journal cannot be written.", journal_->failing() ? 1 : 0);
    one("recording", "gauge", "1 while poses that arrive now would survive a restart.",
        journal_->trouble().empty() ? 1 : 0);
    if (const loop::Checkpointer* checkpoints = journal_->checkpointer()) {
      one("checkpoints_total", "counter", "Checkpoints written.",
          static_cast<double>(checkpoints->written()));
      one("checkpoint_revision", "gauge", "Revision of the last checkpoint.",
          static_cast<double>(checkpoints->last_revision()));
      one("checkpoints_following", "gauge", "0 if there can be no checkpoints until the next reset.",
          checkpoints->following() ? 1 : 0);
    }
  }
  if (devices_) {
    family("device_reports_total", "counter", "Reports of HID devices by what became of them.");
    for (const input::DeviceStatus& device : devices_()) {
      if (device.sources.empty()) continue;
      const input::ReportCounts& r = device.figures.reports;
      const std::pair<const char*, std::uint64_t> counts[]{
          {"arrived", r.reports}, {"lost", r.lost},         {"short", r.short_ones},
          {"other", r.other},     {"repeated", r.repeated}, {"bad_values", r.bad_values}};
      for (const auto& [what, count] : counts) {
        out += "incise_device_reports_total{source=\"" + device.sources.front() + "\",what=\"" + what +
               "\"} " + std::to_string(count) + '\n';
      }
    }
  }
  if (cluster_) {
    const cluster::PublisherCounters c = cluster_();
    const auto count = [&](const char* name, const char* help, std::uint64_t value) {
      one(std::string("cluster_") + name, "counter", help, static_cast<double>(value));
    };
    one("cluster_connected", "gauge", "1 while the session is published on NATS.", c.connected ? 1 : 0);
    one("cluster_queued_bytes", "gauge", "Bytes that wait to be published.",
        static_cast<double>(c.queued_bytes));
    count("connections_total", "Connections made to NATS.", c.connections);
    count("failures_total", "Connections to NATS that failed or were lost, and refusals.", c.failures);
    count("messages_total", "Messages published.", c.messages);
    count("bytes_total", "Bytes of these.", c.bytes);
    count("deltas_total", "Deltas published, of both views.", c.deltas);
    count("snapshots_total", "Snapshots published, of both views.", c.snapshots);
    count("dropped_total", "Steps that were not published because too much waited.", c.dropped);
  }
  if (network_) {
    family("network_input_total", "counter", "What sources on the network brought, by protocol.");
    for (const input::NetworkStatus& status : network_()) {
      for (const auto& [what, count] : status.counts) {
        out += "incise_network_input_total{protocol=\"" + status.protocol + "\",what=\"" + what + "\"} " +
               std::to_string(count) + '\n';
      }
    }
  }
  family("poses_total", "counter", "Poses by what became of them.");
  for (int i = 0; i < core::kPoseVerdicts; ++i) {
    out += "incise_poses_total{verdict=\"" + std::string(core::to_string(static_cast<core::PoseVerdict>(i))) +
           "\"} " +
           std::to_string(stats_.verdicts[static_cast<std::size_t>(i)].load(std::memory_order_relaxed)) +
           '\n';
  }
  family("late_frames_total", "counter", "Frames that ended after the next should have begun, by cause.");
  for (int i = 0; i < loop::kLateCauses; ++i) {
    out += "incise_late_frames_total{cause=\"" + std::string(to_string(static_cast<loop::LateCause>(i))) +
           "\"} " + std::to_string(stats_.late[static_cast<std::size_t>(i)].load(std::memory_order_relaxed)) +
           '\n';
  }
  for (const Stage& stage : kStages) {
    const Histogram& histogram = stats_.*stage.histogram;
    const std::string name = std::string(stage.name) + "_seconds";
    family(name, "summary", std::string(stage.meaning) + ".");
    for (const double q : kQuantiles) {
      out += "incise_" + name + "{quantile=\"" + number(q) + "\"} " +
             number(static_cast<double>(histogram.quantile_ns(q)) * 1e-9) + '\n';
    }
    out += "incise_" + name + "_sum " + number(static_cast<double>(histogram.sum_ns()) * 1e-9) + '\n';
    out += "incise_" + name + "_count " + std::to_string(histogram.count()) + '\n';
  }
  return out;
}

protocol::BladeStats Telemetry::blade_stats(std::uint32_t source, const loop::BladeNow& blade,
                                            const input::PoseSources::Tally& tally) const {
  return {source,
          sources_.name_of(source),
          tally.accepted,
          tally.rejected,
          static_cast<std::uint32_t>(blade.strokes),
          blade.cut_faces,
          tally.open && blade.cutting != 0};
}

protocol::Stats Telemetry::message() const {
  const loop::LoopState state = stats_.state.load();
  protocol::Stats stats;
  stats.json = json();
  stats.live_tets = static_cast<std::uint32_t>(state.live_tets);
  stats.backlog_segments = static_cast<std::uint32_t>(state.backlog_segments);
  stats.frames = state.frames;
  stats.late_frames = stats_.late_frames();
  for (int i = 0; i < core::kPoseVerdicts; ++i) {
    const std::uint64_t count = stats_.verdicts[static_cast<std::size_t>(i)].load(std::memory_order_relaxed);
    (core::accepted(static_cast<core::PoseVerdict>(i)) ? stats.poses_accepted : stats.poses_rejected) +=
        count;
  }
  stats.frame_work_p99_us = static_cast<float>(us(stats_.frame_work.quantile_ns(0.99)));
  if (journal_ && journal_->checkpointer()) stats.undoable = journal_->checkpointer()->undoable();
  const loop::BladesNow blades = stats_.blades.load();
  for (std::uint32_t source = 0; source < blades.size(); ++source) {
    const input::PoseSources::Tally tally = sources_.tally(source);
    if (tally.open) stats.blades.push_back(blade_stats(source, blades[source], tally));
  }
  stats.pose_to_delta_p99_us = static_cast<float>(us(stats_.pose_to_cut.quantile_ns(0.99)));
  return stats;
}

std::vector<protocol::BladePose> Telemetry::blades() const {
  const auto to_protocol = [](const core::Vec3& p) { return protocol::Vec3{p.x, p.y, p.z}; };
  std::vector<protocol::BladePose> blades;
  const loop::BladesNow now = stats_.blades.load();
  for (std::uint32_t source = 0; source < now.size(); ++source) {
    const loop::BladeNow& blade = now[source];
    if (blade.arrival_ns == 0) continue;
    blades.push_back({source, blade.cutting != 0, to_protocol(blade.line.heel), to_protocol(blade.line.tip),
                      blade.arrival_ns, std::nullopt});
    if (squared_length(blade.force) > 0) blades.back().force_n = to_protocol(blade.force);
  }
  return blades;
}

}  // namespace incise::app
