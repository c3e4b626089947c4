#include "server/app/session_journal.hpp"

#include <spdlog/spdlog.h>

#include <string>
#include <utility>

#include "server/base/check.hpp"
#include "server/core/session/session_state.hpp"

namespace incise::app {
namespace {

std::unique_ptr<loop::Checkpointer> make_checkpointer(const Config& config, const Body& body,
                                                      const Recording& recording, const SavedState& saved,
                                                      std::function<void(loop::Undone)> on_undone) {
  if (config.capture.checkpoint_replay_s == 0) return nullptr;
  loop::Checkpointer::Options options;
  options.journal = config.resolve(config.capture.path).string();
  options.replay_s = config.capture.checkpoint_replay_s;
  options.debt_s = recording.debt_s;
  options.may_write = recording.may_write;
  options.fresh = [&config, &body] { return body.session(config.cut); };
  options.undone = std::move(on_undone);
  auto first = options.fresh;
  if (saved.valid()) {
    first = [&config, saved] {
      const std::vector<std::byte> state = std::move(*saved.get());
      std::string error;
      auto copy = core::restore_session(state, config.cut, error);
      INCISE_CHECK(copy, error);
      return copy;
    };
  }
  return std::make_unique<loop::Checkpointer>(
      options, recording.session_id, recording.next_checkpoint, first, [](bool bad, const std::string& text) {
        spdlog::log(bad ? spdlog::level::err : spdlog::level::warn, "{}", text);
      });
}

loop::SyncPolicy sync_policy(const std::string& word) {
  return word == "none"     ? loop::SyncPolicy::kNone
         : word == "always" ? loop::SyncPolicy::kAlways
                            : loop::SyncPolicy::kGroup;
}

void log_trouble(const std::string& trouble) {
  if (trouble.empty()) {
    spdlog::info("the capture can be written again; the gap is marked in it");
  } else {
    spdlog::error("the capture cannot be written: {}; cutting goes on, poses are not recorded", trouble);
  }
}

}  // namespace

SavedState save_for_checkpoints(const Config& config, const core::CutSession& session) {
  if (session.revision() == 0 || config.capture.checkpoint_replay_s == 0) return {};
  return std::async(std::launch::async, [&session] {
    return std::make_shared<std::vector<std::byte>>(core::save_session(session));
  });
}

std::unique_ptr<loop::Journal> make_journal(const Config& config, const Body& body, Recording& recording,
                                            const SavedState& saved, loop::Journal::OnPose on_pose,
                                            std::function<void(loop::Undone)> on_undone) {
  if (!recording.journal) return nullptr;
  loop::Journal::Options options;
  options.policy = sync_policy(config.capture.sync);
  options.lost = recording.lost;
  options.realtime_priority = static_cast<int>(config.loop.realtime_priority) / 2;
  options.sync_interval_ms = static_cast<std::int64_t>(config.capture.sync_interval_ms);
  return std::make_unique<loop::Journal>(
      std::move(recording.journal), options, log_trouble,
      make_checkpointer(config, body, recording, saved, std::move(on_undone)), std::move(on_pose));
}

}  // namespace incise::app
