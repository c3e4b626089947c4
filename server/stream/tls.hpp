#pragma once

#include <boost/asio/ssl/context.hpp>
#include <cstdint>
#include <string>

namespace incise::stream {

// Sets up TLS 1.2 and above with a certificate and its key, both PEM files. Throws std::runtime_error that names the
// configuration's key.
void load_certificate(boost::asio::ssl::context& tls, const std::string& certificate_file,
                      const std::string& private_key_file);

// What is wrong with a PEM file's first certificate at a Unix time: it has expired, is not valid yet, or expires within 14 days; "": nothing, or
// it cannot be read. Clients refuse one that is not valid, and it is read at the start only.
std::string validity_warning(const std::string& certificate_file, std::int64_t now_unix_s);

}  // namespace incise::stream
