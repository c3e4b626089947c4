#include "server/input/hid/hid_system.hpp"

#include <fcntl.h>
#include <hidapi/hidapi.h>
#include <libudev.h>
#include <linux/hidraw.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <cwchar>
#include <fstream>
#include <iterator>
#include <system_error>

namespace incise::input {
namespace {

// hidapi's texts, as UTF-8; unprintable characters become '?'.
std::string utf8(const wchar_t* text) {
  std::string made;
  for (; text && *text; ++text) {
    const auto c = static_cast<char32_t>(*text);
    if (c < 0x20 || c == 0x7f || c > 0x10ffff) {
      made += '?';
    } else if (c < 0x80) {
      made += static_cast<char>(c);
    } else {
      if (c >= 0x10000) {
        made += static_cast<char>(0xf0 | c >> 18);
        made += static_cast<char>(0x80 | (c >> 12 & 0x3f));
      } else if (c >= 0x800) {
        made += static_cast<char>(0xe0 | c >> 12);
      } else {
        made += static_cast<char>(0xc0 | c >> 6);
      }
      if (c >= 0x800) made += static_cast<char>(0x80 | (c >> 6 & 0x3f));
      made += static_cast<char>(0x80 | (c & 0x3f));
    }
  }
  return made;
}

// hidapi 0.13 crashes on a node that opens but is not hidraw, so check first.
std::string trouble_of(const std::string& path) {
  const int node = ::open(path.c_str(), O_RDWR | O_CLOEXEC | O_NONBLOCK);
  if (node < 0) {
    const int error = errno;
    return path + ": " + std::generic_category().message(error) +
           (error == EACCES ? " (DEVICES.md, \"Connecting a device\": the udev rules)" : "");
  }
  int size = 0;
  const bool hidraw = ::ioctl(node, HIDIOCGRDESCSIZE, &size) >= 0;
  ::close(node);
  return hidraw ? "" : path + ": is not a hidraw node";
}

std::vector<std::uint8_t> descriptor_bytes(const std::string& hid_syspath, const std::string& path) {
  // Before 0.14 hidapi has no call for it.
  std::ifstream in(hid_syspath + "/report_descriptor", std::ios::binary);
  std::vector<std::uint8_t> bytes((std::istreambuf_iterator<char>(in)), {});
  if (!bytes.empty() && bytes.size() <= kMaxDescriptorBytes) return bytes;
  const int node = ::open(path.c_str(), O_RDWR | O_CLOEXEC | O_NONBLOCK);
  if (node < 0) return {};
  hidraw_report_descriptor described{};
  int size = 0;
  if (::ioctl(node, HIDIOCGRDESCSIZE, &size) >= 0) {
    described.size = static_cast<std::uint32_t>(std::clamp<int>(size, 0, HID_MAX_DESCRIPTOR_SIZE));
    if (::ioctl(node, HIDIOCGRDESC, &described) >= 0)
      bytes.assign(described.value, described.value + described.size);
  }
  ::close(node);
  return bytes;
}

// Adds what hidapi does not report: the descriptor, and which interfaces belong to one device.
void complete(udev* context, HidInterface& interface) {
  const auto slash = interface.path.rfind('/');
  udev_device* node =
      udev_device_new_from_subsystem_sysname(context, "hidraw", interface.path.substr(slash + 1).c_str());
  std::string hid_syspath;
  if (node) {
    if (udev_device* hid = udev_device_get_parent_with_subsystem_devtype(node, "hid", nullptr)) {
      hid_syspath = udev_device_get_syspath(hid);
      interface.parent = hid_syspath;
    }
    if (udev_device* usb = udev_device_get_parent_with_subsystem_devtype(node, "usb", "usb_device")) {
      interface.parent = udev_device_get_syspath(usb);
    }
    udev_device_unref(node);
  }
  interface.trouble = trouble_of(interface.path);
  if (!interface.trouble.empty() && hid_syspath.empty()) return;
  std::string error;
  interface.descriptor = parse_report_descriptor(descriptor_bytes(hid_syspath, interface.path), error);
  if (interface.descriptor) {  // hidapi does not always find the usages
    interface.usages.clear();
    for (const std::uint32_t usage : interface.descriptor->applications) {
      interface.usages.push_back(
          {static_cast<std::uint16_t>(usage >> 16), static_cast<std::uint16_t>(usage)});
    }
  } else if (interface.trouble.empty()) {
    interface.trouble = interface.path + ": its report descriptor " + error;
  }
}

}  // namespace

std::string HidInterface::identity() const {
  char numbers[16];
  std::snprintf(numbers, sizeof numbers, "%04x:%04x", vendor, product);
  return serial.empty() ? numbers : numbers + (":" + serial);
}

std::vector<HidInterface> list_hid_interfaces() {
  std::vector<HidInterface> found;
  hid_device_info* const all = hid_enumerate(0, 0);
  for (const hid_device_info* info = all; info; info = info->next) {
    if (!info->path) continue;
    // hidapi has an entry for each top-level collection, all with the same path.
    auto known =
        std::find_if(found.begin(), found.end(), [&](const auto& other) { return other.path == info->path; });
    if (known == found.end()) {
      HidInterface interface;
      interface.path = info->path;
      interface.vendor = info->vendor_id;
      interface.product = info->product_id;
      interface.interface = info->interface_number;
      interface.serial = utf8(info->serial_number).substr(0, 128);
      interface.name = utf8(info->product_string).substr(0, 128);
      known = found.insert(found.end(), std::move(interface));
    }
    known->usages.push_back({info->usage_page, info->usage});
  }
  hid_free_enumeration(all);
  if (udev* context = udev_new()) {
    for (HidInterface& interface : found) complete(context, interface);
    udev_unref(context);
  }
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.path < b.path; });
  return found;
}

