// incise-soak: the server under what a long day brings. Not a unit test: it runs for as long as it is told, prints
// figures, and ends with 1 where anything is not as it must be.
//
//   incise-soak soak --seconds 600    poses at 8 kHz, clients that come, go, stall and die, kill -9 now and then
//   incise-soak kills --count 1000    kill -9 at random moments, one after the other

#include <CLI/CLI.hpp>
#include <cinttypes>
#include <csignal>
#include <cstdio>
#include <mutex>
#include <nlohmann/json.hpp>
#include <random>
#include <stdexcept>

#include "server/base/clock.hpp"
#include "server/input/pose_sources.hpp"
#include "tests/e2e/served_session.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::e2e {
namespace {

using client::Client;
using protocol::Role;
using protocol::View;
using std::chrono::milliseconds;

// What must hold; the first thing that does not ends the program.
void require(bool holds, const std::string& what) {
  if (!holds) throw std::runtime_error(what);
}

std::unique_ptr<Client> viewer(const ServedSession& session, const client::Options& options = {}) {
  const std::uint16_t port =
      options.transport == client::TransportKind::kTcp ? session.tcp_port() : session.http_port();
  return Client::connect("127.0.0.1", port, options);
}

std::uint64_t hash_of(const Client& viewer) {
  return viewer.read([](const protocol::Replica& mesh) { return mesh.compute_state_hash(); });
}

std::size_t count_of(const std::string& text, const std::string& what) {
  std::size_t n = 0;
  for (auto at = text.find(what); at != std::string::npos; at = text.find(what, at + 1)) ++n;
  return n;
}

// The longest resumption in the log, s.
double longest_resume_s(const std::string& log) {
  double longest = 0;
  for (auto at = log.find("resumed "); at != std::string::npos; at = log.find("resumed ", at + 1)) {
    const auto in = log.find(" in ", at);
    if (in != std::string::npos) longest = std::max(longest, std::atof(log.c_str() + in + 4));
  }
  return longest;
}

void print_recoveries(const ServedSession& session) {
  const std::string log = session.log();
  std::printf(
      "recoveries from a checkpoint  %zu\nfrom the beginning            %zu\nlongest                       "
      "%.2f s\n",
      count_of(log, "from the checkpoint"), count_of(log, "from the beginning"), longest_resume_s(log));
}

// ------------------------------------------------------------------------------------------------ kills

struct Kills {
  int count = 20;
  int tets = 4000;
  std::uint64_t seed = 1;
};

void run_kills(const Kills& kills) {
  std::mt19937_64 random(kills.seed);
  ServedSession session("kills", kills.tets, R"(, "checkpoint_replay_s": 0.001)");
  CaptureFollower offline(session);
  int while_starting = 0;
  std::uint64_t acknowledged = 0;
  require(session.start(false), "the server did not start: " + session.log());
  for (int round = 0; round < kills.count; ++round) {
    const std::string where = "seed " + std::to_string(kills.seed) + ", kill " + std::to_string(round) + ": ";
    // The server is as the capture says, and the capture still says what it said before.
    const auto watching = viewer(session);
    require(watching->wait_for_revision(0, 60), where + "no snapshot");
    const std::string problem = offline.follow();
    require(problem.empty(), where + problem);
    require(watching->revision() == offline.revision(),
            where + "the server is at revision " + std::to_string(watching->revision()) +
                ", its capture at " + std::to_string(offline.revision()));
    require(hash_of(*watching) == offline.state_hash(), where + "another hash than the capture's");
    std::int64_t taken_ns = 0;
    {
      PoseDriver driver(session, 1000, 0.3);
      std::this_thread::sleep_for(milliseconds(20 + random() % 400));
      if (random() % 4 == 0) watching->drop_connection();
      session.kill();
      taken_ns = driver.acknowledged_ns();
      acknowledged += taken_ns > 0;
      const std::string after = offline.follow();
      require(after.empty(), where + after);
    }
    // What the server has told an operator that it has taken is in the capture, however it ended.
    require(taken_ns <= offline.last_source_ns(),
            where + "poses of " +
                std::to_string(1e-6 * static_cast<double>(taken_ns - offline.last_source_ns())) +
                " ms were acknowledged and are lost");
    // One in four is killed again while it starts.
    while (random() % 4 == 0 && round + 1 < kills.count) {
      session.start(true, false);
      std::this_thread::sleep_for(milliseconds(random() % 120));
      session.kill();
      ++while_starting;
      ++round;
    }
    require(session.start(true), where + "it does not resume: " + session.log());
  }
  const auto watching = viewer(session);
  require(watching->wait_for_revision(0, 60), "no snapshot at the end");
  require(offline.follow().empty() && hash_of(*watching) == offline.state_hash(), "another hash at the end");
  session.server().signal(SIGTERM);
  require(session.server().wait() == 0, "it did not end cleanly");
  std::printf("kills                         %d, of them %d while starting\n", kills.count, while_starting);
  std::printf("poses recorded                %" PRIu64 "\nrevision                      %" PRIu64
              "\nhashes compared               %" PRIu64 "\n",
              offline.poses(), offline.revision(), offline.marks());
  print_recoveries(session);
  std::printf("acknowledged, not recorded    0 poses (%" PRIu64 " kills with an acknowledgement)\n",
              acknowledged);
}

// ------------------------------------------------------------------------------------------------ soak

struct Soak {
  double seconds = 30;
  double pose_rate_hz = 8000;
  int tets = 8000;
  std::uint64_t seed = 1;
};

// Clients that do as clients do, until told to stop. Thread: its own.
class Crowd {
 public:
  Crowd(const ServedSession& session, std::uint64_t seed)
      : thread_([this, &session, seed] { run(session, seed); }) {}
  ~Crowd() { stop(); }
  void stop() {
    stop_ = true;
    if (thread_.joinable()) thread_.join();
  }
  // After stop().
  const std::string& problem() const { return problem_; }
  int visits() const { return visits_; }

