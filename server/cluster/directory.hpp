#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "server/cluster/nats_client.hpp"

namespace incise::cluster {

// One place where a session is served: by the server that cuts, or by a relay.
struct DirectoryEntry {
  std::string session;          // its name
  std::string kind = "server";  // or "relay"
  std::string instance;         // tells the places of a session apart: letters, digits, "-", "_"
  std::string body;             // the mesh's name
  std::string tcp, http;        // "tcp://host:7450", "https://host:7480"; "": not served
  std::string picture;          // a URL, or ""
  std::string software;
  std::uint64_t revision = 0;
  std::uint32_t viewers = 0;
  std::vector<std::string> blades;  // the sources that are held
  double frame_p99_us = 0;          // of the loop's work; a relay has none
  std::int64_t started_unix_s = 0;

  std::string json() const;
};
// False if the text is not an entry.
bool parse_entry(const std::string& json, DirectoryEntry& entry);

// All entries that have not expired, by session, then servers before relays. Throws NatsError.
std::vector<DirectoryEntry> list_directory(const NatsClient& client);
// For GET /sessions and `incise sessions --json`: [{"name": ..., "people": ..., "places": [...]}, ...], one object a session.
std::string sessions_json(const std::vector<DirectoryEntry>& entries);

// The directory on NATS: the bucket "incise_sessions", whose entries expire 10 s after they were last renewed. Shows one or several entries of ours
// there, and keeps a list of all for GET /sessions.
//
// Thread: start() and stop() from one, the rest from any. Owns: a thread that talks to NATS, and waits for nobody else.
class Directory {
 public:
  // What is shown now; asked on the directory's thread every three seconds.
  using Entries = std::function<std::vector<DirectoryEntry>()>;
  using Log = std::function<void(bool warning, const std::string& line)>;
  Directory(NatsOptions nats, Log log, int replicas = 1);
  ~Directory();
  void start(Entries ours);
  // Takes our entries away.
  void stop();
  // As of three seconds ago at most, while NATS can be reached; [] before.
  std::string json() const;
  std::vector<DirectoryEntry> entries() const;

 private:
  void run();
  void renew(const NatsClient& client, const KeyValueStore& store);

  const NatsOptions nats_;
  const Log log_;
  const int replicas_;
  Entries ours_;
  std::vector<std::string> keys_;  // the thread's: that we have written
  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::vector<DirectoryEntry> all_;  // guarded by mutex_
  bool stopping_ = false;            // guarded by mutex_
  std::thread thread_;
};

}  // namespace incise::cluster
