#include "server/app/config.hpp"

#include <unistd.h>

#include <algorithm>
#include <boost/asio/ip/address.hpp>
#include <boost/asio/ssl/context.hpp>
#include <cmath>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <numeric>
#include <set>
#include <sstream>

#include "server/app/token_file.hpp"
#include "server/input/hid/json_node.hpp"
#include "server/stream/tls.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;
using input::shown;
using input::text_of;

constexpr std::size_t kMaxConfigBytes = 1u << 20;

// ------------------------------------------------------------------------------------------------ the table

// One key: its place ("section.key"), what it takes, what it means, and how it is got and set.
struct Key {
  std::string name;
  std::string accepted;
  std::string meaning;
  std::function<Json(const Config&)> get;
  std::function<bool(Config&, const Json&)> set;  // false: not acceptable, and nothing is set

  std::string section() const { return name.substr(0, name.find('.')); }
  std::string leaf() const { return name.substr(name.find('.') + 1); }
};

template <class Field>
Key number(std::string name, Field field, double least, double most, std::string meaning) {
  return {std::move(name), "a number from " + text_of(least) + " to " + text_of(most), std::move(meaning),
          [field](const Config& c) { return Json(field(const_cast<Config&>(c))); },
          [=](Config& c, const Json& value) {
            if (!value.is_number()) return false;
            const double given = value.get<double>();
            if (!(given >= least && given <= most)) return false;
            field(c) = given;
            return true;
          }};
}

template <class Field>
Key integer(std::string name, Field field, std::int64_t least, std::int64_t most, std::string meaning) {
  return {
      std::move(name), "a whole number from " + std::to_string(least) + " to " + std::to_string(most),
      std::move(meaning), [field](const Config& c) { return Json(field(const_cast<Config&>(c))); },
      [=](Config& c, const Json& value) {
        if (!value.is_number_integer()) return false;
        if (value.is_number_unsigned() && value.get<std::uint64_t>() > static_cast<std::uint64_t>(INT64_MAX))
          return false;
        const auto given = value.get<std::int64_t>();
        if (given < least || given > most) return false;
        field(c) = static_cast<std::remove_reference_t<decltype(field(c))>>(given);
        return true;
      }};
}

template <class Field>
Key boolean(std::string name, Field field, std::string meaning) {
  return {std::move(name), "true or false", std::move(meaning),
          [field](const Config& c) { return Json(static_cast<bool>(field(const_cast<Config&>(c)))); },
          [field](Config& c, const Json& value) {
            if (!value.is_boolean()) return false;
            field(c) = value.get<bool>();
            return true;
          }};
}

template <class Field>
Key text(std::string name, Field field, std::string accepted, std::string meaning) {
  return {std::move(name), std::move(accepted), std::move(meaning),
          [field](const Config& c) { return Json(field(const_cast<Config&>(c))); },
          [field](Config& c, const Json& value) {
            if (!value.is_string()) return false;
            // A null byte would end the path or address early for the system, but not for us.
            const auto given = value.get<std::string>();
            if (given.size() > 4096 || given.find('\0') != std::string::npos) return false;
            field(c) = given;
            return true;
          }};
}

std::string quoted_list(const std::vector<std::string>& names) {
  std::string list;
  for (std::size_t i = 0; i < names.size(); ++i) {
    list += (i == 0 ? "\"" : i + 1 == names.size() ? " or \"" : ", \"") + names[i] + '"';
  }
  return list;
}

// One of some words; `get` and `set` convert between words and the field.
template <class Get, class Set>
Key choice(std::string name, const std::vector<std::string>& words, Get get, Set set, std::string meaning) {
  return {std::move(name), quoted_list(words), std::move(meaning),
          [=](const Config& c) { return Json(words[static_cast<std::size_t>(get(c))]); },
          [=](Config& c, const Json& value) {
            if (!value.is_string()) return false;
            for (std::size_t i = 0; i < words.size(); ++i) {
              if (words[i] != value.get<std::string>()) continue;
              set(c, i);
              return true;
            }
            return false;
          }};
}

template <class Field>
Key word(std::string name, std::vector<std::string> words, Field field, std::string meaning) {
  const auto get = [=](const Config& c) {
    const std::string& current = field(const_cast<Config&>(c));
    return static_cast<std::size_t>(std::find(words.begin(), words.end(), current) - words.begin());
  };
  const auto set = [=](Config& c, std::size_t i) { field(c) = words[i]; };
  return choice(std::move(name), words, get, set, std::move(meaning));
}

constexpr const char* kPoint = "[x, y, z], three numbers from -10000 to 10000";

Json point_json(const core::Vec3& p) {
  return Json::array({p.x, p.y, p.z});
}

bool read_point(const Json& value, core::Vec3& point) {
  if (!value.is_array() || value.size() != 3) return false;
  double xyz[3];
  for (std::size_t i = 0; i < 3; ++i) {
    if (!value[i].is_number()) return false;
    xyz[i] = value[i].get<double>();
    if (!(std::abs(xyz[i]) <= 1e4)) return false;
  }
  point = {xyz[0], xyz[1], xyz[2]};
  return true;
}

template <class Field>
Key point(std::string name, Field field, std::string meaning) {
  return {std::move(name), kPoint, std::move(meaning),
          [field](const Config& c) { return point_json(field(const_cast<Config&>(c))); },
          [field](Config& c, const Json& value) { return read_point(value, field(c)); }};
}

template <class Field>
Key texts(std::string name, Field field, std::string accepted, std::string meaning) {
  return {std::move(name), std::move(accepted), std::move(meaning),
          [field](const Config& c) { return Json(field(const_cast<Config&>(c))); },
          [field](Config& c, const Json& value) {
            if (!value.is_array() || value.size() > 256) return false;
            for (const Json& entry : value) {
              if (!entry.is_string()) return false;
            }
            field(c) = value.get<std::vector<std::string>>();
            return true;
          }};
}

