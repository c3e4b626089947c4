#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace incise::stream {

// Whether a page from `origin` may open a WebSocket at `host`, both as the request's headers give them. A
// page of the server's own may, which means: same host and port, and the host an address or "localhost",
// because any name can be made to point here by whoever owns it. No origin: not a browser.
bool origin_allowed(std::string_view origin, std::string_view host, const std::vector<std::string>& allowed);

}  // namespace incise::stream
