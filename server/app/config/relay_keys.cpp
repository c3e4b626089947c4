// Keys of incise-relay: which servers it follows.
#include <set>

#include "client/cli/commands.hpp"
#include "client/cli/usage.hpp"
#include "server/app/config/config_key.hpp"
#include "server/cluster/session_subjects.hpp"

namespace incise::app {
namespace {

constexpr const char* kPlace = "[tcp://|tls://|ws://|wss://]HOST[:PORT] or nats:SESSION";
constexpr const char* kSessionsAccepted =
    "a list of at most 64 objects {\"name\": a text of 1 to 64 letters, digits, \"-\", \"_\" and \".\", "
    "\"upstream\": as relay.upstream, \"tcp_port\", \"http_port\": as in listen, \"upstream_http_port\": as "
    "here} with "
    "different names";
constexpr std::size_t kMaxSessions = 64;

bool is_upstream(const std::string& text) {
  if (text.starts_with("nats:")) return cluster::is_session_name(text.substr(5));
  try {
    client::parse_address(text);
    return true;
  } catch (const client::UsageError&) {
    return false;
  }
}

bool is_name(const std::string& text) {
  return !text.empty() && text.size() <= 64 &&
         text.find_first_not_of("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_.") ==
             std::string::npos;
}

bool read_port(const Json& value, std::int64_t least, std::int64_t& port) {
  if (!value.is_number_integer() || value < least || value > 65535) return false;
  port = value.get<std::int64_t>();
  return true;
}

bool read_session(const Json& value, Config::Relay::Session& session) {
  if (!value.is_object()) return false;
  for (const auto& [key, given] : value.items()) {
    if (key == "name" || key == "upstream") {
      if (!given.is_string()) return false;
      (key == "name" ? session.name : session.upstream) = given.get<std::string>();
    } else if (key == "tcp_port") {
      if (!read_port(given, -1, session.tcp_port)) return false;
    } else if (key == "http_port") {
      if (!read_port(given, -1, session.http_port)) return false;
    } else if (key != "upstream_http_port" || !read_port(given, 1, session.upstream_http_port)) {
      return false;
    }
  }
  return is_name(session.name) && is_upstream(session.upstream);
}

bool read_sessions(const Json& value, Config& config) {
  if (!value.is_array() || value.size() > kMaxSessions) return false;
  std::vector<Config::Relay::Session> sessions(value.size());
  std::set<std::string> names;
  for (std::size_t i = 0; i < value.size(); ++i) {
    if (!read_session(value[i], sessions[i]) || !names.insert(sessions[i].name).second) return false;
  }
  config.relay.sessions = std::move(sessions);
  return true;
}

Json sessions_json(const Config& config) {
  Json list = Json::array();
  for (const Config::Relay::Session& session : config.relay.sessions) {
    list.push_back({{"name", session.name},
                    {"upstream", session.upstream},
                    {"tcp_port", session.tcp_port},
                    {"http_port", session.http_port},
                    {"upstream_http_port", session.upstream_http_port}});
  }
  return list;
}

}  // namespace

ConfigKeys relay_keys() {
  return {
      {"relay.upstream", std::string(kPlace) + ", or \"\" with relay.sessions",
       "The server to follow: an incised, or another relay. It is served at listen.tcp_port and "
       "listen.http_port. Without a port: 7450, or 7480 for ws and wss. nats:SESSION: what is published on "
       "cluster.nats by that name.",
       [](const Config& c) { return Json(c.relay.upstream); },
       [](Config& c, const Json& value) {
         if (!value.is_string()) return false;
         const auto place = value.get<std::string>();
         if (!place.empty() && !is_upstream(place)) return false;
         c.relay.upstream = place;
         return true;
       }},
      integer("relay.upstream_http_port", INCISE_FIELD(relay.upstream_http_port), 1, 65535,
              "Its HTTP port, from which textures come; with ws:// and wss:// it is that of relay.upstream."),
      text("relay.token_file", INCISE_FIELD(relay.token_file), "a path, relative to this file; or \"\"",
           "A file whose first line is the token for the servers above. Its roles bound what the relay's own "
           "clients can be: viewer, and operator and admin where they may be that."),
      text("relay.ca_file", INCISE_FIELD(relay.ca_file), "a path, relative to this file; or \"\"",
           "PEM of the authority that signed those servers' certificates; \"\": the system's."),
      {"relay.sessions", kSessionsAccepted,
       "Several servers, each at ports of its own; relay.upstream and the ports of listen are not used then.",
       sessions_json, [](Config& c, const Json& value) { return read_sessions(value, c); }},
  };
}

std::vector<Config::Relay::Session> Config::Relay::all(const Listen& ports) const {
  if (!sessions.empty()) return sessions;
  const bool on_nats = upstream.starts_with("nats:");
  return {{on_nats ? upstream.substr(5) : "session", upstream, ports.tcp_port, ports.http_port,
           upstream_http_port}};
}

}  // namespace incise::app
