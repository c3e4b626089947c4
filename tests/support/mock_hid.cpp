#include "tests/support/mock_hid.hpp"

#include <fcntl.h>
#include <linux/hidraw.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <time.h>
#include <umockdev.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <stdexcept>

namespace incise::tests {
namespace {

std::int64_t now_ns() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

std::string hex(const Bytes& bytes) {
  constexpr char kDigits[] = "0123456789ABCDEF";
  std::string text;
  for (const std::uint8_t byte : bytes) {
    text += kDigits[byte >> 4];
    text += kDigits[byte & 15];
  }
  return text;
}

template <class... Arguments>
std::string format(const char* pattern, Arguments... arguments) {
  char text[256];
  std::snprintf(text, sizeof text, pattern, arguments...);
  return text;
}

void must(bool good, const char* what) {
  if (!good) throw std::runtime_error(std::string("mock_hid: ") + what + ": " + std::strerror(errno));
}

}  // namespace

Bytes from_hex(std::string_view text) {
  Bytes bytes;
  int digits = 0, value = 0;
  for (const char c : text) {
    const int digit = c >= '0' && c <= '9'   ? c - '0'
                      : c >= 'a' && c <= 'f' ? c - 'a' + 10
                      : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                             : -1;
    if (digit < 0) continue;
    value = 16 * value + digit;
    if (++digits % 2 == 0) {
      bytes.push_back(static_cast<std::uint8_t>(value));
      value = 0;
    }
  }
  return bytes;
}

bool eventually(const std::function<bool()>& condition) {
  // Once a wait has failed the test has failed: the conditions that depend on that one must not wait as long again.
  static std::atomic<bool> failed{false};
  const std::int64_t limit_ns = failed ? 5'000'000'000 : 20'000'000'000;
  for (const std::int64_t end = now_ns() + limit_ns; now_ns() < end;) {
    if (condition()) return true;
    ::usleep(2000);
  }
  failed = !condition();
  return !failed;
}

// ------------------------------------------------------------------------------------------------ MockNode

// /dev/hidrawN. umockdev ends a program that opens a node whose handler comes or goes just then: so a node gets its
// handler before anybody can see it, and keeps it. Without a device every call fails with EIO.
struct MockNode {
  static int on_ioctl(UMockdevIoctlBase*, UMockdevIoctlClient* client, MockNode* node);
  static int on_read(UMockdevIoctlBase*, UMockdevIoctlClient* client, MockNode* node);
  static int on_write(UMockdevIoctlBase*, UMockdevIoctlClient* client, MockNode* node);

