#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <stdexcept>
#include <thread>

#include "client/cli/blade_table.hpp"
#include "client/cli/commands.hpp"
#include "client/cli/output_file.hpp"
#include "client/cli/restart_notice.hpp"

namespace incise::client {
namespace {

using protocol::View;
using std::chrono::steady_clock;

// Nearest-rank percentile of at least one value. Sorts.
double percentile(std::vector<double>& values, double p) {
  std::sort(values.begin(), values.end());
  const auto rank = static_cast<std::size_t>(std::ceil(p / 100 * static_cast<double>(values.size())));
  return values[std::max<std::size_t>(rank, 1) - 1];
}

double area_of(const protocol::Vec3& a, const protocol::Vec3& b, const protocol::Vec3& c) {
  const double ux = b.x - a.x, uy = b.y - a.y, uz = b.z - a.z, wx = c.x - a.x, wy = c.y - a.y, wz = c.z - a.z;
  return std::hypot(uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx) / 2;
}

// Of one side: both are there.
double cut_area_of(const protocol::Replica& mesh) {
  double area = 0;
  mesh.for_each_boundary_face([&](std::uint32_t t, int face) {
    if (!(mesh.cut_mask(t) >> face & 1)) return;
    const auto v = mesh.face_vertices(t, face);
    area += area_of(mesh.position(v[0]), mesh.position(v[1]), mesh.position(v[2]));
  });
  return area / 2;
}

double cut_area_of(const protocol::SurfaceReplica& surface) {
  double area = 0;
  for (const auto& [id, triangle] : surface.triangles()) {
    if (!(triangle.flags & 1)) continue;
    protocol::Vec3 corner[3];
    for (std::size_t k = 0; k < 3; ++k) {
      const auto& p = surface.vertices().find(triangle.vertices[k])->position;
      corner[k] = {p[0], p[1], p[2]};
    }
    area += area_of(corner[0], corner[1], corner[2]);
  }
  return area / 2;
}

// A server sends statistics once a second and answers pings: less often heard, and it does not run.
constexpr double kUnheard_s = 2.5;
// A rate over less is that of a single snapshot or delta.
constexpr double kShortestRate_s = 0.5;

// Two percentiles of what was measured; nothing of nothing.
std::string milliseconds(std::vector<double>& values) {
  if (values.empty()) return "-";
  char text[64];
  std::snprintf(text, sizeof text, "%.2f/%.2f ms", percentile(values, 50), percentile(values, 99));
  return text;
}

// What came since the last line. Filled on the client's thread, taken on the printer's.
struct Window {
  std::vector<double> pose_to_cut_ms, cut_to_here_ms, pose_to_here_ms;
};

class Watcher {
 public:
  explicit Watcher(const WatchCommand& command) : command_(command) {}

  int run() {
    if (!command_.save.empty()) require_can_be_file("--save", command_.save);
    interrupted();
    Address where;
    Options options = command_.server.options(where);
    options.view = command_.view == "surface" ? View::Surface : View::Volume;
    options.max_rate_hz = static_cast<float>(command_.max_rate_hz);
    options.reconnect = true;
    client_ = connect(where, options, callbacks());
    connected_ = client_.get();
    const auto began = steady_clock::now();
    auto next = began + std::chrono::seconds(1);
    bool reached = false;
    while (!interrupted() && !reached) {
      if (client_->status() == Status::kClosed)
        throw std::runtime_error(command_.server.address + ": " + client_->last_error());
      reached = command_.until_revision && client_->wait_for_revision(*command_.until_revision, 0.02);
      if (!command_.until_revision) std::this_thread::sleep_for(std::chrono::milliseconds(20));
      const auto now = steady_clock::now();
      listen(now);
      if (now >= next) {
        print_line();
        next += std::chrono::seconds(1);
      }
      if (given_up(now)) break;
      if (command_.for_s > 0 && now - began >= std::chrono::duration<double>(command_.for_s)) break;
    }
    count_area_ = true;  // the snapshot may be here already, and its callback not yet
    print_line();
    save();
    client_->close();
    if (gone_since_ && !interrupted()) {
      const std::chrono::duration<double> gone = steady_clock::now() - *gone_since_;
      std::fprintf(stderr, "incise: %s did not come back within %.1f s: %s\n",
                   command_.server.address.c_str(), gone.count(), client_->last_error().c_str());
      return 1;
    }
    if (command_.until_revision && !reached && !interrupted()) {
      std::fprintf(stderr, "incise: revision %" PRIu64 " was not reached\n", *command_.until_revision);
      return 1;
    }
    return 0;
  }

