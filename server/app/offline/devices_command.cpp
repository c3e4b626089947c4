#include <signal.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>

#include "server/app/config.hpp"
#include "server/app/offline/commands.hpp"
#include "server/base/clock.hpp"
#include "server/input/hid/hid_system.hpp"
#include "server/input/hid/pose_decoder.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;
using input::DeviceProfile;
using input::HidInterface;

volatile std::sig_atomic_t g_ended = 0;

// A connected interface and the profile that fits it.
struct Candidate {
  HidInterface interface;
  input::Placement placement;
  std::optional<DeviceProfile> profile;
  std::string why;  // without a profile, or not to be opened
};

bool names(const std::string& filter, const HidInterface& interface) {
  const std::string identity = interface.identity();
  return filter.empty() || identity == filter || identity.substr(0, 9) == filter;
}

std::vector<Candidate> look(const Config& config, const std::string& filter) {
  const std::vector<DeviceProfile> profiles = device_profiles(config);
  std::vector<Candidate> found;
  for (HidInterface& interface : input::list_hid_interfaces()) {
    if (!names(filter, interface)) continue;
    const input::DeviceOverride* over = nullptr;
    for (const auto& o : config.devices.overrides) {
      if (o.device == interface.identity() || (!over && o.device == interface.identity().substr(0, 9)))
        over = &o;
    }
    Candidate& made = found.emplace_back();
    made.profile = input::choose_profile(profiles, interface, over, made.why);
    if (made.profile) made.why = interface.trouble;
    if (over) made.placement = over->placement;
    made.interface = std::move(interface);
  }
  return found;
}

std::string usages_of(const HidInterface& interface) {
  std::string text;
  char one[16];
  for (const auto& usage : interface.usages) {
    std::snprintf(one, sizeof one, "%04x/%04x", usage.page, usage.usage);
    text += (text.empty() ? "" : " ") + std::string(one);
  }
  return text;
}

// "input 1: 7 bytes, feature 3: 5 bytes": from the report descriptor.
std::string reports_of(const HidInterface& interface) {
  constexpr const char* kKinds[] = {"input", "output", "feature"};
  std::string text;
  if (!interface.descriptor) return text;
  for (const auto& report : interface.descriptor->reports) {
    text += (text.empty() ? "" : ", ") + std::string(kKinds[static_cast<std::size_t>(report.kind)]);
    if (report.id != 0) text += " " + std::to_string(report.id);
    text += ": " + std::to_string(report.bytes) + " bytes";
  }
  return text;
}

int list(const std::vector<Candidate>& found, bool json) {
  Json all = Json::array();
  for (const Candidate& c : found) {
    const HidInterface& i = c.interface;
    if (json) {
      Json entry{{"device", i.identity()},   {"path", i.path},         {"name", i.name},
                 {"interface", i.interface}, {"usages", usages_of(i)}, {"reports", reports_of(i)}};
      entry["profile"] = c.profile ? Json(c.profile->id) : Json();
      if (!c.why.empty()) entry["not_read"] = c.why;
      all.push_back(std::move(entry));
      continue;
    }
    std::printf("%s  %s\n", i.identity().c_str(), i.name.empty() ? "(no name)" : i.name.c_str());
    std::printf("    %s, interface %d, usages %s\n", i.path.c_str(), i.interface, usages_of(i).c_str());
    if (const std::string reports = reports_of(i); !reports.empty()) std::printf("    %s\n", reports.c_str());
    if (c.profile) {
      const std::string& file = c.profile->file;
      std::printf("    profile %s (%s)\n", c.profile->id.c_str(),
                  file.empty() ? "made from its descriptor" : file.c_str());
    }
    if (!c.why.empty()) std::printf("    not read: %s\n", c.why.c_str());
  }
  if (json) std::printf("%s\n", all.dump(2).c_str());
  if (found.empty() && !json) {
    std::printf(
        "no HID device is connected, or none that this user may access (DEVICES.md, \"Connecting a "
        "device\")\n");
  }
  return 0;
}

std::string hex(const std::vector<std::uint8_t>& bytes) {
  std::string text;
  char one[4];
  for (const std::uint8_t byte : bytes) {
    std::snprintf(one, sizeof one, text.empty() ? "%02x" : " %02x", byte);
    text += one;
  }
  return text;
}

