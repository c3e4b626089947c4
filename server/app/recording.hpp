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

// A session at the start of a server, and its journal.
struct Recording {
  std::unique_ptr<core::CutSession> session;  // with the body's fields
  std::uint64_t session_id = 0;               // names the run of ids
  std::unique_ptr<CaptureJournal> journal;    // null: nothing is recorded
  int next_checkpoint = 0;                    // the checkpoint file that may be overwritten
  double debt_s = 0;                          // work that the next resume would have to repeat
  std::function<bool()> may_write;            // whether the files are still ours; empty: always
  std::uint64_t lost = 0;                     // records at its end that could not be written
  ReplayTail::Tail
      shown;  // what clients see at the start: a state, and the steps from there to the session's
};

// Throws ConfigError, its text beginning with `file`, if capture.path cannot be written, or if that would cost a file that is
// not a capture. `file`: the configuration's.
void check_recording(const Config& config, const std::string& file);

// A fresh session. An existing capture is kept under another name, with its checkpoints. Throws ConfigError,
// std::runtime_error.
// `shown`: what clients see of the body as loaded.
Recording begin_recording(const Config& config, const Body& body, const stream::InitialState& shown);

// The session that config.capture.path recorded, as it was at its end: starts from the newest whole checkpoint, else from
// the one before, else from the beginning, and replays the rest of the capture, comparing every hash. Ends the strokes in
// progress, whose operators are gone. Throws ConfigError, or std::runtime_error with one line that says
// what to do.
Recording resume_recording(const Config& config, const Body& body);

}  // namespace incise::app