  UMockdevIoctlBase* handler = nullptr;
  std::mutex mutex;  // guards device
  MockDevice* device = nullptr;
};

// ------------------------------------------------------------------------------------------------ MockHid

MockNode& MockHid::node(int hidraw) {
  std::unique_ptr<MockNode>& made = nodes_[hidraw];
  if (made) return *made;
  made = std::make_unique<MockNode>();
  made->handler = umockdev_ioctl_base_new();
  g_signal_connect(made->handler, "handle-ioctl", G_CALLBACK(MockNode::on_ioctl), made.get());
  g_signal_connect(made->handler, "handle-read", G_CALLBACK(MockNode::on_read), made.get());
  g_signal_connect(made->handler, "handle-write", G_CALLBACK(MockNode::on_write), made.get());
  GError* error = nullptr;
  const std::string path = format("/dev/hidraw%d", hidraw);
  if (!umockdev_testbed_attach_ioctl(testbed_, path.c_str(), made->handler, &error)) {
    throw std::runtime_error(error->message);
  }
  return *made;
}

MockHid::MockHid() : testbed_(umockdev_testbed_new()) {
  must(umockdev_in_mock_environment(), "umockdev's library is not preloaded");
  gchar* const root = umockdev_testbed_get_root_dir(testbed_);
  root_ = root;
  ::mkdir((root_ + "/dev").c_str(), 0755);
  g_free(root);
}

MockHid::~MockHid() {
  g_object_unref(testbed_);
  for (const auto& [number, node] : nodes_) g_object_unref(node->handler);
}

std::unique_ptr<MockDevice> MockHid::plug(MockDevice::Kind kind) {
  return std::unique_ptr<MockDevice>(new MockDevice(*this, std::move(kind)));
}

// ------------------------------------------------------------------------------------------------ MockDevice

std::string MockDevice::usb_path() const {
  return format("/devices/pci0000:00/usb1/1-%d", kind_.port);
}

std::string MockDevice::interface_path() const {
  return usb_path() + format("/1-%d:1.%d", kind_.port, kind_.interface);
}

MockDevice::MockDevice(MockHid& bus, Kind kind)
    : bus_(bus), kind_(std::move(kind)), node_(bus.node(kind_.hidraw)) {
  const int node = kind_.hidraw;
  const std::string hid =
      interface_path() + format("/0003:%04X:%04X.%04X", kind_.vendor, kind_.product, node + 1);
  const auto add = [&](const std::string& text) {
    GError* error = nullptr;
    if (!umockdev_testbed_add_from_string(bus_.testbed_, text.c_str(), &error))
      throw std::runtime_error(error->message);
  };
  // Everything exists before udev announces it.
  const std::string pipe = bus_.root_ + format("/dev/hidraw%d", node);
  must(::mkfifo(pipe.c_str(), 0600) == 0, "mkfifo");
  pipe_ = ::open(pipe.c_str(), O_RDWR | O_CLOEXEC);
  must(pipe_ >= 0, "open");
  must(::fcntl(pipe_, F_SETFL, O_DIRECT | O_NONBLOCK) == 0, "packet mode");
  must(::fcntl(pipe_, F_SETPIPE_SZ, 64 * 4096) > 0, "F_SETPIPE_SZ");
  {
    const std::scoped_lock lock(node_.mutex);
    node_.device = this;
  }
  // Another interface of the same device may have brought it.
  if (::access((bus_.root_ + "/sys" + usb_path()).c_str(), F_OK) != 0) {
    add("P: " + usb_path() + "\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\n" +
        format("A: idVendor=%04x\\n\nA: idProduct=%04x\\n\n", kind_.vendor, kind_.product) +
        "A: bcdDevice=0100\\n\nA: manufacturer=Mock\\n\nA: product=" + kind_.name +
        "\\n\nA: serial=" + kind_.serial + "\\n\n");
  }
  add("P: " + interface_path() + "\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_interface\n" +
      format("A: bInterfaceNumber=%02x\\n\n", kind_.interface));
  add("P: " + hid + "\nE: SUBSYSTEM=hid\n" +
      format("E: HID_ID=0003:%08X:%08X\n", kind_.vendor, kind_.product) + "E: HID_NAME=" + kind_.name +
      "\nE: HID_UNIQ=" + kind_.serial + "\nH: report_descriptor=" + hex(kind_.descriptor) + "\n");
  const std::string hidraw = hid + format("/hidraw/hidraw%d", node);
  add("P: " + hidraw + format("\nE: SUBSYSTEM=hidraw\nE: DEVNAME=/dev/hidraw%d\n", node));

  umockdev_testbed_uevent(bus_.testbed_, ("/sys" + hidraw).c_str(), "add");
}

MockDevice::~MockDevice() {
  {
    const std::scoped_lock lock(node_.mutex);
    node_.device = nullptr;
  }
  const std::uint8_t wake = 0;
  for (int i = 0; i < 2; ++i) (void)!::write(pipe_, &wake, 1);  // readers are woken and told EIO
  const int node = kind_.hidraw;
  const std::string hid =
      interface_path() + format("/0003:%04X:%04X.%04X", kind_.vendor, kind_.product, node + 1);
  umockdev_testbed_uevent(bus_.testbed_, ("/sys" + hid + format("/hidraw/hidraw%d", node)).c_str(), "remove");
  for (const std::string& path : {hid + format("/hidraw/hidraw%d", node), hid, interface_path()}) {
    umockdev_testbed_remove_device(bus_.testbed_, ("/sys" + path).c_str());
  }
  // The device goes with its last interface.
  const std::string usb = bus_.root_ + "/sys" + usb_path();
  bool others = false;
  for (int i = 0; i < 8; ++i)
    others = others || ::access((usb + format("/1-%d:1.%d", kind_.port, i)).c_str(), F_OK) == 0;
  if (!others) umockdev_testbed_remove_device(bus_.testbed_, ("/sys" + usb_path()).c_str());
  ::unlink((bus_.root_ + format("/dev/hidraw%d", node)).c_str());
  ::close(pipe_);
}

bool MockDevice::report(std::span<const std::uint8_t> bytes) const {
  return ::write(pipe_, bytes.data(), bytes.size()) == static_cast<ssize_t>(bytes.size());
}

std::vector<MockDevice::Sent> MockDevice::outputs(std::size_t from) const {
  const std::scoped_lock lock(mutex_);
  return {outputs_.begin() + static_cast<std::ptrdiff_t>(std::min(from, outputs_.size())), outputs_.end()};
}

std::vector<MockDevice::Sent> MockDevice::features() const {
  const std::scoped_lock lock(mutex_);
  return features_;
}

bool MockDevice::wait_until_open() const {
  return eventually([&] { return opened_ >= 1; });
}

// Each handler answers with complete() and TRUE, or leaves the call to the system with FALSE.
int MockNode::on_ioctl(UMockdevIoctlBase*, UMockdevIoctlClient* client, MockNode* node) {
  const std::scoped_lock device_lock(node->mutex);
  MockDevice* const self = node->device;
  const gulong request = umockdev_ioctl_client_get_request(client);
  UMockdevIoctlData* const argument = umockdev_ioctl_client_get_arg(client);
  const std::size_t size = _IOC_SIZE(request);
  GError* error = nullptr;
  const auto answer = [&](const void* bytes, std::size_t count, glong result) {
    UMockdevIoctlData* const data = umockdev_ioctl_data_resolve(argument, 0, size, &error);
    std::memcpy(data->data, bytes, std::min(count, size));
    g_object_unref(data);
    umockdev_ioctl_client_complete(client, result, 0);
  };
  if (_IOC_TYPE(request) != 'H') {
    umockdev_ioctl_client_complete(client, -1, ENOTTY);
  } else if (!self) {
    umockdev_ioctl_client_complete(client, -1, EIO);
  } else if (_IOC_NR(request) == 1) {  // HIDIOCGRDESCSIZE
    const int count = static_cast<int>(self->kind_.descriptor.size());
    answer(&count, sizeof count, 0);
  } else if (_IOC_NR(request) == 2) {  // HIDIOCGRDESC
    hidraw_report_descriptor described{};
    described.size = static_cast<__u32>(self->kind_.descriptor.size());
    std::copy(self->kind_.descriptor.begin(), self->kind_.descriptor.end(), described.value);
    answer(&described, sizeof described, 0);
    ++self->opened_;
  } else if (_IOC_NR(request) == 3) {  // HIDIOCGRAWINFO
    const hidraw_devinfo info{3, static_cast<__s16>(self->kind_.vendor),
                              static_cast<__s16>(self->kind_.product)};
    answer(&info, sizeof info, 0);
  } else if (_IOC_NR(request) == 6) {  // HIDIOCSFEATURE
    UMockdevIoctlData* const data = umockdev_ioctl_data_resolve(argument, 0, size, &error);
    {
      const std::scoped_lock lock(self->mutex_);
      self->features_.push_back({Bytes(data->data, data->data + data->data_len), now_ns()});
    }
    g_object_unref(data);
    umockdev_ioctl_client_complete(client, static_cast<glong>(size), 0);
  } else {
    umockdev_ioctl_client_complete(client, -1, EINVAL);
  }
  return TRUE;
}

int MockNode::on_read(UMockdevIoctlBase*, UMockdevIoctlClient* client, MockNode* node) {
  {
    const std::scoped_lock device_lock(node->mutex);
    if (node->device) return FALSE;
  }
  umockdev_ioctl_client_complete(client, -1, EIO);
  return TRUE;
}

int MockNode::on_write(UMockdevIoctlBase*, UMockdevIoctlClient* client, MockNode* node) {
  const std::scoped_lock device_lock(node->mutex);
  MockDevice* const self = node->device;
  UMockdevIoctlData* const argument = umockdev_ioctl_client_get_arg(client);
  if (!self || self->refuse_) {
    umockdev_ioctl_client_complete(client, -1, !self ? EIO : EPIPE);
  } else {
    {
      const std::scoped_lock lock(self->mutex_);
      self->outputs_.push_back({Bytes(argument->data, argument->data + argument->data_len), now_ns()});
    }
    umockdev_ioctl_client_complete(client, argument->data_len, 0);
  }
  return TRUE;
}

}  // namespace incise::tests
