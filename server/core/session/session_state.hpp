#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "server/core/cut/cut_config.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::core {

// A session as bytes: everything that later revisions depend on, including strokes in progress, so that a restored session gives
// the ids and hashes that the saved one would have given. Little-endian. Each class's archive() lists its
// members: one that lives from one batch to the next belongs there. When such a list changes: raise the version (older
// bytes are then refused), write the fuzzer's seeds again (INCISE_WRITE_CORPUS=tests/fuzz/corpus/session_state core_tests
// --gtest_filter='SessionState.Small*'), and say so under "Checkpoints" in CHANGELOG.md.
inline constexpr std::uint32_t kSessionStateVersion = 24;

// No batch may wait (advance() returns kIdle): a batch under way cannot be saved. O(mesh).
// `into`: an array that is no longer needed, whose memory is used.
std::vector<std::byte> save_session(const CutSession& session, std::vector<std::byte> into = {});

// Trusts none of the bytes: returns null, and one line in `error`, unless they are a session with this configuration's policy
// and a valid mesh. Allocates no more than a small multiple of their number. O(mesh).
std::unique_ptr<CutSession> restore_session(std::span<const std::byte> bytes, const CutConfig& config,
                                            std::string& error);

}  // namespace incise::core
