// What a single key's value cannot show: whether keys fit together, and whether the files that they name can be used.
#include <unistd.h>

#include <algorithm>
#include <boost/asio/ip/address.hpp>
#include <boost/asio/ssl/context.hpp>
#include <fstream>
#include <set>

#include "server/app/body.hpp"
#include "server/app/config/config_key.hpp"
#include "server/app/nats_options.hpp"
#include "server/app/token_file.hpp"
#include "server/cluster/session_subjects.hpp"
#include "server/input/hid/json_node.hpp"
#include "server/stream/tls.hpp"

namespace incise::app {
namespace {

using input::shown;
using input::text_of;
using Path = std::filesystem::path;

// "host:port".
bool is_place(const std::string& text) {
  const std::size_t colon = text.rfind(':');
  if (colon == std::string::npos || colon == 0 || text.size() - colon > 6) return false;
  const std::string port = text.substr(colon + 1);
  return !port.empty() && port.find_first_not_of("0123456789") == std::string::npos && std::stoi(port) > 0 &&
         std::stoi(port) <= 65535;
}

// Refuses a path at which there is no readable file.
void check_readable(const Config& config, const std::string& file, const std::string& key,
                    const std::string& value) {
  if (value.empty()) return;
  const Path path = config.resolve(value);
  std::error_code error;
  int why = 0;
  if (!std::ifstream(path)) {
    why = errno;
  } else if (std::filesystem::is_directory(path, error)) {
    why = EISDIR;
  }
  if (why != 0) {
    refuse(file, key, shown(value) + " (" + path.string() + ": " + std::generic_category().message(why) + ")",
           "a file that can be read");
  }
}

// Refuses a path that is not a folder, or a folder that cannot be read.
void check_folder(const std::string& file, const std::string& key, const Path& folder) {
  std::error_code error;
  int why = 0;
  if (!std::filesystem::is_directory(folder, error)) {
    why = ENOTDIR;
  } else if (access(folder.c_str(), R_OK | X_OK) != 0) {
    why = errno;
  }
  if (why != 0)
    refuse(file, key, folder.string() + ": " + std::generic_category().message(why),
           "a folder that can be read");
}

void check_secrets(const Config& config, const std::string& file) {
  const Config::Listen& listen = config.listen;
  try {
    if (!listen.token_file.empty()) read_tokens(config.resolve(listen.token_file));
    if (!listen.certificate_file.empty()) {
      boost::asio::ssl::context scratch(boost::asio::ssl::context::tls_server);
      stream::load_certificate(scratch, config.resolve(listen.certificate_file).string(),
                               config.resolve(listen.private_key_file).string());
    }
  } catch (const std::runtime_error& error) {
    throw ConfigError(file + ": " + error.what());
  }
}

// A folder that does not exist (yet) counts as empty.
void check_folder_if_there(const Config& config, const std::string& file, const std::string& key,
                           const std::string& value) {
  const Path folder = config.resolve(value);
  std::error_code error;
  if (!folder.empty() && std::filesystem::exists(folder, error)) check_folder(file, key, folder);
}

void check_files(const Config& config, const std::string& file) {
  Path node = config.resolve(config.mesh.path);
  node += ".node";
  std::error_code error;
  if (config.mesh.phantom.empty() && !std::filesystem::exists(node, error))
    check_readable(config, file, "mesh.path", config.mesh.path);
  check_readable(config, file, "mesh.image", config.mesh.image);
  check_folder_if_there(config, file, "capture.library", config.capture.library);
  device_profiles(config);
}

bool is_loopback(const std::string& address) {
  return address.starts_with("127.") || address == "::1" || address == "localhost";
}

// What the servers of both programs need.
void check_listen(const Config& config, const std::string& file) {
  const Config::Listen& listen = config.listen;
  check_readable(config, file, "listen.token_file", listen.token_file);
  check_readable(config, file, "listen.certificate_file", listen.certificate_file);
  check_readable(config, file, "listen.private_key_file", listen.private_key_file);
  check_secrets(config, file);
  check_folder_if_there(config, file, "listen.viewer_directory", listen.viewer_directory);
  boost::system::error_code no_address;
  boost::asio::ip::make_address(listen.address, no_address);
  if (no_address) refuse(file, "listen.address", shown(listen.address), "an IP address such as 127.0.0.1");
  if (!is_loopback(listen.address) && !listen.insecure &&
      (listen.token_file.empty() || listen.certificate_file.empty())) {
    refuse(file, "listen.address", shown(listen.address),
           "a loopback address, or any if listen.token_file and listen.certificate_file are given, or "
           "listen.insecure is true");
  }
}

}  // namespace

void check_together(const Config& config, const std::string& file) {
  if (!config.mesh.path.empty() && !config.mesh.phantom.empty()) {
    refuse(file, "mesh.phantom", shown(config.mesh.phantom), "\"\" if mesh.path is given");
  }
  if (!config.mesh.phantom.empty() && config.mesh.target_tets < 500) {
    refuse(file, "mesh.target_tets", std::to_string(config.mesh.target_tets), "500 or more for a phantom");
  }
  declared_fields(config, file);
  if (config.cut.blade.heel == config.cut.blade.tip) {
    refuse(file, "blade.tip", shown(point_json(config.cut.blade.tip)), "a point that is not the heel");
  }
  const haptics::SafetyLimits& limits = config.haptics.force.limits;
  if (limits.slew_n_s < limits.most_n / limits.decay_s) {
    refuse(file, "haptics.slew_n_s", text_of(limits.slew_n_s),
           "a number from " + text_of(limits.most_n / limits.decay_s) + ", 100 times haptics.max_force_n");
  }
  if (config.haptics.force.resists && !config.haptics.forces)
    refuse(file, "cut.engage", "\"resistance\" while haptics.forces is false",
           "\"resistance\" with forces, which decide when tissue yields, or \"buttons\" or \"always\"");
  if (config.listen.certificate_file.empty() != config.listen.private_key_file.empty()) {
    const bool key = config.listen.private_key_file.empty();
    refuse(file, key ? "listen.private_key_file" : "listen.certificate_file", "\"\"",
           key ? "a path if listen.certificate_file is given" : "a path if listen.private_key_file is given");
  }
  if (config.listen.tcp_port > 0 && config.listen.tcp_port == config.listen.http_port) {
    refuse(file, "listen.http_port", std::to_string(config.listen.http_port),
           "a port other than listen.tcp_port");
  }
  if (config.openigtlink.connect.size() > 8)
    refuse(file, "openigtlink.connect", std::to_string(config.openigtlink.connect.size()) + " places",
           "8 at most");
  for (const std::string& place : config.openigtlink.connect) {
    if (!is_place(place)) refuse(file, "openigtlink.connect", shown(place), "\"host:port\"");
  }
  const std::string& url = config.haply.url;
  if (!url.empty() && !(url.starts_with("ws://") && is_place(url.substr(5, url.find('/', 5) - 5)))) {
    refuse(file, "haply.url", shown(url), "\"ws://host:port\", or \"\"");
  }
  if (config.haply.source.empty() || config.haply.source.size() > 48)
    refuse(file, "haply.source", shown(config.haply.source), "a text of 1 to 48 characters");
}

namespace {

void check_nats(const Config& config, const std::string& file) {
  const Config::Cluster& cluster = config.cluster;
  if (const std::string bad = cluster::trouble_of_urls(cluster.nats); !bad.empty())
    refuse(file, "cluster.nats", bad, "\"nats://host:port\" or \"tls://host:port\", several with commas");
  if (!cluster::is_protected(nats_options(config)) && !config.listen.insecure) {
    refuse(file, "cluster.nats", shown(cluster.nats),
           "tls://host:port beyond loopback, or any if listen.insecure is true");
  }
  if (cluster.certificate_file.empty() != cluster.private_key_file.empty()) {
    refuse(file, cluster.certificate_file.empty() ? "cluster.certificate_file" : "cluster.private_key_file",
           "\"\"", "both or neither of cluster.certificate_file and cluster.private_key_file");
  }
  check_readable(config, file, "cluster.credentials_file", cluster.credentials_file);
  check_readable(config, file, "cluster.ca_file", cluster.ca_file);
  check_readable(config, file, "cluster.certificate_file", cluster.certificate_file);
  check_readable(config, file, "cluster.private_key_file", cluster.private_key_file);
  if (cluster.credentials_file.empty()) return;
  try {
    cluster::read_credentials(config.resolve(cluster.credentials_file));
  } catch (const std::runtime_error& error) {
    throw ConfigError(file + ": cluster.credentials_file: " + error.what());
  }
}

void check_cluster(const Config& config, const std::string& file) {
  const Config::Cluster& cluster = config.cluster;
  if (cluster.nats.empty()) {
    if (cluster.failover) refuse(file, "cluster.failover", "true", "false without cluster.nats");
    return;
  }
  check_nats(config, file);
  if (!cluster::is_session_name(cluster.name))
    refuse(file, "cluster.name", shown(cluster.name), "1 to 64 letters, digits, \"-\" and \"_\"");
  if (2 * cluster.join_megabytes >= cluster.stream_megabytes) {
    refuse(file, "cluster.stream_megabytes", std::to_string(cluster.stream_megabytes),
           "more than twice cluster.join_megabytes");
  }
  if (cluster.failover && config.capture.path.empty())
    refuse(file, "cluster.failover", "true", "true with capture.path, on storage that all instances share");
}

}  // namespace

cluster::NatsOptions nats_options(const Config& config) {
  const Config::Cluster& cluster = config.cluster;
  return {cluster.nats,
          "incised " + cluster.name,
          config.resolve(cluster.credentials_file),
          config.resolve(cluster.ca_file),
          config.resolve(cluster.certificate_file),
          config.resolve(cluster.private_key_file)};
}

void check_config(const Config& config, const std::string& file) {
  if (config.mesh.path.empty() && config.mesh.phantom.empty()) {
    refuse(file, "mesh.path", "nothing",
           "the path of a mesh, or for a generated body mesh.phantom (\"liver\"); what --print-config prints "
           "leaves the body to you");
  }
  check_files(config, file);
  check_cluster(config, file);
#ifndef INCISE_OPENIGTLINK
  if (config.openigtlink.wanted()) {
    refuse(file, config.openigtlink.port >= 0 ? "openigtlink.port" : "openigtlink.connect", "a value",
           "none: this program was built without OpenIGTLink");
  }
#endif
  if (config.openigtlink.port >= 0 && !is_loopback(config.openigtlink.address) && !config.listen.insecure) {
    refuse(file, "openigtlink.address", shown(config.openigtlink.address),
           "a loopback address, or any if listen.insecure is true");
  }
  check_listen(config, file);
}

void check_relay_config(const Config& config, const std::string& file) {
  const Config::Relay& relay = config.relay;
  if (relay.upstream.empty() == relay.sessions.empty()) {
    refuse(file, "relay.upstream", shown(relay.upstream),
           relay.sessions.empty() ? "the server to follow, HOST:PORT, or relay.sessions"
                                  : "\"\" if relay.sessions is given");
  }
  if (!config.cluster.nats.empty()) check_nats(config, file);
  for (const Config::Relay::Session& session : relay.all(config.listen)) {
    if (!session.nats_session().empty() && config.cluster.nats.empty())
      refuse(file, "cluster.nats", "\"\"", "where NATS is, since " + session.upstream + " is followed there");
  }
  std::set<std::int64_t> ports;
  for (const Config::Relay::Session& session : relay.sessions) {
    for (const std::int64_t port : {session.tcp_port, session.http_port}) {
      if (port > 0 && !ports.insert(port).second)
        refuse(file, "relay.sessions", "port " + std::to_string(port) + " twice", "a port for each, or 0");
    }
  }
  check_readable(config, file, "relay.token_file", relay.token_file);
  check_readable(config, file, "relay.ca_file", relay.ca_file);
  check_listen(config, file);
}

}  // namespace incise::app
