#pragma once

#include <cstddef>
#include <iosfwd>
#include <span>

#include "protocol/messages.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::wasm {

// A body as a file: the messages with which a server would greet a viewer of the view Volume, one after the other as on
// TCP: Welcome, and the snapshot of revision 0.

// `welcome`: everything but revision and hash, which are the session's. `session` is at revision 0.
void write_body(std::ostream& out, protocol::Welcome welcome, const core::CutSession& session);

struct BodyFile {
  protocol::Welcome welcome;
  core::MeshData mesh;
};
// Trusts none of the bytes: the snapshot's hash is checked. Throws std::runtime_error: one line.
BodyFile read_body(std::span<const std::byte> bytes);

}  // namespace incise::wasm
