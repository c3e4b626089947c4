#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "server/input/hid/device_profile.hpp"

struct hid_device_;
struct udev;
struct udev_monitor;

namespace incise::input {

// One HID interface of a connected device: one /dev/hidraw node.
struct HidInterface {
  struct Usage {
    std::uint16_t page = 0, usage = 0;
  };
  std::string path;
  std::uint16_t vendor = 0, product = 0;
  int interface = -1;  // -1: the bus has none (Bluetooth)
  std::string serial, name;
  std::vector<Usage> usages;  // of its top-level collections
  std::string parent;         // the whole device, the same for all its interfaces
  std::optional<ReportDescriptor> descriptor;
  std::string trouble;  // why it cannot be used: permission, a broken descriptor; empty: it can

  // "vvvv:pppp" or "vvvv:pppp:serial".
  std::string identity() const;
};

// All connected interfaces, each once. Opens nodes only to check permissions.
// Thread: the one that opens (hidapi's enumeration and opening share their last error).
std::vector<HidInterface> list_hid_interfaces();

// An open interface. hidapi's reads and writes on one handle race on the handle's last error: so one handle is used by
// one thread.
class HidHandle {
 public:
  // Nothing, and the reason in `error`, if it cannot be opened.
  static std::optional<HidHandle> open(const std::string& path, std::string& error);

  // The next report, its number first if the device numbers its reports. Returns its length; 0 after `timeout_ms` without one; -1
  // when the device is gone.
  int read(std::span<std::uint8_t> report, int timeout_ms) noexcept;
  // Sends a whole report, its number (or 0) first. False if the device refused it. May wait for the device.
  bool write(std::span<const std::uint8_t> report) noexcept;
  bool send_feature(std::span<const std::uint8_t> report) noexcept;

 private:
  struct Close {
    void operator()(hid_device_* device) const;
  };
  explicit HidHandle(hid_device_* device) : device_(device) {}
  std::unique_ptr<hid_device_, Close> device_;
};

// Sends a profile's start or stop reports through `handle`, an open handle of `interface`, or to the interface that the
// report names (of the same device, in `all`). False, and the reason in `error`, if one was refused.
bool send_all(const std::vector<FixedReport>& reports, const HidInterface& interface, HidHandle& handle,
              const std::vector<HidInterface>& all, std::string& error);

// Tells when a HID device comes or goes, by udev. Thread: one.
class HotplugMonitor {
 public:
  HotplugMonitor();
  // To poll for reading; -1 without udev.
  int descriptor() const;
  // Discards the notices that wait. Whether there were any.
  bool drain();

 private:
  struct Unref {
    void operator()(udev* context) const;
    void operator()(udev_monitor* monitor) const;
  };
  std::unique_ptr<udev, Unref> udev_;
  std::unique_ptr<udev_monitor, Unref> monitor_;
};

// The first profile that fits an interface; null if none does: `why` then says why those that name it do not fit, or that
// none names it.
const DeviceProfile* find_profile(const std::vector<DeviceProfile>& profiles, const HidInterface& interface,
                                  std::string& why);

}  // namespace incise::input
