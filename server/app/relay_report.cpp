#include "server/app/relay_report.hpp"

#include <nlohmann/json.hpp>

#include "server/app/telemetry.hpp"
#include "server/app/version.hpp"
#include "server/base/hex.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;

// What the origin said; an object, whatever that was. What is nested deeper than a server's is left out, since writing it takes as
// deep a stack.
Json origin_json(const std::string& text) {
  constexpr int kMaxDepth = 16;
  const auto shallow = [](int depth, Json::parse_event_t, Json&) { return depth < kMaxDepth; };
  Json json = Json::parse(text, shallow, false);
  return json.is_object() ? json : Json::object();
}

Json relay_json(const relay::Session& session, const relay::Figures& figures) {
  Json json{{"session", session.name()},
            {"upstream", figures.upstream},
            {"hops", figures.hops},
            {"connected", figures.connected},
            {"trouble", figures.trouble},
            {"round_trip_ms", figures.round_trip_ms},
            {"connections", figures.welcomes},
            {"resumed", figures.resumed},
            {"epochs", figures.epochs},
            {"snapshots", figures.snapshots},
            {"deltas", figures.deltas},
            {"combined", figures.combined},
            {"refused", figures.refused}};
  json["operators"] = Json::array();
  for (const relay::Figures::Operator& held : figures.operators) {
    json["operators"].push_back(
        {{"name", held.source_name}, {"source", held.source}, {"round_trip_ms", held.round_trip_ms}});
  }
  return json;
}

}  // namespace

std::string relay_stats_json(const relay::Session& session) {
  const relay::Figures figures = session.figures();
  const stream::StreamCounters counters = session.counters();
  Json root = origin_json(figures.origin.json);
  Json relay = relay_json(session, figures);
  root["software"] = kSoftware;
  root["revision"] = counters.revision;
  root["state_hash"] = hex(counters.state_hash);
  root["access"] = access_json(counters);
  root["stream"] = stream_json(counters);
  root["relay"] = std::move(relay);
  // Names are what clients have sent.
  return root.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::string relay_metrics(const relay::Session& session) {
  const relay::Figures figures = session.figures();
  const stream::StreamCounters counters = session.counters();
  std::string out;
  const auto one = [&](const std::string& name, const char* type, const std::string& help, double value) {
    out += "# HELP incise_" + name + ' ' + help + "\n# TYPE incise_" + name + ' ' + type + "\nincise_" +
           name + ' ' + Json(value).dump() + '\n';
  };
  const auto count = [](std::uint64_t n) { return static_cast<double>(n); };
  one("revision", "gauge", "Committed batches and deformations since the mesh was loaded.",
      count(counters.revision));
  one("relay_connected", "gauge", "1 while the upstream is there.", figures.connected ? 1 : 0);
  one("relay_healthy", "gauge", "0 while viewers may be behind the origin.", figures.trouble.empty() ? 1 : 0);
  one("relay_round_trip_seconds", "gauge", "To the upstream and back.", 1e-3 * figures.round_trip_ms);
  one("relay_connections_total", "counter", "Connections to the upstream that were welcomed.",
      count(figures.welcomes));
  one("relay_resumed_total", "counter", "Of these, those that went on without a snapshot.",
      count(figures.resumed));
  one("relay_snapshots_total", "counter", "Whole states that came.", count(figures.snapshots));
  one("relay_deltas_total", "counter", "Deltas that came.", count(figures.deltas));
  one("relay_refused_total", "counter", "Messages that did not fit, or led to another hash than announced.",
      count(figures.refused));
  one("relay_operators", "gauge", "Blades at the origin that operators here hold.",
      count(figures.operators.size()));
  return out;
}

}  // namespace incise::app
