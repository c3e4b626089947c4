// Keys of what clients meet: ports, access and limits, the stream, the capture, the log.
#include "server/app/config/config_key.hpp"

namespace incise::app {
namespace {

constexpr const char* kPathOrNone = "a path, relative to this file; or \"\"";

ConfigKeys access_keys() {
  return {
      text("listen.address", INCISE_FIELD(listen.address), "an IP address",
           "Where clients connect. Beyond loopback it needs listen.token_file and a certificate, or "
           "listen.insecure."),
      integer("listen.tcp_port", INCISE_FIELD(listen.tcp_port), -1, 65535,
              "Port of the binary protocol; 0: any free one, -1: off."),
      integer("listen.http_port", INCISE_FIELD(listen.http_port), -1, 65535,
              "Port of WebSocket, the viewer page, /stats and /metrics; 0: any free one, -1: off."),
      text("listen.viewer_directory", INCISE_FIELD(listen.viewer_directory), kPathOrNone,
           "Static files that the HTTP port serves; \"\": the viewer that was built with the program."),
      texts("listen.allowed_origins", INCISE_FIELD(listen.allowed_origins), "a list of texts",
            "Origins of web pages that may connect besides the server's own; \"*\": any."),
      text("listen.token_file", INCISE_FIELD(listen.token_file), kPathOrNone,
           "JSON: [{\"token\": \"...\", \"roles\": [\"viewer\", \"operator\", \"simulator\", \"admin\", "
           "\"metrics\"]}, ...]. With one, nobody enters without a token, nor reads /stats, /metrics or "
           "/captures; \"metrics\" opens the first two alone."),
      text("listen.certificate_file", INCISE_FIELD(listen.certificate_file), kPathOrNone,
           "PEM; with it and the key both ports speak TLS."),
      text("listen.private_key_file", INCISE_FIELD(listen.private_key_file), kPathOrNone, "PEM."),
      boolean("listen.insecure", INCISE_FIELD(listen.insecure),
              "Listen beyond loopback without tokens and TLS: anyone who reaches the port may cut, watch and "
              "reset."),
  };
}

ConfigKeys limit_keys() {
  return {
      integer("listen.max_sessions", INCISE_FIELD(listen.max_sessions), 1, 100'000, "Clients at once."),
      integer("listen.max_handshakes", INCISE_FIELD(listen.max_handshakes), 1, 10'000,
              "Connections at once that have not introduced themselves; one more, and the oldest is closed."),
      number("listen.handshake_timeout_s", INCISE_FIELD(listen.handshake_timeout_s), 0.1, 600,
             "Time for a client to introduce itself."),
      number("listen.idle_timeout_s", INCISE_FIELD(listen.idle_timeout_s), 1, 86'400,
             "A client that is silent for longer is disconnected; before that it is pinged."),
      number("listen.write_timeout_s", INCISE_FIELD(listen.write_timeout_s), 0.1, 600,
             "Time for one message to go out to a client."),
      number("listen.stop_grace_s", INCISE_FIELD(listen.stop_grace_s), 0, 60,
             "When the server stops: time for clients to receive what was published."),
      integer("listen.max_messages_per_s", INCISE_FIELD(listen.max_messages_per_s), 1, 1'000'000,
              "Messages a second from one client, not counting poses."),
  };
}

}  // namespace

ConfigKeys listen_keys() {
  ConfigKeys keys = access_keys();
  for (ConfigKey& key : limit_keys()) keys.push_back(std::move(key));
  return keys;
}

ConfigKeys stream_keys() {
  return {
      integer("stream.ring_bytes", INCISE_FIELD(stream.ring_bytes), 1 << 16, std::int64_t{1} << 36,
              "Deltas kept for clients that return or fall behind."),
      integer(
          "stream.outbox_bytes", INCISE_FIELD(stream.outbox_bytes), 1 << 16, std::int64_t{1} << 32,
          "How much may wait to be sent to one client; beyond that, it gets coalesced deltas or a snapshot."),
      integer("stream.max_slow_snapshots", INCISE_FIELD(stream.max_slow_snapshots), 1, 1000,
              "A client that needs this many snapshots in a row without catching up is disconnected."),
      number("stream.max_report_rate_hz", INCISE_FIELD(stream.max_report_rate_hz), 1, 1000,
             "Pose reports a second to an operator."),
  };
}

ConfigKeys capture_keys() {
  return {
      text("capture.path", INCISE_FIELD(capture.path), kPathOrNone,
           "Where to record the poses that the loop has used and the marks of its batches; \"\": nowhere, "
           "and then no stroke can be undone."),
      word("capture.sync", {"none", "group", "always"}, INCISE_FIELD(capture.sync),
           "When recorded data must be on the disk: when the system decides, every capture.sync_interval_ms, "
           "or at once."),
      number("capture.sync_interval_ms", INCISE_FIELD(capture.sync_interval_ms), 1, 60'000,
             "With \"group\": the most that a power failure may lose."),
      text("capture.library", INCISE_FIELD(capture.library), kPathOrNone,
           "A directory of captures (*.capture) that anyone who may watch can replay in the viewer; \"\": "
           "none."),
      number("capture.checkpoint_replay_s", INCISE_FIELD(capture.checkpoint_replay_s), 0, 3600,
             "How much work, in seconds, incised --resume has to replay at most, about: checkpoints beside "
             "the capture are written that often. They cost a second copy of the mesh and of that work, at "
             "low priority. 0: no checkpoints."),
      number("capture.keep_free_percent", INCISE_FIELD(capture.keep_free_percent), 0, 90,
             "Recording stops, as on a full disk, while less than this share of the capture's file system is "
             "free. 0: the capture may fill it."),
  };
}

ConfigKeys log_keys() {
  return {
      word("log.level", {"trace", "debug", "info", "warning", "error", "off"}, INCISE_FIELD(log.level),
           "The least important messages that are logged."),
      word("log.format", {"text", "json"}, INCISE_FIELD(log.format),
           "Lines for people, or one JSON object a line."),
  };
}

}  // namespace incise::app
