// incise doctor: finds what would keep a server from working well on this machine, as this user.

#include <netdb.h>
#include <pwd.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "server/app/certificate_check.hpp"
#include "server/app/config.hpp"
#include "server/app/nats_options.hpp"
#include "server/app/offline/commands.hpp"
#include "server/app/offline/terminal.hpp"
#include "server/base/clock.hpp"
#include "server/base/wording.hpp"
#include "server/input/hid/hid_system.hpp"
#include "server/mesh_io/tetgen_process.hpp"

namespace incise::app {
namespace {

namespace fs = std::filesystem;

enum class Verdict { kGood, kNote, kWarning, kFault };

struct Finding {
  std::string what;
  Verdict verdict = Verdict::kGood;
  std::string found;
  std::string remedy;  // empty if there is nothing to fix
};

constexpr const char* kUdevRemedy =
    "install the udev rules (DEVICES.md, \"Connecting a device\"), plug the device in again, or join the "
    "group "
    "incise";

std::string reason(int error) {
  return std::generic_category().message(error);
}

std::string first_word(const char* file) {
  std::string word;
  std::ifstream(file) >> word;
  return word;
}

// Whether it is one of incise-relay: no other has this section. What cannot be read is not.
Program program_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  const nlohmann::json root = nlohmann::json::parse(in, nullptr, false, true);
  return root.is_object() && root.contains("relay") ? Program::kRelay : Program::kServer;
}

Finding check_configuration(const DoctorCommand& command, Program program, Config& config) {
  if (command.config.empty())
    return {"configuration", Verdict::kGood, "none given: checking the defaults", ""};
  const bool relay = program == Program::kRelay;
  try {
    config = load_config(command.config, program);
    if (relay) {
      check_relay_config(config, command.config.string());
    } else {
      check_config(config, command.config.string());
    }
  } catch (const ConfigError& error) {
    return {"configuration", Verdict::kFault, error.what(),
            std::string(relay ? "incise-relay" : "incised") +
                " --print-config shows every key with what it accepts"};
  }
  return {"configuration", Verdict::kGood, command.config.string() + ": good", ""};
}

// For the calling thread. 0: it has the loop's priority; else the error.
int request_priority(const Config& config) {
  sched_param wanted{};
  wanted.sched_priority = static_cast<int>(config.loop.realtime_priority);
  return pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted);
}

// Requests the priority in a thread that then ends: the only way to find out.
Finding check_priority(const Config& config) {
  const int priority = static_cast<int>(config.loop.realtime_priority);
  if (priority == 0) return {"real-time priority", Verdict::kGood, "not asked for", ""};
  int error = 0;
  std::thread([&] { error = request_priority(config); }).join();
  const std::string text = "SCHED_FIFO " + std::to_string(priority);
  if (error == 0) return {"real-time priority", Verdict::kGood, text + " is granted", ""};
  return {"real-time priority", Verdict::kWarning,
          text + ": " + reason(error) + "; frames will be late under load",
          "LimitRTPRIO=" + std::to_string(priority) +
              " or more in the service, or 'rtprio' in "
              "/etc/security/limits.conf and a new login; or loop.realtime_priority 0"};
}

Finding check_memory(const Config& config) {
  if (!config.loop.lock_memory) return {"locked memory", Verdict::kGood, "not asked for", ""};
  rlimit limit{};
  getrlimit(RLIMIT_MEMLOCK, &limit);
  // With a limit below its final size the server starts and fails later. So only no limit, or the right to exceed it, is
  // good.
  const bool locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
  if (locked) munlockall();
  if (limit.rlim_cur == RLIM_INFINITY || (locked && geteuid() == 0)) {
    return {"locked memory", Verdict::kGood, "granted", ""};
  }
  return {
      "locked memory", Verdict::kWarning,
      "at most " + std::to_string(limit.rlim_cur / 1024) + " kB may be locked; page faults will delay frames",
      "LimitMEMLOCK=infinity in the service, or 'memlock unlimited' in /etc/security/limits.conf and a new "
      "login; or "
      "loop.lock_memory false"};
}

