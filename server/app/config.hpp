#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "server/core/cut/cut_config.hpp"
#include "server/haptics/force_config.hpp"
#include "server/input/haply/haply_input.hpp"
#include "server/input/hid/hid_input.hpp"
#include "server/input/openigtlink/openigtlink_input.hpp"

namespace incise::app {

// A configuration that cannot be used. Its text is one line: file, key, what was found, what is accepted.
struct ConfigError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// How a region of the body looks: what differs from its tissue.
struct RegionLook {
  struct Side {
    std::optional<std::array<double, 3>> colour;  // sRGB, 0 to 1
    std::optional<double> roughness;
    std::string texture;  // path of an image; "": none
    bool operator==(const Side&) const = default;
  };
  std::int32_t region = 0;
  std::string tissue;  // one of look.hpp's; "": as the region's place among the others says
  Side surface, inside;
  std::optional<double> vessels, fat_rim;
};

// All settings of `incised`. A table (app/config/*_keys.cpp) gives for each key its place in the JSON file, what it accepts
// and what it means: reading, --print-config and the error texts follow from it. The defaults are those here.
struct Config {
  struct Mesh {
    std::string path;     // as given; resolve() finds it
    std::string phantom;  // instead: "liver", "cylinder" or "slab"
    double scale_to_metres = 1;
    std::int64_t target_tets = 60'000;
    std::string tetgen_switches = "pYq1.4";
    double fill_time_limit_s = 300;
    std::int64_t fill_memory_limit_mb = 8192;
    std::string cache_directory;
    std::vector<std::string> fields;
    std::string image;                 // a volume image, shown inside the body; "": none
    std::vector<double> image_window;  // two numbers: black and white; none: from the image
    std::string image_space = "LPS";   // of the body's coordinates
    double image_scale_to_metres = 1e-3;
    core::Vec3 image_origin;
  } mesh;

  core::CutConfig cut;  // with the blade

  struct Loop {
    double rate_hz = 1000;
    double budget_fraction = 0.6;
    std::int64_t realtime_priority = 40;  // SCHED_FIFO; 0: do not ask
    std::int64_t cpu = -1;                // to run on; -1: any
    bool lock_memory = true;
  } loop;

  struct Haptics {
    bool forces = true;
    double contact_valid_ms = 50;
    haptics::ForceConfig force;  // with the materials
  } haptics;

  struct Listen {
    std::string address = "127.0.0.1";
    std::int64_t tcp_port = 7450;
    std::int64_t http_port = 7480;
    std::string viewer_directory;
    std::vector<std::string> allowed_origins;
    std::string token_file;
    std::string certificate_file, private_key_file;
    bool insecure = false;
    std::int64_t max_sessions = 300;
    std::int64_t max_handshakes = 64;
    double handshake_timeout_s = 5;
    double idle_timeout_s = 30;
    double write_timeout_s = 10;
    double stop_grace_s = 2;
    std::int64_t max_messages_per_s = 500;
  } listen;

  struct Stream {
    std::int64_t ring_bytes = 64 << 20;
    std::int64_t outbox_bytes = 4 << 20;
    std::int64_t max_slow_snapshots = 3;
    double max_report_rate_hz = 20;
  } stream;

  struct Capture {
    std::string path;  // empty: none is written
    std::string sync = "group";
    double sync_interval_ms = 100;
    std::string library;  // a directory; empty: none
    double checkpoint_replay_s = 1;
    double keep_free_percent = 0;
  } capture;

  struct Devices {
    bool enabled = true;
    std::string profiles;  // a folder; "": the shipped ones alone
    std::vector<input::DeviceOverride> overrides;
  } devices;

  input::OpenIgtLinkOptions openigtlink;
  input::HaplyOptions haply;

  struct Cluster {
    std::string nats;  // empty: this server is on its own
    std::string name;
    std::string credentials_file, ca_file, certificate_file, private_key_file;
    std::string advertise, picture;
    std::string storage = "memory";
    std::int64_t replicas = 1;
    std::int64_t stream_megabytes = 128;
    double keep_minutes = 60;
    std::int64_t join_megabytes = 16;
    std::int64_t queue_megabytes = 64;
    bool failover = false;
    double lease_s = 15;
  } cluster;

  struct Log {
    std::string level = "info";
    std::string format = "text";
  } log;

  struct Source {
    std::string name;
    core::Blade blade;
  };
  std::vector<Source> sources;

  std::vector<RegionLook> looks;  // of entries of "materials", whose other part is in haptics

  // Of incise-relay, which of all these has only this, listen, stream, log and of cluster how to reach NATS.
  struct Relay {
    std::string upstream;
    std::int64_t upstream_http_port = 7480;
    std::string token_file, ca_file;
    struct Session {
      std::string name, upstream;
      std::int64_t tcp_port = 0, http_port = 0, upstream_http_port = 7480;
      // What follows "nats:" in `upstream`: the name of a session that is published there; "" if it is an address.
      std::string nats_session() const { return upstream.starts_with("nats:") ? upstream.substr(5) : ""; }
    };
    std::vector<Session> sessions;
    // Either of the two.
    std::vector<Session> all(const Listen& ports) const;
  } relay;

  // Where the file was read from; paths in it are relative to that. Empty: the working directory.
  std::filesystem::path directory;
  std::filesystem::path resolve(const std::string& path) const;
};

// Whose configuration it is: each has keys of its own.
enum class Program : std::uint8_t { kServer, kRelay };

// Reads a configuration file: JSON, with // and /* */ comments. Absent keys have their defaults; unknown keys are
// refused. Throws ConfigError.
Config load_config(const std::filesystem::path& file, Program program = Program::kServer);
// The same from a text; `name` is the file in messages.
Config parse_config(std::string_view text, const std::string& name, Program program = Program::kServer);

// What a server needs and parsing does not check: usable tokens, certificates and profiles, a mesh that exists, folders
// that can be read. Throws ConfigError, its text beginning with `file`.
void check_config(const Config& config, const std::string& file);
// The same for a relay.
void check_relay_config(const Config& config, const std::string& file);

// The profiles of devices.profiles, then the shipped ones; none if devices are not enabled. Throws ConfigError.
std::vector<input::DeviceProfile> device_profiles(const Config& config);
// The folder of the shipped ones.
std::filesystem::path shipped_profiles();

// The configuration as a file with all keys, each with a comment: what it means and accepts.
std::string commented(const Config& config, Program program = Program::kServer);
// As one line of JSON: what a capture carries.
std::string compact(const Config& config);

}  // namespace incise::app
