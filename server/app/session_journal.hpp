#pragma once

#include <cstddef>
#include <functional>
#include <future>
#include <memory>
#include <vector>

#include "server/app/body.hpp"
#include "server/app/config.hpp"
#include "server/app/recording.hpp"
#include "server/loop/journal.hpp"

namespace incise::app {

// A session's state while another thread saves it. The checkpoints' session begins with it, and moves it out.
using SavedState = std::shared_future<std::shared_ptr<std::vector<std::byte>>>;

// Begins to save a resumed session for its checkpoints. Invalid if there are to be none, or nothing was cut yet. Wait for it
// before anything changes the session.
SavedState save_for_checkpoints(const Config& config, const core::CutSession& session);

// The journal of a session, with its checkpoints, both logging their trouble; null if nothing is to be recorded.
// `on_pose` is called for each pose from the journal's thread, `on_undone` for what a stroke is undone with from the checkpoints'. Config and body must outlive the journal.
std::unique_ptr<loop::Journal> make_journal(const Config& config, const Body& body, Recording& recording,
                                            const SavedState& saved, loop::Journal::OnPose on_pose,
                                            std::function<void(loop::Undone)> on_undone);

}  // namespace incise::app