Finding check_clock() {
  const std::string source = first_word("/sys/devices/system/clocksource/clocksource0/current_clocksource");
  timespec resolution{};
  clock_getres(CLOCK_MONOTONIC, &resolution);
  const std::string found = "clock source " + (source.empty() ? "unknown" : source) + ", resolution " +
                            std::to_string(resolution.tv_sec * 1'000'000'000L + resolution.tv_nsec) + " ns";
  if (resolution.tv_sec > 0 || resolution.tv_nsec > 1000) {
    return {"clock", Verdict::kFault, found, "a kernel with high-resolution timers (CONFIG_HIGH_RES_TIMERS)"};
  }
  if (source == "hpet" || source == "acpi_pm" || source == "jiffies") {
    return {"clock", Verdict::kWarning, found + ": reading it takes microseconds",
            "the kernel parameter clocksource=tsc, if the processor's is stable"};
  }
  return {"clock", Verdict::kGood, found, ""};
}

// How late a thread wakes from 200 sleeps of a millisecond, at the loop's priority where that is granted.
std::vector<double> late_wakeups_us() {
  std::vector<double> late_us;
  timespec at{};
  clock_gettime(CLOCK_MONOTONIC, &at);
  for (int i = 0; i < 200; ++i) {
    at.tv_nsec += 1'000'000;
    if (at.tv_nsec >= 1'000'000'000) at.tv_nsec -= 1'000'000'000, ++at.tv_sec;
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, nullptr);
    timespec now{};
    clock_gettime(CLOCK_MONOTONIC, &now);
    late_us.push_back(static_cast<double>(now.tv_sec - at.tv_sec) * 1e6 +
                      static_cast<double>(now.tv_nsec - at.tv_nsec) * 1e-3);
  }
  std::sort(late_us.begin(), late_us.end());
  return late_us;
}

Finding check_wakeups(const Config& config) {
  std::vector<double> late_us;
  bool real_time = false;
  std::thread([&] {
    real_time = config.loop.realtime_priority > 0 && request_priority(config) == 0;
    late_us = late_wakeups_us();
  }).join();
  char found[128];
  std::snprintf(found, sizeof found, "late by %.0f us (half of 200 times), at most %.0f us", late_us[100],
                late_us[199]);
  if (late_us[199] < 1000) return {"wake-ups at 1 kHz", Verdict::kGood, found, ""};
  return {"wake-ups at 1 kHz", Verdict::kWarning, found,
          std::string(real_time ? "" : "a real-time priority for the loop, ") +
              "less other work on this machine, or a kernel with PREEMPT_RT"};
}

Finding check_processors(const Config& config) {
  const auto count = static_cast<std::int64_t>(std::max(1u, std::thread::hardware_concurrency()));
  const std::string governor = first_word("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor");
  const std::string found = std::to_string(count) + (governor.empty() ? "" : ", governor " + governor);
  if (config.loop.cpu >= count) {
    return {"processors", Verdict::kFault, found + "; loop.cpu is " + std::to_string(config.loop.cpu),
            "loop.cpu from 0 to " + std::to_string(count - 1) + ", or -1 for any"};
  }
  if (count < 2) {
    return {"processors", Verdict::kWarning, found + ": loop and network share one",
            "a machine with two or more"};
  }
  if (governor == "powersave") {
    return {"processors", Verdict::kWarning, found + ": slow after each pause",
            "cpupower frequency-set -g performance"};
  }
  return {"processors", Verdict::kGood, found, ""};
}

// Whether incised answers there, over HTTP without TLS, within two seconds.
bool incised_answers(const std::string& address, std::int64_t port) {
  addrinfo hints{}, *list = nullptr;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_NUMERICSERV;
  const std::string number = std::to_string(port);
  if (port == 0 || getaddrinfo(address.c_str(), number.c_str(), &hints, &list) != 0) return false;
  const int s = socket(list->ai_family, SOCK_STREAM, 0);
  const timeval patience{2, 0};
  setsockopt(s, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  setsockopt(s, SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof patience);
  const std::string request =
      "GET /healthz HTTP/1.1\r\nHost: " + address + ":" + number + "\r\nConnection: close\r\n\r\n";
  std::string answer;
  if (s >= 0 && connect(s, list->ai_addr, list->ai_addrlen) == 0 &&
      send(s, request.data(), request.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(request.size())) {
    char buffer[512];
    for (ssize_t n; answer.size() < 4096 && (n = recv(s, buffer, sizeof buffer, 0)) > 0;) {
      answer.append(buffer, static_cast<std::size_t>(n));
    }
  }
  if (s >= 0) close(s);
  freeaddrinfo(list);
  return answer.find("\"revision\":") != std::string::npos &&
         answer.find("\"sessions\":") != std::string::npos;
}

// Whether the server could listen there: tries it for a moment. `running`: an incised listens there already.
Finding check_port(const std::string& key, const std::string& address, std::int64_t port,
                   bool running = false) {
  const std::string where = address + ":" + std::to_string(port);
  addrinfo hints{}, *list = nullptr;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE | AI_NUMERICSERV;
  if (const int error = getaddrinfo(address.c_str(), std::to_string(port).c_str(), &hints, &list)) {
    return {key, Verdict::kFault, where + ": " + gai_strerror(error),
            "listen.address: an address of this machine"};
  }
  const int s = socket(list->ai_family, SOCK_STREAM, 0);
  const int on = 1;
  setsockopt(s, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  const bool bound = s >= 0 && bind(s, list->ai_addr, list->ai_addrlen) == 0 && ::listen(s, 1) == 0;
  const int error = errno;
  if (s >= 0) close(s);
  freeaddrinfo(list);
  if (bound) return {key, Verdict::kGood, where + " is free", ""};
  if (error == EADDRINUSE && running)
    return {key, Verdict::kGood, where + " is in use: an incised runs here", ""};
  const std::string remedy =
      error == EADDRINUSE      ? "end the program that has it (ss -ltnp shows it), or another port"
      : error == EACCES        ? "a port from 1024 on"
      : error == EADDRNOTAVAIL ? "listen.address: an address of this machine (ip address shows them)"
                               : "another address or port";
  return {key, Verdict::kFault, where + ": " + reason(error), remedy};
}

// Whether it can be reached and keeps streams, as who we are there.
Finding check_nats(const Config& config) {
  try {
    const cluster::NatsClient client(nats_options(config));
    jsAccountInfo* info = nullptr;
    client.check(js_GetAccountInfo(&info, client.jetstream(), nullptr, nullptr), "JetStream");
    char found[160];
    std::snprintf(found, sizeof found, "JetStream there, %.0f MB used, messages of up to %zu kB",
                  1e-6 * static_cast<double>(info->Memory + info->Store), client.max_payload() / 1024);
    jsAccountInfo_Destroy(info);
    if (client.max_payload() < 65536)
      return {"NATS", Verdict::kWarning, found,
              "max_payload of 1 MB in the configuration of nats-server, its default"};
    return {"NATS", Verdict::kGood, found, ""};
  } catch (const std::exception& error) {
    return {"NATS", Verdict::kFault, error.what(),
            "the section cluster: --print-config shows its keys; nats-server -js runs one"};
  }
}

void check_devices(const Config& config, std::vector<Finding>& findings) {
  if (!config.devices.enabled) {
    findings.push_back({"devices", Verdict::kGood, "not asked for (devices.enabled)", ""});
    return;
  }
  std::size_t usable = 0;
  for (const input::HidInterface& interface : input::list_hid_interfaces()) {
    if (interface.trouble.empty()) {
      ++usable;
    } else {
      findings.push_back(
          {"device " + interface.identity(), Verdict::kWarning, interface.trouble, kUdevRemedy});
    }
  }
  findings.push_back(
      {"devices", usable > 0 ? Verdict::kGood : Verdict::kNote,
       (usable > 0 ? std::to_string(usable) : "none") + " that can be opened (incise devices lists them)",
       ""});
}

Finding check_tetgen() {
  const std::string program = mesh_io::tetgen_program();
  const std::string path = std::getenv("PATH") ? std::getenv("PATH") : "";
  bool found = program.find('/') != program.npos && access(program.c_str(), X_OK) == 0;
  for (std::size_t begin = 0; !found && program.find('/') == program.npos && begin <= path.size();) {
    const std::size_t end = std::min(path.find(':', begin), path.size());
    found = access((path.substr(begin, end - begin) + "/" + program).c_str(), X_OK) == 0;
    begin = end + 1;
  }
  if (found) return {"incise-tetgen", Verdict::kGood, program, ""};
  return {"incise-tetgen", Verdict::kWarning,
          program + " is not there: surfaces and phantoms cannot be filled",
          "install it beside incise, or name it in INCISE_TETGEN"};
}

Finding check_directory(const std::string& what, fs::path directory) {
  // A missing directory is made when it is needed, if that is possible.
  std::error_code error;
  while (!directory.empty() && !fs::exists(directory, error) && directory.has_parent_path()) {
    directory = directory.parent_path();
  }
  if (directory.empty()) directory = ".";
  if (!fs::is_directory(directory, error)) {
    return {what, Verdict::kFault, directory.string() + ": " + reason(ENOTDIR), "name another place"};
  }
  if (access(directory.c_str(), W_OK | X_OK) == 0)
    return {what, Verdict::kGood, directory.string() + " can be written", ""};
  return {what, Verdict::kFault, directory.string() + ": " + reason(errno),
          "give this user the right to write there, or name another place"};
}

std::string user_name() {
  const passwd* entry = getpwuid(geteuid());
  return entry ? entry->pw_name : std::to_string(geteuid());
}

// A relay has neither loop nor body nor devices.
void examine_relay(const Config& config, std::vector<Finding>& findings) {
  for (const Config::Relay::Session& session : config.relay.all(config.listen)) {
    const bool running = incised_answers(config.listen.address, session.http_port);
    for (const auto& [key, port] :
         {std::pair{"tcp_port", session.tcp_port}, {"http_port", session.http_port}}) {
      findings.push_back(check_port(session.name + ' ' + key, config.listen.address, port, running));
    }
  }
}

void examine_server(const Config& config, std::vector<Finding>& findings) {
  findings.push_back(check_priority(config));
  findings.push_back(check_memory(config));
  findings.push_back(check_clock());
  findings.push_back(check_wakeups(config));
  findings.push_back(check_processors(config));
  const bool running = incised_answers(config.listen.address, config.listen.http_port);
  findings.push_back(check_port("listen.tcp_port", config.listen.address, config.listen.tcp_port, running));
  findings.push_back(check_port("listen.http_port", config.listen.address, config.listen.http_port, running));
  if (config.openigtlink.port >= 0) {
    findings.push_back(check_port("openigtlink.port", config.openigtlink.address, config.openigtlink.port));
  }
  check_devices(config, findings);
  findings.push_back(check_tetgen());
  if (!config.capture.path.empty()) {
    findings.push_back(check_directory("capture.path", config.resolve(config.capture.path).parent_path()));
  }
}

std::vector<Finding> examine(const DoctorCommand& command) {
  Config config;
  const Program program = program_of(command.config);
  std::vector<Finding> findings{check_configuration(command, program, config)};
  for (const std::string& warning : certificate_warnings(config, unix_ns() / 1'000'000'000))
    findings.push_back({"certificate", Verdict::kWarning, warning, ""});
  if (program == Program::kRelay) {
    examine_relay(config, findings);
  } else {
    examine_server(config, findings);
  }
  if (!config.cluster.nats.empty()) findings.push_back(check_nats(config));
  return findings;
}

const char* word(Verdict verdict) {
  constexpr const char* kWords[] = {"good", "note", "warning", "fault"};
  return kWords[static_cast<std::size_t>(verdict)];
}

}  // namespace

int run_doctor(const DoctorCommand& command) {
  const std::vector<Finding> findings = examine(command);
  const auto count = [&](Verdict verdict) {
    return static_cast<std::uint64_t>(std::count_if(findings.begin(), findings.end(),
                                                    [=](const Finding& f) { return f.verdict == verdict; }));
  };
  if (command.json) {
    nlohmann::ordered_json all{{"user", user_name()}, {"findings", nlohmann::ordered_json::array()}};
    for (const Finding& f : findings) {
      nlohmann::ordered_json one{{"what", f.what}, {"verdict", word(f.verdict)}, {"found", f.found}};
      if (!f.remedy.empty()) one["remedy"] = f.remedy;
      all["findings"].push_back(std::move(one));
    }
    std::printf("%s\n", all.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace).c_str());
  } else {
    for (const Finding& f : findings) {
      std::printf("%-8s %-19s %s\n", word(f.verdict), f.what.c_str(), f.found.c_str());
      if (!f.remedy.empty()) std::printf("%28s to fix it: %s\n", "", f.remedy.c_str());
    }
    std::printf("as the user %s: %s, %s\n", user_name().c_str(),
                counted(count(Verdict::kFault), "fault", "faults").c_str(),
                counted(count(Verdict::kWarning), "warning", "warnings").c_str());
  }
  return count(Verdict::kFault) == 0 ? 0 : 1;
}

}  // namespace incise::app
