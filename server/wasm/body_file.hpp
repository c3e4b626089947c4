#pragma once

#include <cstddef>
#include <iosfwd>
#include <memory>
#include <span>

#include "protocol/messages.hpp"
#include "protocol/surface_asset.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::wasm {

// A body as a file. First what blades have left in it (core::MeshData::cut_memory): the number of its bytes, little-endian in eight, and these. Then the
// messages with which a server would greet a viewer of the view Volume, one after the other as on TCP: Welcome, and the snapshot of revision 0. Behind them, for a body that was filled from a surface, that surface (its triangles alone), in which boundary
// faces have their origins.

// `welcome`: everything but revision and hash, which are the session's. `session` is at revision 0. `surface`: null where there is none.
// Throws std::length_error where it is too long for a message.
void write_body(std::ostream& out, protocol::Welcome welcome, const core::CutSession& session,
                const protocol::SurfaceAsset* surface);

struct BodyFile {
  protocol::Welcome welcome;
  core::MeshData mesh;
  std::shared_ptr<const protocol::OriginTree> origins = {};  // null: the file has no surface
};
// Trusts none of the bytes: the snapshot's hash is checked. Throws std::runtime_error: one line.
BodyFile read_body(std::span<const std::byte> bytes);

}  // namespace incise::wasm
