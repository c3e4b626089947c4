#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "server/app/config.hpp"
#include "server/haptics/force_slot.hpp"
#include "server/input/pose_sources.hpp"
#include "server/stream/server.hpp"

namespace incise::app {

// The configured sources of poses on the network: OpenIGTLink peers, Haply's service.
class NetworkSources {
 public:
  // Takes the port of OpenIGTLink; throws std::runtime_error where it cannot. All must outlive this; `server` is not used before start().
  NetworkSources(const Config& config, input::PoseSources& sources, stream::Server& server);
  // `on_thread` is called first in Haply's thread. `forces` must outlive this.
  void start(haptics::ForceSlots& forces, const std::function<void()>& on_thread);
  std::vector<input::NetworkStatus> status() const;
  // Where OpenIGTLink listens, for the line that the server prints at the start: " openigtlink=address:port"; empty: nowhere.
  std::string place(const Config& config) const;
  void stop();

 private:
  const Config& config_;
  input::PoseSources& sources_;
#ifdef INCISE_OPENIGTLINK
  std::unique_ptr<input::OpenIgtLinkInput> openigtlink_;
#endif
  std::unique_ptr<input::HaplyInput> haply_;
};

}  // namespace incise::app
