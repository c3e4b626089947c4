#pragma once

#include <boost/asio/awaitable.hpp>
#include <memory>

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

}  // namespace incise::relay