bool read_quaternion(const Json& value, core::Quat& q);

Json quaternion_json(const core::Quat& q) {
  return Json::array({q.w, q.x, q.y, q.z});
}

template <class Field>
Key rotation(std::string name, Field field, std::string meaning) {
  return {std::move(name), "[w, x, y, z], a unit quaternion", std::move(meaning),
          [field](const Config& c) { return quaternion_json(field(const_cast<Config&>(c))); },
          [field](Config& c, const Json& value) { return read_quaternion(value, field(c)); }};
}

constexpr const char* kOverridesAccepted =
    "a list of at most 32 objects {\"device\": \"vvvv:pppp\" or \"vvvv:pppp:serial\" as incise devices shows "
    "it, "
    "\"use\": \"profile\", \"descriptor\" or \"ignore\", \"source\": a text of 1 to 48 characters, "
    "\"origin\": [x, y, "
    "z] in metres, \"rotation\": [w, x, y, z], a unit quaternion, \"scale\": a number from 0.001 to 1000}";

bool read_quaternion(const Json& value, core::Quat& q) {
  if (!value.is_array() || value.size() != 4) return false;
  double wxyz[4], norm2 = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    if (!value[i].is_number()) return false;
    wxyz[i] = value[i].get<double>();
    norm2 += wxyz[i] * wxyz[i];
  }
  if (!(std::abs(norm2 - 1) < 1e-3)) return false;
  const double n = std::abs(norm2 - 1) < 1e-14 ? 1 : std::sqrt(norm2);  // a unit one stays as it was printed
  q = {wxyz[0] / n, wxyz[1] / n, wxyz[2] / n, wxyz[3] / n};
  return true;
}

constexpr const char* kUses[] = {"profile", "descriptor", "ignore"};

bool read_override(const Json& value, input::DeviceOverride& over) {
  if (!value.is_object() || !value.contains("device")) return false;
  for (const auto& [key, given] : value.items()) {
    if (key == "device") {
      if (!given.is_string()) return false;
      over.device = given.get<std::string>();
      const auto hex = [&](std::size_t i) {
        return std::string_view("0123456789abcdef").find(over.device[i]) < 16;
      };
      bool good = over.device.size() >= 9 && over.device.size() <= 138 && over.device[4] == ':' &&
                  (over.device.size() == 9 || (over.device.size() > 10 && over.device[9] == ':'));
      for (std::size_t i = 0; good && i < 9; ++i) good = i == 4 || hex(i);
      if (!good) return false;
    } else if (key == "use") {
      const auto* const use = std::find(std::begin(kUses), std::end(kUses), given);
      if (use == std::end(kUses)) return false;
      over.use = static_cast<input::DeviceOverride::Use>(use - kUses);
    } else if (key == "source") {
      if (!given.is_string()) return false;
      over.source = given.get<std::string>();
      if (over.source.empty() || over.source.size() > 48) return false;
    } else if (key == "origin") {
      if (!read_point(given, over.placement.origin)) return false;
    } else if (key == "rotation") {
      if (!read_quaternion(given, over.placement.rotation)) return false;
    } else if (key == "scale") {
      over.placement.scale = given.is_number() ? given.get<double>() : 0;
      if (!(over.placement.scale >= 1e-3 && over.placement.scale <= 1e3)) return false;
    } else {
      return false;
    }
  }
  return true;
}

Json override_json(const input::DeviceOverride& over) {
  Json json{{"device", over.device}, {"use", kUses[static_cast<std::size_t>(over.use)]}};
  if (!over.source.empty()) json["source"] = over.source;
  json["origin"] = point_json(over.placement.origin);
  json["rotation"] = quaternion_json(over.placement.rotation);
  json["scale"] = over.placement.scale;
  return json;
}

Key overrides() {
  return {"devices.overrides", kOverridesAccepted,
          "What is to be different for some devices: where their workspace lies in the world (a point p of "
          "it is at "
          "origin + rotation (scale p); a tool that is steered by deflection starts at the origin), the name "
          "of their "
          "source, whether they are read by a profile, by their report descriptor alone, or not at all.",
          [](const Config& c) {
            Json list = Json::array();
            for (const auto& over : c.devices.overrides) list.push_back(override_json(over));
            return list;
          },
          [](Config& c, const Json& value) {
            if (!value.is_array() || value.size() > 32) return false;
            std::vector<input::DeviceOverride> made(value.size());
            for (std::size_t i = 0; i < value.size(); ++i) {
              if (!read_override(value[i], made[i])) return false;
            }
            c.devices.overrides = std::move(made);
            return true;
          }};
}

// NOLINTBEGIN(bugprone-macro-parentheses): a member's name
#define INCISE_FIELD(member) \
  [](Config & c) -> auto& {  \
    return c.member;         \
  }
// NOLINTEND(bugprone-macro-parentheses)