// A device that the monitor reads. It gets only the profile's start reports, and the stop reports at the end.
class Watched {
 public:
  Watched(Candidate candidate, input::HidHandle handle)
      : candidate_(std::move(candidate)), handle_(std::move(handle)) {
    if (!candidate_.profile) return;
    decoder_.emplace(*candidate_.profile, candidate_.placement);
    send(candidate_.profile->start);
  }
  ~Watched() {
    if (candidate_.profile && !gone_) send(candidate_.profile->stop);
  }
  Watched(const Watched&) = delete;
  Watched& operator=(const Watched&) = delete;

  // Reads all reports that wait. False once the device is gone.
  bool read_reports() {
    int bytes = 0;
    std::vector<std::uint8_t> report(4096);
    while ((bytes = handle_.read(report, 0)) > 0) {
      const std::vector<std::uint8_t> got(report.begin(), report.begin() + bytes);
      const bool numbered = candidate_.interface.descriptor && candidate_.interface.descriptor->numbered();
      last_[numbered ? got[0] : 0] = got;
      ++reports_;
      if (!decoder_) continue;
      for (const auto& sample : decoder_->decode(got, monotonic_ns())) samples_[sample.tool] = sample;
    }
    gone_ = bytes != 0;
    return !gone_;
  }

  void show(bool json, double seconds) {
    const double rate = static_cast<double>(reports_ - shown_) / seconds;
    shown_ = reports_;
    json ? show_json(rate) : show_text(rate);
  }

 private:
  void send(const std::vector<input::FixedReport>& reports) {
    std::string error;
    if (!input::send_all(reports, candidate_.interface, handle_, input::list_hid_interfaces(), error))
      std::fprintf(stderr, "incise: %s: %s\n", candidate_.interface.identity().c_str(), error.c_str());
  }

  std::string tool_name(std::size_t tool) const {
    const std::string& name = candidate_.profile->tools[tool].name;
    return candidate_.profile->id + (name.empty() ? "" : "." + name);
  }

  void show_text(double rate) const {
    std::printf("%s  %s  %.0f reports/s\n", candidate_.interface.identity().c_str(),
                candidate_.interface.name.c_str(), rate);
    for (const auto& [id, bytes] : last_) {
      std::printf("  report %u, %zu bytes: %s\n", id, bytes.size(), hex(bytes).c_str());
    }
    if (!decoder_) return;
    for (const auto& [tool, sample] : samples_) {
      const auto& axes = decoder_->axes(tool);
      const core::Pose& pose = sample.pose;
      std::printf("  %s%s\n", tool_name(tool).c_str(), sample.valid ? "" : "  NOT VALID");
      std::printf("    fields    x %+10.5f  y %+10.5f  z %+10.5f   w %+8.4f  x %+8.4f  y %+8.4f  z %+8.4f\n",
                  axes.position[0], axes.position[1], axes.position[2], axes.rotation[0], axes.rotation[1],
                  axes.rotation[2], axes.rotation[3]);
      std::printf(
          "    in world  x %+10.5f  y %+10.5f  z %+10.5f m w %+8.4f  x %+8.4f  y %+8.4f  z %+8.4f   buttons "
          "%s\n",
          pose.position.x, pose.position.y, pose.position.z, pose.orientation.w, pose.orientation.x,
          pose.orientation.y, pose.orientation.z, buttons(pose.buttons).c_str());
    }
    const input::ReportCounts& n = decoder_->counts();
    std::printf(
        "  of %llu reports: %llu too short, %llu of other numbers, %llu with bad values, %llu repeated; %llu "
        "lost on the way\n",
        ull(n.reports), ull(n.short_ones), ull(n.other), ull(n.bad_values), ull(n.repeated), ull(n.lost));
  }

