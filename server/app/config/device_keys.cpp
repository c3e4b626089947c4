// Keys of where poses come from besides clients: HID devices, OpenIGTLink peers, Haply's service.
#include <algorithm>
#include <iterator>

#include "server/app/config/config_key.hpp"

namespace incise::app {
namespace {

constexpr const char* kOverridesAccepted =
    "a list of at most 32 objects {\"device\": \"vvvv:pppp\" or \"vvvv:pppp:serial\" as incise devices shows "
    "it, \"use\": \"profile\", \"descriptor\" or \"ignore\", \"source\": a text of 1 to 48 characters, "
    "\"origin\": [x, y, z] in metres, \"rotation\": [w, x, y, z], a unit quaternion, \"scale\": a number "
    "from 0.001 to 1000}";
constexpr const char* kOverridesMeaning =
    "Settings of single devices: where their workspace lies in the world (its point p is at origin + "
    "rotation (scale p); a tool that is steered by deflection starts at the origin), the name of their "
    "source, and whether they are read by a profile, by their report descriptor alone, or not at all.";
constexpr std::size_t kMaxOverrides = 32;

constexpr const char* kUses[] = {"profile", "descriptor", "ignore"};

// "vvvv:pppp" or "vvvv:pppp:serial", vendor and product in hexadecimal.
bool is_device(const std::string& text) {
  if (text.size() < 9 || text.size() > 138 || text[4] != ':') return false;
  if (text.size() > 9 && (text.size() == 10 || text[9] != ':')) return false;
  for (std::size_t i = 0; i < 9; ++i) {
    if (i != 4 && std::string_view("0123456789abcdef").find(text[i]) == std::string_view::npos) return false;
  }
  return true;
}

bool read_override_key(const std::string& key, const Json& given, input::DeviceOverride& over) {
  if (key == "device") {
    if (!given.is_string()) return false;
    over.device = given.get<std::string>();
    return is_device(over.device);
  }
  if (key == "use") {
    const auto* const use = std::find(std::begin(kUses), std::end(kUses), given);
    if (use == std::end(kUses)) return false;
    over.use = static_cast<input::DeviceOverride::Use>(use - kUses);
    return true;
  }
  if (key == "source") {
    if (!given.is_string()) return false;
    over.source = given.get<std::string>();
    return !over.source.empty() && over.source.size() <= 48;
  }
  if (key == "origin") return read_point(given, over.placement.origin);
  if (key == "rotation") return read_quaternion(given, over.placement.rotation);
  if (key == "scale") {
    over.placement.scale = given.is_number() ? given.get<double>() : 0;
    return over.placement.scale >= 1e-3 && over.placement.scale <= 1e3;
  }
  return false;
}

bool read_override(const Json& value, input::DeviceOverride& over) {
  if (!value.is_object() || !value.contains("device")) return false;
  for (const auto& [key, given] : value.items()) {
    if (!read_override_key(key, given, over)) return false;
  }
  return true;
}

bool read_overrides(const Json& value, std::vector<input::DeviceOverride>& out) {
  if (!value.is_array() || value.size() > kMaxOverrides) return false;
  std::vector<input::DeviceOverride> read(value.size());
  for (std::size_t i = 0; i < value.size(); ++i) {
    if (!read_override(value[i], read[i])) return false;
  }
  out = std::move(read);
  return true;
}

Json overrides_json(const std::vector<input::DeviceOverride>& overrides) {
  Json list = Json::array();
  for (const input::DeviceOverride& over : overrides) {
    Json json{{"device", over.device}, {"use", kUses[static_cast<std::size_t>(over.use)]}};
    if (!over.source.empty()) json["source"] = over.source;
    json["origin"] = point_json(over.placement.origin);
    json["rotation"] = quaternion_json(over.placement.rotation);
    json["scale"] = over.placement.scale;
    list.push_back(std::move(json));
  }
  return list;
}

}  // namespace

ConfigKeys devices_keys() {
  return {
      boolean("devices.enabled", INCISE_FIELD(devices.enabled),
              "Use this machine's HID devices that match a profile (incise devices lists them) as sources of "
              "poses."),
      text("devices.profiles", INCISE_FIELD(devices.profiles),
           "the path of a folder, relative to this file; or \"\"",
           "Device profiles of your own, *.json; they take precedence over the shipped ones. See DEVICES.md, "
           "\"Writing a device profile\"."),
      {"devices.overrides", kOverridesAccepted, kOverridesMeaning,
       [](const Config& c) { return overrides_json(c.devices.overrides); },
       [](Config& c, const Json& value) { return read_overrides(value, c.devices.overrides); }},
  };
}

ConfigKeys openigtlink_keys() {
  return {
      integer("openigtlink.port", INCISE_FIELD(openigtlink.port), -1, 65535,
              "Where OpenIGTLink peers such as 3D Slicer connect, usually 18944; 0: any free one, -1: off."),
      text("openigtlink.address", INCISE_FIELD(openigtlink.address), "an IP address",
           "OpenIGTLink has neither passwords nor TLS: an address beyond loopback needs listen.insecure."),
      texts(
          "openigtlink.connect", INCISE_FIELD(openigtlink.connect), "a list of at most 8 texts \"host:port\"",
          "OpenIGTLink servers (trackers, PLUS, 3D Slicer) to connect to, and to reconnect to after a loss."),
      word("openigtlink.ask_for", {"nothing", "TDATA", "QTDATA"}, INCISE_FIELD(openigtlink.ask_for),
           "What to ask those servers to stream (STT_TDATA, STT_QTDATA); many send without that."),
      texts("openigtlink.devices", INCISE_FIELD(openigtlink.devices), "a list of texts",
            "Names of the devices (for tracking data: of its elements) that are blades; []: all. An entry of "
            "the same name in sources gives a device its own blade."),
      word("openigtlink.engage", {"always", "string"}, INCISE_FIELD(openigtlink.engage),
           "When a device's blade cuts (if cut.engage allows it): while its poses arrive, or while the last "
           "STRING from NAME or NAME_engage was \"1\", \"on\", \"true\" or \"engaged\"."),
      number("openigtlink.silence_s", INCISE_FIELD(openigtlink.silence_s), 0.01, 3600,
             "A device that sends no pose for so long ends its stroke and releases its blade."),
      point("openigtlink.origin", INCISE_FIELD(openigtlink.world.origin),
            "Where the origin of the peers' space lies in the world, metres; a point p of that space is at "
            "origin + rotation (scale p)."),
      rotation("openigtlink.rotation", INCISE_FIELD(openigtlink.world.rotation),
               "How that space is rotated: [0, 0, 0, 1] turns the RAS of 3D Slicer into the LPS of DICOM."),
      number("openigtlink.scale", INCISE_FIELD(openigtlink.world.scale), 1e-9, 1e9,
             "Metres for a unit of that space: 0.001 for millimetres."),
      word("openigtlink.surface", {"asked", "always", "never"}, INCISE_FIELD(openigtlink.surface),
           "Who gets the surface as POLYDATA: peers that ask for it (GET_POLYDATA, STT_POLYDATA), all peers "
           "that connect, or nobody."),
      number("openigtlink.surface_hz", INCISE_FIELD(openigtlink.surface_hz), 0.01, 50,
             "How often a second the whole surface is sent at most; it is sent only when it has changed."),
  };
}

ConfigKeys haply_keys() {
  return {
      text("haply.url", INCISE_FIELD(haply.url), "\"ws://host:port\", or \"\"",
           "Haply's Inverse Service, usually ws://localhost:10001: an Inverse3 that sends poses and renders "
           "forces; \"\": off."),
      choice("haply.version", {"3.5", "3.1"}, INCISE_FIELD(haply.version),
             "Version of the service: from 3.5 on it reads a force from \"vector\", before from \"values\"."),
      text("haply.device", INCISE_FIELD(haply.device), "a text",
           "The Inverse3's id, such as 049D; \"\": the first."),
      text("haply.grip", INCISE_FIELD(haply.grip), "a text",
           "The id of the grip that gives orientation and buttons; \"\": the first."),
      text("haply.source", INCISE_FIELD(haply.source), "a text", "The name of its source."),
      number("haply.rate_hz", INCISE_FIELD(haply.rate_hz), 50, 4000,
             "The most commands, and so states, a second."),
      number(
          "haply.max_force_n", INCISE_FIELD(haply.max_force_n), 0, 10,
          "The largest force that the device is asked for; haptics.max_force_n also applies. 0: no forces."),
      point("haply.origin", INCISE_FIELD(haply.placement.origin),
            "Where the origin of the device's space lies in the world, metres; a point p of that space is at "
            "origin + rotation (scale p)."),
      rotation("haply.rotation", INCISE_FIELD(haply.placement.rotation), "How that space is rotated."),
      number("haply.scale", INCISE_FIELD(haply.placement.scale), 1e-3, 1e3,
             "Metres in the world for a metre of that space."),
  };
}

}  // namespace incise::app
