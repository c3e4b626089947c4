#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <thread>
#include <vector>

#include "server/app/body.hpp"
#include "server/app/stream_setup.hpp"
#include "server/core/cut/cut_config.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::app {

// What a reset begins with, built beside the loop and ahead of time: a session of the body as loaded, and the mirror and fields of it. So a
// reset costs the loop the exchange of a pointer.
//
// With Body::built the sessions are copies of that.
//
// Thread: take() and give_back() from the loop's; the rest from one. Owns: a thread that builds and destroys sessions, one that waits
// and the mirror.
class SpareSession {
 public:
  // Body and configuration must outlive this.
  // `shown`: what viewers are shown of the body as loaded, if that is known.
  SpareSession(const Body& body, const core::CutConfig& config, const stream::InitialState& shown = {})
      : body_(body), config_(config), mirror_(shown.mirror), fields_(shown.fields) {}
  SpareSession(const SpareSession&) = delete;
  SpareSession& operator=(const SpareSession&) = delete;
  ~SpareSession();

  // Begins to build. O(mesh), in its own thread.
  void start();
  // A session as loaded; null where the next one is not ready yet.
  std::unique_ptr<core::CutSession> take() noexcept {
    return std::unique_ptr<core::CutSession>(spare_.exchange(nullptr));
  }
  // Has a session that the loop no longer uses destroyed, and after a take() another one built.
  void give_back(std::unique_ptr<core::CutSession> used) noexcept;
  // What viewers are shown of a fresh session: another epoch each time. After a take() that gave one.
  std::shared_ptr<stream::InitialState> shown() const { return shown_again(mirror_, fields_); }

 private:
  void run(const std::stop_token& stop);

  const Body& body_;
  const core::CutConfig& config_;
  // Set before the first session is there, and not changed.
  std::shared_ptr<const stream::Mirror> mirror_;
  std::shared_ptr<const std::vector<core::Field>> fields_;
  std::atomic<core::CutSession*> spare_{nullptr}, used_{nullptr};
  std::atomic<std::uint32_t> turns_{0};
  std::jthread thread_;
};

}  // namespace incise::app
