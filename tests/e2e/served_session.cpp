#include "tests/e2e/served_session.hpp"

#include <unistd.h>

#include <csignal>
#include <fstream>
#include <nlohmann/json.hpp>
#include <vector>

#include "server/app/offline/recorded_motion.hpp"
#include "server/base/clock.hpp"
#include "server/input/pose_sources.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/support/to_and_fro.hpp"

namespace incise::e2e {
namespace {

namespace fs = std::filesystem;

}  // namespace

ServedSession::ServedSession(const std::string& name, int target_tets, const std::string& capture)
    : directory_(fs::temp_directory_path() / ("incise_" + name + "_" + std::to_string(::getpid()))),
      mesh_(R"("phantom": "slab", "target_tets": )" + std::to_string(target_tets)),
      more_capture_(capture) {
  fs::create_directories(directory_ / "disk");
  write_config();
  config_ = app::load_config(directory_ / "server.json");
  body_ = app::load_body(config_);
}

void ServedSession::use_body(const std::string& file_name) {
  mesh_ = R"("path": ")" + file_name + R"(", "fields": ["heat", "mark:2:tets:int"])";
  write_config();
  config_ = app::load_config(directory_ / "server.json");
  body_ = app::load_body(config_, {}, true);
}

void ServedSession::write_config() const {
  std::ofstream(directory_ / "server.json") << R"({"mesh": {)" << mesh_ << R"(},
             "blade": {"heel": [0, 0, 0], "tip": [0, 0, -1]},
             "cut": {"speed_limit_m_s": 50)" << more_cut_
                                            << R"(},
             "listen": {"tcp_port": )" << tcp_port_
                                            << R"(, "http_port": )" << http_port_ << R"(},
             "loop": {"realtime_priority": 0, "lock_memory": false},
             "capture": {"path": "disk/session.capture")"
                                            << more_capture_ << "}" << more_keys_ << "}";
}

ServedSession::~ServedSession() {
  server_.reset();
  fs::remove_all(directory_);
}

bool ServedSession::start(bool resume, bool wait) {
  for (int attempt = 0; attempt < 100; ++attempt) {
    const std::size_t logged = log().size();
    // Its log goes to a file, its process is the shell's.
    server_ = std::make_unique<Process>(std::vector<std::string>{
        "/bin/sh", "-c",
        "exec " + std::string(INCISE_BIN_DIR) + "/incised --config " + file("server.json") +
            (resume ? " --resume" : "") + " 2>>" + file("log.txt")});
    if (!wait || wait_until_listening()) return true;
    // A port of ours may just now be the other end of somebody's connection.
    if (server_->running() || log().find("in use", logged) == std::string::npos) return false;
    resume = true;
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
  }
  return false;
}

bool ServedSession::wait_until_listening() {
  const std::string line = server_->line("listening ");
  if (line.empty()) return false;
  const bool first = tcp_port_ == 0;
  tcp_port_ = port_after(line, "tcp=");
  http_port_ = port_after(line, "http=");
  if (first) write_config();
  return tcp_port_ != 0;
}

void ServedSession::kill() {
  server_->signal(SIGKILL);
  server_->wait();
}

std::string ServedSession::log() const {
  std::ifstream in(directory_ / "log.txt");
  return std::string(std::istreambuf_iterator<char>(in), {});
}

std::optional<double> stat(std::uint16_t http_port, const std::string& pointer) {
  const std::string answer = stream::http(http_port, "/stats");
  const auto body = answer.find("\r\n\r\n");
  if (body == std::string::npos) return std::nullopt;
  const auto json = nlohmann::json::parse(answer.substr(body + 4), nullptr, false);
  const nlohmann::json::json_pointer at(pointer);
  if (!json.contains(at)) return std::nullopt;
  return json[at].is_boolean() ? static_cast<double>(json[at].get<bool>()) : json[at].get<double>();
}

// ------------------------------------------------------------------------------------------------ poses

PoseDriver::PoseDriver(const ServedSession& session, double rate_hz, double speed_m_s,
                       const std::string& source, std::uint16_t port)
    : thread_([this, &session, rate_hz, speed_m_s, source, port] {
        run(session, rate_hz, speed_m_s, source, port);
      }) {}

PoseDriver::~PoseDriver() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
}

bool PoseDriver::settle() {
  settling_ = true;
  stop_ = true;
  if (thread_.joinable()) thread_.join();
  return settled_;
}