const std::vector<Key>& keys() {
  static const std::vector<Key> table{
      text("mesh.path", INCISE_FIELD(mesh.path), "a path, relative to this file",
           "The body: a tetrahedral mesh (TetGen .node/.ele, or their common name; .msh, .vtk, .vtu, .mesh, "
           ".veg) or a "
           "closed surface (.stl .ply .off .obj), which is filled with tetrahedra."),
      word("mesh.phantom", {"", "liver", "cylinder", "slab"}, INCISE_FIELD(mesh.phantom),
           "Instead of a file: a body of our own, made at the start with mesh.target_tets tetrahedra."),
      number("mesh.scale_to_metres", INCISE_FIELD(mesh.scale_to_metres), 1e-9, 1e9,
             "The file's coordinates times this are metres: 0.001 for a file in millimetres."),
      integer("mesh.target_tets", INCISE_FIELD(mesh.target_tets), 0, 20'000'000,
              "Tetrahedra wanted when a surface is filled (0: as few as the surface allows) or a phantom is "
              "made."),
      text("mesh.tetgen_switches", INCISE_FIELD(mesh.tetgen_switches), "TetGen's switches, a text",
           "How a surface is filled; TetGen's manual, section 4.2. The volume bound comes from "
           "mesh.target_tets."),
      number("mesh.fill_time_limit_s", INCISE_FIELD(mesh.fill_time_limit_s), 1, 86'400,
             "Filling that takes longer is given up."),
      integer("mesh.fill_memory_limit_mb", INCISE_FIELD(mesh.fill_memory_limit_mb), 64, 1 << 24,
              "Memory that filling may take."),
      text("mesh.cache_directory", INCISE_FIELD(mesh.cache_directory),
           "a path, relative to this file; or \"\"",
           "Where filled surfaces are kept for the next start; \"\": ~/.cache/incise."),

      point("blade.heel", INCISE_FIELD(cut.blade.heel),
            "One end of the cutting edge in the tool's frame, metres."),
      point("blade.tip", INCISE_FIELD(cut.blade.tip), "Its other end."),

      choice(
          "cut.policy", {"conforming", "croll"},
          [](const Config& c) { return static_cast<int>(c.cut.policy); },
          [](Config& c, std::size_t i) { c.cut.policy = static_cast<core::Policy>(i); },
          "How a swept surface becomes a cut: \"conforming\" follows it exactly; \"croll\" is the baseline "
          "of 2007."),
      choice(
          "cut.prefer", {"no-growth", "balanced", "exact"},
          [](const Config& c) { return static_cast<int>(c.cut.prefer); },
          [](Config& c, std::size_t i) { c.cut.prefer = static_cast<core::Preference>(i); },
          "What to prefer where accuracy and few new tetrahedra are at odds (policy conforming): "
          "\"no-growth\" never adds one, and leaves the cut ragged where no vertex can be moved; "
          "\"balanced\" splits an edge where it must; "
          "\"exact\" splits nearly all, so that parts thinner than an element stay as they are."),
      choice(
          "cut.engage", {"buttons", "always"}, [](const Config& c) { return c.cut.always_engaged ? 1 : 0; },
          [](Config& c, std::size_t i) { c.cut.always_engaged = i == 1; },
          "When the blade cuts: while one of cut.engage_buttons is held, or always."),
      integer(
          "cut.engage_buttons", INCISE_FIELD(cut.engage_buttons), 1, 0xffffffff,
          "The buttons that engage the blade, as a sum: 1 for button 0, 2 for button 1, 4 for button 2, ..."),
      number("cut.batch_h", INCISE_FIELD(cut.batch_h), 0.05, 100,
             "The blade's travel that is committed together, in mean edge lengths; "
             "at least 1 with the policy croll."),
      number("cut.chord_tolerance_h", INCISE_FIELD(cut.chord_tolerance_h), 1e-4, 1,
             "How far the cut surface may leave the poses that it stands for, in mean edge lengths. Where it "
             "moves less than a third of one, up to 0.08 counts as the device's noise."),
      number("cut.speed_limit_m_s", INCISE_FIELD(cut.speed_limit_m_s), 1e-3, 1e3,
             "A faster motion is a jump: it ends the stroke and begins another, and does not cut."),
      number("cut.gap_limit_s", INCISE_FIELD(cut.gap_limit_s), 1e-3, 3600,
             "So does a longer silence between two poses."),

      number("loop.rate_hz", INCISE_FIELD(loop.rate_hz), 250, 4000, "Frames a second."),
      number("loop.budget_fraction", INCISE_FIELD(loop.budget_fraction), 0.01, 0.95,
             "The part of a frame that input and cutting may use; what does not fit waits for the next."),
      integer("loop.realtime_priority", INCISE_FIELD(loop.realtime_priority), 0, 99,
              "Priority of the loop's thread under SCHED_FIFO, where the system grants it; 0: do not ask."),
      integer("loop.cpu", INCISE_FIELD(loop.cpu), -1, 1023,
              "The processor that the loop's thread keeps to; -1: any."),
      boolean("loop.lock_memory", INCISE_FIELD(loop.lock_memory),
              "Keep all memory from being swapped out, where the system grants it."),

      boolean("haptics.forces", INCISE_FIELD(haptics.forces),
              "Compute the force on each blade, in each frame, for devices and operators."),
      number("haptics.max_force_n", INCISE_FIELD(haptics.force.limits.most_n), 0.01, 100,
             "No force is larger; a device's own limit may be smaller."),
      number(
          "haptics.slew_n_s", INCISE_FIELD(haptics.force.limits.slew_n_s), 1, 1e5,
          "No force changes faster; at least a hundred times haptics.max_force_n, so that a fault ends it in "
          "10 ms."),
      number("haptics.frozen_s", INCISE_FIELD(haptics.force.limits.frozen_s), 0.02, 1e6,
             "Poses that repeat each other so long to the bit while a force acts: the device is stuck, the "
             "force "
             "ends."),
      number("haptics.stiffest_n_m", INCISE_FIELD(haptics.force.stiffest_n_m), 10, 20'000,
             "The stiffest that tissue may feel: more makes a device tremble."),
      number("haptics.damping_n_s_m", INCISE_FIELD(haptics.force.damping_n_s_m), 0, 50,
             "Damping of the contact with a surface, along its normal."),
      number("haptics.contact_valid_ms", INCISE_FIELD(haptics.contact_valid_ms), 1, 1000,
             "How long an operator on the network may go on with the last contact it was told of."),
      number("haptics.toughness_j_m2", INCISE_FIELD(haptics.force.materials.tissue.toughness_j_m2), 0, 1e5,
             "Of the tissue: work for each area of cut. Liver: 76 to 185, 164 in bovine."),
      number("haptics.puncture_n", INCISE_FIELD(haptics.force.materials.tissue.puncture_n), 0, 100,
             "What a point must press with before it gets in."),
      number("haptics.stiffness_n_m", INCISE_FIELD(haptics.force.materials.tissue.stiffness_n_m), 1, 1e5,
             "How fast the force grows under a point before the tissue tears."),
      number("haptics.stiffness_pa", INCISE_FIELD(haptics.force.materials.tissue.stiffness_pa), 0, 1e7,
             "How much faster for each metre of edge that presses."),
      number("haptics.friction_n_s_m2", INCISE_FIELD(haptics.force.materials.tissue.friction_n_s_m2), 0, 1e4,
             "Viscous friction on the blade's faces, for each metre of edge inside."),

      text("listen.address", INCISE_FIELD(listen.address), "an IP address",
           "Where clients connect. Beyond loopback it needs listen.token_file and a certificate, or "
           "listen.insecure."),
      integer("listen.tcp_port", INCISE_FIELD(listen.tcp_port), -1, 65535,
              "Port of the binary protocol; 0: any free one, -1: off."),
      integer("listen.http_port", INCISE_FIELD(listen.http_port), -1, 65535,
              "Port of WebSocket, the viewer page, /stats and /metrics; 0: any free one, -1: off."),
      text("listen.viewer_directory", INCISE_FIELD(listen.viewer_directory),
           "a path, relative to this file; or \"\"",
           "Static files that the HTTP port serves; \"\": the viewer that was built with the program."),
      texts("listen.allowed_origins", INCISE_FIELD(listen.allowed_origins), "a list of texts",
            "Origins of web pages that may connect beside the server's own; \"*\": any."),
      text("listen.token_file", INCISE_FIELD(listen.token_file), "a path, relative to this file; or \"\"",
           "JSON: [{\"token\": \"...\", \"roles\": [\"viewer\", \"operator\", \"simulator\", \"admin\", "
           "\"metrics\"]}, ...]. With one, nobody enters without a token, nor reads /stats, /metrics or "
           "/captures; \"metrics\" opens the first two alone."),
      text("listen.certificate_file", INCISE_FIELD(listen.certificate_file),
           "a path, relative to this file; or \"\"", "PEM; with it and the key both ports speak TLS."),
      text("listen.private_key_file", INCISE_FIELD(listen.private_key_file),
           "a path, relative to this file; or \"\"", "PEM."),
      boolean("listen.insecure", INCISE_FIELD(listen.insecure),
              "Listen beyond loopback without tokens and TLS: whoever reaches the port may cut, watch and "
              "reset."),
      integer("listen.max_sessions", INCISE_FIELD(listen.max_sessions), 1, 100'000, "Clients at once."),
      integer("listen.max_handshakes", INCISE_FIELD(listen.max_handshakes), 1, 10'000,
              "Connections at once that have not introduced themselves; one more, and the oldest is closed."),
      number("listen.handshake_timeout_s", INCISE_FIELD(listen.handshake_timeout_s), 0.1, 600,
             "For a client to introduce itself."),
      number("listen.idle_timeout_s", INCISE_FIELD(listen.idle_timeout_s), 1, 86'400,
             "A client that is silent longer is disconnected; it is pinged before."),
      number("listen.write_timeout_s", INCISE_FIELD(listen.write_timeout_s), 0.1, 600,
             "For one message to go out to a client."),
      number("listen.stop_grace_s", INCISE_FIELD(listen.stop_grace_s), 0, 60,
             "At the end, time for clients to receive what was published."),
      integer("listen.max_messages_per_s", INCISE_FIELD(listen.max_messages_per_s), 1, 1'000'000,
              "Messages a second from one client, beside poses."),

      integer("stream.ring_bytes", INCISE_FIELD(stream.ring_bytes), 1 << 16, std::int64_t{1} << 36,
              "Deltas kept for clients that return or fall behind."),
      integer("stream.outbox_bytes", INCISE_FIELD(stream.outbox_bytes), 1 << 16, std::int64_t{1} << 32,
              "What may wait for one client; beyond it, it gets coalesced deltas or a snapshot."),
      integer("stream.max_slow_snapshots", INCISE_FIELD(stream.max_slow_snapshots), 1, 1000,
              "A client that needs so many snapshots in a row without catching up is disconnected."),
      number("stream.max_report_rate_hz", INCISE_FIELD(stream.max_report_rate_hz), 1, 1000,
             "Pose reports to an operator, a second."),

      text("capture.path", INCISE_FIELD(capture.path), "a path, relative to this file; or \"\"",
           "Where the poses that the loop took and the marks of its batches are recorded; \"\": nowhere."),
      word("capture.sync", {"none", "group", "always"}, INCISE_FIELD(capture.sync),
           "When what was recorded must be on the disk: left to the system, every capture.sync_interval_ms, "
           "or at once."),
      number("capture.sync_interval_ms", INCISE_FIELD(capture.sync_interval_ms), 1, 60'000,
             "What a power failure may cost under \"group\"."),
      text(
          "capture.library", INCISE_FIELD(capture.library), "a path, relative to this file; or \"\"",
          "A directory of captures (*.capture) that whoever may watch can replay in the viewer; \"\": none."),
      number("capture.checkpoint_replay_s", INCISE_FIELD(capture.checkpoint_replay_s), 0, 3600,
             "Checkpoints beside the capture are so frequent that incised --resume replays about so many "
             "seconds "
             "of work; they cost a second copy of the mesh and of that work, at low priority. 0: none."),
      number("capture.keep_free_percent", INCISE_FIELD(capture.keep_free_percent), 0, 90,
             "Recording stops, as on a full disk, while less than this share of the capture's file system is "
             "free. 0: the capture may fill it."),

      boolean("devices.enabled", INCISE_FIELD(devices.enabled),
              "Read HID devices of this machine that a profile fits (incise devices lists them) as sources "
              "of poses."),
      text("devices.profiles", INCISE_FIELD(devices.profiles),
           "the path of a folder, relative to this file; or \"\"",
           "Device profiles of your own, *.json; they go before the shipped ones. DEVICES.md, \"Writing a "
           "device "
           "profile\"."),
      overrides(),

      integer("openigtlink.port", INCISE_FIELD(openigtlink.port), -1, 65535,
              "Where OpenIGTLink peers such as 3D Slicer connect, usually 18944; 0: any free one, -1: off."),
      text("openigtlink.address", INCISE_FIELD(openigtlink.address), "an IP address",
           "OpenIGTLink has neither passwords nor TLS: an address beyond loopback needs listen.insecure."),
      texts(
          "openigtlink.connect", INCISE_FIELD(openigtlink.connect), "a list of at most 8 texts \"host:port\"",
          "OpenIGTLink servers (trackers, PLUS, 3D Slicer) to connect to, again where a connection is lost."),
      word("openigtlink.ask_for", {"nothing", "TDATA", "QTDATA"}, INCISE_FIELD(openigtlink.ask_for),
           "What to ask those servers to stream (STT_TDATA, STT_QTDATA); many send without that."),
      texts("openigtlink.devices", INCISE_FIELD(openigtlink.devices), "a list of texts",
            "Device names (of tracking data: of its elements) that are blades; []: all. A blade of its own "
            "comes "
            "by the same name in sources."),
      word("openigtlink.engage", {"always", "string"}, INCISE_FIELD(openigtlink.engage),
           "When a device's blade cuts (cut.engage permitting): while its poses come, or while the last "
           "STRING "
           "from NAME or NAME_engage was \"1\", \"on\", \"true\" or \"engaged\"."),
      number("openigtlink.silence_s", INCISE_FIELD(openigtlink.silence_s), 0.01, 3600,
             "A device without a pose for so long ends its stroke and lets go of its blade."),
      point("openigtlink.origin", INCISE_FIELD(openigtlink.world.origin),
            "Where the origin of the peers' space lies in the world, metres; a point p of it is at origin + "
            "rotation (scale p)."),
      rotation("openigtlink.rotation", INCISE_FIELD(openigtlink.world.rotation),
               "How that space is turned: [0, 0, 0, 1] makes the RAS of 3D Slicer the LPS of DICOM."),
      number("openigtlink.scale", INCISE_FIELD(openigtlink.world.scale), 1e-9, 1e9,
             "Metres for a unit of that space: 0.001 for millimetres."),
      word("openigtlink.surface", {"asked", "always", "never"}, INCISE_FIELD(openigtlink.surface),
           "Who gets the surface as POLYDATA: who asks (GET_POLYDATA, STT_POLYDATA), everybody who connects, "
           "nobody."),
      number("openigtlink.surface_hz", INCISE_FIELD(openigtlink.surface_hz), 0.01, 50,
             "The whole surface is sent at most so often a second, and only where it has changed."),

      text("haply.url", INCISE_FIELD(haply.url), "\"ws://host:port\", or \"\"",
           "Haply's Inverse Service, usually ws://localhost:10001: an Inverse3 as a source of poses and a "
           "sink of "
           "forces; \"\": off."),
      choice(
          "haply.version", {"3.5", "3.1"}, [](const Config& c) { return static_cast<int>(c.haply.version); },
          [](Config& c, std::size_t i) { c.haply.version = static_cast<input::HaplyVersion>(i); },
          "Of the service: from 3.5 on it takes a force as \"vector\", before as \"values\"."),
      text("haply.device", INCISE_FIELD(haply.device), "a text",
           "The Inverse3's id, such as 049D; \"\": the first."),
      text("haply.grip", INCISE_FIELD(haply.grip), "a text",
           "The id of the grip that gives orientation and buttons; \"\": the first."),
      text("haply.source", INCISE_FIELD(haply.source), "a text", "The name of its source."),
      number("haply.rate_hz", INCISE_FIELD(haply.rate_hz), 50, 4000,
             "Commands, and so states, a second at most."),
      number("haply.max_force_n", INCISE_FIELD(haply.max_force_n), 0, 10,
             "The most that the device may be asked for; haptics.max_force_n holds too. 0: no forces."),
      point(
          "haply.origin", INCISE_FIELD(haply.placement.origin),
          "Where the origin of the device's space lies in the world, metres; a point p of it is at origin + "
          "rotation (scale p)."),
      rotation("haply.rotation", INCISE_FIELD(haply.placement.rotation), "How that space is turned."),
      number("haply.scale", INCISE_FIELD(haply.placement.scale), 1e-3, 1e3,
             "Metres in the world for a metre of it."),

      word("log.level", {"trace", "debug", "info", "warning", "error", "off"}, INCISE_FIELD(log.level),
           "What is worth a line."),
      word("log.format", {"text", "json"}, INCISE_FIELD(log.format),
           "Lines for people, or a JSON object each."),
  };
  return table;
}

#undef INCISE_FIELD

// Blades that differ from `blade`, by their sources' names.
constexpr const char* kSourcesAccepted =
    "a list of at most 8 objects {\"name\": a text of 1 to 64 characters, \"heel\": [x, y, z], \"tip\": [x, "
    "y, z]} with "
    "different names";
constexpr const char* kSourcesMeaning =
    "Blades of their own for sources of these names; any other source has the blade above.";

// Tissue that differs from the rest, by the mesh's region attribute.
struct MaterialKey {
  const char* name;
  double haptics::Material::*field;
};
constexpr MaterialKey kMaterialKeys[] = {{"toughness_j_m2", &haptics::Material::toughness_j_m2},
                                         {"puncture_n", &haptics::Material::puncture_n},
                                         {"stiffness_n_m", &haptics::Material::stiffness_n_m},
                                         {"stiffness_pa", &haptics::Material::stiffness_pa},
                                         {"friction_n_s_m2", &haptics::Material::friction_n_s_m2}};
constexpr std::size_t kMostMaterials = 64;
constexpr const char* kMaterialsAccepted =
    "a list of at most 64 objects {\"region\": a whole number, \"toughness_j_m2\", \"puncture_n\", "
    "\"stiffness_n_m\", \"stiffness_pa\", \"friction_n_s_m2\": numbers as in haptics} with different regions";
constexpr const char* kMaterialsMeaning =
    "What the regions of the mesh feel like, by its region attribute; what is absent is as in haptics.";

// ------------------------------------------------------------------------------------------------ reading

[[noreturn]] void refuse(const std::string& file, const std::string& key, const std::string& found,
                         const std::string& accepted) {
  throw ConfigError(file + ": " + key + ": found " + found + "; accepted is " + accepted);
}

std::string joined(const std::set<std::string>& names) {
  std::string list;
  for (const std::string& name : names) list += (list.empty() ? "" : ", ") + name;
  return list;
}

void read_sources(Config& config, const Json& value, const std::string& file) {
  if (!value.is_array() || value.size() > core::kMaxSources)
    refuse(file, "sources", shown(value), kSourcesAccepted);
  std::set<std::string> names;
  for (std::size_t i = 0; i < value.size(); ++i) {
    const std::string at = "sources[" + std::to_string(i) + "]";
    const Json& entry = value[i];
    if (!entry.is_object()) refuse(file, at, shown(entry), kSourcesAccepted);
    Config::Source source;
    source.blade = config.cut.blade;
    for (const auto& [key, given] : entry.items()) {
      if (key == "name") {
        if (!given.is_string() || given.get<std::string>().empty() || given.get<std::string>().size() > 64) {
          refuse(file, at + ".name", shown(given), "a text of 1 to 64 characters");
        }
        source.name = given.get<std::string>();
      } else if (key == "heel" || key == "tip") {
        if (!read_point(given, key == "heel" ? source.blade.heel : source.blade.tip)) {
          refuse(file, at + "." + key, shown(given), kPoint);
        }
      } else {
        throw ConfigError(file + ": " + at + ": unknown key " + shown(key) +
                          "; accepted are heel, name, tip");
      }
    }
    if (source.name.empty()) refuse(file, at + ".name", "nothing", "a text of 1 to 64 characters");
    if (!names.insert(source.name).second)
      refuse(file, at + ".name", shown(source.name), "a name that no other source has");
    if (source.blade.heel == source.blade.tip) {
      refuse(file, at + ".tip", shown(point_json(source.blade.tip)), "a point that is not the heel");
    }
    config.sources.push_back(std::move(source));
  }
}

haptics::Material read_material(const Config& config, const Json& entry, const std::string& at,
                                const std::string& file) {
  Config scratch = config;  // takes the values under the keys of haptics, which know their ranges
  for (const auto& [key, given] : entry.items()) {
    if (key == "region") continue;
    const auto known = std::find_if(std::begin(kMaterialKeys), std::end(kMaterialKeys),
                                    [&key = key](const MaterialKey& k) { return key == k.name; });
    if (known == std::end(kMaterialKeys)) {
      throw ConfigError(file + ": " + at + ": unknown key " + shown(key) + "; accepted are region" +
                        std::accumulate(std::begin(kMaterialKeys), std::end(kMaterialKeys), std::string(),
                                        [](std::string list, const MaterialKey& k) {
                                          return std::move(list) + ", " + k.name;
                                        }));
    }
    const auto table = std::find_if(keys().begin(), keys().end(),
                                    [&key = key](const Key& k) { return k.name == "haptics." + key; });
    if (!table->set(scratch, given)) refuse(file, at + "." + key, shown(given), table->accepted);
  }
  return scratch.haptics.force.materials.tissue;
}

void read_materials(Config& config, const Json& value, const std::string& file) {
  if (!value.is_array() || value.size() > kMostMaterials)
    refuse(file, "materials", shown(value), kMaterialsAccepted);
  std::set<std::int32_t> regions;
  for (std::size_t i = 0; i < value.size(); ++i) {
    const std::string at = "materials[" + std::to_string(i) + "]";
    const Json& entry = value[i];
    if (!entry.is_object()) refuse(file, at, shown(entry), kMaterialsAccepted);
    const Json region = entry.value("region", Json());
    if (!region.is_number_integer() || region.get<double>() < INT32_MIN || region.get<double>() > INT32_MAX)
      refuse(file, at + ".region", region.is_null() ? "nothing" : shown(region), "a whole number");
    const auto number = region.get<std::int32_t>();
    if (!regions.insert(number).second)
      refuse(file, at + ".region", shown(region), "a region that no other entry has");
    config.haptics.force.materials.by_region.emplace_back(number, read_material(config, entry, at, file));
  }
}

// "host:port".
bool is_place(const std::string& text) {
  const std::size_t colon = text.rfind(':');
  if (colon == std::string::npos || colon == 0 || text.size() - colon > 6) return false;
  const std::string port = text.substr(colon + 1);
  return !port.empty() && port.find_first_not_of("0123456789") == std::string::npos && std::stoi(port) > 0 &&
         std::stoi(port) <= 65535;
}

// What one key alone cannot tell.
void check_together(const Config& config, const std::string& file) {
  if (!config.mesh.path.empty() && !config.mesh.phantom.empty()) {
    refuse(file, "mesh.phantom", shown(config.mesh.phantom), "\"\" where mesh.path is given");
  }
  if (!config.mesh.phantom.empty() && config.mesh.target_tets < 500) {
    refuse(file, "mesh.target_tets", std::to_string(config.mesh.target_tets), "500 or more for a phantom");
  }
  if (config.cut.blade.heel == config.cut.blade.tip) {
    refuse(file, "blade.tip", shown(point_json(config.cut.blade.tip)), "a point that is not the heel");
  }
  const haptics::SafetyLimits& limits = config.haptics.force.limits;
  if (limits.slew_n_s < limits.most_n / limits.decay_s) {
    refuse(file, "haptics.slew_n_s", text_of(limits.slew_n_s),
           "a number from " + text_of(limits.most_n / limits.decay_s) + ", 100 times haptics.max_force_n");
  }
  if (config.listen.certificate_file.empty() != config.listen.private_key_file.empty()) {
    const bool key = config.listen.private_key_file.empty();
    refuse(file, key ? "listen.private_key_file" : "listen.certificate_file", "\"\"",
           key ? "a path where listen.certificate_file is given"
               : "a path where listen.private_key_file is given");
  }
  if (config.listen.tcp_port > 0 && config.listen.tcp_port == config.listen.http_port) {
    refuse(file, "listen.http_port", std::to_string(config.listen.http_port),
           "a port other than listen.tcp_port");
  }
  if (config.openigtlink.connect.size() > 8)
    refuse(file, "openigtlink.connect", std::to_string(config.openigtlink.connect.size()) + " places",
           "8 at most");
  for (const std::string& place : config.openigtlink.connect) {
    if (!is_place(place)) refuse(file, "openigtlink.connect", shown(place), "\"host:port\"");
  }
  const std::string& url = config.haply.url;
  if (!url.empty() && !(url.starts_with("ws://") && is_place(url.substr(5, url.find('/', 5) - 5)))) {
    refuse(file, "haply.url", shown(url), "\"ws://host:port\", or \"\"");
  }
  if (config.haply.source.empty() || config.haply.source.size() > 48)
    refuse(file, "haply.source", shown(config.haply.source), "a text of 1 to 48 characters");
}

}  // namespace

