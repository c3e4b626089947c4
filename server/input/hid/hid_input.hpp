#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "server/input/hid/hid_device.hpp"

namespace incise::input {

// Settings of a single device.
struct DeviceOverride {
  enum class Use : std::uint8_t { kProfile, kDescriptor, kIgnore };
  std::string device;  // "vvvv:pppp" or "vvvv:pppp:serial"; one with the serial number takes precedence
  Use use = Use::kProfile;
  std::string source;  // name of its source, or the beginning of its sources' names; "": the profile's id
  Placement placement;

  friend bool operator==(const DeviceOverride&, const DeviceOverride&) = default;
};

// A connected HID interface, and how it is used.
struct DeviceStatus {
  std::string identity, path, name, profile;
  std::vector<std::string> sources;  // empty: it is not read
  std::string why;                   // it is not read
  std::uint64_t connections = 0;     // how often it has been opened
  DeviceFigures figures;
};

// The HID devices of this machine as pose sources: opens those that match a profile when they are plugged in, and closes
// those that are unplugged. A device that returns is recognised by its maker, product and serial number, whatever its path,
// and keeps its name.
//
// Thread: made and destroyed by one; status() from any. Owns: a thread that looks for devices, and the devices.
class HidInput {
 public:
  struct Options {
    std::vector<DeviceProfile> profiles;  // the first that fits is used
    std::vector<DeviceOverride> overrides;
    std::function<void()> on_thread = [] {};  // called first in each thread that reads or writes a device
  };

  HidInput(PoseSources& sources, haptics::ForceSlots& forces, Options options);
  ~HidInput();
  // Closes all devices, for good.
  void stop();

  std::vector<DeviceStatus> status() const;

 private:
  // A device that was here, and may be again.
  struct Known {
    std::string identity, name;
    std::uint64_t connections = 0;
    bool here = false;
  };
  struct Open {
    std::unique_ptr<HidDevice> device;
    std::size_t known;
  };

  void run(const std::stop_token& stop);
  void wake() const;
  void scan();
  void let_go(const std::vector<HidInterface>& all);
  void consider(const HidInterface& interface, const std::vector<HidInterface>& all, DeviceStatus& status);
  const DeviceOverride* override_of(const HidInterface& interface) const;
  std::size_t know(const HidInterface& interface, const std::string& name);
  void close(std::size_t i, const char* why);

  PoseSources& sources_;
  haptics::ForceSlots& forces_;
  const Options options_;
  const int wake_;  // an eventfd
  std::vector<Known> known_;
  std::vector<Open> open_;
  std::vector<std::string> told_;  // "path: why", so that a reason is logged once
  mutable std::mutex mutex_;       // guards open_ while its members change, and status_
  std::vector<DeviceStatus> status_;
  std::jthread thread_;
};

// The profile for an interface: one of `profiles`, or one from its descriptor if its override asks for that or it is a
// multi-axis controller without a profile. Nothing, and the reason in `why`, if there is none or it is to be ignored.
std::optional<DeviceProfile> choose_profile(const std::vector<DeviceProfile>& profiles,
                                            const HidInterface& interface, const DeviceOverride* over,
                                            std::string& why);

}  // namespace incise::input
