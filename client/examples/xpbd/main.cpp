// incise-xpbd: a small soft body simulation that an incised cuts. It follows the deltas, computes where tension and gravity
// take the tissue, and sends that back: the cut opens. An example of a client in the role simulator.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <string>
#include <thread>

#include "client/client.hpp"
#include "client/examples/xpbd/soft_body.hpp"

namespace {

using namespace incise;
using std::chrono::steady_clock;

volatile std::sig_atomic_t stop = 0;

double seconds_since(steady_clock::time_point then) {
  return std::chrono::duration<double>(steady_clock::now() - then).count();
}

struct Settings {
  std::string host = "127.0.0.1";
  std::uint16_t port = 7450;
  std::string token;
  double rate_hz = 60, seconds = 0;
  int substeps = 8;
  xpbd::Material material;
};

// A line a second: how fast it is, and what became of what it sent.
class Report {
 public:
  void step(double work_s) {
    ++steps_;
    work_s_ += work_s;
  }
  void take(const protocol::PositionsReport& report) { last_ = report, held_ = report.held.size(); }
  void print(const xpbd::SoftBody& body) {
    const double dt = seconds_since(since_);
    if (dt < 1) return;
    std::printf("%u tetrahedra, %.0f steps/s of %.1f ms, revision %llu, held %zu, skipped %llu\n",
                body.tets(), steps_ / dt, 1e3 * work_s_ / std::max(steps_, 1),
                static_cast<unsigned long long>(last_.revision), held_,
                static_cast<unsigned long long>(last_.skipped));
    std::fflush(stdout);
    since_ = steady_clock::now();
    steps_ = 0;
    work_s_ = 0;
  }

 private:
  steady_clock::time_point since_ = steady_clock::now();
  int steps_ = 0;
  double work_s_ = 0;
  protocol::PositionsReport last_;
  std::size_t held_ = 0;
};

void simulate(const Settings& settings) {
  xpbd::SoftBody body(settings.material);
  Report report;
  std::unique_ptr<client::Client> client;
  client::Callbacks callbacks;
  // All of these are called within poll().
  callbacks.on_snapshot = [&](const protocol::SnapshotEnd&, protocol::SnapshotCause) {
    if (client) client->read([&](const protocol::Replica& mesh) { body.load(mesh); });
  };
  callbacks.on_delta = [&](const protocol::Replica& mesh, const protocol::Delta& delta,
                           const client::Arrival&) { body.apply(mesh, delta); };
  callbacks.on_positions_report = [&](const protocol::PositionsReport& told) {
    client->read([&](const protocol::Replica& mesh) { body.hold(mesh, told.held); });
    report.take(told);
  };
  callbacks.on_error = [](const protocol::Error& error) { std::fprintf(stderr, "%s\n", error.text.c_str()); };
  client::Options options;
  options.role = protocol::Role::Simulator;
  options.client_name = "incise-xpbd";
  options.token = settings.token;
  options.background = false;
  options.reconnect = true;
  client = client::Client::connect(settings.host, settings.port, options, callbacks);
  client->read([&](const protocol::Replica& mesh) { body.load(mesh); });  // what has come with the welcome

  const auto began = steady_clock::now();
  const double dt_s = 1 / settings.rate_hz;
  auto next = began;
  std::uint64_t frame = 0;
  while (!stop && (settings.seconds == 0 || seconds_since(began) < settings.seconds)) {
    const double left_s = std::chrono::duration<double>(next - steady_clock::now()).count();
    if (!client->poll(std::max(left_s, 0.0))) break;
    if (body.tets() == 0 || steady_clock::now() < next) continue;
    // Where the machine is too slow, the body is: time that is lost is not made up for.
    next = std::max(
        next + std::chrono::duration_cast<steady_clock::duration>(std::chrono::duration<double>(dt_s)),
        steady_clock::now());
    const auto start = steady_clock::now();
    body.step(dt_s, settings.substeps);
    protocol::Positions positions;
    positions.frame = ++frame;
    positions.revision = client->revision();
    positions.source_ns = std::chrono::nanoseconds(start - began).count();
    positions.f32 = body.positions();
    report.step(seconds_since(start));
    client->send_positions(positions);
    report.print(body);
  }
  if (!client->last_error().empty()) std::fprintf(stderr, "%s\n", client->last_error().c_str());
}

}  // namespace

int main(int argc, char** argv) {
  Settings settings;
  std::string server = "127.0.0.1:7450";
  CLI::App app("incise-xpbd: a soft body that an incised cuts, under tension and gravity");
  app.add_option("server", server, "HOST:PORT of incised (" + server + ")");
  app.add_option("--token", settings.token, "what opens the role simulator there");
  app.add_option("--rate", settings.rate_hz, "time steps a second (60)")->check(CLI::Range(1.0, 1000.0));
  app.add_option("--substeps", settings.substeps, "in each of them (8)")->check(CLI::Range(1, 100));
  app.add_option("--young", settings.material.young_pa, "stiffness, Pa (4000)")->check(CLI::Range(10.0, 1e7));
  app.add_option("--shrink", settings.material.shrink,
                 "tension: lengths are so much shorter without stress (0.12)")
      ->check(CLI::Range(0.0, 0.5));
  app.add_option("--gravity", settings.material.gravity_m_s2, "against z, m/s2 (9.81)")
      ->check(CLI::Range(-100.0, 100.0));
  app.add_option("--seconds", settings.seconds, "ends after so long; 0: with Ctrl-C")
      ->check(CLI::Range(0.0, 1e6));
  CLI11_PARSE(app, argc, argv);
  const std::size_t colon = server.rfind(':');
  settings.host = server.substr(0, colon);
  if (colon != std::string::npos)
    settings.port = static_cast<std::uint16_t>(std::stoul(server.substr(colon + 1)));
  std::signal(SIGINT, [](int) { stop = 1; });
  std::signal(SIGTERM, [](int) { stop = 1; });
  try {
    simulate(settings);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "incise-xpbd: %s\n", error.what());
    return 1;
  }
}