std::filesystem::path Config::resolve(const std::string& path) const {
  return path.empty() || directory.empty() ? std::filesystem::path(path) : directory / path;
}

Config parse_config(std::string_view text, const std::string& name) {
  Json root;
  try {
    root = input::parse_json(text, name);
  } catch (const std::runtime_error& error) {
    throw ConfigError(error.what());
  }
  if (!root.is_object()) throw ConfigError(name + ": found " + shown(root) + "; accepted is a JSON object");
  std::set<std::string> sections{"sources", "materials"};
  for (const Key& key : keys()) sections.insert(key.section());

  Config config;
  for (const auto& [section, values] : root.items()) {
    if (!sections.contains(section)) {
      throw ConfigError(name + ": unknown key " + shown(section) + "; accepted are " + joined(sections));
    }
    if (section == "sources" || section == "materials") continue;
    if (!values.is_object()) refuse(name, section, shown(values), "an object {...}");
    for (const auto& [leaf, value] : values.items()) {
      const Key* found = nullptr;
      std::set<std::string> known;
      for (const Key& key : keys()) {
        if (key.section() != section) continue;
        known.insert(key.leaf());
        if (key.leaf() == leaf) found = &key;
      }
      if (!found) {
        throw ConfigError(name + ": unknown key " + shown(section + "." + leaf) + "; accepted in " + section +
                          " are " + joined(known));
      }
      if (!found->set(config, value)) refuse(name, found->name, shown(value), found->accepted);
    }
  }
  if (root.contains("sources")) read_sources(config, root["sources"], name);
  if (root.contains("materials")) read_materials(config, root["materials"], name);
  check_together(config, name);
  return config;
}