 private:
  // Whether the server has been gone for too long. Says so when it goes and when it comes back.
  bool given_up(steady_clock::time_point now) {
    if (client_->status() != Status::kReconnecting) {
      // Counted, as it may have come back between two looks.
      const std::uint64_t reconnects = client_->counters().reconnects;
      if (std::exchange(reconnects_, reconnects) != reconnects) say("connected again");
      gone_since_.reset();
      return false;
    }
    std::string trouble = client_->last_error();
    if (!gone_since_) {
      gone_since_ = now;
      const std::string until = command_.give_up_after_s > 0
                                    ? " for " + number(command_.give_up_after_s) + " s"
                                    : " until it is interrupted";
      say(command_.server.address + " is gone; trying to connect again" + until);
    } else if (!trouble.empty() && trouble != trouble_) {
      // A server that is back may refuse us: for another token, say.
      say("not connected yet: " + trouble);
    }
    trouble_ = std::move(trouble);
    return command_.give_up_after_s > 0 &&
           now - *gone_since_ >= std::chrono::duration<double>(command_.give_up_after_s);
  }
  static std::string number(double value) {
    char text[32];
    std::snprintf(text, sizeof text, "%g", value);
    return text;
  }
  static std::string fixed(double value, int decimals) {
    char text[64];
    std::snprintf(text, sizeof text, "%.*f", decimals, value);
    return text;
  }
  // On stderr. What is drawn next comes below it.
  void say(const std::string& line) {
    std::fprintf(stderr, "incise: %s\n", line.c_str());
    drawn_lines_ = 0;
  }

  // Notes when the server was last heard, and when its loop last made a frame.
  void listen(steady_clock::time_point now) {
    if (const std::uint64_t messages = client_->counters().messages_in; messages != messages_) {
      messages_ = messages;
      heard_ = now;
    }
    const std::scoped_lock lock(mutex_);
    const std::uint64_t frames = stats_ ? stats_->frames : 0;
    if (frames != frames_ || frames == 0) frame_ = now;
    frames_ = frames;
  }
  double unheard_s() const { return seconds_since(heard_); }
  // How long the loop has stood, by what the server says of it.
  double stalled_s() const { return unheard_s() > kUnheard_s ? 0 : seconds_since(frame_); }
  static double seconds_since(steady_clock::time_point then) {
    return std::chrono::duration<double>(steady_clock::now() - then).count();
  }

  Callbacks callbacks() {
    Callbacks c;
    c.on_delta = [this](const protocol::Replica&, const protocol::Delta& d, const Arrival& a) {
      note(d.steps, a);
    };
    c.on_surface_delta = [this](const protocol::SurfaceReplica&, const protocol::SurfaceDelta& d,
                                const Arrival& a) {
      live_tets_ = d.live_tets;
      note(d.steps, a);
    };
    c.on_welcome = [this](const protocol::Welcome& welcome) {
      if (restarts_(welcome) && command_.json) print_event(welcome);
      drawn_lines_ = 0;
      if (welcome.revision == 0) live_tets_ = welcome.mesh.tets;
    };
    c.on_snapshot = [this](const protocol::SnapshotEnd&, protocol::SnapshotCause) { count_area_ = true; };
    c.on_stats = [this](const protocol::Stats& stats) {
      live_tets_ = stats.live_tets;
      const std::scoped_lock lock(mutex_);
      stats_ = stats;
    };
    c.on_error = [this](const protocol::Error& e) { say("server: " + e.text); };
    c.on_resync = [this](const std::string& why) { say("resync: " + why); };
    c.on_disconnect = [this](const std::string& why) { say(why); };
    return c;
  }

  // The callbacks come before connect() has returned.
  std::int64_t clock_offset_ns() const {
    const Client* client = connected_;
    return client ? client->clock_offset_ns() : 0;
  }

  void note(const std::vector<protocol::Step>& steps, const Arrival& arrival) {
    const double here_ns = static_cast<double>(arrival.received_ns + clock_offset_ns());
    const std::scoped_lock lock(mutex_);
    for (const protocol::Step& step : steps) {
      cut_area_ += step.cut_area_m2;
      // The estimate of the server's clock is wrong by up to half a round trip, more than the way here may take: nothing comes before
      // it was sent.
      const double pose_to_cut_ms = 1e-6 * static_cast<double>(step.cut_ns - step.arrival_ns);
      const double cut_to_here_ms = std::max(0.0, 1e-6 * (here_ns - static_cast<double>(step.cut_ns)));
      window_.pose_to_cut_ms.push_back(pose_to_cut_ms);
      window_.cut_to_here_ms.push_back(cut_to_here_ms);
      window_.pose_to_here_ms.push_back(pose_to_cut_ms + cut_to_here_ms);
    }
  }

