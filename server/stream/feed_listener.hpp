#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "server/stream/mirror.hpp"

namespace incise::stream {

// The whole live state, as a viewer without a token gets it that chose all fields.
struct WholeState {
  std::uint64_t epoch = 0, revision = 0;
  // How often clients had set fields when it was asked for.
  std::uint64_t fields_set = 0;
  // Welcome, SnapshotBegin, chunks, field values, SnapshotEnd.
  std::vector<SharedFrame> frames;
};

// Hears what the live feed publishes, as the frames that viewers get: for whatever carries them further.
//
// Thread: all calls come from the stream thread (before Server::start from the one that makes the server), in the order in which
// things happen. None may block or throw.
class FeedListener {
 public:
  // The ids start again, also at the start. What follows is of this epoch.
  virtual void on_epoch(std::uint64_t epoch, std::uint64_t revision) = 0;
  virtual void on_step(const EncodedStep& step) = 0;
  // A step that is too long for one message was made: only a whole state leads on.
  virtual void on_gap(std::uint64_t revision) = 0;
  // A client has set values of a field.
  virtual void on_fields_set() = 0;
  // Statistics once a second, and blades' poses if wanted: only the newest matters.
  virtual void on_live(const SharedFrame& frame) = 0;
  virtual bool wants_blades() const = 0;

 protected:
  ~FeedListener() = default;
};

}  // namespace incise::stream
