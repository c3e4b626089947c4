#include "server/input/hid/hid_input.hpp"

#include <hidapi/hidapi.h>
#include <poll.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>

namespace incise::input {
namespace {

// Looks besides udev's notices: udevd may be absent, a notice may get lost, and what could not be opened is tried again.
constexpr int kRescan_ms = 2000, kRetry_ms = 200;

}  // namespace

std::optional<DeviceProfile> choose_profile(const std::vector<DeviceProfile>& profiles,
                                            const HidInterface& interface, const DeviceOverride* over,
                                            std::string& why) {
  using Use = DeviceOverride::Use;
  const Use use = over ? over->use : Use::kProfile;
  if (use == Use::kIgnore) {
    why = "devices.overrides says to ignore it";
    return std::nullopt;
  }
  if (use == Use::kProfile) {
    if (const DeviceProfile* profile = find_profile(profiles, interface, why)) return *profile;
    if (why != "no profile names it" || !interface.descriptor || !is_multi_axis(*interface.descriptor)) {
      return std::nullopt;
    }
  }
  if (!interface.descriptor) {
    why = "its report descriptor cannot be read";
    return std::nullopt;
  }
  auto made = profile_from(*interface.descriptor, why);
  if (!made) return std::nullopt;
  made->id = interface.identity().substr(0, 9);
  made->name = interface.name;
  return made;
}

HidInput::HidInput(PoseSources& sources, haptics::ForceSlots& forces, Options options)
    : sources_(sources),
      forces_(forces),
      options_(std::move(options)),
      wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  hid_init();
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

void HidInput::stop() {
  if (!thread_.joinable()) return;
  thread_.request_stop();
  wake();
  thread_.join();
  std::vector<Open> gone;
  {
    const std::scoped_lock lock(mutex_);
    gone.swap(open_);
  }
}

HidInput::~HidInput() {
  stop();
  ::close(wake_);
  hid_exit();
}

void HidInput::wake() const {
  ::eventfd_write(wake_, 1);
}

std::vector<DeviceStatus> HidInput::status() const {
  const std::scoped_lock lock(mutex_);
  std::vector<DeviceStatus> all = status_;
  for (DeviceStatus& status : all) {
    for (const Open& open : open_) {
      if (open.device->setup().interface.path == status.path) status.figures = open.device->figures();
    }
  }
  return all;
}

void HidInput::run(const std::stop_token& stop) {
  HotplugMonitor monitor;  // before the first look, so that no device slips in between
  while (!stop.stop_requested()) {
    scan();
    const bool waiting = std::any_of(status_.begin(), status_.end(), [](const DeviceStatus& status) {
      return status.sources.empty() && !status.profile.empty();
    });
    pollfd ready[2]{{wake_, POLLIN, 0}, {monitor.descriptor(), POLLIN, 0}};  // -1 is left out
    ::poll(ready, 2, waiting ? kRetry_ms : kRescan_ms);
    eventfd_t count;
    ::eventfd_read(wake_, &count);
    monitor.drain();
  }
}

void HidInput::scan() {
  const std::vector<HidInterface> all = list_hid_interfaces();
  let_go(all);
  std::vector<DeviceStatus> found;
  std::vector<std::string> told;
  for (const HidInterface& interface : all) {
    DeviceStatus& status = found.emplace_back();
    status.identity = interface.identity();
    status.path = interface.path;
    status.name = interface.name;
    consider(interface, all, status);
    if (status.why.empty()) continue;
    const std::string line = status.path + ": " + status.why;
    told.push_back(line);
    if (std::find(told_.begin(), told_.end(), line) != told_.end()) continue;
    // Not worth a line for keyboards and mice; but a device that should work is.
    spdlog::log(status.profile.empty() ? spdlog::level::debug : spdlog::level::warn,
                "device {} ({}) is not read: {}", status.identity, status.name, status.why);
  }
  told_ = std::move(told);
  const std::scoped_lock lock(mutex_);
  status_ = std::move(found);
}

void HidInput::let_go(const std::vector<HidInterface>& all) {
  for (std::size_t i = open_.size(); i-- > 0;) {
    const HidInterface& held = open_[i].device->setup().interface;
    const bool here = std::any_of(all.begin(), all.end(), [&](const HidInterface& interface) {
      return interface.path == held.path && interface.identity() == held.identity();
    });
    if (open_[i].device->lost() || !here) close(i, "unplugged");
  }
}

void HidInput::close(std::size_t i, const char* why) {
  Open gone;
  {
    const std::scoped_lock lock(mutex_);
    gone = std::move(open_[i]);
    open_.erase(open_.begin() + static_cast<std::ptrdiff_t>(i));
  }
  known_[gone.known].here = false;
  const HidDevice::Setup& setup = gone.device->setup();
  spdlog::info("device {} ({}): {}", setup.interface.identity(), setup.name, why);
}

void HidInput::consider(const HidInterface& interface, const std::vector<HidInterface>& all,
                        DeviceStatus& status) {
  for (const Open& open : open_) {
    if (open.device->setup().interface.path != interface.path) continue;
    status.profile = open.device->setup().profile.id;
    status.sources = open.device->sources();
    status.connections = known_[open.known].connections;
    return;
  }
  const DeviceOverride* const over = override_of(interface);
  auto profile = choose_profile(options_.profiles, interface, over, status.why);
  if (!profile) return;
  status.profile = profile->id;
  if (!interface.trouble.empty()) {
    status.why = interface.trouble;
    return;
  }
  const std::size_t known = know(interface, over && !over->source.empty() ? over->source : profile->id);
  HidDevice::Setup setup{interface, std::move(*profile), over ? over->placement : Placement{},
                         known_[known].name};
  auto device = HidDevice::open(std::move(setup), all,
                                {sources_, forces_, options_.on_thread, [this] { wake(); }}, status.why);
  if (!device) return;
  known_[known].here = true;
  status.connections = ++known_[known].connections;
  status.sources = device->sources();
  std::string names;
  for (const std::string& name : status.sources) names += (names.empty() ? "" : ", ") + name;
  spdlog::info("device {} ({}, {}): profile {}, source {}", status.identity, status.name, status.path,
               status.profile, names);
  const std::scoped_lock lock(mutex_);
  open_.push_back({std::move(device), known});
}

const DeviceOverride* HidInput::override_of(const HidInterface& interface) const {
  const std::string whole = interface.identity(), numbers = whole.substr(0, 9);
  const DeviceOverride* found = nullptr;
  for (const DeviceOverride& over : options_.overrides) {
    if (over.device == whole) return &over;
    if (!found && over.device == numbers) found = &over;
  }
  return found;
}

std::size_t HidInput::know(const HidInterface& interface, const std::string& name) {
  for (std::size_t i = 0; i < known_.size(); ++i) {
    // Among equal devices without a serial number any absent one will do. A number that two devices share does not count.
    if (!known_[i].here && known_[i].identity == interface.identity()) return i;
  }
  const auto taken = [&](const std::string& wanted) {
    return std::any_of(known_.begin(), known_.end(),
                       [&](const Known& other) { return other.name == wanted; });
  };
  std::string free = name;
  for (int n = 2; taken(free); ++n) free = name + "-" + std::to_string(n);
  known_.push_back({interface.identity(), free, 0, false});
  return known_.size() - 1;
}

}  // namespace incise::input
