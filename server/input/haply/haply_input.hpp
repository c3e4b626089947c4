#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "server/haptics/force_slot.hpp"
#include "server/input/haply/haply_messages.hpp"
#include "server/input/network_status.hpp"
#include "server/input/placement.hpp"
#include "server/input/pose_sources.hpp"

namespace incise::input {

struct HaplyOptions {
  std::string url;  // "ws://host:port"; "": off
  HaplyVersion version = HaplyVersion::k35;
  std::string device, grip;  // ids; "": the first
  std::string source = "haply";
  double rate_hz = 1000;  // commands a second, at most
  double max_force_n = 3.3;
  Placement placement;
  std::function<void()> on_thread = [] {};  // called first in its thread
};

// Haply's Inverse Service as a pose source that renders forces. Connects, and reconnects when the connection is lost. Each
// state from the service is a pose, at the time it arrived; each command carries the newest force and asks for the next
// state. ForceGuard has the last word on a force. When the service is gone, silent for a second or stopped, the device has
// no force: the service releases a device that gets no commands.
//
// Thread: made and destroyed by one; status() by any. Owns: a thread with the connection.
class HaplyInput {
 public:
  // `sources` and `forces` must outlive this.
  HaplyInput(PoseSources& sources, haptics::ForceSlots& forces, HaplyOptions options);
  ~HaplyInput();
  // Sends no force as the last command and releases the blade, for good.
  void stop();

  NetworkStatus status() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace incise::input
