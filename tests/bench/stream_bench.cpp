#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <memory>
#include <thread>

#include "client/client.hpp"
#include "protocol/surface.hpp"
#include "server/stream/mirror.hpp"
#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"
#include "tests/stream/mini_loop.hpp"

// What a delta costs on the wire and to encode, beside sending the surface or the whole mesh anew each time; how long a
// snapshot takes to a client on loopback; how long a delta takes to many viewers.
namespace incise::bench {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

stream::InitialState initial_state(const core::TetMesh& mesh) {
  stream::InitialState state;
  state.session = 1;
  for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) state.positions.push_back(mesh.position(v));
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) state.tets.push_back(mesh.state(t));
  return state;
}

// Bytes of a whole state in both views.
std::pair<std::size_t, std::size_t> snapshot_bytes(const stream::Mirror& mirror) {
  std::size_t volume = 0, surface = 0;
  protocol::SnapshotWriter volume_writer(mirror.volume(), protocol::SnapshotCause::Join);
  while (volume_writer.next()) volume += protocol::encode(volume_writer.chunk()).tcp().size();
  protocol::SurfaceSnapshotWriter surface_writer(mirror.surface(), protocol::SnapshotCause::Join);
  while (surface_writer.next()) surface += protocol::encode(surface_writer.chunk()).tcp().size();
  return {volume, surface};
}

// One through-cut as a moving blade makes it, in batches.
std::vector<std::shared_ptr<stream::PublishedDelta>> deltas_of_a_cut(core::CutSession& session,
                                                                     const core::MeshData& mesh) {
  push(session, through_cut(mesh, {0.31, 0.17, 1}), 200);
  std::vector<std::shared_ptr<stream::PublishedDelta>> deltas;
  for (;;) {
    auto published = std::make_shared<stream::PublishedDelta>();
    core::WorkBudget budget = core::WorkBudget::unlimited();
    if (session.advance(budget, published->delta) != core::CutSession::Progress::kCommitted) return deltas;
    deltas.push_back(std::move(published));
  }
}

void bench_deltas(const NamedMesh& mesh, Report& report) {
  core::CutSession session(mesh.mesh, bench_config(core::Policy::kConforming));
  stream::Mirror mirror;
  mirror.reset(initial_state(session.mesh()));
  std::vector<double> encode_us;
  std::size_t volume = 0, surface = 0, faces = 0;
  const auto deltas = deltas_of_a_cut(session, mesh.mesh);
  for (const auto& delta : deltas) {
    const auto start = Clock::now();
    const auto step = mirror.apply(*delta);
    encode_us.push_back(1e6 * seconds_since(start));
    volume += step->volume->tcp().size();
    surface += step->surface->tcp().size();
    faces += delta->delta.cut_faces;
  }
  const auto [whole_volume, whole_surface] = snapshot_bytes(mirror);
  const double n = static_cast<double>(std::max<std::size_t>(1, faces));
  const double steps = static_cast<double>(deltas.size());
  report.table("one through-cut of " + mesh.name + ": bytes a cut face",
               {{"view"}, {"delta", 1}, {"surface anew", 1}, {"mesh anew", 1}, {"surface anew / delta", 1}});
  report.row({std::string("volume"), static_cast<double>(volume) / n,
              static_cast<double>(whole_surface) * steps / n, static_cast<double>(whole_volume) * steps / n,
              static_cast<double>(whole_surface) * steps / static_cast<double>(volume)});
  report.row({std::string("surface"), static_cast<double>(surface) / n,
              static_cast<double>(whole_surface) * steps / n, static_cast<double>(whole_volume) * steps / n,
              static_cast<double>(whole_surface) * steps / static_cast<double>(surface)});
  report.table("mirror and encoding of both views, us a delta",
               {{"deltas"}, {"cut faces"}, {"p50", 1}, {"p99", 1}, {"max", 1}});
  report.row({count(deltas.size()), count(faces), percentile(encode_us, 0.5), percentile(encode_us, 0.99),
              percentile(encode_us, 1)});
}