Config load_config(const std::filesystem::path& file) {
  std::error_code error;
  if (std::filesystem::is_directory(file, error))
    throw ConfigError(file.string() + ": is a directory; accepted is a file");
  std::ifstream in(file, std::ios::binary);
  if (!in) throw ConfigError(file.string() + ": cannot be opened: " + std::generic_category().message(errno));
  std::string text(kMaxConfigBytes + 1, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(in.gcount()));
  if (text.size() > kMaxConfigBytes) {
    throw ConfigError(file.string() + ": longer than " + std::to_string(kMaxConfigBytes) +
                      " bytes; that is no configuration");
  }
  Config config = parse_config(text, file.string());
  config.directory = file.parent_path();
  return config;
}

namespace {

using Path = std::filesystem::path;

// Refuses a path at which there is no file that can be read.
void check_readable(const Config& config, const std::string& file, const std::string& key,
                    const std::string& value) {
  if (value.empty()) return;
  const Path path = config.resolve(value);
  std::error_code error;
  int why = 0;
  if (!std::ifstream(path)) {
    why = errno;
  } else if (std::filesystem::is_directory(path, error)) {
    why = EISDIR;
  }
  if (why != 0) {
    refuse(file, key, shown(value) + " (" + path.string() + ": " + std::generic_category().message(why) + ")",
           "a file that can be read");
  }
}

// Refuses a path that is not a folder, or a folder that cannot be read.
void check_folder(const std::string& file, const std::string& key, const Path& folder) {
  std::error_code error;
  int why = 0;
  if (!std::filesystem::is_directory(folder, error)) {
    why = ENOTDIR;
  } else if (access(folder.c_str(), R_OK | X_OK) != 0) {
    why = errno;
  }
  if (why != 0)
    refuse(file, key, folder.string() + ": " + std::generic_category().message(why),
           "a folder that can be read");
}

void check_secrets(const Config& config, const std::string& file) {
  const Config::Listen& listen = config.listen;
  try {
    if (!listen.token_file.empty()) read_tokens(config.resolve(listen.token_file));
    if (!listen.certificate_file.empty()) {
      boost::asio::ssl::context scratch(boost::asio::ssl::context::tls_server);
      stream::load_certificate(scratch, config.resolve(listen.certificate_file).string(),
                               config.resolve(listen.private_key_file).string());
    }
  } catch (const std::runtime_error& error) {
    throw ConfigError(file + ": " + error.what());
  }
}

void check_files(const Config& config, const std::string& file) {
  Path node = config.resolve(config.mesh.path);
  node += ".node";
  std::error_code error;
  if (config.mesh.phantom.empty() && !std::filesystem::exists(node, error))
    check_readable(config, file, "mesh.path", config.mesh.path);
  check_readable(config, file, "listen.token_file", config.listen.token_file);
  check_readable(config, file, "listen.certificate_file", config.listen.certificate_file);
  check_readable(config, file, "listen.private_key_file", config.listen.private_key_file);
  check_secrets(config, file);
  // Where these are not there (yet), they are empty.
  for (const auto& [key, value] : {std::pair{"capture.library", config.capture.library},
                                   std::pair{"listen.viewer_directory", config.listen.viewer_directory}}) {
    const Path folder = config.resolve(value);
    if (!folder.empty() && std::filesystem::exists(folder, error)) check_folder(file, key, folder);
  }
  device_profiles(config);
}

}  // namespace

