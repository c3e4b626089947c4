// Keys of a server that is one of several: where NATS is, and what is published there.
#include "server/app/config/config_key.hpp"

namespace incise::app {

namespace {

constexpr const char* kPathOrNone = "a path, relative to this file; or \"\"";

// Also a relay's.
ConfigKeys nats_keys() {
  return {
      text(
          "cluster.nats", INCISE_FIELD(cluster.nats),
          "\"nats://host:port\", \"tls://host:port\", several with commas; or \"\"",
          "The NATS servers on which sessions are published and listed; \"\": this one is on its own. Beyond "
          "loopback it must be tls://, unless listen.insecure."),
      text("cluster.credentials_file", INCISE_FIELD(cluster.credentials_file), kPathOrNone,
           "Who we are for NATS: its .creds file, {\"user\": \"...\", \"password\": \"...\"} or {\"token\": "
           "\"...\"}."),
      text("cluster.ca_file", INCISE_FIELD(cluster.ca_file), kPathOrNone,
           "PEM of the authority that signed the certificate of NATS; \"\": those that the system knows."),
      text("cluster.certificate_file", INCISE_FIELD(cluster.certificate_file), kPathOrNone,
           "PEM, where NATS wants a certificate of us."),
      text("cluster.private_key_file", INCISE_FIELD(cluster.private_key_file), kPathOrNone, "PEM."),
      text("cluster.advertise", INCISE_FIELD(cluster.advertise), "a host name or an address; or \"\"",
           "How others reach this machine; \"\": listen.address, or the machine's name where that is any "
           "address."),
  };
}

ConfigKeys publishing_keys() {
  return {
      text("cluster.name", INCISE_FIELD(cluster.name), "1 to 64 letters, digits, \"-\" and \"_\"",
           "The session's name there. No other session may have it."),
      text("cluster.picture", INCISE_FIELD(cluster.picture), "a URL; or \"\"",
           "A picture for lists of sessions."),
      word("cluster.storage", {"memory", "file"}, INCISE_FIELD(cluster.storage),
           "Where NATS keeps what is published. Memory is enough: it is published again whenever NATS comes "
           "back."),
      integer("cluster.replicas", INCISE_FIELD(cluster.replicas), 1, 5,
              "On how many servers of a NATS cluster it is kept."),
      integer("cluster.stream_megabytes", INCISE_FIELD(cluster.stream_megabytes), 16, 1 << 20,
              "How much NATS keeps of this session. It must hold two snapshots of both views, and "
              "cluster.join_megabytes twice."),
      number("cluster.keep_minutes", INCISE_FIELD(cluster.keep_minutes), 1, 10'080,
             "How long NATS keeps it; a new snapshot is published after half of that."),
      integer(
          "cluster.join_megabytes", INCISE_FIELD(cluster.join_megabytes), 1, 1 << 16,
          "Deltas that one who joins has to read after a snapshot, at most; then a new one is published."),
      integer("cluster.queue_megabytes", INCISE_FIELD(cluster.queue_megabytes), 1, 1 << 16,
              "What may wait here while NATS is slow; beyond that it is dropped, and a snapshot is published "
              "later."),
      boolean(
          "cluster.failover", INCISE_FIELD(cluster.failover),
          "Several servers may have this name and this capture.path, on storage that they share: one has the "
          "session, by a lease on NATS, the others wait. It goes on with the capture, as --resume, if there "
          "is one."),
      number("cluster.lease_s", INCISE_FIELD(cluster.lease_s), 1, 3600,
             "With cluster.failover: after this time without a word of the one that has it another takes the "
             "session. It stops "
             "by itself when it has not reached NATS for two thirds of it."),
  };
}

}  // namespace

ConfigKeys cluster_keys() {
  ConfigKeys keys = nats_keys();
  for (ConfigKey& key : publishing_keys()) keys.push_back(std::move(key));
  return keys;
}

ConfigKeys relay_cluster_keys() {
  return nats_keys();
}

}  // namespace incise::app
