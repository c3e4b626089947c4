#include "server/app/network_sources.hpp"

#include <utility>

namespace incise::app {

NetworkSources::NetworkSources(const Config& config, input::PoseSources& sources,
                               [[maybe_unused]] stream::Server& server)
    : config_(config), sources_(sources) {
#ifdef INCISE_OPENIGTLINK
  if (config.openigtlink.wanted()) {
    input::OpenIgtLinkOptions options = config.openigtlink;
    options.engage_buttons = static_cast<std::uint32_t>(config.cut.engage_buttons);
    openigtlink_ = std::make_unique<input::OpenIgtLinkInput>(
        sources, std::move(options),
        input::SurfaceFeed{[&server] { return server.counters().state_hash; },
                           [&server](auto ready) { server.request_surface(std::move(ready)); }});
  }
#endif
}

void NetworkSources::start(haptics::ForceSlots& forces, const std::function<void()>& on_thread) {
#ifdef INCISE_OPENIGTLINK
  if (openigtlink_) openigtlink_->start();
#endif
  if (!config_.haply.url.empty()) {
    input::HaplyOptions options = config_.haply;
    options.on_thread = on_thread;
    haply_ = std::make_unique<input::HaplyInput>(sources_, forces, std::move(options));
  }
}

std::vector<input::NetworkStatus> NetworkSources::status() const {
  std::vector<input::NetworkStatus> all;
#ifdef INCISE_OPENIGTLINK
  if (openigtlink_) all.push_back(openigtlink_->status());
#endif
  if (haply_) all.push_back(haply_->status());
  return all;
}

std::string NetworkSources::place([[maybe_unused]] const Config& config) const {
#ifdef INCISE_OPENIGTLINK
  if (openigtlink_ && openigtlink_->port() != 0)
    return " openigtlink=" + config.openigtlink.address + ":" + std::to_string(openigtlink_->port());
#endif
  return "";
}

void NetworkSources::stop() {
  if (haply_) haply_->stop();
#ifdef INCISE_OPENIGTLINK
  if (openigtlink_) openigtlink_->stop();
#endif
}

}  // namespace incise::app