void check_config(const Config& config, const std::string& file) {
  if (config.mesh.path.empty() && config.mesh.phantom.empty()) {
    refuse(file, "mesh.path", "nothing", "the path of a mesh, or mesh.phantom instead");
  }
  check_files(config, file);
  const auto is_loopback = [](const std::string& address) {
    return address.starts_with("127.") || address == "::1" || address == "localhost";
  };
#ifndef INCISE_OPENIGTLINK
  if (config.openigtlink.wanted()) {
    refuse(file, config.openigtlink.port >= 0 ? "openigtlink.port" : "openigtlink.connect", "a value",
           "none: this program was built without OpenIGTLink");
  }
#endif
  if (config.openigtlink.port >= 0 && !is_loopback(config.openigtlink.address) && !config.listen.insecure) {
    refuse(file, "openigtlink.address", shown(config.openigtlink.address),
           "a loopback address, or any where listen.insecure is true");
  }
  boost::system::error_code no_address;
  boost::asio::ip::make_address(config.listen.address, no_address);
  if (no_address)
    refuse(file, "listen.address", shown(config.listen.address), "an IP address such as 127.0.0.1");
  if (!is_loopback(config.listen.address) && !config.listen.insecure &&
      (config.listen.token_file.empty() || config.listen.certificate_file.empty())) {
    refuse(file, "listen.address", shown(config.listen.address),
           "a loopback address, or any where listen.token_file and listen.certificate_file are given, or "
           "listen.insecure is "
           "true");
  }
}

