// Runs inside of a virtual machine as its only program (tests/e2e/qemu_hid.sh): incised and a Reference Stylus that the
// kernel's uhid makes, so that hidapi meets a real /dev/hidraw0. Prints the verdict as its last line. Says nothing of times:
// an emulated processor has its own.

#include <fcntl.h>
#include <linux/input.h>
#include <linux/uhid.h>
#include <poll.h>
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <functional>
#include <mutex>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <thread>

#include "tests/e2e/process.hpp"
#include "tests/input/hid/stylus.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::e2e {
namespace {

using tests::stylus_report;

void require(bool holds, const std::string& what) {
  if (!holds) throw std::runtime_error(what);
}

bool eventually(const std::function<bool()>& condition) {
  for (int i = 0; i < 12'000; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return false;
}

// A device on the kernel's bus for as long as it lives.
class Device {
 public:
  Device() : file_(::open("/dev/uhid", O_RDWR | O_CLOEXEC)) {
    require(file_ >= 0, "/dev/uhid cannot be opened");
    uhid_event event{};
    event.type = UHID_CREATE2;
    uhid_create2_req& made = event.u.create2;
    std::strcpy(reinterpret_cast<char*>(made.name), "Stylus");
    std::strcpy(reinterpret_cast<char*>(made.uniq), "U1");
    const std::uint8_t descriptor[] = {INCISE_STYLUS_REPORT_DESCRIPTOR};
    made.rd_size = sizeof descriptor;
    std::memcpy(made.rd_data, descriptor, sizeof descriptor);
    made.bus = BUS_USB;
    made.vendor = 0x1209;
    made.product = 1;
    send(event);
    thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
  }
  ~Device() {
    thread_.request_stop();
    thread_.join();
    uhid_event event{};
    event.type = UHID_DESTROY;
    send(event);
    ::close(file_);
  }
  void report(const incise_stylus_input& input) {
    uhid_event event{};
    event.type = UHID_INPUT2;
    event.u.input2.size = sizeof input;
    std::memcpy(event.u.input2.data, &input, sizeof input);
    send(event);
  }
  std::atomic<int> outputs{0}, forces{0}, settings{0};
  std::atomic<double> strongest_n{0};
  std::atomic<bool> released{false};  // by the last output

 private:
  void send(const uhid_event& event) {
    const std::scoped_lock lock(mutex_);
    require(::write(file_, &event, sizeof event) == sizeof event, "uhid refuses an event");
  }
  void run(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      pollfd wait{file_, POLLIN, 0};
      if (::poll(&wait, 1, 50) <= 0) continue;
      uhid_event event{};
      if (::read(file_, &event, sizeof event) <= 0) continue;
      if (event.type == UHID_SET_REPORT) {
        ++settings;
        uhid_event answer{};
        answer.type = UHID_SET_REPORT_REPLY;
        answer.u.set_report_reply.id = event.u.set_report.id;
        send(answer);
      }
      if (event.type == UHID_OUTPUT) take(event.u.output);
    }
  }
  void take(const uhid_output_req& sent) {
    incise_stylus_output output{};
    if (sent.size != sizeof output) return;
    std::memcpy(&output, sent.data, sizeof output);
    ++outputs;
    released = (output.flags & INCISE_STYLUS_FORCE_ON) == 0;
    const double newtons =
        1e-6 * core::length({double(output.force[0]), double(output.force[1]), double(output.force[2])});
    forces += newtons > 0;
    strongest_n = std::max(strongest_n.load(), newtons);
  }

  const int file_;
  std::mutex mutex_;
  std::jthread thread_;
};

class Server {
 public:
  Server() {
    std::ofstream("/tmp/server.json") << R"({"mesh": {"phantom": "liver", "target_tets": 8000},
      "blade": {"heel": [0, 0, 0], "tip": [0, 0, -0.12]}, "cut": {"gap_limit_s": 3600, "speed_limit_m_s": 100},
      "listen": {"tcp_port": 0, "http_port": 0}, "log": {"level": "warning"}})";
    process_ =
        std::make_unique<Process>(std::vector<std::string>{"/bin/incised", "--config", "/tmp/server.json"});
    const std::string line = process_->line("listening ", 120);
    port_ = port_after(line, "http=");
    require(port_ != 0, "incised does not listen");
  }
  nlohmann::json stats() const {
    const std::string answer = stream::http(port_, "/stats");
    const auto body = answer.find("\r\n\r\n");
    require(body != std::string::npos, "no /stats");
    return nlohmann::json::parse(answer.substr(body + 4));
  }
  Process& process() { return *process_; }

 private:
  std::unique_ptr<Process> process_;
  std::uint16_t port_ = 0;
};

void run() {
  constexpr int kReports = 3000;
  Server server;
  auto device = std::make_unique<Device>();
  require(eventually([&] { return server.stats()["sources"] == 1; }), "the device is not read");
  // A millisecond apart, and never more than half of what the kernel's queue holds: an emulated processor may give the
  // reader no time for longer than a real one would.
  const auto arrived = [&] {
    const auto stats = server.stats();
    const auto& reports = stats["devices"][0]["reports"];
    return reports["count"].get<int>() + reports["lost"].get<int>();
  };
  for (int i = 0; i < kReports; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
    if (i % 32 == 0) require(eventually([&] { return arrived() >= i; }), "the reports do not arrive");
    device->report(stylus_report(static_cast<std::uint16_t>(i), {0.03, -0.1 + 0.2 * i / (kReports - 1), 0.07},
                                 i + 1 < kReports ? 1 : 0));
  }
  require(eventually([&] {
            const auto stats = server.stats();
            return arrived() >= kReports && stats["backlog"]["batches"] == 0 &&
                   stats["backlog"]["poses"] == 0;
          }),
          "the reports do not arrive");
  const auto stats = server.stats();
  const auto& seen = stats["devices"][0];
  std::printf("reports %d, lost %d; outputs %d, with a force %d, the strongest %.2f N; cut faces %d\n",
              seen["reports"]["count"].get<int>(), seen["reports"]["lost"].get<int>(), device->outputs.load(),
              device->forces.load(), device->strongest_n.load(), stats["cut_faces"].get<int>());
  require(seen["device"] == "1209:0001:U1", "it is not known by its numbers: " + seen.dump());
  require(seen["path"] == "/dev/hidraw0", "another node: " + seen.dump());
  require(device->settings == 1, "it was not told its settings");
  require(seen["reports"]["lost"] == 0 && seen["reports"]["bad_values"] == 0,
          "reports were lost: " + seen.dump());
  require(stats["strokes"] == 1 && stats["cut_faces"].get<int>() > 50, "it was not cut");
  require(seen["forces"]["failed"] == 0 && device->outputs > 100 && device->forces > 0,
          "no forces: " + seen.dump());
  require(device->strongest_n <= 3.3 + 1e-5, "a force beyond the limit");

  device.reset();
  require(eventually([&] { return server.stats()["sources"] == 0; }), "its end is not noticed");
  device = std::make_unique<Device>();
  require(eventually([&] { return server.stats()["sources"] == 1; }), "it is not found again");
  require(server.stats()["devices"][0]["connections"] == 2, "it is taken for another one");
  server.process().signal(SIGTERM);
  require(server.process().wait(60) == 0, "the server does not end cleanly");
  require(eventually([&] { return device->released.load(); }), "it is not released at the end");
}

}  // namespace
}  // namespace incise::e2e

int main() {
  try {
    incise::e2e::run();
    std::puts("verdict: good");
    return 0;
  } catch (const std::exception& error) {
    std::printf("verdict: bad: %s\n", error.what());
    return 1;
  }
}
