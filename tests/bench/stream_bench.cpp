// incise-bench stream: what a cut costs as deltas, compared with sending the surface or the whole mesh each time; what many
// viewers cost a frame, and how long a delta takes to them; what ten thousand connections do; what boxes of interest cost.

#include <CLI/CLI.hpp>
#include <boost/beast/zlib/deflate_stream.hpp>
#include <chrono>
#include <fstream>
#include <functional>
#include <memory>
#include <string>
#include <thread>

#include "client/client.hpp"
#include "protocol/surface.hpp"
#include "server/stream/mirror.hpp"
#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"
#include "tests/bench/box_bench.hpp"
#include "tests/bench/crowd.hpp"
#include "tests/bench/live_server.hpp"

namespace incise::bench {
namespace {

stream::InitialState initial_state(const core::TetMesh& mesh) {
  stream::InitialState state;
  state.epoch = 1;
  for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) state.positions.push_back(mesh.position(v));
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t)
    if (mesh.alive(t)) state.tets.push_back(mesh.state(t));
  return state;
}

// The length of a message as permessage-deflate would send it, with the earlier messages as context.
class Deflater {
 public:
  Deflater() { stream_.reset(6, 15, 8, boost::beast::zlib::Strategy::normal); }
  std::size_t operator()(std::span<const std::byte> message) {
    namespace zlib = boost::beast::zlib;
    out_.resize(stream_.upper_bound(message.size()) + 64);
    zlib::z_params z;
    z.next_in = message.data();
    z.avail_in = message.size();
    z.next_out = out_.data();
    z.avail_out = out_.size();
    boost::system::error_code error;
    stream_.write(z, zlib::Flush::sync, error);
    if (error) throw std::runtime_error("deflate: " + error.message());
    return out_.size() - z.avail_out - 4;  // the end of the block is left out
  }

 private:
  boost::beast::zlib::deflate_stream stream_;
  std::vector<std::byte> out_;
};

// A way to bring a viewer on: its bytes over all steps, and the CPU time of each.
struct Way {
  std::string name;
  double bytes = 0, deflated = 0;
  std::vector<double> ms, deflate_ms;
  Deflater deflater;

  void time(const std::function<std::size_t()>& encode) {
    const double start = thread_cpu_s();
    bytes += static_cast<double>(encode());
    ms.push_back(1e3 * (thread_cpu_s() - start));
  }
  void deflate(const stream::SharedFrame& frame) {
    const double start = thread_cpu_s();
    deflated += static_cast<double>(deflater(frame->body()));
    deflate_ms.push_back(1e3 * (thread_cpu_s() - start));
  }
};

template <class Writer>
std::size_t encode_chunks(Writer writer) {
  std::size_t bytes = 0;
  while (writer.next()) bytes += protocol::encode(writer.chunk()).tcp().size();
  return bytes;
}

std::size_t decode_and_encode(const stream::SharedFrame& frame) {
  return protocol::encode(protocol::decode(frame->body()).message->body).tcp().size();
}

// One through-cut, batch by batch as a moving blade makes it, sent in each of four ways after each batch.
void bench_bytes(const NamedMesh& named, Report& report) {
  core::CutSession session(named.mesh, bench_config(core::Policy::kConforming));
  push(session, through_cut(named.mesh, {0.31, 0.17, 1}), 200);
  stream::Mirror mirror;
  mirror.reset(initial_state(session.mesh()));
  Way ways[4];
  ways[0].name = "surface, deltas";
  ways[1].name = "whole surface";
  ways[2].name = "volume, deltas";
  ways[3].name = "whole mesh";
  std::vector<double> mirror_ms;
  std::uint64_t faces = 0;
  for (;;) {
    stream::PublishedDelta published;
    core::WorkBudget budget = core::WorkBudget::unlimited();
    if (session.advance(budget, published.delta) != core::CutSession::Progress::kCommitted) break;
    faces += published.delta.cut_faces;
    const double start = thread_cpu_s();
    const std::optional<stream::EncodedStep> step = mirror.apply(published).step;
    mirror_ms.push_back(1e3 * (thread_cpu_s() - start));
    if (!step) throw std::runtime_error("a delta longer than a message may be");
    // Both include reading the arrays that they send, as the snapshots do.
    ways[0].time([&] { return decode_and_encode(step->surface); });
    ways[1].time([&] {
      return encode_chunks(protocol::SurfaceSnapshotWriter(mirror.surface(), protocol::SnapshotCause::Join));
    });
    ways[0].deflate(step->surface);
    ways[2].deflate(step->volume);
    ways[2].time([&] { return decode_and_encode(step->volume); });
    ways[3].time([&] {
      return encode_chunks(protocol::SnapshotWriter(mirror.volume(), protocol::SnapshotCause::Join));
    });
  }
  report.fact("mesh", named.name);
  report.fact("tetrahedra", count(named.mesh.tets.size()));
  report.fact("deltas of the cut", count(mirror_ms.size()));
  report.fact("cut faces", count(faces));
  report.table("one through-cut, sent after each batch", {{"way"},
                                                          {"bytes a cut face"},
                                                          {"kB a batch", 1},
                                                          {"encode p50, ms", 3},
                                                          {"p99, ms", 3},
                                                          {"max, ms", 3}});
  for (const Way& way : ways) {
    report.row({way.name, way.bytes / static_cast<double>(std::max<std::uint64_t>(1, faces)),
                1e-3 * way.bytes / static_cast<double>(std::max<std::size_t>(1, way.ms.size())),
                percentile(way.ms, 0.5), percentile(way.ms, 0.99), percentile(way.ms, 1)});
  }
  report.row({std::string("(the mirror: both deltas found, checked, encoded)"), std::string(), std::string(),
              percentile(mirror_ms, 0.5), percentile(mirror_ms, 0.99), percentile(mirror_ms, 1)});
  report.table("what permessage-deflate would do to the deltas, once for each WebSocket",
               {{"way"}, {"bytes"}, {"deflated"}, {"p50, ms", 3}, {"p99, ms", 3}, {"max, ms", 3}});
  for (const Way* way : {&ways[0], &ways[2]}) {
    report.row({way->name, way->bytes, way->deflated, percentile(way->deflate_ms, 0.5),
                percentile(way->deflate_ms, 0.99), percentile(way->deflate_ms, 1)});
  }
}

