#pragma once

#include <boost/system/error_code.hpp>
#include <cstdint>
#include <stdexcept>
#include <string>

namespace incise::net {

// What to throw where a port cannot be listened on: why, and what to do about it. `key` is the configuration's name of the port.
std::runtime_error cannot_listen(const std::string& key, const std::string& address, std::int64_t port,
                                 const boost::system::error_code& error);

}  // namespace incise::net
