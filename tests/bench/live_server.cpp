#include "tests/bench/live_server.hpp"

#include <sys/resource.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <stdexcept>
#include <string>
#include <thread>

#include "server/base/clock.hpp"
#include "server/input/pose_sources.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::bench {
namespace {

namespace fs = std::filesystem;

void write_config(const LiveMotion& motion, const core::Blade& blade, const nlohmann::json& listen,
                  const fs::path& file) {
  nlohmann::json config{{"mesh", {{"phantom", "liver"}, {"target_tets", motion.tets}}},
                        {"blade",
                         {{"heel", {blade.heel.x, blade.heel.y, blade.heel.z}},
                          {"tip", {blade.tip.x, blade.tip.y, blade.tip.z}}}},
                        {"listen", {{"tcp_port", 0}, {"http_port", 0}}},
                        {"log", {{"level", "warning"}}}};
  config["listen"].update(listen);
  if (motion.capture) config["capture"]["path"] = "live.capture";
  if (motion.batch_h > 0) config["cut"]["batch_h"] = motion.batch_h;
  std::ofstream(file) << config;
}

}  // namespace

LiveServer::LiveServer(const LiveMotion& motion, const nlohmann::json& listen)
    : motion_(motion), folder_(fs::temp_directory_path() / ("incise_live_" + std::to_string(::getpid()))) {
  const NamedMesh body = phantom("liver", static_cast<std::size_t>(motion.tets));
  tets_ = body.mesh.tets.size();
  box_ = bounds(body.mesh);
  const auto& [low, high] = box_;
  way_.emplace(low, high, motion.speed_m_s, motion.pose_rate_hz);
  fs::remove_all(folder_);
  fs::create_directories(folder_);
  const fs::path file = folder_ / "live.json";
  write_config(motion, way_->blade(), listen, file);
  process_ =
      std::make_unique<e2e::Process>(std::vector<std::string>{motion.incised, "--config", file.string()});
  const std::string line = process_->line("listening ");
  if (line.empty()) throw std::runtime_error("incised did not start");
  tcp_port_ = e2e::port_after(line, "tcp=");
  http_port_ = e2e::port_after(line, "http=");
}

LiveServer::~LiveServer() {
  process_.reset();
  std::error_code ignored;
  fs::remove_all(folder_, ignored);
}

double LiveServer::cpu_s() const {
  if (ended_) {
    rusage used{};
    ::getrusage(RUSAGE_CHILDREN, &used);
    const auto seconds = [](const timeval& t) {
      return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
    };
    return seconds(used.ru_utime) + seconds(used.ru_stime);
  }
  clockid_t clock{};
  timespec used{};
  if (clock_getcpuclockid(pid(), &clock) != 0 || clock_gettime(clock, &used) != 0)
    throw std::runtime_error("incised has no processor time");
  return static_cast<double>(used.tv_sec) + 1e-9 * static_cast<double>(used.tv_nsec);
}

std::map<std::string, double> LiveServer::threads_cpu_s() const {
  std::map<std::string, double> used;
  for (const auto& task : fs::directory_iterator("/proc/" + std::to_string(pid()) + "/task")) {
    std::string name;
    double ran_ns = 0;
    std::getline(std::ifstream(task.path() / "comm"), name);
    std::ifstream(task.path() / "schedstat") >> ran_ns;
    used[name] += 1e-9 * ran_ns;
  }
  return used;
}

void LiveServer::connect_device() {
  client::Options options;
  options.role = protocol::Role::Operator;
  options.view = protocol::View::None;
  device_ = client::Client::connect("127.0.0.1", tcp_port_, options);
}

LivePoses LiveServer::drive() {
  if (!device_) connect_device();
  LivePoses poses;
  std::uint64_t sequence = 0;
  const std::int64_t start = monotonic_ns(), period = static_cast<std::int64_t>(1e9 / motion_.pose_rate_hz);
  const auto count = static_cast<std::int64_t>(motion_.seconds * motion_.pose_rate_hz);
  for (std::int64_t i = 0; i <= count; ++i) {
    const std::int64_t at = start + i * period;
    const timespec when{at / 1'000'000'000, at % 1'000'000'000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &when, nullptr) != 0) {
    }
    const core::Pose pose = way_->next();
    const core::Vec3& p = pose.position;
    // The last one is lifted: what was begun is ended.
    const protocol::PoseSample sample{at, {p.x, p.y, p.z}, {1, 0, 0, 0}, i < count ? pose.buttons : 0, 0};
    if (const std::uint64_t n = device_->send_poses(std::span(&sample, 1))) {
      sequence = n;
      ++poses.sent;
    }
  }
  poses.settled = device_->wait_for_report(sequence, 60);
  poses.accepted = device_->report().accepted;
  device_.reset();
  return poses;
}

nlohmann::json LiveServer::stats() const {
  // While too many connections have not said Hello, others are turned away.
  for (int i = 0; i < 600; ++i) {
    const std::string answer = stream::http(http_port_, "/stats");
    const auto body = answer.find("\r\n\r\n");
    if (body != std::string::npos) return nlohmann::json::parse(answer.substr(body + 4));
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  throw std::runtime_error("incised gave no /stats for a minute");
}

nlohmann::json LiveServer::settled_stats() const {
  nlohmann::json now = stats();
  for (int i = 0; i < 6000 && (now["backlog"]["batches"] != 0 || i < 20); ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    now = stats();
  }
  return now;
}

void LiveServer::end() {
  process_->signal(SIGTERM);
  if (process_->wait() != 0) throw std::runtime_error("incised did not end cleanly");
  ended_ = true;
}

}  // namespace incise::bench
