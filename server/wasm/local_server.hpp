#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "protocol/capture.hpp"
#include "protocol/messages.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/stream/mirror.hpp"
#include "server/wasm/body_file.hpp"
#include "server/wasm/local_replay.hpp"
#include "server/wasm/recording.hpp"
#include "server/wasm/session_config.hpp"

namespace incise::wasm {

// A session and those who follow it, without threads, files or a network: what incised is for the page in a browser, over
// messages of the same protocol. It serves one user, who trusts it: no tokens, no resuming, no coalescing, no boxes, no
// simulator, no forces.
//
// Thread: one. Owns: the session, its mirror, its recording, the replays.
class LocalServer {
 public:
  // The world around it. Nothing here calls back into the server.
  class Host {
   public:
    virtual void send(std::uint32_t peer, std::span<const std::byte> message) = 0;
    virtual void close(std::uint32_t peer) = 0;  // after Bye
    // A viewer wants this capture: offer_capture() is expected.
    virtual void fetch_capture(const std::string& name) = 0;
    virtual std::int64_t now_ns() = 0;  // never goes back
    virtual std::int64_t unix_ns() = 0;
    virtual std::uint64_t random() = 0;

   protected:
    ~Host() = default;
  };

  // `header`: of a capture with the session's configuration and body. Throws std::runtime_error.
  LocalServer(BodyFile body, const protocol::CaptureHeader& header, Host& host);
  ~LocalServer();

  void open(std::uint32_t peer);
  void receive(std::uint32_t peer, std::span<const std::byte> message);
  void closed(std::uint32_t peer);
  // Cuts and replays until `until_ns`, at least a slice. When it wants to be called again; none: not before a message.
  std::optional<std::int64_t> work(std::int64_t until_ns);
  // To be called once a second: the figures.
  void tick();

  // Everything so far, as a closed capture.
  std::vector<std::byte> capture() const { return recording_->capture(); }
  // Answers fetch_capture(): the capture, or for the user why there is none.
  void offer_capture(const std::string& name, std::span<const std::byte> bytes);
  void miss_capture(const std::string& name, const std::string& why);

  const core::MeshData& body() const { return body_.mesh; }

 private:
  struct Peer;
  // What a viewer who replays a capture, or waits for one, has.
  struct Playing;

  void dispatch(std::uint32_t number, Peer& peer, const protocol::Message& message);
  void on_hello(std::uint32_t number, Peer& peer, const protocol::Hello& hello, std::uint64_t sequence);
  bool take_blade(std::uint32_t number, Peer& peer, const protocol::Hello& hello, std::uint64_t sequence);
  void release_blade(Peer& peer);
  void on_poses(Peer& peer, const protocol::PoseBatch& batch);
  void on_stroke(std::uint32_t number, Peer& peer, const protocol::StrokeControl& control,
                 std::uint64_t sequence);
  void on_replay(std::uint32_t number, Peer& peer, const protocol::ReplayControl& control,
                 std::uint64_t sequence);
  template <class What>
  void answer_wanted(const std::string& name, What what);
  void begin_replay(std::uint32_t number, Peer& peer, const std::string& name,
                    std::span<const std::byte> bytes);
  void end_replay(std::uint32_t number, Peer& peer);
  void reset();
  void undo(std::uint32_t number, std::uint64_t sequence);
  void commit_all();
  // After the session was replaced: the blades in it, and everybody's picture.
  void welcome_again();

  void send(std::uint32_t peer, const protocol::Body& body);
  void complain(std::uint32_t peer, protocol::ErrorCode code, const std::string& text,
                std::uint64_t sequence);
  void refuse(std::uint32_t peer, protocol::ErrorCode code, const std::string& text, std::uint64_t sequence);
  void finish(std::uint32_t peer, protocol::ByeReason reason, const std::string& text);
  void send_welcome(std::uint32_t number, const Peer& peer);
  void send_snapshot(std::uint32_t number, const Peer& peer, protocol::SnapshotCause cause);
  void send_step(std::uint32_t number, const Peer& peer, const stream::Mirror::Applied& step,
                 const stream::Mirror& mirror);
  const stream::Mirror& mirror_of(const Peer& peer) const;

  void begin_session();
  void show_session();
  void commit();
  std::int64_t arrival_of_batch();
  void record(const protocol::CaptureRecord& record);

  BodyFile body_;
  SessionConfig config_;
  Host& host_;
  std::unique_ptr<core::CutSession> session_;
  std::uint64_t epoch_ = 0;
  stream::Mirror mirror_;
  stream::PublishedDelta delta_;
  std::map<std::uint32_t, Peer> peers_;
  std::array<std::deque<std::pair<std::int64_t, std::int64_t>>, core::kMaxSources>
      arrivals_;  // of poses: source time, ours
  std::optional<Recording> recording_;
  // The session's strokes, in their order.
  struct Stroke {
    protocol::UndoRecord undo;  // that undoes it; without session and arrival
    bool has_cut = false;
  };
  std::vector<Stroke> strokes_;
  // Figures.
  std::int64_t began_ns_, busy_ns_ = 0;
  std::uint64_t poses_accepted_ = 0, poses_rejected_ = 0;
};

}  // namespace incise::wasm
