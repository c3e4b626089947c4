#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "server/app/body.hpp"
#include "server/app/capture_journal.hpp"
#include "server/app/config.hpp"
#include "server/app/replay_tail.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::app {

// A session at the start of a server, and the journal that records what is done to it.
struct Recording {
  std::unique_ptr<core::CutSession> session;
  std::uint64_t session_id = 0;             // names the run of ids
  std::unique_ptr<CaptureJournal> journal;  // null: nothing is recorded
  int next_checkpoint = 0;                  // the checkpoint file that may be written over
  double debt_s = 0;                        // of computing that the next resume would have to repeat
  std::uint64_t lost = 0;                   // records at the end of it that the disk has not taken
  ReplayTail::Tail shown;  // what clients see at the start: a state, and the steps to the session's
};

// Throws ConfigError, `file` in front, where capture.path names a place that cannot be written.
void check_recording(const Config& config, const std::string& file);

// A fresh session. A capture that is there already is kept under another name, with its checkpoints. Throws ConfigError,
// std::runtime_error.
Recording begin_recording(const Config& config, const Body& body);

// The session that config.capture.path recorded, where it ended: from the newest checkpoint that is whole, else from the
// one before, else from the beginning; what the capture holds after that is replayed, with every hash compared. Ends the
// strokes of those who held a blade: they are gone. Throws ConfigError, or std::runtime_error with one line that says
// what to do.
Recording resume_recording(const Config& config, const Body& body);

}  // namespace incise::app
