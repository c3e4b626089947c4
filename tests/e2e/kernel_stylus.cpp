// kernel_stylus uhid|usb: runs inside of a virtual machine as its only program (tests/e2e/qemu_hid.sh): incised and a
// Reference Stylus that the kernel makes, so that hidapi meets a real /dev/hidraw0. With uhid the kernel's HID layer has
// the device from this program; with usb it is a USB gadget on a bus of the kernel's own (dummy_hcd), found, read and
// written by the same drivers as a device on a cable. Prints the verdict as its last line. Does not check times: an
// emulated processor distorts them.

#include <fcntl.h>
#include <linux/input.h>
#include <linux/uhid.h>
#include <poll.h>
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <filesystem>
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

// A stylus on a bus of the kernel's for as long as it lives.
class Device {
 public:
  virtual ~Device() = default;
  virtual void report(const incise_stylus_input& input) = 0;

  // Whether a report from the host may hide the one before it, as long as this has not been read.
  bool newest_only = false;
  std::atomic<int> outputs{0}, forces{0}, settings{0};
  std::atomic<double> strongest_n{0};
  std::atomic<bool> released{false};  // by the last output

 protected:
  void take(std::span<const std::uint8_t> sent) {
    incise_stylus_output output{};
    if (sent.size() != sizeof output) return;
    std::memcpy(&output, sent.data(), sizeof output);
    ++outputs;
    released = (output.flags & INCISE_STYLUS_FORCE_ON) == 0;
    const double newtons =
        1e-6 * core::length({double(output.force[0]), double(output.force[1]), double(output.force[2])});
    forces += newtons > 0;
    strongest_n = std::max(strongest_n.load(), newtons);
  }
};

class UhidDevice : public Device {
 public:
  UhidDevice() : file_(::open("/dev/uhid", O_RDWR | O_CLOEXEC)) {
    require(file_ >= 0, "/dev/uhid cannot be opened");
    uhid_event event{};
    event.type = UHID_CREATE2;
    uhid_create2_req& made = event.u.create2;
    std::strcpy(reinterpret_cast<char*>(made.name), "Stylus");
    std::strcpy(reinterpret_cast<char*>(made.uniq), "U1");
    const tests::Bytes& descriptor = tests::stylus_descriptor();
    made.rd_size = static_cast<std::uint16_t>(descriptor.size());
    std::memcpy(made.rd_data, descriptor.data(), descriptor.size());
    made.bus = BUS_USB;
    made.vendor = 0x1209;
    made.product = 1;
    send(event);
    thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
  }
  ~UhidDevice() override {
    thread_.request_stop();
    thread_.join();
    uhid_event event{};
    event.type = UHID_DESTROY;
    send(event);
    ::close(file_);
  }
  void report(const incise_stylus_input& input) override {
    uhid_event event{};
    event.type = UHID_INPUT2;
    event.u.input2.size = sizeof input;
    std::memcpy(event.u.input2.data, &input, sizeof input);
    send(event);
  }

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
      if (event.type == UHID_OUTPUT) take(std::span(event.u.output.data, event.u.output.size));
    }
  }

  const int file_;
  std::mutex mutex_;
  std::jthread thread_;
};

// The kernel's own HID gadget; what it is set up with: Documentation/usb/gadget_configfs.rst and gadget_hid.rst. It has
// no endpoint for output reports: with one it refuses feature reports, and the stylus takes its settings by one. Both then
// come by the control endpoint.
class GadgetDevice : public Device {
 public:
  GadgetDevice() {
    newest_only = true;
    if (!std::filesystem::exists(kGadget)) make_gadget();
    set("UDC", "dummy_udc.0");
    require(eventually([] { return ::access("/dev/hidg0", R_OK | W_OK) == 0; }), "no /dev/hidg0");
    file_ = ::open("/dev/hidg0", O_RDWR | O_CLOEXEC | O_NONBLOCK);
    require(file_ >= 0, "/dev/hidg0 cannot be opened");
    thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
  }
  ~GadgetDevice() override {
    thread_.request_stop();
    thread_.join();
    ::close(file_);
    std::ofstream(kGadget / "UDC") << "\n";  // pulls the plug
  }
  // Waits for the host to have fetched the last one.
  void report(const incise_stylus_input& input) override {
    const bool written = eventually([&] {
      if (::write(file_, &input, sizeof input) == sizeof input) return true;
      require(errno == EAGAIN, std::string("/dev/hidg0 refuses a report: ") + std::strerror(errno));
      pollfd wait{file_, POLLOUT, 0};
      ::poll(&wait, 1, 10);
      return false;
    });
    require(written, "the host fetches no reports");
  }

 private:
  static inline const std::filesystem::path kGadget = "/sys/kernel/config/usb_gadget/stylus";

