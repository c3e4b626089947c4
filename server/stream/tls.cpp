#include "server/stream/tls.hpp"

#include <stdexcept>

namespace incise::stream {

void load_certificate(boost::asio::ssl::context& tls, const std::string& certificate_file,
                      const std::string& private_key_file) {
  namespace ssl = boost::asio::ssl;
  tls.set_options(ssl::context::default_workarounds | ssl::context::no_sslv2 | ssl::context::no_sslv3 |
                  ssl::context::no_tlsv1 | ssl::context::no_tlsv1_1);
  boost::system::error_code error;
  tls.use_certificate_chain_file(certificate_file, error);
  if (error) {
    throw std::runtime_error("listen.certificate_file: " + certificate_file + ": " + error.message() +
                             "; give a chain of certificates in PEM");
  }
  tls.use_private_key_file(private_key_file, ssl::context::pem, error);
  if (error) {
    throw std::runtime_error("listen.private_key_file: " + private_key_file + ": " + error.message() +
                             "; give the private key, in PEM, of " + certificate_file);
  }
}

}  // namespace incise::stream
