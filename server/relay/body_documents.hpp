#pragma once

#include <boost/asio/awaitable.hpp>
#include <memory>
#include <string>

#include "protocol/surface_asset.hpp"
#include "server/relay/upstream.hpp"
#include "server/stream/providers.hpp"

namespace incise::relay {

// What an origin's HTTP port serves of the surface that its body was filled from: the asset, its images, and what finds the origins of
// faces.
struct FetchedSurface {
  stream::Documents documents;
  std::shared_ptr<const protocol::OriginTree> origins;
};
// `facts` are Welcome's. Throws std::runtime_error: no answer, or another one than is due.
boost::asio::awaitable<FetchedSurface> fetch_surface(Origin origin, protocol::SurfaceFacts facts);

// "/look.json" and what it names (PROTOCOL.md, section 5): only the former where it is what `held` has of it; nothing where the origin
// has none. Throws std::runtime_error as fetch_surface() does.
boost::asio::awaitable<stream::Documents> fetch_look(Origin origin, std::string held);

}  // namespace incise::relay
