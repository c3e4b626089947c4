#include "server/app/certificate_check.hpp"

#include <utility>

#include "server/stream/tls.hpp"

namespace incise::app {

std::vector<std::string> certificate_warnings(const Config& config, std::int64_t now_unix_s) {
  std::vector<std::string> warnings;
  for (const auto& [key, name] : {std::pair{"listen.certificate_file", config.listen.certificate_file},
                                  {"cluster.certificate_file", config.cluster.certificate_file}}) {
    if (name.empty()) continue;
    const std::string path = config.resolve(name).string();
    const std::string wrong = stream::validity_warning(path, now_unix_s);
    if (!wrong.empty())
      warnings.push_back(std::string(key) + ": " + path + ": " + wrong +
                         "; renew it, and restart what uses it");
  }
  return warnings;
}

}  // namespace incise::app