 private:
  void run(const ServedSession& session, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::vector<std::unique_ptr<stream::RawPeer>> stalled;
    while (!stop_ && problem_.empty()) {
      std::this_thread::sleep_for(milliseconds(random() % 150));
      ++visits_;
      try {
        switch (random() % 4) {
          case 0:
            visit(session, random);
            break;
          case 1: {  // asks for everything and reads nothing
            auto peer = std::make_unique<stream::RawPeer>(session.tcp_port(), 4096);
            protocol::Hello hello;
            hello.role = Role::Viewer;
            hello.view = View::Volume;
            if (peer->connected()) peer->send(hello);
            stalled.push_back(std::move(peer));
            if (stalled.size() > 6) stalled.erase(stalled.begin());
            break;
          }
          case 2: {  // dies in the middle of its first message
            stream::RawPeer peer(session.tcp_port());
            const protocol::Frame frame = protocol::encode(protocol::Hello{}, {1, 0});
            if (peer.connected()) peer.send(frame.tcp().first(1 + random() % frame.tcp().size()));
            if (peer.connected() && random() % 2) peer.vanish();
            break;
          }
          default: {  // garbage
            stream::RawPeer peer(random() % 2 ? session.tcp_port() : session.http_port());
            std::vector<std::byte> garbage(1 + random() % 300);
            for (std::byte& b : garbage) b = std::byte(random() & 0xff);
            if (peer.connected()) peer.send(garbage);
          }
        }
      } catch (const client::ConnectError&) {  // it is down just now
      }
    }
  }
  void visit(const ServedSession& session, std::mt19937_64& random) {
    client::Options options;
    options.transport = random() % 2 ? client::TransportKind::kTcp : client::TransportKind::kWebSocket;
    const auto guest = viewer(session, options);
    if (!guest->wait_for_revision(0, 10)) return;  // the server was killed meanwhile
    std::this_thread::sleep_for(milliseconds(random() % 300));
    const auto [said, computed] = guest->read([](const protocol::Replica& mesh) {
      return std::pair(mesh.state_hash(), mesh.compute_state_hash());
    });
    if (said != computed) problem_ = "a guest holds a mesh with another hash than it was sent";
    if (random() % 2) guest->drop_connection();
  }