  void show_json(double rate) const {
    Json line{{"device", candidate_.interface.identity()}, {"rate_hz", rate}};
    for (const auto& [id, bytes] : last_) line["reports"][std::to_string(id)] = hex(bytes);
    for (const auto& [tool, sample] : samples_) {
      const core::Pose& p = sample.pose;
      const auto& axes = decoder_->axes(tool);
      line["tools"].push_back(
          {{"source", tool_name(tool)},
           {"valid", sample.valid},
           {"fields", {{"position", axes.position}, {"rotation", axes.rotation}}},
           {"position", {p.position.x, p.position.y, p.position.z}},
           {"orientation", {p.orientation.w, p.orientation.x, p.orientation.y, p.orientation.z}},
           {"buttons", p.buttons}});
    }
    if (decoder_) {
      const input::ReportCounts& n = decoder_->counts();
      line["counts"] = {{"reports", n.reports},       {"short", n.short_ones},  {"other", n.other},
                        {"bad_values", n.bad_values}, {"repeated", n.repeated}, {"lost", n.lost}};
    }
    std::printf("%s\n", line.dump().c_str());
  }

  static unsigned long long ull(std::uint64_t n) { return n; }
  static std::string buttons(std::uint32_t bits) {
    std::string text;
    for (unsigned i = 0; i < 32; ++i) {
      if (bits >> i & 1) text += (text.empty() ? "" : ",") + std::to_string(i);
    }
    return text.empty() ? "none" : text;
  }

  const Candidate candidate_;
  input::HidHandle handle_;
  std::optional<input::PoseDecoder> decoder_;
  std::map<unsigned, std::vector<std::uint8_t>> last_;
  std::map<std::size_t, input::PoseDecoder::Sample> samples_;
  std::uint64_t reports_ = 0, shown_ = 0;
  bool gone_ = false;
};

// Opens one for reading. Null if that fails; stderr says why.
std::unique_ptr<Watched> watch(const Candidate& candidate) {
  std::string error = candidate.interface.trouble;
  std::optional<input::HidHandle> handle;
  if (error.empty()) handle = input::HidHandle::open(candidate.interface.path, error);
  if (!handle) {
    std::fprintf(stderr, "incise: %s\n", error.c_str());
    return nullptr;
  }
  return std::make_unique<Watched>(candidate, std::move(*handle));
}

int monitor(const std::vector<Candidate>& found, const DevicesCommand& command) {
  std::vector<std::unique_ptr<Watched>> watched;
  for (const Candidate& candidate : found) {
    if (!candidate.profile && command.device.empty()) continue;
    if (auto one = watch(candidate)) watched.push_back(std::move(one));
  }
  if (found.empty() && !command.device.empty()) {
    throw std::runtime_error(
        "--device " + command.device +
        ": is not connected, or this user may not access it; incise devices lists what is there");
  }
  if (watched.empty()) {
    throw std::runtime_error(
        "no device to show; incise devices lists them, and --device names one without a profile");
  }
  struct sigaction action {};
  action.sa_handler = [](int) { g_ended = 1; };
  action.sa_flags = static_cast<int>(SA_RESETHAND);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);

  const bool terminal = !command.json && ::isatty(STDOUT_FILENO) != 0;
  const double between_s = terminal ? 0.1 : 0.5;
  const auto start = monotonic_ns();
  auto shown = start;
  while (g_ended == 0 && !watched.empty()) {
    ::usleep(2000);
    for (std::size_t i = watched.size(); i-- > 0;) {
      if (watched[i]->read_reports()) continue;
      std::fprintf(stderr, "incise: unplugged\n");
      watched.erase(watched.begin() + static_cast<std::ptrdiff_t>(i));
    }
    const auto now = monotonic_ns();
    const bool end = command.for_s > 0 && static_cast<double>(now - start) * 1e-9 >= command.for_s;
    if (!end && static_cast<double>(now - shown) * 1e-9 < between_s) continue;
    if (terminal) std::printf("\x1b[H\x1b[2J");
    for (const auto& one : watched) one->show(command.json, static_cast<double>(now - shown) * 1e-9);
    std::fflush(stdout);
    shown = now;
    if (end) break;
  }
  return 0;
}

}  // namespace

int run_devices(const DevicesCommand& command) {
  if (!command.check.empty()) {
    const DeviceProfile profile = input::load_profile(command.check);
    std::printf("%s: good: %s\n", command.check.c_str(), profile.name.c_str());
    return 0;
  }
  Config config;
  if (!command.config.empty()) config = load_config(command.config);
  config.devices.enabled = true;
  const std::vector<Candidate> found = look(config, command.device);
  return command.monitor ? monitor(found, command) : list(found, command.json);
}

}  // namespace incise::app