// ------------------------------------------------------------------------------------------------ HidHandle

void HidHandle::Close::operator()(hid_device_* device) const {
  hid_close(device);
}

std::optional<HidHandle> HidHandle::open(const std::string& path, std::string& error) {
  error = trouble_of(path);
  if (!error.empty()) return std::nullopt;
  hid_device* device = hid_open_path(path.c_str());
  if (!device) {
    error = path + ": " + utf8(hid_error(nullptr));
    return std::nullopt;
  }
  return HidHandle(device);
}

int HidHandle::read(std::span<std::uint8_t> report, int timeout_ms) noexcept {
  return hid_read_timeout(device_.get(), report.data(), report.size(), timeout_ms);
}

bool HidHandle::write(std::span<const std::uint8_t> report) noexcept {
  return hid_write(device_.get(), report.data(), report.size()) >= 0;
}

bool HidHandle::send_feature(std::span<const std::uint8_t> report) noexcept {
  return hid_send_feature_report(device_.get(), report.data(), report.size()) >= 0;
}

bool send_all(const std::vector<FixedReport>& reports, const HidInterface& interface, HidHandle& handle,
              const std::vector<HidInterface>& all, std::string& error) {
  const auto send = [&](HidHandle& to, const FixedReport& report) {
    if (report.feature ? to.send_feature(report.bytes) : to.write(report.bytes)) return true;
    error =
        std::string("it refused a report of the profile (") + (report.feature ? "feature" : "output") + ")";
    return false;
  };
  for (const FixedReport& report : reports) {
    if (report.interface < 0 || report.interface == interface.interface) {
      if (!send(handle, report)) return false;
      continue;
    }
    const auto other = std::find_if(all.begin(), all.end(), [&](const HidInterface& one) {
      return one.parent == interface.parent && one.interface == report.interface;
    });
    if (other == all.end()) {
      error =
          "its interface " + std::to_string(report.interface) + ", which the profile sends to, is not there";
      return false;
    }
    auto opened = HidHandle::open(other->path, error);
    if (!opened || !send(*opened, report)) return false;
  }
  return true;
}

// ------------------------------------------------------------------------------------------------ HotplugMonitor

void HotplugMonitor::Unref::operator()(udev* context) const {
  udev_unref(context);
}
void HotplugMonitor::Unref::operator()(udev_monitor* monitor) const {
  udev_monitor_unref(monitor);
}

HotplugMonitor::HotplugMonitor() : udev_(udev_new()) {
  if (!udev_) return;
  monitor_.reset(udev_monitor_new_from_netlink(udev_.get(), "udev"));
  if (!monitor_ || udev_monitor_filter_add_match_subsystem_devtype(monitor_.get(), "hidraw", nullptr) < 0 ||
      udev_monitor_enable_receiving(monitor_.get()) < 0) {
    monitor_.reset();
  }
}

int HotplugMonitor::descriptor() const {
  return monitor_ ? udev_monitor_get_fd(monitor_.get()) : -1;
}

bool HotplugMonitor::drain() {
  bool any = false;
  while (udev_device* device = monitor_ ? udev_monitor_receive_device(monitor_.get()) : nullptr) {
    any = true;
    udev_device_unref(device);
  }
  return any;
}

// ------------------------------------------------------------------------------------------------ profiles

const DeviceProfile* find_profile(const std::vector<DeviceProfile>& profiles, const HidInterface& interface,
                                  std::string& why) {
  why.clear();
  for (const DeviceProfile& profile : profiles) {
    if (profile.vendor && (*profile.vendor != interface.vendor || *profile.product != interface.product))
      continue;
    if (profile.usage_page) {
      const bool has = std::any_of(interface.usages.begin(), interface.usages.end(), [&](const auto& usage) {
        return usage.page == *profile.usage_page && (!profile.usage || usage.usage == *profile.usage);
      });
      if (!has) {
        if (profile.vendor) why += profile.id + " is for another usage of this device; ";
        continue;
      }
    }
    if (profile.interface && interface.interface != -1 && interface.interface != *profile.interface) {
      why += profile.id + " is for its interface " + std::to_string(*profile.interface) + "; ";
      continue;
    }
    const std::string fault = interface.descriptor ? mismatch(profile, *interface.descriptor) : "";
    if (fault.empty()) {
      why.clear();
      return &profile;
    }
    why += profile.id + " does not fit: " + fault + "; ";
  }
  if (why.empty()) {
    why = "no profile names it";
  } else {
    why.resize(why.size() - 2);
  }
  return nullptr;
}

}  // namespace incise::input
