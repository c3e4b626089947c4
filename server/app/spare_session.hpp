#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <thread>

#include "server/core/cut/cut_config.hpp"
#include "server/core/mesh/mesh_data.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/stream/mirror.hpp"

namespace incise::app {

// What a reset begins with, built beside the loop and ahead of time: a session of the mesh as loaded, and the mirror of it. So a reset
// costs the loop the exchange of a pointer.
//
// Thread: take() and give_back() from the loop's; the rest from one. Owns: a thread that builds and destroys sessions, one that waits
// and the mirror.
class SpareSession {
 public:
  // Mesh and configuration must outlive this. `origins`: InitialState::origins.
  SpareSession(const core::MeshData& mesh, const core::CutConfig& config,
               std::shared_ptr<const protocol::OriginTree> origins = nullptr)
      : mesh_(mesh), config_(config), origins_(std::move(origins)) {}
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
  // What viewers are shown of each fresh session. After a take() that gave one.
  std::shared_ptr<const stream::Mirror> mirror() const { return mirror_; }

 private:
  void run(const std::stop_token& stop);

  const core::MeshData& mesh_;
  const core::CutConfig& config_;
  const std::shared_ptr<const protocol::OriginTree> origins_;
  std::shared_ptr<const stream::Mirror> mirror_;  // set before the first session is there, and not changed
  std::atomic<core::CutSession*> spare_{nullptr}, used_{nullptr};
  std::atomic<std::uint32_t> turns_{0};
  std::jthread thread_;
};

}  // namespace incise::app
