#pragma once

// What the benches of the whole server share: incised in a process of its own, and a device that moves its blade.

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>

#include "client/client.hpp"
#include "tests/bench/bench_util.hpp"
#include "tests/e2e/process.hpp"
#include "tests/support/to_and_fro.hpp"

namespace incise::bench {

// What it cuts, and how the device moves.
struct LiveMotion {
  double seconds = 60;
  double pose_rate_hz = 1000;
  double speed_m_s = 0.2;
  int tets = 60'000;
  double batch_h = 0;  // 0: the server's default
  bool capture = true;
  std::string incised = "incised";  // a path, for another build of it
};

// What became of the device's poses.
struct LivePoses {
  std::uint64_t sent = 0, accepted = 0;
  bool settled = false;
};

// incised on a phantom liver on free ports of loopback, its files in a folder that goes with this.
class LiveServer {
 public:
  // `listen`: more keys of the configuration's "listen". Throws std::runtime_error where it does not start.
  explicit LiveServer(const LiveMotion& motion, const nlohmann::json& listen = nlohmann::json::object());
  ~LiveServer();

  std::uint16_t tcp_port() const { return tcp_port_; }
  std::uint16_t http_port() const { return http_port_; }
  std::size_t tets() const { return tets_; }
  pid_t pid() const { return process_->pid(); }
  // Around the body as loaded.
  std::pair<core::Vec3, core::Vec3> box() const { return box_; }
  // Of its process so far; after end() of all of it, its last checkpoint included. s.
  double cpu_s() const;
  // Of each of its threads so far, by name; several of one name together. s.
  std::map<std::string, double> threads_cpu_s() const;

  // An operator takes the blade; drive() does it where this has not.
  void connect_device();
  // The operator sends each pose at its time; the source's clock is CLOCK_MONOTONIC.
  // Waits until the server has taken all of them.
  LivePoses drive();
  nlohmann::json stats() const;
  // The same when nothing waits to be cut any more.
  nlohmann::json settled_stats() const;
  // Stops it. Throws std::runtime_error where it does not end cleanly.
  void end();

 private:
  LiveMotion motion_;
  std::filesystem::path folder_;
  std::optional<tests::ToAndFro> way_;
  std::unique_ptr<e2e::Process> process_;
  std::unique_ptr<client::Client> device_;
  std::uint16_t tcp_port_ = 0, http_port_ = 0;
  std::size_t tets_ = 0;
  bool ended_ = false;
  std::pair<core::Vec3, core::Vec3> box_;
};

}  // namespace incise::bench