std::vector<input::DeviceProfile> device_profiles(const Config& config) {
  std::vector<input::DeviceProfile> profiles;
  if (!config.devices.enabled) return profiles;
  try {
    if (!config.devices.profiles.empty())
      profiles = input::load_profiles(config.resolve(config.devices.profiles));
    // A profile of one's own replaces the shipped one of the same name.
    for (input::DeviceProfile& shipped : input::load_profiles(shipped_profiles())) {
      const auto same = [&](const input::DeviceProfile& own) { return own.id == shipped.id; };
      if (std::none_of(profiles.begin(), profiles.end(), same)) profiles.push_back(std::move(shipped));
    }
  } catch (const input::ProfileError& error) {
    throw ConfigError(std::string("devices.profiles: ") + error.what());
  }
  return profiles;
}

std::filesystem::path shipped_profiles() {
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
  const std::filesystem::path installed = program.parent_path().parent_path() / "share/incise/devices";
  return std::filesystem::is_directory(installed, error) ? installed : INCISE_DEVICE_PROFILES;
}

// ------------------------------------------------------------------------------------------------ writing

namespace {

Json sources_json(const Config& config) {
  Json list = Json::array();
  for (const Config::Source& source : config.sources) {
    list.push_back({{"name", source.name},
                    {"heel", point_json(source.blade.heel)},
                    {"tip", point_json(source.blade.tip)}});
  }
  return list;
}

Json materials_json(const Config& config) {
  Json list = Json::array();
  for (const auto& [region, material] : config.haptics.force.materials.by_region) {
    Json entry{{"region", region}};
    for (const MaterialKey& key : kMaterialKeys) entry[key.name] = material.*key.field;
    list.push_back(entry);
  }
  return list;
}

void append_comment(std::string& out, const std::string& text, const std::string& indent) {
  constexpr std::size_t kWidth = 100;
  std::istringstream words(text);
  std::string line = indent + "//", word;
  while (words >> word) {
    if (line.size() + 1 + word.size() > kWidth) {
      out += line + '\n';
      line = indent + "//";
    }
    line += ' ' + word;
  }
  out += line + '\n';
}

}  // namespace

std::string commented(const Config& config) {
  std::string out = "{\n", section;
  for (const Key& key : keys()) {
    if (key.section() != section) {
      if (!section.empty()) out += "\n  },\n";
      section = key.section();
      out += "  \"" + section + "\": {\n";
    } else {
      out += ",\n";
    }
    append_comment(out, key.meaning + " Accepted: " + key.accepted + '.', "    ");
    out += "    \"" + key.leaf() + "\": " + key.get(config).dump();
  }
  out += "\n  },\n";
  append_comment(out, std::string(kSourcesMeaning) + " Accepted: " + kSourcesAccepted + '.', "  ");
  out += "  \"sources\": " + sources_json(config).dump() + ",\n";
  append_comment(out, std::string(kMaterialsMeaning) + " Accepted: " + kMaterialsAccepted + '.', "  ");
  out += "  \"materials\": " + materials_json(config).dump() + "\n}\n";
  return out;
}

std::string compact(const Config& config) {
  Json root;
  for (const Key& key : keys()) root[key.section()][key.leaf()] = key.get(config);
  root["sources"] = sources_json(config);
  root["materials"] = materials_json(config);
  return root.dump();
}

}  // namespace incise::app