  void measure(std::uint32_t& tets, std::size_t& pieces) {
    if (command_.view == "surface") {
      std::set<std::uint32_t> ids;
      client_->read_surface([&](const protocol::SurfaceReplica& s) {
        for (const auto& [id, triangle] : s.triangles()) ids.insert(triangle.piece);
        count_area(s);
      });
      tets = live_tets_;
      pieces = ids.size();
      return;
    }
    client_->read([&](const protocol::Replica& mesh) {
      tets = mesh.live_tets();
      std::set<std::uint32_t> ids;
      std::uint32_t last = protocol::kNoId;
      mesh.for_each_tet([&](std::uint32_t t) {
        if (mesh.piece(t) != last) ids.insert(last = mesh.piece(t));
      });
      pieces = ids.size();
      count_area(mesh);
    });
  }

  // What was cut before the snapshot.
  template <class Held>
  void count_area(const Held& held) {
    if (!count_area_.exchange(false)) return;
    const std::scoped_lock lock(mutex_);
    cut_area_ = cut_area_of(held);
  }

  // What one line tells.
  struct Figures {
    std::uint64_t revision = 0;
    std::optional<double> steps_s, deltas_s, bytes_s;  // since the line before, where that is long enough
    Window window;
    std::uint32_t tets = 0;
    std::size_t pieces = 0;
    double cut_area_m2 = 0;
    Counters counters;
    std::optional<protocol::Stats> stats;
  };

  Figures figures() {
    Figures f;
    measure(f.tets, f.pieces);
    f.counters = client_->counters();
    const auto time = steady_clock::now();
    const double seconds = std::chrono::duration<double>(time - printed_).count();
    printed_ = time;
    const auto rate = [&](std::uint64_t a, std::uint64_t b) {
      return seconds < kShortestRate_s ? std::nullopt : std::optional(static_cast<double>(a - b) / seconds);
    };
    f.steps_s = rate(f.counters.steps, before_.steps);
    f.deltas_s = rate(f.counters.deltas, before_.deltas);
    f.bytes_s = rate(f.counters.bytes_in, before_.bytes_in);
    before_ = f.counters;
    {
      const std::scoped_lock lock(mutex_);
      f.window = std::exchange(window_, {});
      f.cut_area_m2 = cut_area_;
      f.stats = stats_;
    }
    f.revision = client_->revision();
    return f;
  }

  void print_line() {
    Figures f = figures();
    if (command_.json) {
      print_json(f);
    } else {
      print_text(f);
    }
    std::fflush(stdout);
  }

  // A line of its own: who has reset the body or undone something, and the revision that it is at since.
  static void print_event(const protocol::Welcome& welcome) {
    std::printf("%s\n", restart_json(*welcome.restart, welcome.revision).c_str());
  }
  // Names are what clients have sent. One call: both threads print.
  static void print(const nlohmann::ordered_json& line) {
    std::printf("%s\n", line.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace).c_str());
  }

  static nlohmann::ordered_json or_null(const std::optional<double>& value) {
    return value ? nlohmann::ordered_json(*value) : nlohmann::ordered_json(nullptr);
  }

