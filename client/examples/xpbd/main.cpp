// incise-xpbd: a small soft body simulation that an incised cuts. It follows the deltas and the loads of the blades, computes
// where these and the tissue's tension take it, and sends that back: the body dents under a blade, and cuts open. What
// rests sends nothing. An example of a client in the role simulator.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <string>
#include <thread>

#include "client/cli/commands.hpp"
#include "client/client.hpp"
#include "client/examples/xpbd/stepper.hpp"

namespace {

using namespace incise;
using std::chrono::steady_clock;

volatile std::sig_atomic_t stop = 0;

double seconds_since(steady_clock::time_point then) {
  return std::chrono::duration<double>(steady_clock::now() - then).count();
}

struct Settings {
  client::ServerOptions server{"127.0.0.1:7450", {}, {}};
  std::string token;
  double rate_hz = 60, seconds = 0;
  int substeps = 10;
  xpbd::Material material;
};

constexpr float kLoadRate_hz = 240;  // a few in each time step: the newest counts
constexpr double kIdle_s = 0.1;      // between two looks at the network while it rests

// A line a second: how fast it is, and what became of what it sent.
class Report {
 public:
  void step(double work_s, bool sent) {
    ++steps_;
    sent_ += sent;
    work_s_ += work_s;
  }
  void take(const protocol::PositionsReport& report) { last_ = report, held_ = report.held.size(); }
  void print(std::uint32_t tets, bool rests) {
    const double dt = seconds_since(since_);
    if (dt < 1 && !rests) return;
    std::printf(
        "%u tetrahedra, %.0f steps/s of %.1f ms, %.0f sent/s, revision %llu, held %zu, skipped %llu%s\n",
        tets, steps_ / dt, 1e3 * work_s_ / std::max(steps_, 1), sent_ / dt,
        static_cast<unsigned long long>(last_.revision), held_,
        static_cast<unsigned long long>(last_.skipped), rests ? ", at rest" : "");
    std::fflush(stdout);
    begin();
  }
  void begin() {
    since_ = steady_clock::now();
    steps_ = sent_ = 0;
    work_s_ = 0;
  }

 private:
  steady_clock::time_point since_ = steady_clock::now();
  int steps_ = 0, sent_ = 0;
  double work_s_ = 0;
  protocol::PositionsReport last_;
  std::size_t held_ = 0;
};

// The body and its connection: follows, steps, sends while something moves.
class Simulation {
 public:
  explicit Simulation(const Settings& settings)
      : settings_(settings), stepper_(settings.material, settings.rate_hz, settings.substeps) {}
  void run();

 private:
  client::Callbacks callbacks();
  void load();
  void step();
  void complain(const protocol::Error& error);
  // Does what may wake the body.
  template <class F>
  void told(F&& f);

