#include "server/input/hid/device_profile.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <set>

#include "server/input/hid/json_node.hpp"

namespace incise::input {
namespace {

constexpr std::size_t kMaxProfileBytes = 1u << 20;
constexpr const char* kTypes =
    "\"u1\" to \"u32\" (unsigned), \"i2\" to \"i32\" (two's complement), \"f32\" or \"f64\" (IEEE 754), with "
    "\"be\" "
    "appended if the highest byte comes first: \"i16be\"";

// ------------------------------------------------------------------------------------------------ pieces

void read_type(const JsonNode& node, ReportField& field) {
  const std::string text = node.text(1, 8);
  const char kind = text[0];
  unsigned bits = 0;
  const auto [rest, error] = std::from_chars(text.data() + 1, text.data() + text.size(), bits);
  const std::string_view order(rest, static_cast<std::size_t>(text.data() + text.size() - rest));
  const bool known = (kind == 'u' && bits >= 1 && bits <= 32) || (kind == 'i' && bits >= 2 && bits <= 32) ||
                     (kind == 'f' && (bits == 32 || bits == 64));
  if (error != std::errc() || !known || !(order.empty() || order == "be")) node.refuse(kTypes);
  field.kind = kind == 'u'   ? ReportField::Kind::kUnsigned
               : kind == 'i' ? ReportField::Kind::kSigned
                             : ReportField::Kind::kFloat;
  field.bits = static_cast<std::uint8_t>(bits);
  field.big_endian = order == "be";
  if (field.big_endian && bits % 8 != 0) node.refuse("\"be\" only after whole bytes: 8, 16, 24, 32, 64 bits");
}

// The keys of every field; users of a field add their own.
#define INCISE_FIELD_KEYS "report", "at", "bit", "type", "scale", "zero"

// `report`: the default of the report's number.
ReportField read_field(const JsonNode& node, std::uint8_t report) {
  ReportField field;
  field.report = node.has("report") ? static_cast<std::uint8_t>(node.at("report").integer(0, 255)) : report;
  field.bit = 8 * static_cast<std::uint32_t>(node.at("at").integer(0, kMaxReportBytes - 8));
  read_type(node.at("type"), field);
  if (node.has("bit")) {
    const JsonNode bit = node.at("bit");
    field.bit += static_cast<std::uint32_t>(bit.integer(0, 7));
    if (field.bit % 8 != 0 && (field.big_endian || field.kind == ReportField::Kind::kFloat)) {
      bit.refuse("0 for numbers with the highest byte first and for floats");
    }
  }
  if (field.report != 0 && field.bit < 8) {
    node.at("at").refuse("1 or more: byte 0 of a numbered report is its number");
  }
  if (node.has("scale")) {
    const JsonNode scale = node.at("scale");
    field.scale = scale.number(-1e9, 1e9);
    if (std::abs(field.scale) < 1e-15) scale.refuse("a number that is not 0");
  }
  if (node.has("zero")) field.zero = node.at("zero").number(-1e10, 1e10);
  return field;
}

std::optional<ReportField> read_axis(const JsonNode& node, const char* axis, std::uint8_t report) {
  if (!node.has(axis)) return std::nullopt;
  return read_field(node.at(axis).only({INCISE_FIELD_KEYS}), report);
}

// A counter or a clock: an integer field.
ReportField read_count(const JsonNode& node, std::uint8_t report) {
  ReportField field = read_field(node, report);
  if (field.kind == ReportField::Kind::kFloat || field.bits < 4) {
    node.at("type").refuse("an integer of 4 bits or more: \"u4\" to \"u32\"");
  }
  return field;
}

ToolProfile::Switch read_switch(const JsonNode& node, std::uint8_t report, unsigned button) {
  ToolProfile::Switch made;
  made.field = read_field(node, report);
  made.button = button;
  if (node.has("from")) made.from = node.at("from").number(-1e10, 1e10);
  return made;
}

std::uint16_t read_hex16(const JsonNode& node) {
  constexpr const char* kAccepted = "a text of 1 to 4 hexadecimal digits: \"046d\"";
  if (!node.is_text()) node.refuse(kAccepted);
  std::string text = node.text(0, 1000);
  if (text.starts_with("0x") || text.starts_with("0X")) text = text.substr(2);
  std::uint16_t value = 0;
  const auto [rest, error] = std::from_chars(text.data(), text.data() + text.size(), value, 16);
  if (error != std::errc() || rest != text.data() + text.size() || text.size() > 4) node.refuse(kAccepted);
  return value;
}

// "02 ff 00*5": bytes in hexadecimal; *5 repeats one five times.
std::vector<std::uint8_t> read_bytes(const JsonNode& node) {
  constexpr const char* kAccepted =
      "bytes in hexadecimal, the report's number first (00 if the device does not number its reports), "
      "with *N "
      "after one that is repeated: \"02 ff 00*5\"";
  if (!node.is_text()) node.refuse(kAccepted);
  const std::string text = node.text(0, 100'000);
  std::vector<std::uint8_t> bytes;
  const char* at = text.data();
  const char* const end = at + text.size();
  while (at < end) {
    if (*at == ' ') {
      ++at;
      continue;
    }
    std::uint8_t byte = 0;
    std::size_t times = 1;
    auto [rest, error] = std::from_chars(at, std::min(at + 2, end), byte, 16);
    if (error != std::errc() || rest != at + 2) node.refuse(kAccepted);
    if (rest < end && *rest == '*') {
      const auto count = std::from_chars(rest + 1, end, times);
      if (count.ec != std::errc() || times < 1) node.refuse(kAccepted);
      rest = count.ptr;
    }
    if ((rest < end && *rest != ' ') || bytes.size() + times > kMaxReportBytes) node.refuse(kAccepted);
    bytes.insert(bytes.end(), times, byte);
    at = rest;
  }
  if (bytes.size() < 2) node.refuse(kAccepted);
  return bytes;
}

RateShape read_shape(const JsonNode& node, const char* full) {
  RateShape shape;
  shape.full = node.at(full).number(1e-6, 1000);
  if (node.has("dead_zone")) shape.dead_zone = node.at("dead_zone").number(0, 0.9);
  if (node.has("curve")) shape.curve = node.at("curve").number(0.2, 5);
  return shape;
}

// ------------------------------------------------------------------------------------------------ tools

void read_position(const JsonNode& node, std::uint8_t report, ToolProfile& tool) {
  node.only({"mode", "x", "y", "z", "full_m_s", "dead_zone", "curve", "reach_m"});
  if (node.has("mode")) {
    tool.position =
        static_cast<ToolProfile::Position>(node.at("mode").word({"absolute", "rate", "relative"}));
  }
  constexpr const char* kNames[] = {"x", "y", "z"};
  for (std::size_t i = 0; i < 3; ++i) tool.position_fields[i] = read_axis(node, kNames[i], report);
  const bool rate = tool.position == ToolProfile::Position::kRate;
  if (rate) tool.position_rate = read_shape(node, "full_m_s");
  for (const char* key : {"full_m_s", "dead_zone", "curve"}) {
    if (!rate && node.has(key)) node.at(key).refuse("this key only if mode is \"rate\"");
  }
  if (node.has("reach_m")) {
    if (tool.position == ToolProfile::Position::kAbsolute) {
      node.at("reach_m").refuse("this key only if mode is \"rate\" or \"relative\"");
    }
    tool.position_reach = node.at("reach_m").number(1e-4, 100);
  }
}

void read_euler_order(const JsonNode& node, ToolProfile& tool) {
  const std::string order = node.text(0, 100);
  std::string sorted = order;
  std::sort(sorted.begin(), sorted.end());
  if (sorted != "xyz") node.refuse("the letters x, y and z in the order of the turns: \"zyx\"");
  for (std::size_t i = 0; i < 3; ++i) tool.euler_order[i] = static_cast<std::uint8_t>(order[i] - 'x');
}

void read_rotation(const JsonNode& node, std::uint8_t report, ToolProfile& tool) {
  node.only({"mode", "w", "x", "y", "z", "order", "frame", "full_rad_s", "dead_zone", "curve"});
  using Rotation = ToolProfile::Rotation;
  constexpr Rotation kModes[] = {Rotation::kQuaternion, Rotation::kEuler, Rotation::kRate};
  tool.rotation = kModes[node.at("mode").word({"quaternion", "euler", "rate"})];
  constexpr const char* kNames[] = {"w", "x", "y", "z"};
  for (std::size_t i = 0; i < 4; ++i) tool.rotation_fields[i] = read_axis(node, kNames[i], report);
  const auto needs = [&](const char* key, bool allowed, const char* mode) {
    if (!allowed && node.has(key)) node.at(key).refuse(std::string("this key only if mode is ") + mode);
  };
  const bool rate = tool.rotation == Rotation::kRate;
  needs("w", tool.rotation == Rotation::kQuaternion, "\"quaternion\"");
  needs("order", tool.rotation == Rotation::kEuler, "\"euler\"");
  for (const char* key : {"frame", "full_rad_s", "dead_zone", "curve"}) needs(key, rate, "\"rate\"");
  if (tool.rotation == Rotation::kQuaternion) {
    for (const char* name : kNames) node.at(name);
  } else if (rate) {
    tool.rotation_rate = read_shape(node, "full_rad_s");
    if (node.has("frame")) tool.rotation_in_tool_frame = node.at("frame").word({"device", "tool"}) == 1;
  } else if (node.has("order")) {
    read_euler_order(node.at("order"), tool);
  }
}

ToolProfile read_tool(const JsonNode& node, std::uint8_t report, bool alone) {
  node.only({"name", "position", "rotation", "buttons", "valid", "home"});
  ToolProfile tool;
  if (!alone || node.has("name")) {
    const JsonNode name = node.at("name");
    tool.name = name.text(1, 24);
    for (const char c : tool.name) {
      if (!(c >= 'a' && c <= 'z') && !(c >= '0' && c <= '9') && c != '_' && c != '-') {
        name.refuse("1 to 24 of the characters a-z, 0-9, _ and -");
      }
    }
  }
  if (node.has("position")) read_position(node.at("position"), report, tool);
  if (node.has("rotation")) read_rotation(node.at("rotation"), report, tool);
  const auto given = [](const auto& fields) {
    return std::any_of(fields.begin(), fields.end(), [](const auto& field) { return field.has_value(); });
  };
  if (!given(tool.position_fields) && !given(tool.rotation_fields)) {
    node.refuse("nothing that moves", "a position with x, y or z, or a rotation, or both");
  }
  if (node.has("buttons")) {
    for (const JsonNode& entry : node.at("buttons").list(0, 64)) {
      entry.only({INCISE_FIELD_KEYS, "from", "button"});
      const auto next = static_cast<std::int64_t>(tool.buttons.size());
      if (!entry.has("button") && next > 31) entry.refuse("\"button\", 0 to 31");
      const std::int64_t button = entry.has("button") ? entry.at("button").integer(0, 31) : next;
      tool.buttons.push_back(read_switch(entry, report, static_cast<unsigned>(button)));
    }
  }
  if (node.has("valid"))
    tool.valid = read_switch(node.at("valid").only({INCISE_FIELD_KEYS, "from"}), report, 0);
  if (node.has("home")) tool.home = read_switch(node.at("home").only({INCISE_FIELD_KEYS, "from"}), report, 0);
  return tool;
}

// ------------------------------------------------------------------------------------------------ profile

void read_match(const JsonNode& root, DeviceProfile& profile) {
  for (auto& [key, value] :
       {std::pair("vendor", &profile.vendor), std::pair("product", &profile.product),
        std::pair("usage_page", &profile.usage_page), std::pair("usage", &profile.usage)}) {
    if (root.has(key)) *value = read_hex16(root.at(key));
  }
  if (root.has("interface")) profile.interface = static_cast<int>(root.at("interface").integer(0, 255));
  if (profile.vendor || profile.product || !profile.usage_page) {
    root.at("vendor");
    root.at("product");
  } else {
    root.at("usage");
  }
}

void read_world(const JsonNode& node, DeviceProfile& profile) {
  node.only({"x", "y", "z", "scale"});
  constexpr const char* kNames[] = {"x", "y", "z"};
  unsigned used = 0;
  for (std::size_t i = 0; i < 3; ++i) {
    if (node.has(kNames[i])) {
      const std::size_t axis = node.at(kNames[i]).word({"x", "y", "z", "-x", "-y", "-z"});
      profile.axes[i] = static_cast<std::uint8_t>(axis % 3);
      profile.signs[i] = axis < 3 ? 1 : -1;
    }
    used |= 1u << profile.axes[i];
  }
  if (used != 7) node.refuse("each of the device's axes x, y and z once");
  if (node.has("scale")) profile.scale = node.at("scale").number(1e-3, 1e3);
}

std::vector<FixedReport> read_fixed(const JsonNode& node) {
  std::vector<FixedReport> made;
  for (const JsonNode& entry : node.list(0, 16)) {
    entry.only({"feature", "output", "interface"});
    FixedReport report;
    report.feature = entry.has("feature");
    if (report.feature == entry.has("output"))
      entry.refuse("an object with either \"feature\" or \"output\"");
    report.bytes = read_bytes(entry.at(report.feature ? "feature" : "output"));
    if (entry.has("interface")) report.interface = static_cast<int>(entry.at("interface").integer(0, 255));
    made.push_back(std::move(report));
  }
  return made;
}

ForceProfile read_force(const JsonNode& node) {
  node.only({"max_newtons", "rate_hz", "bytes", "x", "y", "z", "magnitude", "torque"});
  ForceProfile force;
  force.max_newtons = node.at("max_newtons").number(1e-3, 1000);
  if (node.has("rate_hz")) force.rate_hz = node.at("rate_hz").number(1, 8000);
  force.bytes = read_bytes(node.at("bytes"));
  const auto inside = [&](const JsonNode& at, const ReportField& field) {
    if (field.bit < 8 || field.end() > force.bytes.size()) {
      at.refuse("a place between byte 1 and the end of force.bytes, which has " +
                std::to_string(force.bytes.size()));
    }
  };
  constexpr const char* kNames[] = {"x", "y", "z"};
  const auto read_axes = [&](const JsonNode& from, std::array<std::optional<ReportField>, 3>& axes) {
    for (std::size_t i = 0; i < 3; ++i) {
      if (!from.has(kNames[i])) continue;
      const JsonNode axis = from.at(kNames[i]).only({"at", "bit", "type", "scale", "zero"});
      axes[i] = read_field(axis, force.bytes[0]);
      inside(axis.at("at"), *axes[i]);
    }
  };
  read_axes(node, force.components);
  if (node.has("torque")) {
    const JsonNode torque = node.at("torque").only({"max_newton_metres", "x", "y", "z"});
    force.max_newton_metres = torque.at("max_newton_metres").number(1e-4, 100);
    read_axes(torque, force.torque);
    if (!force.torque[0] && !force.torque[1] && !force.torque[2])
      torque.refuse("no place for the torque", "x, y or z");
  }
  if (node.has("magnitude")) {
    for (const JsonNode& entry : node.at("magnitude").list(1, 8)) {
      force.magnitudes.push_back(
          read_field(entry.only({"at", "bit", "type", "scale", "zero"}), force.bytes[0]));
      inside(entry.at("at"), force.magnitudes.back());
    }
  }
  if (force.magnitudes.empty() && !force.components[0] && !force.components[1] && !force.components[2]) {
    node.refuse("no place for the force", "x, y or z, or a list magnitude, or both");
  }
  return force;
}

// Calls visit(field) for each input field of the profile.
template <class Profile, class Visit>
void each_input(Profile& profile, Visit&& visit) {
  const auto look = [&](auto& field) {
    if (field) visit(*field);
  };
  look(profile.counter);
  look(profile.clock);
  for (auto& tool : profile.tools) {
    for (auto& field : tool.position_fields) look(field);
    for (auto& field : tool.rotation_fields) look(field);
    for (auto& button : tool.buttons) visit(button.field);
    if (tool.valid) visit(tool.valid->field);
    if (tool.home) visit(tool.home->field);
  }
}

}  // namespace

double RateShape::speed(double deflection) const noexcept {
  const double d = std::min(std::abs(deflection), 1.0);
  if (!(d > dead_zone)) return 0;
  return std::copysign(full * std::pow((d - dead_zone) / (1 - dead_zone), curve), deflection);
}

DeviceProfile parse_profile(std::string_view text, const std::string& name) {
  JsonNode::Json json;
  try {
    json = parse_json(text, name);
  } catch (const std::runtime_error& error) {
    throw ProfileError(error.what());
  }
  const JsonNode root(json, "", name);
  root.only({"name", "vendor", "product", "usage_page", "usage", "interface", "report", "rate_hz", "counter",
             "clock", "tools", "world", "start", "stop", "force"});
  DeviceProfile profile;
  profile.file = name;
  profile.id = std::filesystem::path(name).stem().string();
  profile.name = root.at("name").text(1, 64);
  read_match(root, profile);
  const auto report = static_cast<std::uint8_t>(root.has("report") ? root.at("report").integer(0, 255) : 0);
  if (root.has("rate_hz")) profile.rate_hz = root.at("rate_hz").number(1, 8000);
  if (root.has("counter")) {
    const JsonNode counter = root.at("counter").only({INCISE_FIELD_KEYS, "step"});
    profile.counter = read_count(counter, report);
    if (counter.has("step"))
      profile.counter_step = static_cast<double>(counter.at("step").integer(1, 1 << 20));
  }
  if (root.has("clock")) {
    const JsonNode clock = root.at("clock").only({"report", "at", "bit", "type", "tick_s"});
    profile.clock = read_count(clock, report);
    profile.clock->scale = clock.at("tick_s").number(1e-9, 1);
  }
  const std::vector<JsonNode> tools = root.at("tools").list(1, kMaxTools);
  std::set<std::string> names;
  for (const JsonNode& node : tools) {
    profile.tools.push_back(read_tool(node, report, tools.size() == 1));
    if (!names.insert(profile.tools.back().name).second)
      node.at("name").refuse("a name that no other tool has");
  }
  if (root.has("world")) read_world(root.at("world"), profile);
  if (root.has("start")) profile.start = read_fixed(root.at("start"));
  if (root.has("stop")) profile.stop = read_fixed(root.at("stop"));
  if (root.has("force")) profile.force = read_force(root.at("force"));

  bool some = false, all = true;
  each_input(profile, [&](const ReportField& field) {
    some = some || field.report != 0;
    all = all && field.report != 0;
  });
  if (some && !all) {
    root.at("tools").refuse(
        "fields with a report number and fields without",
        "a number for all (\"report\" at the top is that of all fields that name none) or none");
  }
  return profile;
}

DeviceProfile load_profile(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in)
    throw ProfileError(file.string() + ": cannot be opened: " + std::generic_category().message(errno));
  std::string text(kMaxProfileBytes + 1, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(in.gcount()));
  if (text.size() > kMaxProfileBytes)
    throw ProfileError(file.string() + ": longer than 1 MB; that is too much for a profile");
  return parse_profile(text, file.string());
}

std::vector<DeviceProfile> load_profiles(const std::filesystem::path& folder) {
  std::error_code error;
  std::vector<std::filesystem::path> files;
  for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    if (entry->path().extension() == ".json") files.push_back(entry->path());
  }
  if (error)
    throw ProfileError(folder.string() + ": cannot be read as a folder of profiles: " + error.message());
  std::sort(files.begin(), files.end());
  std::vector<DeviceProfile> profiles;
  for (const auto& file : files) profiles.push_back(load_profile(file));
  return profiles;
}

std::string mismatch(const DeviceProfile& profile, const ReportDescriptor& descriptor) {
  std::string why;
  const auto look = [&](DescribedField::Kind kind, std::uint8_t id, std::size_t end, const char* what) {
    const std::uint32_t bytes = descriptor.bytes_of(kind, id);
    if (!why.empty() || end <= bytes) return;
    const std::string report = what + (id == 0 ? std::string(" report") : " report " + std::to_string(id));
    why = bytes == 0 ? "it has no " + report + ", which the profile names"
                     : "its " + report + " has " + std::to_string(bytes) + " bytes, and the profile wants " +
                           std::to_string(end);
  };
  each_input(profile, [&](const ReportField& field) {
    look(DescribedField::Kind::kInput, field.report, field.end(), "input");
  });
  if (profile.force) {
    const auto& bytes = profile.force->bytes;
    // An unnumbered report's leading 0 is not on the wire.
    look(DescribedField::Kind::kOutput, bytes[0], bytes[0] == 0 ? bytes.size() - 1 : bytes.size(), "output");
  }
  return why;
}

}  // namespace incise::input
