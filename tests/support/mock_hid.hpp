#pragma once

// HID devices that are not there: umockdev shows this process, and those it starts, a /sys, a /dev and udev's events of
// its own. A mocked hidraw node is a pipe in packet mode, so that one write is one report, with room for as many as the
// kernel's ring has. The program must run with umockdev's library preloaded (tests/CMakeLists.txt: incise_mock_hid_test).

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

using UMockdevTestbed = struct _UMockdevTestbed;
using UMockdevIoctlBase = struct _UMockdevIoctlBase;
using UMockdevIoctlClient = struct _UMockdevIoctlClient;

namespace incise::tests {

using Bytes = std::vector<std::uint8_t>;

// "05 01 09": bytes in hexadecimal, separated by anything.
Bytes from_hex(std::string_view text);

class MockHid;
struct MockNode;

// A device that is plugged in; unplugged when destroyed.
class MockDevice {
 public:
  struct Kind {
    std::uint16_t vendor = 0x1209, product = 1;
    std::string name = "Mock", serial;
    Bytes descriptor;
    int interface = 0;
    int hidraw = 0;  // the node's number
    int port = 1;    // interfaces of one device have the same
  };
  // What came from the host, and when (CLOCK_MONOTONIC).
  struct Sent {
    Bytes bytes;
    std::int64_t time_ns = 0;
  };

  ~MockDevice();
  // Puts a report into the system's queue; false where it is full.
  bool report(std::span<const std::uint8_t> bytes) const;
  // Output and feature reports from the host so far; outputs from that one on.
  std::vector<Sent> outputs(std::size_t from = 0) const;
  std::vector<Sent> features() const;
  // From now on output reports fail, or are taken again.
  void refuse_outputs(bool refuse) { refuse_ = refuse; }
  // Once the host has an open handle; false after 30 s without.
  bool wait_until_open() const;

 private:
  friend class MockHid;
  friend struct MockNode;
  MockDevice(MockHid& bus, Kind kind);
  std::string usb_path() const;
  std::string interface_path() const;

  MockHid& bus_;
  const Kind kind_;
  MockNode& node_;
  int pipe_ = -1;
  std::atomic<bool> refuse_{false};
  std::atomic<int> opened_{0};
  mutable std::mutex mutex_;  // guards outputs_, features_
  std::vector<Sent> outputs_, features_;
};

// The machine's devices; at most one at a time.
class MockHid {
 public:
  MockHid();
  ~MockHid();
  std::unique_ptr<MockDevice> plug(MockDevice::Kind kind);

 private:
  friend class MockDevice;
  MockNode& node(int hidraw);

  UMockdevTestbed* testbed_;
  std::string root_;
  std::map<int, std::unique_ptr<MockNode>> nodes_;
};

// Waits for a condition that comes true without our doing, 30 s at most. Whether it did.
bool eventually(const std::function<bool()>& condition);

}  // namespace incise::tests
