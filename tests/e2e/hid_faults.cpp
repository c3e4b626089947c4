// incise-hid-faults: incised with a force device that umockdev simulates, and faults while a force acts: unplugged, garbage,
// silence, a frozen device, NaN, no tracking, a loop that hangs, writes that fail; and, with --simulation, a host simulation that
// stalls, dies, sends NaN, is late or floods meanwhile. Exits with 1 if a
// force breaks its limit, does not reach 0, or returns without its ramp; prints how long things took. Exact times
// are checked by tests/e2e/force_faults_test.cpp, which has its own clock.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <random>
#include <stdexcept>
#include <thread>

#include "server/base/clock.hpp"
#include "server/core/geometry/vec3.hpp"
#include "server/input/pose_sources.hpp"
#include "tests/e2e/failing_simulation.hpp"
#include "tests/e2e/process.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/support/float_stylus.hpp"
#include "tests/support/mock_hid.hpp"

namespace incise::e2e {
namespace {

namespace fs = std::filesystem;
using tests::eventually;
using tests::MockDevice;

constexpr double kMost_n = 3.3, kRamp_s = 2, kQuantum_n = 2e-6;
constexpr std::int64_t kMs = 1'000'000;

void require(bool holds, const std::string& what) {
  if (!holds) throw std::runtime_error(what);
}

MockDevice::Kind kind() {
  MockDevice::Kind made;
  made.vendor = 0xabcd;
  made.product = 0x10;
  made.name = "Float";
  made.serial = "F1";
  // Report 1: 15 bytes in; report 2: 12 bytes out.
  made.descriptor = tests::from_hex(
      "06 00 ff 09 01 a1 01 15 00 26 ff 00 75 08 85 01 95 0f 09 01 81 02 85 02 95 0c 09 02 91 02 c0");
  return made;
}

enum class Fault { kUnplug, kGarbage, kSilent, kFrozen, kNotANumber, kOutOfSight, kLateLoop, kRefuses };
constexpr int kFaults = 8;
constexpr const char* kNames[kFaults] = {"unplugged",    "garbage",      "silent",    "frozen",
                                         "not a number", "out of sight", "late loop", "writes refused"};

// The device in the user's hand: a report a millisecond. Thread: its own; what it does is set from outside.
class Stylus {
 public:
  explicit Stylus(tests::MockHid& machine)
      : machine_(machine),
        device_(machine.plug(kind())),
        thread_([this](const std::stop_token& stop) { run(stop); }) {}

  // From when this returns its reports have this fault; -1: none.
  void begin(int wanted) {
    fault_ = wanted;
    require(eventually([&] { return acting_ == wanted; }), "the test's own thread hangs");
  }
  std::atomic<double> height{0.06};
  std::atomic<bool> engaged{false};

  void unplug() {
    const std::scoped_lock lock(mutex_);
    device_.reset();
    looked_ = 0;
  }
  void plug() {
    const std::scoped_lock lock(mutex_);
    device_ = machine_.plug(kind());
  }
  void refuse(bool refuse) {
    const std::scoped_lock lock(mutex_);
    device_->refuse_outputs(refuse);
  }
  struct Felt {
    double newtons;
    std::int64_t time_ns;
  };
  // What it was sent since the last call.
  std::vector<Felt> felt() {
    const std::scoped_lock lock(mutex_);
    std::vector<Felt> felt;
    if (!device_) return felt;
    const auto sent = device_->outputs(looked_);
    looked_ += sent.size();
    for (const auto& output : sent) {
      require(output.bytes.size() == 13,
              "an output report of " + std::to_string(output.bytes.size()) + " bytes");
      std::int32_t raw[3];
      std::memcpy(raw, &output.bytes[1], sizeof raw);
      felt.push_back({1e-6 * core::length({double(raw[0]), double(raw[1]), double(raw[2])}), output.time_ns});
      require(felt.back().newtons <= kMost_n + kQuantum_n,
              "a force of " + std::to_string(felt.back().newtons) + " N");
    }
    return felt;
  }

