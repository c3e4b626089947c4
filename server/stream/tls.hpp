#pragma once

#include <boost/asio/ssl/context.hpp>
#include <string>

namespace incise::stream {

// Sets up TLS 1.2 and above with a certificate and its key, both PEM files. Throws std::runtime_error that names the
// configuration's key.
void load_certificate(boost::asio::ssl::context& tls, const std::string& certificate_file,
                      const std::string& private_key_file);

}  // namespace incise::stream