void PoseDriver::run(const ServedSession& session, double rate_hz, double speed_m_s,
                     const std::string& source, std::uint16_t port) {
  core::Vec3 low = session.body().loaded.mesh.positions.front(), high = low;
  for (const core::Vec3& p : session.body().loaded.mesh.positions) {
    extend(p, low, high);
  }
  tests::ToAndFro motion(low, high, speed_m_s, rate_hz);
  constexpr std::int64_t kChunk_ns = 4'000'000;  // 250 messages a second
  std::unique_ptr<client::Client> client;
  std::vector<protocol::PoseSample> chunk;
  protocol::PoseSample latest;
  std::uint64_t sequence = 0;
  std::int64_t last_ns = 0;
  client::Callbacks callbacks;
  callbacks.on_report = [this](const protocol::PoseReport& report) {
    if (report.last_source_ns > 0) acknowledged_ns_ = report.last_source_ns;
    rejected_ = report.not_finite + report.not_unit + report.time_not_rising;
    accepted_ = report.accepted;
    recorded_ = report.recorded;
    recorded_ns_ = report.recorded_source_ns;
    recording_ = report.recording;
  };
  callbacks.on_error = [this](const protocol::Error& error) {
    warnings_ += error.code == protocol::ErrorCode::NotRecorded;
  };
  const auto connected = [&] { return client && client->status() != client::Status::kClosed; };
  // The server may have been killed and started again just now: to settle, it is found again first.
  int attempts = 0;
  while (!stop_ || (settling_ && !connected() && ++attempts < 500)) {
    try {
      if (!connected()) {
        client::Options options;
        options.role = protocol::Role::Operator;
        options.view = protocol::View::None;
        options.source_name = source;
        options.take_over = true;
        client = client::Client::connect("127.0.0.1", port ? port : session.tcp_port(), options, callbacks);
        last_ns = monotonic_ns();
        sequence = 0;
      }
    } catch (const std::exception&) {  // it is down just now
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      continue;
    }
    std::this_thread::sleep_for(std::chrono::nanoseconds(kChunk_ns));
    // What a device at this rate has measured since; its clock is ours.
    const std::int64_t now = monotonic_ns(), period = static_cast<std::int64_t>(1e9 / rate_hz);
    chunk.clear();
    while (last_ns + period <= now && chunk.size() < 4096) {
      last_ns += period;
      const core::Pose pose = motion.next();
      const core::Vec3& p = pose.position;
      chunk.push_back({last_ns, {p.x, p.y, p.z}, {1, 0, 0, 0}, pose.buttons, 0});
    }
    if (chunk.empty()) continue;
    latest = chunk.back();
    if (const std::uint64_t n = client->send_poses(chunk)) {
      sequence = n;
      sent_ += chunk.size();
    }
  }
  if (!connected() || sent_ == 0) return;
  latest.source_ns = last_ns + 1;
  latest.buttons = 0;
  const std::uint64_t last = client->send_poses(std::span(&latest, 1));
  sent_ += last > 0;
  settled_ = client->wait_for_report(std::max(sequence, last), 300);
}

// ------------------------------------------------------------------------------------------------ second opinion

CaptureFollower::CaptureFollower(const ServedSession& session)
    : served_(session),
      session_(std::make_unique<core::CutSession>(session.body().loaded.mesh, session.config().cut)) {}

std::string CaptureFollower::follow() {
  seen_.clear();
  std::ifstream in(served_.capture(), std::ios::binary);
  protocol::CaptureReader reader(in);
  if (!reader.header_ok())
    return good_bytes_ == 0 ? "" : "the capture has lost its header: " + reader.error();
  if (good_bytes_ > 0) reader.skip_to(good_bytes_, records_);
  protocol::CaptureRecord record;
  protocol::CaptureReader::Status status;
  std::string problem;
  while ((status = reader.next(record)) == protocol::CaptureReader::Status::Record && problem.empty())
    (*this)(record, problem);
  good_bytes_ = reader.good_bytes();
  records_ = reader.records();
  if (problem.empty() && status == protocol::CaptureReader::Status::Corrupt) problem = reader.error();
  return problem;
}

void CaptureFollower::operator()(const protocol::CaptureRecord& record, std::string& problem) {
  if (const auto* pose = std::get_if<protocol::PoseRecord>(&record)) {
    const auto& p = pose->pose.position;
    const auto& q = pose->pose.orientation;
    session_->push(pose->source,
                   {pose->pose.source_ns, {p.x, p.y, p.z}, {q.w, q.x, q.y, q.z}, pose->pose.buttons});
    ++poses_;
    seen_.insert(pose->pose.source_ns);
    last_source_ns_ = std::max(last_source_ns_, pose->pose.source_ns);
  } else if (const auto* stroke = std::get_if<protocol::StrokeRecord>(&record)) {
    if (stroke->action == protocol::StrokeAction::HandOver)
      session_->set_blade(stroke->source, app::blade_of(served_.config(), stroke->source));
    if (stroke->action == protocol::StrokeAction::End) session_->end_stroke(stroke->source);
  } else if (const auto* opened = std::get_if<protocol::BladeRecord>(&record)) {
    session_->set_blade(opened->source, replay::to_core(opened->blade));
  } else if (const auto* positions = std::get_if<protocol::PositionsRecord>(&record)) {
    session_->deform(replay::positions_of(*positions));
    ++deformations_;
  } else if (const auto* mark = std::get_if<protocol::BatchMark>(&record)) {
    const auto computed = hashes_.find(mark->revision);
    if (computed == hashes_.end()) {
      problem = "a mark of revision " + std::to_string(mark->revision) + ", where the poses lead to " +
                std::to_string(session_->revision());
      return;
    }
    if (computed->second != mark->state_hash)
      problem = "revision " + std::to_string(mark->revision) + " has another hash";
    hashes_.erase(computed);
    ++marks_;
  } else if (std::holds_alternative<protocol::ResetRecord>(record)) {
    session_ = std::make_unique<core::CutSession>(served_.body().loaded.mesh, served_.config().cut);
    hashes_.clear();
  } else if (std::holds_alternative<protocol::UndoRecord>(record)) {
    problem = "an undo, which this follower does not know";
  } else if (std::holds_alternative<protocol::GapRecord>(record)) {
    ++gaps_;
  }
  core::WorkBudget budget = core::WorkBudget::unlimited();
  core::Delta delta;
  while (session_->advance(budget, delta) == core::CutSession::Progress::kCommitted)
    hashes_[delta.revision] = delta.state_hash;
}

}  // namespace incise::e2e
