#pragma once

// A loop for tests: a CutSession behind an PeerInput, with deltas published to a Server. Small meshes, no
// frames.

#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "protocol/messages.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/stream/server.hpp"

namespace incise::stream {

// A box of n x n x n cubes of `cell` metres, six tetrahedra each, its low corner at the origin.
core::MeshData box_mesh(std::uint32_t n, double cell = 0.01);

// Fields of such a mesh: on the vertices "rest", where they are at rest, and "label"; on the tetrahedra "cell".
std::vector<core::Field> fields_of(const core::MeshData& mesh);

// A stroke right through that box in the plane y = `y`: engaged poses along x, the blade pointing down. Times
// rise from `t0_ns` by a millisecond.
std::vector<protocol::PoseSample> sweep(double y, int poses, std::int64_t t0_ns, double side = 0.1);

class MiniLoop final : public PeerInput {
 public:
  explicit MiniLoop(const core::MeshData& mesh, std::uint64_t session = 4711);
  ~MiniLoop() override;

  InitialState initial() const;
  ServerFacts facts() const;
  // Deltas go to `server` from here on.
  void attach(Server& server) { server_ = &server; }

  // Cuts with these poses, as source 0, and publishes what comes of it. From one thread, before start().
  void cut(const std::vector<protocol::PoseSample>& poses);
  // A thread takes what the operators send.
  void start();
  void stop();
  // While true nothing is taken from the queues.
  void hold(bool held) { held_ = held; }
  // Whether the poses that it takes count as recorded, too.
  void record(bool recorded) { recorded_ = recorded; }

  std::unique_ptr<PoseInput> open(std::string_view source_name,
                                  const std::optional<protocol::BladeEdge>& blade) override;
  bool is_held(std::string_view source_name) const override;
  std::vector<std::string> holders() const override;
  bool reset(const Later& later) override;
  // Is neither done nor refused until a test answers.
  std::string undo(const UndoRequest& request, const Answer& answer) override;
  std::vector<Answer> asked_undos() const;

  std::uint64_t revision() const { return revision_; }
  std::uint64_t state_hash() const;
  std::uint32_t live_tets() const { return live_tets_; }
  std::uint64_t strokes_ended() const { return strokes_ended_; }
  std::size_t open_count() const;

 private:
  class Source;
  struct Slot {
    std::string name;
    bool open = false, closing = false, end_stroke = false;
    std::vector<protocol::PoseSample> poses;
    PoseTotals totals;
  };
  void work();
  void feed(std::uint32_t source, const std::vector<protocol::PoseSample>& poses, PoseTotals& totals);
  void publish_all();

  core::MeshData mesh_;
  core::CutConfig config_;
  std::uint64_t session_id_;
  std::unique_ptr<core::CutSession> session_;
  Server* server_ = nullptr;
  std::atomic<std::uint64_t> revision_{0}, strokes_ended_{0}, hash_{0};
  std::atomic<std::uint32_t> live_tets_{0};
  std::atomic<bool> running_{false}, held_{false}, recorded_{false}, reset_{false};
  mutable std::mutex mutex_;
  std::array<Slot, core::kMaxSources> slots_;  // guarded by mutex_
  std::vector<Answer> undos_;                  // likewise
  std::thread thread_;
};

// Waits until `condition` holds; false after `seconds`.
bool eventually(const std::function<bool()>& condition, double seconds = 20);

StreamConfig test_config();

// A server on free loopback ports with a MiniLoop behind it.
struct TestServer {
  explicit TestServer(std::uint32_t n = 6, StreamConfig config = test_config(), Providers providers = {});
  ~TestServer();
  // Cuts `strokes` strokes and waits until the mirror has them.
  void cut(int strokes = 1);
  void wait_for_mirror();

  MiniLoop loop;
  Server server;
  int strokes = 0;
  double side;
};

}  // namespace incise::stream
