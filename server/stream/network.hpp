#pragma once

#include <boost/asio/ip/address.hpp>
#include <string>

namespace incise::stream {

// Who an address counts as where addresses are limited: an IPv4 address as itself, also where it came through a
// socket for IPv6; an IPv6 address by its first 64 bits, which are one subscriber's.
std::string network_of(const boost::asio::ip::address& address);

}  // namespace incise::stream
