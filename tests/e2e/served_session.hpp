#pragma once

// What the tests of recovery share: incised in a folder of its own, killed and started again; a source of poses that
// survives it; and a second opinion on its capture.

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <unordered_set>

#include "client/client.hpp"
#include "protocol/capture.hpp"
#include "server/app/body.hpp"
#include "server/app/config.hpp"
#include "server/core/session/cut_session.hpp"
#include "tests/e2e/process.hpp"

namespace incise::e2e {

// One number of a server's /stats, by its path ("/journal/lost"); nothing where it cannot be had.
std::optional<double> stat(std::uint16_t http_port, const std::string& pointer);

// incised on a phantom slab, its files in a folder that goes with this. The capture is in a folder of its own below, "disk".
class ServedSession {
 public:
  // `capture`: more keys for the configuration's "capture", each with a comma in front.
  ServedSession(const std::string& name, int target_tets, const std::string& capture);
  ~ServedSession();

  // Another body, before the first start: a file in its folder, with two more fields for clients to set.
  void use_body(const std::string& file_name);
  // Other keys for "capture", from the next start on.
  void set_capture(const std::string& capture) {
    more_capture_ = capture;
    write_config();
  }
  // More keys for "cut", each with a comma in front, from the next start on.
  void set_cut(const std::string& cut) {
    more_cut_ = cut;
    write_config();
  }
  // Other keys of the configuration, each with a comma in front, from the next start on.
  void set_keys(const std::string& keys) {
    more_keys_ = keys;
    write_config();
  }
  // Starts it; waits until it listens where told so. False where it ended instead, or did not listen within a minute. After
  // the first time it listens where it did then, so that clients find it again.
  bool start(bool resume, bool wait = true);
  bool wait_until_listening();
  // kill -9, and waits for its end.
  void kill();

  Process& server() { return *server_; }
  std::uint16_t tcp_port() const { return tcp_port_; }
  std::uint16_t http_port() const { return http_port_; }
  std::string capture() const { return file("disk/session.capture"); }
  std::string file(const std::string& name) const { return (directory_ / name).string(); }
  // What it has logged, all starts together.
  std::string log() const;
  std::optional<double> stat(const std::string& pointer) const { return e2e::stat(http_port_, pointer); }
  const app::Config& config() const { return config_; }
  const app::Body& body() const { return body_; }

 private:
  void write_config() const;
  std::filesystem::path directory_;
  std::string mesh_, more_capture_, more_cut_, more_keys_;
  // Drivers and viewers look them up while it is started again.
  std::atomic<std::uint16_t> tcp_port_ = 0, http_port_ = 0;
  app::Config config_;
  app::Body body_;
  std::unique_ptr<Process> server_;
};

// Sends poses to and fro across the body, at a device's rate, for as long as it lives: connects again when the server
// has gone. Thread: its own.
class PoseDriver {
 public:
  // At a relay of it with `port`.
  PoseDriver(const ServedSession& session, double rate_hz, double speed_m_s,
             const std::string& source = "blade", std::uint16_t port = 0);
  ~PoseDriver();
  // Lifts the blade and ends sending; waits until the server has dealt with all that was sent in this connection. False
  // where it has not within five minutes.
  bool settle();
  std::uint64_t sent() const { return sent_; }
  // Source time of the last pose that the server says it has taken; the clock is CLOCK_MONOTONIC, ns.
  std::int64_t acknowledged_ns() const { return acknowledged_ns_; }
  std::uint64_t rejected() const { return rejected_; }
  // By the last report, of this connection.
  std::uint64_t accepted() const { return accepted_; }
  std::uint64_t recorded() const { return recorded_; }
  std::int64_t recorded_ns() const { return recorded_ns_; }
  protocol::Recording recording() const { return recording_; }
  // Errors of the code NotRecorded that came.
  int warnings() const { return warnings_; }

 private:
  void run(const ServedSession& session, double rate_hz, double speed_m_s, const std::string& source,
           std::uint16_t port);
  std::atomic<bool> stop_{false}, settling_{false}, settled_{false};
  std::atomic<std::uint64_t> sent_{0}, rejected_{0}, accepted_{0}, recorded_{0};
  std::atomic<std::int64_t> acknowledged_ns_{0}, recorded_ns_{0};
  std::atomic<protocol::Recording> recording_{protocol::Recording::Off};
  std::atomic<int> warnings_{0};
  std::thread thread_;
};

// The offline run: reads a capture as it grows, computes with no budget and no server what its poses make, and compares
// each mark's hash.
class CaptureFollower {
 public:
  explicit CaptureFollower(const ServedSession& session);
  // Reads on, to the last whole record. Empty, or what is wrong.
  std::string follow();

  std::uint64_t revision() const { return session_->revision(); }
  std::uint64_t state_hash() const { return session_->mesh().state_hash(); }
  bool in_stroke() const {
    for (std::uint32_t source = 0; source < core::kMaxSources; ++source)
      if (session_->in_stroke(source)) return true;
    return false;
  }
  std::uint64_t marks() const { return marks_; }
  std::uint64_t poses() const { return poses_; }
  std::uint64_t gaps() const { return gaps_; }
  std::uint64_t deformations() const { return deformations_; }
  std::int64_t last_source_ns() const { return last_source_ns_; }
  // Whether the last follow() found a pose with that source time.
  bool has_seen(std::int64_t source_ns) const { return seen_.contains(source_ns); }

 private:
  void operator()(const protocol::CaptureRecord& record, std::string& problem);
  const ServedSession& served_;
  std::unique_ptr<core::CutSession> session_;
  std::map<std::uint64_t, std::uint64_t> hashes_;  // of revisions whose marks have not come by
  std::uint64_t good_bytes_ = 0, records_ = 0, marks_ = 0, poses_ = 0, gaps_ = 0, deformations_ = 0;
  std::int64_t last_source_ns_ = 0;
  std::unordered_set<std::int64_t> seen_;
};

}  // namespace incise::e2e
