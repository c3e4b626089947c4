#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace incise::loop {

// A session's state at one place of its journal, on disk (protocol/PROTOCOL.md, "Capture", gives the bytes).
struct Checkpoint {
  std::uint64_t id = 0;       // of its record in the journal
  std::uint64_t session = 0;  // whose ids these are
  std::uint64_t offset = 0;   // of that record, in bytes
  std::uint64_t records = 0;  // before that record
  std::uint64_t revision = 0;
  std::uint64_t state_hash = 0;
  std::vector<std::byte> state;  // core/session/session_state.hpp
};

// Each journal has two: the next one replaces the older, so that a whole one exists at any time.
inline constexpr int kCheckpointFiles = 2;
std::string checkpoint_path(const std::string& journal, int number);

// Writes and syncs `path`.part, then renames it to `path`: a crash leaves the old one or the new one. Throws
// std::system_error.
void write_checkpoint(const std::string& path, const Checkpoint& checkpoint);

// Whether a file begins as a checkpoint does.
bool begins_as_checkpoint(const std::string& path);
// Reads and checks a checkpoint; the bytes of its state remain untrusted. Returns nothing if the file is not a whole
// checkpoint, with one line in `error`, or does not exist, without.
std::optional<Checkpoint> read_checkpoint(const std::string& path, std::string& error);

}  // namespace incise::loop