  const Settings& settings_;
  xpbd::Stepper stepper_;
  Report report_;
  std::unique_ptr<client::Client> client_;
  const steady_clock::time_point began_ = steady_clock::now();
  steady_clock::time_point next_ = began_;
  std::uint64_t frame_ = 0;
  // Positions up to this message may be of a state that was replaced; all are while `replaced_`.
  std::uint64_t sent_ = 0, outdated_ = 0;
  bool replaced_ = false;
  std::string complaint_;  // the last one
};

template <class F>
void Simulation::told(F&& f) {
  const bool awake = stepper_.awake();
  f();
  if (awake || !stepper_.awake()) return;
  report_.begin();
  next_ = steady_clock::now();
}

// All of these are called within poll().
client::Callbacks Simulation::callbacks() {
  client::Callbacks callbacks;
  callbacks.on_welcome = [this](const protocol::Welcome&) { replaced_ = true; };
  callbacks.on_snapshot = [this](const protocol::SnapshotEnd&, protocol::SnapshotCause) {
    if (client_) load();
  };
  callbacks.on_delta = [this](const protocol::Replica& mesh, const protocol::Delta& delta,
                              const client::Arrival&) { told([&] { stepper_.apply(mesh, delta); }); };
  callbacks.on_blade_load = [this](const protocol::BladeLoad& load) { told([&] { stepper_.press(load); }); };
  callbacks.on_positions_report = [this](const protocol::PositionsReport& outcome) {
    client_->read([&](const protocol::Replica& mesh) { stepper_.hold(mesh, outcome.held); });
    report_.take(outcome);
    complaint_.clear();
  };
  callbacks.on_disconnect = [this](const std::string&) { told([&] { stepper_.release_blades(); }); };
  callbacks.on_error = [this](const protocol::Error& error) { complain(error); };
  return callbacks;
}

// Another state: as served, after a reset or an undo, or of a server that was started again.
void Simulation::load() {
  replaced_ = false;
  outdated_ = sent_;
  client_->read([this](const protocol::Replica& mesh) { told([&] { stepper_.load(mesh); }); });
}

// Once where each message is refused, and not where positions have crossed a reset or an undo.
void Simulation::complain(const protocol::Error& error) {
  const bool outdated = replaced_ || error.in_reply_to <= outdated_;
  if (error.code == protocol::ErrorCode::BadRequest && outdated) return;
  if (error.text != complaint_) std::fprintf(stderr, "%s\n", error.text.c_str());
  complaint_ = error.text;
}

void Simulation::step() {
  // Where the machine is too slow, the body is: time that is lost is not made up for.
  next_ = std::max(next_ + std::chrono::duration_cast<steady_clock::duration>(
                               std::chrono::duration<double>(1 / settings_.rate_hz)),
                   steady_clock::now());
  const auto start = steady_clock::now();
  const bool moves = stepper_.step();
  report_.step(seconds_since(start), moves);
  if (moves) {
    protocol::Positions positions;
    positions.frame = ++frame_;
    positions.revision = client_->revision();
    positions.source_ns = std::chrono::nanoseconds(start - began_).count();
    positions.f32 = stepper_.positions();
    if (const std::uint64_t sent = client_->send_positions(positions)) {
      sent_ = sent;
      stepper_.note_sent();
    }
  }
  report_.print(stepper_.tets(), !stepper_.awake());
}

void Simulation::run() {
  client::Address where;
  client::Options options = settings_.server.options(where);
  options.role = protocol::Role::Simulator;
  options.client_name = "incise-xpbd";
  if (!settings_.token.empty()) options.token = settings_.token;
  options.load_rate_hz = kLoadRate_hz;
  options.background = false;
  options.reconnect = true;
  client_ = client::connect(where, options, callbacks());
  load();  // what has come with the welcome
  while (!stop && (settings_.seconds == 0 || seconds_since(began_) < settings_.seconds)) {
    const double left_s = std::chrono::duration<double>(next_ - steady_clock::now()).count();
    if (!client_->poll(stepper_.awake() ? std::max(left_s, 0.0) : kIdle_s)) break;
    if (stepper_.awake() && stepper_.tets() > 0 && steady_clock::now() >= next_) step();
  }
  if (!client_->last_error().empty()) std::fprintf(stderr, "%s\n", client_->last_error().c_str());
}

}  // namespace

int main(int argc, char** argv) {
  Settings settings;
  CLI::App app("incise-xpbd: a soft body that an incised cuts, which gives way and is under tension");
  app.add_option("server", settings.server.address,
                 "[tcp://|tls://|ws://|wss://]HOST[:PORT] of incised (" + settings.server.address + ")");
  app.add_option("--token", settings.token, "what opens the role simulator there");
  client::add_server_options(app, settings.server);
  app.add_option("--rate", settings.rate_hz, "time steps a second (60)")->check(CLI::Range(1.0, 1000.0));
  app.add_option("--substeps", settings.substeps, "in each of them (10)")->check(CLI::Range(1, 100));
  app.add_option("--young", settings.material.young_pa, "stiffness, Pa (2000)")->check(CLI::Range(10.0, 1e7));
  app.add_option("--tension", settings.material.tension_pa, "with which tissue pulls at a cut, Pa (300)")
      ->check(CLI::Range(0.0, 1e6));
  app.add_option("--seconds", settings.seconds, "ends after so long; 0: with Ctrl-C")
      ->check(CLI::Range(0.0, 1e6));
  CLI11_PARSE(app, argc, argv);
  std::signal(SIGINT, [](int) { stop = 1; });
  std::signal(SIGTERM, [](int) { stop = 1; });
  try {
    Simulation(settings).run();
  } catch (const std::exception& error) {
    std::fprintf(stderr, "incise-xpbd: %s\n", error.what());
    return 1;
  }
}