  std::atomic<bool> stop_{false};
  std::string problem_;
  int visits_ = 0;
  std::thread thread_;
};

nlohmann::json run_command(std::vector<std::string> arguments) {
  Process process(std::move(arguments));
  const std::string printed = process.rest();
  require(process.wait(600) == 0, "a command failed: " + printed);
  return nlohmann::json::parse(printed);
}

void run_soak(const Soak& soak) {
  std::mt19937_64 random(soak.seed);
  ServedSession session("soak", soak.tets, R"(, "checkpoint_replay_s": 0.2)");
  require(session.start(false), "the server did not start: " + session.log());
  client::Options options;
  options.reconnect = true;
  options.full_check_interval = 50;
  const auto by_tcp = viewer(session, options);
  options.transport = client::TransportKind::kWebSocket;
  const auto by_web = viewer(session, options);
  options.view = View::Surface;
  const auto surface = viewer(session, options);

  CaptureFollower offline(session);
  PoseDriver driver(session, soak.pose_rate_hz, 0.2), second(session, 1000, 0.1, "left");
  Crowd crowd(session, soak.seed + 1);
  int kills = 0, resets = 0;
  std::uint64_t acknowledged = 0;
  std::int64_t checked_ns[2] = {0, 0};
  const auto end = monotonic_ns() + static_cast<std::int64_t>(1e9 * soak.seconds);
  while (monotonic_ns() < end) {
    std::this_thread::sleep_for(milliseconds(1000 + random() % 4000));
    if (random() % 4 == 0) by_tcp->drop_connection();
    // A body cut to crumbs is as unlike a day's work as an uncut one.
    if (kills % 4 == 2) {
      client::Options admin;
      admin.role = Role::Admin;
      admin.view = View::None;
      resets += viewer(session, admin)->reset();
      std::this_thread::sleep_for(milliseconds(random() % 300));
    }
    session.kill();
    ++kills;
    const std::string problem = offline.follow();
    require(problem.empty(), "kill " + std::to_string(kills) + ": " + problem);
    // What the server has told an operator that it has taken is in the capture.
    for (const auto& [source, checked] :
         {std::pair<const PoseDriver&, std::int64_t&>(driver, checked_ns[0]), {second, checked_ns[1]}}) {
      const std::int64_t taken_ns = source.acknowledged_ns();
      require(taken_ns == checked || offline.has_seen(taken_ns),
              "kill " + std::to_string(kills) + ": a pose that was acknowledged is lost");
      acknowledged += taken_ns != checked;
      checked = taken_ns;
    }
    require(session.start(true), "it does not resume: " + session.log());
  }
  crowd.stop();
  require(crowd.problem().empty(), crowd.problem());
  require(driver.settle() && second.settle(), "the server has not dealt with all poses");
  require(driver.rejected() + second.rejected() == 0, "poses were rejected");
  // Letting the blades go ends their strokes; the capture says so, and what they made of the mesh.
  std::string problem;
  for (int i = 0; i < 3000 && problem.empty(); ++i) {
    problem = offline.follow();
    if (session.stat("/sources") == 0.0 && !offline.in_stroke() && by_tcp->revision() == offline.revision())
      break;
    std::this_thread::sleep_for(milliseconds(100));
  }
  require(problem.empty(), problem);
  const std::uint64_t revision = offline.revision();
  require(revision > 0, "nothing was cut");
  for (const auto* client : {by_tcp.get(), by_web.get(), surface.get()})
    require(const_cast<Client*>(client)->wait_for_revision(revision, 300), "a client did not get to the end");
  options.reconnect = false;
  const auto late = viewer(session, options);
  require(late->wait_for_revision(revision, 300), "a late viewer did not get to the end");
  const auto surface_bytes = [](const Client& c) {
    return c.read_surface([](const protocol::SurfaceReplica& s) { return s.canonical_bytes(); });
  };
  const auto volume_bytes = [](const Client& c) {
    return c.read([](const protocol::Replica& m) { return m.canonical_bytes(); });
  };
  require(volume_bytes(*by_tcp) == volume_bytes(*by_web), "the volumes of two clients differ");
  require(surface_bytes(*surface) == surface_bytes(*late), "the surfaces of two clients differ");
  const std::uint64_t hash = hash_of(*by_tcp);
  session.server().signal(SIGTERM);
  require(session.server().wait() == 0, "it did not end cleanly");

  problem = offline.follow();
  require(problem.empty(), problem);
  require(offline.revision() == revision && offline.state_hash() == hash,
          "the offline run ends elsewhere: at revision " + std::to_string(offline.revision()) +
              " instead of " + std::to_string(revision));
  char text[17];
  std::snprintf(text, sizeof text, "%016" PRIx64, hash);
  const auto replayed = run_command({"incise", "replay", session.capture(), "--verify", "--json"});
  require(replayed["state_hash"] == text, "the replay ends with another hash");
  const auto converted = run_command(
      {"incise", "convert", session.capture(), "--out", session.file("offline.capture"), "--json"});
  require(converted["state_hash"] == text, "the offline conversion ends with another hash");

  std::printf(
      "seconds                       %.0f\nkills, resets                 %d, %d\nvisits by other clients     "
      "  %d\n",
      soak.seconds, kills, resets, crowd.visits());
  std::printf("poses sent / recorded         %" PRIu64 " / %" PRIu64
              "\nrevision                      %" PRIu64
              "\nstate hash                    %s\nhashes compared               %" PRIu64 "\n",
              driver.sent() + second.sent(), offline.poses(), revision, text, offline.marks());
  std::printf("acknowledged, not recorded    0 poses (%" PRIu64 " looks after kills)\n", acknowledged);
  std::printf("resyncs of steady clients     %" PRIu64 "\nreconnections                 %" PRIu64 "\n",
              by_tcp->counters().resyncs + by_web->counters().resyncs + surface->counters().resyncs,
              by_tcp->counters().reconnects + by_web->counters().reconnects + surface->counters().reconnects);
  print_recoveries(session);
}

}  // namespace
}  // namespace incise::e2e

int main(int argc, char** argv) {
  using namespace incise::e2e;
  CLI::App app("The server under what a long day brings.", "incise-soak");
  app.require_subcommand(1);
  Kills kills;
  CLI::App* sub = app.add_subcommand("kills", "kill -9 at random moments, and go on");
  sub->add_option("--count", kills.count, "How often")->capture_default_str();
  sub->add_option("--tets", kills.tets, "Of the phantom slab")->capture_default_str();
  sub->add_option("--seed", kills.seed, "Of the random moments")->capture_default_str();
  sub->callback([&] { run_kills(kills); });
  Soak soak;
  sub = app.add_subcommand("soak", "Poses, clients of all kinds, kills; at the end all must hold the same");
  sub->add_option("--seconds", soak.seconds, "How long")->capture_default_str();
  sub->add_option("--pose-rate", soak.pose_rate_hz, "Poses a second")->capture_default_str();
  sub->add_option("--tets", soak.tets, "Of the phantom slab")->capture_default_str();
  sub->add_option("--seed", soak.seed, "Of the random moments")->capture_default_str();
  sub->callback([&] { run_soak(soak); });
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "incise-soak: %s\n", error.what());
    return 1;
  }
  return 0;
}
