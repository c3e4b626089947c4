#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace incise::stream {

// Whether a page from `origin` may open a WebSocket at `host`, both as the request's headers give them. The server's
// own pages may: same host and port, where the host is an address or "localhost", because the owner of any other name
// can make it point here. A request without an origin does not come from a browser.
bool origin_allowed(std::string_view origin, std::string_view host, const std::vector<std::string>& allowed);

}  // namespace incise::stream
