#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
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
  std::uint64_t renewal = 0;  // rises each time that it is renewed; not in its JSON

  std::string json() const;
};
// False if the text is not an entry.
bool parse_entry(const std::string& json, DirectoryEntry& entry);

// All entries that have not expired, by session, then servers before relays. Throws NatsError.
// `replicas`: of the bucket, where there is none yet.
std::vector<DirectoryEntry> list_directory(const NatsClient& client, int replicas = 1);
// The server of a session that is alive: its entry is renewed while this looks, for up to 4 s where there is one. The entry of a server that
// was killed stays for some seconds, too; one at `own_tcp` is such, since we have its place. Throws NatsError.
std::optional<DirectoryEntry> find_live_server(const NatsClient& client, const std::string& session,
                                               const std::string& own_tcp, int replicas);
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
  // Where another server is that publishes a session of ours, as a person would say it; "": nowhere. Both would overwrite each other.
  std::string rival() const;

 private:
  void run();
  void look_for_rival(const std::vector<DirectoryEntry>& all);
  void renew(const NatsClient& client, const KeyValueStore& store);

  const NatsOptions nats_;
  const Log log_;
  const int replicas_;
  Entries ours_;
  std::vector<std::string> keys_;  // the thread's: that we have written
  // The thread's: of other servers of our sessions, by key, the first renewal that was seen.
  std::map<std::string, std::uint64_t> others_;
  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::vector<DirectoryEntry> all_;  // guarded by mutex_
  std::string rival_;                // guarded by mutex_
  bool stopping_ = false;            // guarded by mutex_
  std::thread thread_;
};

}  // namespace incise::cluster
