#pragma once

// The messages of Haply's Inverse Service on its simulation channel (JSON over WebSocket, port 10001):
// docs.haply.co/inverseSDK/service/realtime/websocket-protocol and .../control-commands, version 3.5; version 3.1 differs
// in the name of a force's vector. The service sends a list of its devices, then one state for each message it gets.

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "server/core/stroke/blade.hpp"

namespace incise::input {

// What a state message says about one Inverse3 and its grip.
struct HaplyState {
  std::string device;         // its id; empty: there is none
  core::Vec3 position;        // of the cursor, metres
  core::Vec3 velocity;        // m/s
  core::Quat orientation;     // of the grip; the identity without one
  std::uint32_t buttons = 0;  // bit 0: a, 1: b, 2: c (or the only one, or button_0 to button_3)
};

// The state of the Inverse3 and the grip with these ids; "": the first. Nothing, and the reason in `error`, if the text is
// not such a message. The caller bounds the text's length. O(text).
std::optional<HaplyState> read_haply_state(std::string_view text, const std::string& device,
                                           const std::string& grip, std::string& error);

enum class HaplyVersion : std::uint8_t { k35, k31 };

// The command that applies a force (newtons, the device's axes) to the cursor and asks for the next state. `first`: adds
// the session's name.
std::string haply_force(const std::string& device, const core::Vec3& force, HaplyVersion version, bool first);
// Asks for a state with all devices.
std::string haply_query();

}  // namespace incise::input
