#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "protocol/messages.hpp"
#include "server/replay/replay.hpp"
#include "server/stream/mirror.hpp"

namespace incise::wasm {

// A capture that one viewer replays on a copy of the body. Times are of the caller's clock, ns.
class LocalReplay {
 public:
  struct Events {
    std::function<void()> restarted;                              // the mirror has another state
    std::function<void(const stream::Mirror::Applied&)> stepped;  // it has gone on by one revision
  };
  // Shows the uncut body at once. `epoch` names the run of ids.
  // `origins`: of boundary faces; null where the body has none.
  LocalReplay(std::string name, replay::Replay replay, std::uint64_t epoch,
              std::shared_ptr<const protocol::OriginTree> origins, Events events);

  void control(const protocol::ReplayControl& wish, std::int64_t now_ns);
  // Applies what is due. Whether it did something.
  bool work(std::int64_t now_ns);
  // When work() has something to do; none: not before the next wish.
  std::optional<std::int64_t> due_ns() const;

  const stream::Mirror& mirror() const { return mirror_; }
  // `first`: says what there is in the recording, too.
  protocol::ReplayState state(bool first = false) const;

 private:
  void show();
  bool advance(bool tell);
  void seek(std::uint64_t revision);

  std::string name_;
  replay::Replay replay_;
  std::uint64_t epoch_;
  std::shared_ptr<const protocol::OriginTree> origins_;
  Events events_;
  stream::Mirror mirror_;
  stream::PublishedDelta delta_;
  bool playing_ = false;
  float speed_ = 1;
  // While it plays: the recording's clock read `from_ns_` at the time `since_ns_`.
  std::int64_t from_ns_ = 0, since_ns_ = 0;
};

}  // namespace incise::wasm
