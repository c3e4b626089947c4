#pragma once

// What the rest of the server tells the stream about itself.

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/messages.hpp"
#include "server/stream/replay_library.hpp"

namespace incise::stream {

class FeedListener;

// What the HTTP port answers to a GET of a path, "/surface/0.png", for holders of a token of any role (where the server has tokens).
struct Document {
  std::string type;
  std::shared_ptr<const std::string> body;
};
using Documents = std::map<std::string, Document, std::less<>>;

// What Welcome says and the stream does not know itself.
struct ServerFacts {
  protocol::MeshFacts mesh;
  protocol::Vec3 blade_heel, blade_tip;  // for peers that hold no blade
  std::int32_t engage_button = -1;       // -1: always engaged
  double max_speed_m_s = 0;
  double frame_rate_hz = 0;
  std::string policy;
  std::optional<protocol::SurfaceFacts> surface;
};

// Kinds of audit lines. A log limits each apart, so that many of one kind do not hide another.
enum class Audit { kRefused, kBlade, kReset };
inline constexpr std::size_t kAudits = 3;

// Whether poses are recorded; `trouble` says why not.
struct RecordingNow {
  protocol::Recording state = protocol::Recording::Off;
  std::string trouble;
};

// What the HTTP port and some messages show. Called on the stream thread; must not block. Without a function its path
// answers 404 and its message is not sent.
struct Providers {
  std::function<std::string()> stats_json;    // GET /stats
  std::function<std::string()> metrics_text;  // GET /metrics; what the stream itself counts is appended
  // Once a second to every peer; sessions, revision, live_tets, pieces and recording are filled in here.
  std::function<protocol::Stats()> statistics;
  // Where the blades are now, for peers that asked; blades that never moved are left out.
  std::function<std::vector<protocol::BladePose>()> blades;
  // For replays and GET /captures; must outlive the server. Null: no captures.
  ReplayLibrary* library = nullptr;
  std::function<std::string()> trouble;  // GET /healthz: why the server does not work; "": it does
  // One line for the log: who was refused, reset the mesh, or took or handed over a blade. `address` is what to limit
  // lines by, since peers can cause any number of them.
  std::function<void(Audit, const std::string& address, const std::string& line)> audit;
  // Asked at every tick. Absent: nothing is recorded.
  std::function<RecordingNow()> recording;
  // The newest load of each blade that ever had one, for simulators that asked; asked every millisecond while one does. The arrays
  // live until the next call.
  std::function<std::span<const protocol::BladeLoad>()> loads = {};
  // Passes a simulator's own model of a blade's tissue on to the loop; "", or why it cannot be used.
  std::function<std::string(const protocol::BladeModel&)> use_model = {};
  Documents documents = {};
  // Must outlive the server; may be null.
  FeedListener* listener = nullptr;
  // GET /sessions: the sessions that others can be sent to, a JSON list.
  std::function<std::string()> sessions_json = {};
};

}  // namespace incise::stream