// ---- The whole server ----

// Memory in use of a process, MB.
double resident_mb(pid_t pid) {
  std::ifstream status("/proc/" + std::to_string(pid) + "/status");
  for (std::string key; status >> key;) {
    double kb = 0;
    if (key == "VmRSS:" && status >> kb) return kb / 1024;
  }
  return 0;
}

void begin_crowd_table(const std::string& title, Report& report) {
  report.table(title, {{"peers"},
                       {"frames"},
                       {"work p50, us", 1},
                       {"p99, us", 1},
                       {"p99.9, us", 1},
                       {"deltas"},
                       {"viewers' p50, ms", 2},
                       {"p99, ms", 2},
                       {"max, ms", 2},
                       {"viewers lost"},
                       {"server, MB", 1}});
}

// The server with that crowd around it, while a device cuts; one row.
void run_crowd(const std::string& name, const LiveMotion& motion, const nlohmann::json& listen,
               const Crowd::Options& many, const Crowd::Options& few, Report& report) {
  LiveServer server(motion, listen);
  server.connect_device();
  Crowd viewers(server.tcp_port(), few);
  Crowd others(server.tcp_port(), many);
  server.drive();
  const double memory = resident_mb(server.pid());
  const nlohmann::json stats = server.settled_stats();
  if (!viewers.wait_for_revision(stats["revision"], 60))
    throw std::runtime_error("a viewer fell behind for good");
  const std::vector<double>& ms = viewers.stop();
  const auto& work = stats["stages_us"]["frame_work"];
  report.row({name, count(stats["frames"]["count"]), work["p50"].get<double>(), work["p99"].get<double>(),
              work["p99.9"].get<double>(), count(stats["revision"]), percentile(ms, 0.5),
              percentile(ms, 0.99), percentile(ms, 1),
              count(static_cast<std::uint64_t>(viewers.viewers_lost())), memory});
  others.stop();
  server.end();
}

struct StreamBench : LiveMotion {
  StreamBench() { seconds = 10; }
  std::string mesh;
  double scale = 1;
  int viewers = 256, stalled = 5, rounds = 2, connections = 0, snapshots = 0;
  std::vector<int> boxed;
  double box = 0.5;
};

void bench_viewers(const StreamBench& bench, Report& report) {
  begin_crowd_table("a device cuts while viewers of the surface follow", report);
  const std::string name =
      std::to_string(bench.viewers) + " viewers and " + std::to_string(bench.stalled) + " that read nothing";
  for (int round = 0; round < bench.rounds; ++round) {
    run_crowd("none", bench, nlohmann::json::object(), {}, {}, report);
    Crowd::Options viewers, stalled;
    viewers.viewers = bench.viewers;
    stalled.stalled = bench.stalled;
    run_crowd(name, bench, nlohmann::json::object(), stalled, viewers, report);
  }
}