 private:
  void run(const std::stop_token& stop) {
    std::mt19937_64 random(1);
    std::int64_t due = monotonic_ns();
    const std::int64_t begun = due;
    double at = 0.06, x = 0;
    std::uint16_t counter = 0;
    while (!stop.stop_requested()) {
      due = std::max(due + kMs, monotonic_ns() - 3 * kMs);
      const timespec when{due / 1'000'000'000, due % 1'000'000'000};
      clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &when, nullptr);
      const auto now = static_cast<Fault>(fault_.load());
      acting_ = static_cast<int>(now);
      if (now == Fault::kSilent) continue;
      if (now != Fault::kFrozen) {
        at += std::clamp(height - at, -2e-4, 2e-4);
        x = 0.01 * std::sin(1e-9 * static_cast<double>(due - begun));
      }
      std::array<std::uint8_t, 16> bytes{};
      bytes[0] = 1;
      ++counter;
      std::memcpy(&bytes[1], &counter, 2);
      bytes[3] = now == Fault::kOutOfSight ? 0 : 2 + (engaged ? 1 : 0);
      float p[3] = {static_cast<float>(x), 0, static_cast<float>(at)};
      if (now == Fault::kNotANumber) p[random() % 3] = random() % 2 ? NAN : INFINITY;
      std::memcpy(&bytes[4], p, sizeof p);
      std::size_t size = bytes.size();
      if (now == Fault::kGarbage) {
        for (std::uint8_t& byte : bytes) byte = static_cast<std::uint8_t>(random());
        bytes[0] = static_cast<std::uint8_t>(random() % 3);
        if (bytes[0] == 1) bytes[7] = 0x7e;  // else it might be a place where a stylus can be
        size = 1 + random() % bytes.size();
      }
      const std::scoped_lock lock(mutex_);
      if (device_) device_->report(std::span(bytes).first(size));
    }
  }