  void print_json(Figures& f) const {
    const auto percentiles = [](std::vector<double>& values) {
      const auto of = [&](double p) {
        return or_null(values.empty() ? std::nullopt : std::optional(percentile(values, p)));
      };
      return nlohmann::ordered_json{{"p50", of(50)}, {"p99", of(99)}};
    };
    nlohmann::ordered_json line{{"revision", f.revision},
                                {"connected", client_->status() == Status::kConnected},
                                {"unheard_s", unheard_s()},
                                {"stalled_s", stalled_s()},
                                {"revisions_per_s", or_null(f.steps_s)},
                                {"deltas_per_s", or_null(f.deltas_s)},
                                {"bytes_per_s", or_null(f.bytes_s)},
                                {"pose_to_cut_ms", percentiles(f.window.pose_to_cut_ms)},
                                {"cut_to_here_ms", percentiles(f.window.cut_to_here_ms)},
                                {"pose_to_here_ms", percentiles(f.window.pose_to_here_ms)},
                                {"tets", nullptr},
                                {"pieces", f.pieces},
                                {"cut_area_m2", f.cut_area_m2},
                                {"snapshots", f.counters.snapshots},
                                {"resyncs", f.counters.resyncs},
                                {"reconnects", f.counters.reconnects}};
    if (f.tets > 0) line["tets"] = f.tets;
    if (f.stats) {
      line["server"] = {{"sessions", f.stats->sessions},
                        {"backlog_segments", f.stats->backlog_segments},
                        {"frames", f.stats->frames},
                        {"late_frames", f.stats->late_frames},
                        {"poses_accepted", f.stats->poses_accepted},
                        {"poses_rejected", f.stats->poses_rejected},
                        {"frame_work_p99_us", f.stats->frame_work_p99_us},
                        {"pose_to_delta_p99_us", f.stats->pose_to_delta_p99_us}};
      nlohmann::ordered_json blades = nlohmann::ordered_json::array();
      for (const protocol::BladeStats& blade : f.stats->blades) {
        blades.push_back({{"source", blade.source},
                          {"name", blade.name},
                          {"poses", blade.poses},
                          {"rejected", blade.rejected},
                          {"strokes", blade.strokes},
                          {"cut_faces", blade.cut_faces},
                          {"in_stroke", blade.in_stroke}});
      }
      line["server"]["blades"] = std::move(blades);
    }
    print(line);
  }

  // On a terminal in place of what was printed last.
  void print_text(Figures& f) {
    const std::string text = text_of(f);
    if (const int drawn = drawn_lines_; terminal_ && drawn > 0) std::printf("\x1b[%dA\r\x1b[J", drawn);
    std::printf("%s", text.c_str());
    drawn_lines_ = static_cast<int>(std::count(text.begin(), text.end(), '\n'));
  }

  // At most 80 columns.
  std::string text_of(Figures& f) const {
    std::string text = "revision " + std::to_string(f.revision) + "  ";
    if (client_->status() != Status::kConnected) return text + "connecting again\n";
    if (unheard_s() > kUnheard_s)
      return text + "no word from the server for " + fixed(unheard_s(), 0) + " s\n";
    if (stalled_s() > kUnheard_s)
      return text + "the server's loop has stood for " + fixed(stalled_s(), 0) + " s\n";
    if (f.steps_s) text += fixed(*f.steps_s, 0) + "/s  ";
    text += (f.tets > 0 ? std::to_string(f.tets) : "-") + " tets  " + std::to_string(f.pieces) +
            (f.pieces == 1 ? " piece  " : " pieces  ") + "cut " + fixed(1e4 * f.cut_area_m2, 2) + " cm2";
    if (f.bytes_s) text += "  " + fixed(1e-3 * *f.bytes_s, 1) + " kB/s";
    text += "\npose to cut " + milliseconds(f.window.pose_to_cut_ms) + "  cut to here " +
            milliseconds(f.window.cut_to_here_ms) + " (p50/p99)\n";
    return f.stats ? text + blade_table(f.stats->blades) : text;
  }

  void save() const {
    if (command_.save.empty()) return;
    const std::vector<std::byte> bytes =
        command_.view == "surface"
            ? client_->read_surface([](const protocol::SurfaceReplica& s) { return s.canonical_bytes(); })
            : client_->read([](const protocol::Replica& mesh) { return mesh.canonical_bytes(); });
    std::ofstream out(command_.save, std::ios::binary);
    out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    out.close();
    if (!out) throw std::runtime_error(command_.save.string() + ": cannot be written");
  }

  const WatchCommand& command_;
  const bool terminal_ = ::isatty(STDOUT_FILENO) != 0;
  std::atomic<int> drawn_lines_{0};  // that end the output; 0 after anything else was printed
  std::mutex mutex_;
  Window window_;
  double cut_area_ = 0;
  std::optional<protocol::Stats> stats_;
  RestartNotice restarts_;  // the client's thread
  std::atomic<bool> count_area_{false};
  std::atomic<std::uint32_t> live_tets_{0};
  std::atomic<const Client*> connected_{nullptr};
  std::optional<steady_clock::time_point> gone_since_;  // without a connection
  std::string trouble_;                                 // why, as far as it has been said
  steady_clock::time_point heard_ = steady_clock::now(), frame_ = heard_;
  std::uint64_t messages_ = 0, frames_ = 0, reconnects_ = 0;
  Counters before_;
  steady_clock::time_point printed_ = steady_clock::now();
  std::unique_ptr<Client> client_;  // last: its thread calls into all above
};

}  // namespace

int run_watch(const WatchCommand& command) {
  return Watcher(command).run();
}

}  // namespace incise::client
