#include "server/app/advertised.hpp"

#include <unistd.h>

namespace incise::app {

std::string advertised(const Config& config, std::uint16_t port, bool web) {
  if (port == 0) return "";
  std::string host = config.cluster.advertise.empty() ? config.listen.address : config.cluster.advertise;
  if (host == "0.0.0.0" || host == "::") {
    char name[256] = {};
    gethostname(name, sizeof name - 1);
    host = name;
  }
  if (host.find(':') != std::string::npos) host = "[" + host + "]";
  const bool tls = !config.listen.certificate_file.empty();
  return std::string(web   ? tls ? "https://" : "http://"
                     : tls ? "tls://"
                           : "tcp://") +
         host + ":" + std::to_string(port);
}

}  // namespace incise::app
