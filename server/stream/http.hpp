#pragma once

#include <boost/asio/awaitable.hpp>

#include "server/stream/peer.hpp"
#include "server/stream/static_files.hpp"
#include "server/stream/transport.hpp"

namespace incise::stream {

// Serves one connection of the HTTP port until it ends: /healthz and the viewer's files for everybody, /stats,
// /metrics, /captures, /sessions and Providers::documents for holders of a token (where the server has tokens), and /ws, which makes it a peer.
asio::awaitable<void> serve_http(PeerContext& context, PeerDirectory& peers, const StaticFiles& files,
                                 NetStream stream, Ticket ticket);

}  // namespace incise::stream
