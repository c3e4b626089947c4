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
  // `on_thread` is called first in Haply's thread. The others must outlive this.
  NetworkSources(const Config& config, input::PoseSources& sources, haptics::ForceSlots& forces,
                 stream::Server& server, const std::function<void()>& on_thread);
  std::vector<input::NetworkStatus> status() const;
  // Where OpenIGTLink listens, for the line that the server prints at the start: " openigtlink=address:port"; empty: nowhere.
  std::string place(const Config& config) const;
  void stop();

 private:
#ifdef INCISE_OPENIGTLINK
  std::unique_ptr<input::OpenIgtLinkInput> openigtlink_;
#endif
  std::unique_ptr<input::HaplyInput> haply_;
};

}  // namespace incise::app