  static void set(const std::filesystem::path& key, std::string_view value) {
    std::ofstream file(kGadget / key, std::ios::binary);
    file << value << std::flush;
    require(bool(file), "the gadget refuses its " + key.string());
  }
  static void make_gadget() {
    for (const char* part : {"strings/0x409", "configs/c.1", "functions/hid.usb0"}) {
      std::filesystem::create_directories(kGadget / part);
    }
    set("idVendor", "0x1209");
    set("idProduct", "0x0001");
    set("strings/0x409/product", "Stylus");
    set("strings/0x409/serialnumber", "U1");
    const tests::Bytes& descriptor = tests::stylus_descriptor();
    set("functions/hid.usb0/report_desc",
        {reinterpret_cast<const char*>(descriptor.data()), descriptor.size()});
    set("functions/hid.usb0/report_length", std::to_string(sizeof(incise_stylus_input)));
    set("functions/hid.usb0/no_out_endpoint", "1");
    std::filesystem::create_directory_symlink(kGadget / "functions/hid.usb0",
                                              kGadget / "configs/c.1/hid.usb0");
  }
  void run(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      pollfd wait{file_, POLLIN, 0};
      if (::poll(&wait, 1, 50) <= 0) continue;
      std::uint8_t bytes[64];
      const auto size = ::read(file_, bytes, sizeof bytes);
      if (size <= 0) continue;
      settings += bytes[0] == INCISE_STYLUS_SETTINGS;
      if (bytes[0] == INCISE_STYLUS_OUTPUT) take(std::span(bytes, static_cast<std::size_t>(size)));
    }
  }

  int file_ = -1;
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

void run(const std::function<std::unique_ptr<Device>()>& plug) {
  constexpr int kReports = 3000;
  Server server;
  auto device = plug();
  // The source is open a moment before the device is listed.
  const auto is_read = [&](int connections) {
    const auto stats = server.stats();
    return stats["sources"] == 1 && !stats["devices"].empty() &&
           stats["devices"][0]["connections"] == connections;
  };
  require(eventually([&] { return is_read(1); }), "the device is not read");
  // A millisecond apart, and never more than half of what the kernel's queue holds: an emulated processor may give the
  // reader no time for longer than a real one would.
  const auto arrived = [&] {
    const auto stats = server.stats();
    const auto& reports = stats["devices"][0]["reports"];
    return reports["count"].get<int>() + reports["lost"].get<int>();
  };
  // Back and forth through the liver, each time in a new place; again if the processor was too slow for a force, which is
  // zero once it is old.
  int sent = 0;
  const auto send_pass = [&](int pass) {
    const int end = (pass + 1) * kReports;
    for (; sent < end; ++sent) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
      if (sent % 32 == 0) require(eventually([&] { return arrived() >= sent; }), "the reports do not arrive");
      const double way = -0.1 + 0.2 * (sent % kReports) / (kReports - 1);
      device->report(stylus_report(static_cast<std::uint16_t>(sent),
                                   {0.03 - 0.005 * pass, pass % 2 == 0 ? way : -way, 0.07}, 1));
    }
  };
  for (int pass = 0; pass < 5 && device->forces == 0; ++pass) send_pass(pass);
  const auto worked_off = [&] {
    const auto stats = server.stats();
    return stats["backlog"]["batches"] == 0 && stats["backlog"]["poses"] == 0;
  };
  require(eventually([&] { return arrived() >= sent && worked_off(); }), "the reports do not arrive");
  const auto stats = server.stats();
  const auto& seen = stats["devices"][0];
  std::printf(
      "settings %d; reports %d, lost %d; outputs %d, with a force %d, the strongest %.2f N; cut faces %d\n",
      device->settings.load(), seen["reports"]["count"].get<int>(), seen["reports"]["lost"].get<int>(),
      device->outputs.load(), device->forces.load(), device->strongest_n.load(),
      stats["cut_faces"].get<int>());
  require(seen["device"] == "1209:0001:U1", "it is not known by its numbers: " + seen.dump());
  require(seen["path"] == "/dev/hidraw0", "another node: " + seen.dump());
  // A device that refuses them is not read.
  require(device->settings == 1 || device->newest_only, "it was not told its settings");
  require(seen["reports"]["lost"] == 0 && seen["reports"]["bad_values"] == 0,
          "reports were lost: " + seen.dump());
  require(stats["strokes"] == 1 && stats["cut_faces"].get<int>() > 50, "it was not cut");
  require(seen["forces"]["failed"] == 0 && device->outputs > 100 && device->forces > 0,
          "no forces: " + seen.dump());
  require(device->strongest_n <= 3.3 + 1e-5, "a force beyond the limit");

  // In the middle of the stroke.
  device.reset();
  require(eventually([&] { return server.stats()["sources"] == 0 && worked_off(); }),
          "its end is not noticed");
  const int cut_faces = server.stats()["cut_faces"];
  device = plug();
  require(eventually([&] { return is_read(2); }), "it is not found again, or taken for another one");
  // It engages at another place. Had the first stroke not ended, the way there would be cut.
  for (std::uint16_t i = 0; i < 10; ++i) device->report(stylus_report(i, {-0.03, -0.1, 0.07}, 1));
  require(eventually([&] { return server.stats()["strokes"] == 2 && worked_off(); }), "no second stroke");
  require(server.stats()["cut_faces"] == cut_faces, "the first stroke went on");
  server.process().signal(SIGTERM);
  require(server.process().wait(60) == 0, "the server does not end cleanly");
  require(eventually([&] { return device->released.load(); }), "it is not released at the end");
}

}  // namespace
}  // namespace incise::e2e

int main(int argc, char** argv) {
  using namespace incise::e2e;
  try {
    const std::string kind = argc == 2 ? argv[1] : "";
    require(kind == "uhid" || kind == "usb", "usage: kernel_stylus uhid|usb");
    run([&]() -> std::unique_ptr<Device> {
      if (kind == "usb") return std::make_unique<GadgetDevice>();
      return std::make_unique<UhidDevice>();
    });
    std::puts("verdict: good");
    return 0;
  } catch (const std::exception& error) {
    std::printf("verdict: bad: %s\n", error.what());
    return 1;
  }
}