void bench_snapshot(std::uint32_t cells, Report& report) {
  stream::StreamConfig config = stream::test_config();
  stream::TestServer test(cells, config);
  report.table("snapshot to a client on loopback, s",
               {{"transport"}, {"view"}, {"tets"}, {"bytes"}, {"join", 3}});
  for (const auto transport : {client::TransportKind::kTcp, client::TransportKind::kWebSocket}) {
    for (const auto view : {protocol::View::Volume, protocol::View::Surface}) {
      client::Options options;
      options.transport = transport;
      options.view = view;
      const auto start = Clock::now();
      const auto client = client::Client::connect(
          "127.0.0.1",
          transport == client::TransportKind::kTcp ? test.server.tcp_port() : test.server.http_port(),
          options);
      client->wait_for_revision(0, 60);
      const double seconds = seconds_since(start);
      report.row({std::string(transport == client::TransportKind::kTcp ? "TCP" : "WebSocket"),
                  std::string(view == protocol::View::Volume ? "volume" : "surface"),
                  count(6ull * cells * cells * cells), count(client->counters().bytes_in), seconds});
    }
  }
}

void bench_viewers(const std::vector<int>& counts, Report& report) {
  report.table("from publishing to viewers, ms",
               {{"viewers"}, {"deltas"}, {"p50", 3}, {"p99", 3}, {"max", 3}});
  for (const int viewers : counts) {
    stream::StreamConfig config = stream::test_config();
    config.max_handshakes = 1000;
    config.max_sessions = 1000;
    stream::TestServer test(10, config);
    std::mutex mutex;
    std::vector<double> late_ms;
    std::vector<std::unique_ptr<client::Client>> clients;
    for (int i = 0; i < viewers; ++i) {
      client::Callbacks callbacks;
      callbacks.on_surface_delta = [&](const protocol::SurfaceReplica&, const protocol::SurfaceDelta& delta,
                                       const client::Arrival& arrival) {
        const std::scoped_lock lock(mutex);
        late_ms.push_back(1e-6 * static_cast<double>(arrival.received_ns - delta.steps.back().cut_ns));
      };
      client::Options options;
      options.view = protocol::View::Surface;
      clients.push_back(
          client::Client::connect("127.0.0.1", test.server.tcp_port(), options, std::move(callbacks)));
    }
    for (const auto& client : clients) client->wait_for_revision(0, 60);
    for (int i = 0; i < 60; ++i) {
      test.cut();
      std::this_thread::sleep_for(std::chrono::milliseconds(30));
    }
    for (const auto& client : clients) client->wait_for_revision(test.loop.revision(), 60);
    const std::scoped_lock lock(mutex);
    report.row({count(static_cast<std::uint64_t>(viewers)), count(test.loop.revision()),
                percentile(late_ms, 0.5), percentile(late_ms, 0.99), percentile(late_ms, 1)});
  }
}

}  // namespace

void add_stream_bench(CLI::App& app, Report& report) {
  struct Options {
    std::string mesh;
    double scale = 1;
    std::size_t tets = 60'000;
    std::uint32_t cells = 63;
    std::vector<int> viewers{1, 16, 64};
  };
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("stream", "Bytes a cut face, encoding, snapshots, many viewers");
  sub->add_option("--mesh", options->mesh, "A mesh to cut, instead of the phantom");
  sub->add_option("--scale", options->scale, "Its unit in metres");
  sub->add_option("--tets", options->tets, "Size of the phantom");
  sub->add_option("--cells", options->cells, "The snapshot's mesh: 6 n^3 tetrahedra")
      ->check(CLI::Range(1, 100));
  sub->add_option("--viewers", options->viewers, "Numbers of viewers to serve");
  sub->callback([options, &report] {
    report.begin("stream");
    bench_deltas(
        options->mesh.empty() ? phantom("liver", options->tets) : load(options->mesh, options->scale),
        report);
    bench_snapshot(options->cells, report);
    bench_viewers(options->viewers, report);
  });
}

}  // namespace incise::bench