  std::atomic<int> fault_{-1}, acting_{-1};
  tests::MockHid& machine_;
  std::mutex mutex_;  // guards device_, looked_
  std::unique_ptr<MockDevice> device_;
  std::size_t looked_ = 0;
  std::jthread thread_;
};

struct Options {
  int count = 500;
  std::uint64_t seed = 1;
  bool simulation = false;
};

class Run {
 public:
  explicit Run(const Options& options)
      : random_(options.seed),
        folder_(fs::temp_directory_path() / ("incise_faults_" + std::to_string(::getpid()))) {
    fs::create_directories(folder_ / "profiles");
    std::ofstream(folder_ / "profiles/float.json")
        << tests::float_stylus_profile(R"("vendor": "abcd", "product": "0010")");
    std::ofstream(folder_ / "server.json") << R"({"mesh": {"phantom": "slab", "target_tets": 3000},
      "blade": {"heel": [0, 0, 0], "tip": [0, 0, -0.05]}, "listen": {"tcp_port": 0, "http_port": 0},
      "haptics": {"stiffness_n_m": 2000}, "devices": {"profiles": "profiles"},
      "capture": {"path": "run.capture"}, "log": {"level": "error"}})";
    server_ = std::make_unique<Process>(
        std::vector<std::string>{"incised", "--config", (folder_ / "server.json").string()});
    const std::string line = server_->line("listening ", 120);
    port_ = port_after(line, "http=");
    require(port_ != 0, "incised did not start");
    if (options.simulation) simulation_.emplace(port_after(line, "tcp="), options.seed);
  }
  ~Run() {
    server_.reset();
    fs::remove_all(folder_);
  }

  void run(const Options& options) {
    std::vector<double> to_zero_ms[kFaults];
    clean();
    for (int i = 0; i < options.count; ++i) {
      const int fault = static_cast<int>(random_() % kFaults);
      try {
        to_zero_ms[fault].push_back(episode(static_cast<Fault>(fault)));
      } catch (const std::exception& error) {
        throw std::runtime_error("seed " + std::to_string(options.seed) + ", fault " + std::to_string(i) +
                                 " (" + kNames[fault] + "): " + error.what());
      }
    }
    stylus_.height = 0.06;
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
    if (simulation_) {
      const auto deformations = stats()["deformations"]["count"].get<std::uint64_t>();
      std::printf("%-30s", "simulation");
      for (int mood = 0; mood < FailingSimulation::kMoods; ++mood) {
        std::printf(
            "%s %llu, ", FailingSimulation::kNames[mood],
            static_cast<unsigned long long>(simulation_->count(static_cast<FailingSimulation::Mood>(mood))));
      }
      std::printf("%llu connections, %llu deformations\n",
                  static_cast<unsigned long long>(simulation_->connections()),
                  static_cast<unsigned long long>(deformations));
      require(deformations > static_cast<std::uint64_t>(options.count),
              "the simulation did not move the body");
      simulation_.reset();
    }
    server_->signal(SIGTERM);
    require(server_->wait(60) == 0, "the server did not end cleanly");
    Process replay({"incise", "replay", (folder_ / "run.capture").string(), "--verify"});
    require(replay.wait(300) == 0, "the capture does not replay");
    std::printf("%-16s %6s %22s\n", "fault", "count", "force 0 after ms, p50 max");
    for (int fault = 0; fault < kFaults; ++fault) {
      auto& times = to_zero_ms[fault];
      if (times.empty()) continue;
      std::sort(times.begin(), times.end());
      std::printf("%-16s %6zu %14.1f %7.1f\n", kNames[fault], times.size(), times[times.size() / 2],
                  times.back());
    }
  }

 private:
  nlohmann::json stats() const {
    const std::string answer = stream::http(port_, "/stats");
    const auto body = answer.find("\r\n\r\n");
    require(body != std::string::npos,
            "no /stats: " + (answer.empty() ? std::string(std::strerror(errno)) : answer));
    return nlohmann::json::parse(answer.substr(body + 4));
  }

  // Down into a contact, until a force acts. On a busy machine frames are late and reports are by themselves, and three such
  // faults end the force for good: then the button is pressed again.
  void press() {
    const std::int64_t end = monotonic_ns() + 60'000 * kMs;
    while (monotonic_ns() < end) {
      stylus_.height = surface_ + 0.05 - 0.004;
      for (int i = 0; i < 500; ++i) {
        std::this_thread::sleep_for(std::chrono::milliseconds(2));
        const auto felt = stylus_.felt();
        if (!felt.empty() && felt.back().newtons > 0) return;
      }
      lift();
    }
    require(false, "no force in contact");
  }

  // Out of the tissue, and the button pressed there.
  void lift() {
    stylus_.engaged = false;
    stylus_.height = surface_ + 0.05 + 0.02;
    std::this_thread::sleep_for(std::chrono::milliseconds(150));
    stylus_.engaged = true;
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
    stylus_.engaged = false;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    stylus_.felt();
  }

  // Some seconds without a fault: how fast reports come, and how old the poses are that they belong to.
  void clean() {
    // Where the top is.
    const auto answer = stats();
    require(eventually([&] { return stats()["sources"] == 1; }), "the device is not read");
    find_surface();
    press();
    stylus_.felt();
    std::this_thread::sleep_for(std::chrono::milliseconds(3000));
    const auto felt = stylus_.felt();
    require(felt.size() > 2, "no reports");
    const double seconds = 1e-9 * static_cast<double>(felt.back().time_ns - felt.front().time_ns);
    const auto ways = stats()["devices"][0]["forces"]["pose_to_report_us"];
    std::printf("force reports a second        %.0f\n", static_cast<double>(felt.size() - 1) / seconds);
    std::printf("a pose's way to its report    p50 %.0f, p99 %.0f, p99.9 %.0f, max %.0f us\n",
                ways["p50"].get<double>(), ways["p99"].get<double>(), ways["p99.9"].get<double>(),
                ways["max"].get<double>());
  }

  // Lowers the tip until there is a force.
  void find_surface() {
    for (surface_ = 0.02; surface_ > -0.05; surface_ -= 0.001) {
      stylus_.height = surface_ + 0.05 - 0.001;
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      for (const auto& felt : stylus_.felt()) {
        if (felt.newtons > 0) return;
      }
    }
    require(false, "no tissue below the tip");
  }

  // One fault in a contact. After how many ms the force was 0.
  double episode(Fault fault) {
    press();
    // One in three with a stroke under way.
    stylus_.engaged = random_() % 3 == 0;
    std::this_thread::sleep_for(std::chrono::milliseconds(30 + random_() % 200));
    stylus_.felt();
    stylus_.begin(static_cast<int>(fault));
    const std::int64_t from = monotonic_ns();
    // The first report without a force that is followed by none with one for as long as any fault takes to be noticed.
    std::int64_t first_zero_ns = 0;
    // Before the ramp can begin.
    std::int64_t before_ramp_ns = 0;
    const auto ended = [&] {
      for (const auto& felt : stylus_.felt()) {
        if (felt.newtons > 0) {
          first_zero_ns = 0;
          continue;
        }
        if (first_zero_ns == 0) first_zero_ns = felt.time_ns;
      }
      return first_zero_ns > 0 && monotonic_ns() - std::max(from, first_zero_ns) > 300 * kMs;
    };
    if (fault == Fault::kUnplug) {
      stylus_.unplug();
      require(eventually([&] { return stats()["sources"] == 0; }), "the stroke goes on without its device");
      // The server may have found it long before /stats says so.
      before_ramp_ns = monotonic_ns();
      stylus_.plug();
      require(eventually([&] { return stats()["sources"] == 1; }), "the device is not found again");
      first_zero_ns = monotonic_ns();
    } else if (fault == Fault::kLateLoop) {
      server_->signal(SIGSTOP);
      std::this_thread::sleep_for(std::chrono::milliseconds(30 + random_() % 40));
      stylus_.felt();
      before_ramp_ns = monotonic_ns();
      server_->signal(SIGCONT);
      // A report that it was writing may still come.
      int old = 0;
      require(eventually([&] { return has_hung(before_ramp_ns, old, first_zero_ns); }),
              "no force after the loop has hung");
    } else if (fault == Fault::kRefuses) {
      // The device hears nothing and lets go by itself. The server takes it for broken: what it is sent from here on is 0.
      stylus_.refuse(true);
      std::this_thread::sleep_for(std::chrono::milliseconds(20 + random_() % 60));
      stylus_.felt();
      stylus_.refuse(false);
      require(eventually(ended), "the force does not come to 0");
    } else {
      require(eventually(ended), "the force does not come to 0");
      // And stays there as long as the fault does.
      std::this_thread::sleep_for(std::chrono::milliseconds(30));
      for (const auto& felt : stylus_.felt()) {
        require(felt.newtons == 0, "a force while the fault lasts");
      }
    }
    if (before_ramp_ns == 0) before_ramp_ns = monotonic_ns();
    stylus_.begin(-1);
    come_back(fault, before_ramp_ns);
    return 1e-6 * static_cast<double>(first_zero_ns - from);
  }

  // Whether a force is no larger than a ramp allows that began after this moment of the test's own: the server knew nothing of it
  // before, and what it computes reaches the device later. So a machine that is late only makes this allow more. A zero
  // report would be no such moment: there is no force either while the simulation holds the tissue away, and the ramp goes on.
  static bool within_ramp(const Stylus::Felt& felt, std::int64_t before_ramp_ns) {
    const double most = kMost_n / kRamp_s * 1e-9 * static_cast<double>(felt.time_ns - before_ramp_ns);
    return felt.newtons <= std::max(0.0, most) + kQuantum_n;
  }
  static void require_within_ramp(const Stylus::Felt& felt, std::int64_t before_ramp_ns) {
    require(within_ramp(felt, before_ramp_ns),
            "it comes back with " + std::to_string(felt.newtons) + " N at most " +
                std::to_string(1e-6 * static_cast<double>(felt.time_ns - before_ramp_ns)) +
                " ms after the ramp began");
  }

  // The loop goes on at once, so there may be no report without a force. From the first one on that a ramp allows, all must keep
  // to the ramp; before it there is at most the one that was under way when the process was stopped.
  bool has_hung(std::int64_t before_ramp_ns, int& old, std::int64_t& first_new_ns) {
    for (const auto& felt : stylus_.felt()) {
      if (first_new_ns > 0 || old == 1) {
        require_within_ramp(felt, before_ramp_ns);
      } else if (!within_ramp(felt, before_ramp_ns)) {
        ++old;
        continue;
      }
      if (first_new_ns == 0) first_new_ns = felt.time_ns;
    }
    return first_new_ns > 0;
  }

  // What comes back comes with the ramp.
  void come_back(Fault fault, std::int64_t before_ramp_ns) {
    bool came = false;
    for (int i = 0; i < 8; ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      for (const auto& felt : stylus_.felt()) {
        came = came || felt.newtons > 0;
        require_within_ramp(felt, before_ramp_ns);
      }
    }
    if (fault == Fault::kRefuses) {
      require(!came, "a device that refused a report is given a force");
      stylus_.unplug();
      require(eventually([&] { return stats()["sources"] == 0; }), "a source without its device");
      stylus_.plug();
      require(eventually([&] { return stats()["sources"] == 1; }), "the device is not found again");
    }
    lift();  // three faults in a minute end the force until the button is pressed again in the air
  }

  std::mt19937_64 random_;
  const fs::path folder_;
  tests::MockHid machine_;
  Stylus stylus_{machine_};
  std::unique_ptr<Process> server_;
  std::optional<FailingSimulation> simulation_;
  std::uint16_t port_ = 0;
  double surface_ = 0;  // where the tissue begins under the tip, m
};

}  // namespace
}  // namespace incise::e2e

int main(int argc, char** argv) {
  using namespace incise::e2e;
  CLI::App app("Faults of a force device and of the loop while a force acts.", "incise-hid-faults");
  Options options;
  app.add_option("--count", options.count, "Faults")->capture_default_str();
  app.add_option("--seed", options.seed, "Of what happens when")->capture_default_str();
  app.add_flag("--simulation", options.simulation, "With a simulation that fails, too");
  CLI11_PARSE(app, argc, argv);
  try {
    Run(options).run(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "incise-hid-faults: %s\n", error.what());
    return 1;
  }
  return 0;
}
