#include "server/app/spare_session.hpp"

#include "server/base/thread_name.hpp"
#include "server/replay/session_view.hpp"

namespace incise::app {

SpareSession::~SpareSession() {
  thread_.request_stop();
  give_back(nullptr);
  if (thread_.joinable()) thread_.join();
  take();
  delete used_.load();
}

void SpareSession::start() {
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

void SpareSession::give_back(std::unique_ptr<core::CutSession> used) noexcept {
  // The last one was destroyed long ago: the session that this one has made way for took longer to build.
  delete used_.exchange(used.release());
  ++turns_;
  turns_.notify_one();
}

void SpareSession::run(const std::stop_token& stop) {
  name_thread("spare session");
  for (std::uint32_t turn = 0; !stop.stop_requested(); turns_.wait(turn), turn = turns_.load()) {
    delete used_.exchange(nullptr);
    if (spare_.load() != nullptr) continue;
    std::unique_ptr<core::CutSession> session = body_.session(config_);
    if (!mirror_) {
      fields_ = replay::shared_fields(session->fields());
      mirror_ = mirror_of(*session, body_.origins);
    }
    session->drop_fields();
    spare_.store(session.release());
  }
}

}  // namespace incise::app