// Eight viewers follow; the rest are connections that say nothing, at the default caps, and sessions that only listen
// (view None), where the cap is raised.
void bench_connections(const StreamBench& bench, Report& report) {
  const std::size_t limit = raise_descriptor_limit();
  int n = bench.connections;
  if (static_cast<std::size_t>(n) + 100 > limit) {
    n = static_cast<int>(limit) - 100;
    report.fact("connections", std::to_string(n) + ", as this process may have " + std::to_string(limit) +
                                   " open files (ulimit -n)");
  }
  begin_crowd_table("a device cuts, 8 viewers follow, and others are connected", report);
  Crowd::Options viewers, silent, sessions;
  viewers.viewers = 8;
  silent.silent = n;
  sessions.viewers = n;
  sessions.view = protocol::View::None;
  run_crowd("8", bench, nlohmann::json::object(), {}, viewers, report);
  run_crowd("8 and " + std::to_string(n) + " silent", bench, nlohmann::json::object(), silent, viewers,
            report);
  run_crowd("8 and " + std::to_string(n) + " sessions", bench, {{"max_sessions", n + 20}}, sessions, viewers,
            report);
}

// One who joins while a device cuts a large body, again and again: from connect() to a whole, checked replica, and what
// that does to the frames.
void bench_snapshots(const StreamBench& bench, Report& report) {
  report.table("somebody joins again and again while a device cuts", {{"joins"},
                                                                      {"frames"},
                                                                      {"work p50, us", 1},
                                                                      {"p99, us", 1},
                                                                      {"p99.9, us", 1},
                                                                      {"MB a snapshot", 1},
                                                                      {"whole after p50, ms", 1},
                                                                      {"max, ms", 1}});
  for (const int joins : {0, bench.snapshots}) {
    LiveServer server(bench);
    server.connect_device();
    std::vector<double> ms;
    double megabytes = 0;
    std::thread joiner([&] {
      for (int i = 0; i < joins; ++i) {
        const auto start = std::chrono::steady_clock::now();
        const auto client = client::Client::connect("127.0.0.1", server.tcp_port());
        if (!client->wait_for_revision(0, 60)) return;
        ms.push_back(
            std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count());
        megabytes = 1e-6 * static_cast<double>(client->counters().bytes_in);
      }
    });
    server.drive();
    joiner.join();
    const nlohmann::json stats = server.settled_stats();
    const auto& work = stats["stages_us"]["frame_work"];
    report.row({count(ms.size()), count(stats["frames"]["count"]), work["p50"].get<double>(),
                work["p99"].get<double>(), work["p99.9"].get<double>(), megabytes, percentile(ms, 0.5),
                percentile(ms, 1)});
    if (joins > 0) report.fact("tetrahedra", count(server.tets()));
    server.end();
  }
}

void run(const StreamBench& bench, Report& report) {
  report.begin("stream");
  if (!bench.boxed.empty()) return bench_boxed({bench, bench.boxed, bench.box, 60, bench.rounds}, report);
  if (bench.snapshots > 0) return bench_snapshots(bench, report);
  if (bench.connections > 0) return bench_connections(bench, report);
  bench_bytes(bench.mesh.empty() ? phantom("liver", static_cast<std::size_t>(bench.tets))
                                 : load(bench.mesh, bench.scale),
              report);
  if (bench.rounds > 0) bench_viewers(bench, report);
}

}  // namespace

void add_stream_bench(CLI::App& app, Report& report) {
  auto bench = std::make_shared<StreamBench>();
  CLI::App* sub = app.add_subcommand(
      "stream", "Bytes a cut face and encoding; what viewers cost a frame, and a delta's way to them");
  sub->add_option("--mesh", bench->mesh, "A mesh whose deltas are measured, instead of the phantom liver");
  sub->add_option("--scale", bench->scale, "Its unit in metres")->capture_default_str();
  sub->add_option("--tets", bench->tets, "Of the phantom liver")->capture_default_str();
  sub->add_option("--seconds", bench->seconds, "How long poses come in each run")->capture_default_str();
  sub->add_option("--speed", bench->speed_m_s, "Of the blade, m/s")->capture_default_str();
  sub->add_option("--viewers", bench->viewers, "That follow")->capture_default_str();
  sub->add_option("--stalled", bench->stalled, "That ask for everything and read nothing")
      ->capture_default_str();
  sub->add_option("--rounds", bench->rounds, "Runs without and with viewers, in turn; 0: none")
      ->capture_default_str();
  sub->add_option("--connections", bench->connections, "Instead: the server with so many connections")
      ->check(CLI::Range(1, 100'000));
  sub->add_option("--snapshots", bench->snapshots,
                  "Instead: somebody joins so often, and how long that takes")
      ->check(CLI::Range(1, 1000));
  sub->add_option(
         "--boxed", bench->boxed,
         "Instead: a simulator moves the body, and so many viewers with a box follow; 0 1 3 8: four runs")
      ->check(CLI::Range(0, 1000));
  sub->add_option("--box", bench->box, "Of the body's size, a box's along each axis")->capture_default_str();
  sub->add_option("--incised", bench->incised, "Another build of incised, to compare with");
  sub->callback([bench, &report] { run(*bench, report); });
}

}  // namespace incise::bench
