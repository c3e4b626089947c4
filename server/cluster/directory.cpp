#include "server/cluster/directory.hpp"

#include <algorithm>
#include <chrono>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <tuple>
#include <utility>

namespace incise::cluster {
namespace {

using Json = nlohmann::ordered_json;
constexpr const char* kBucket = "incise_sessions";
constexpr double kExpires_s = 10;
constexpr std::chrono::seconds kRenew{3};
constexpr std::chrono::milliseconds kLookAgain{250};
constexpr std::int64_t kList_ms = 2000;

std::string key_of(const DirectoryEntry& entry) {
  return entry.session + "." + entry.kind + "." + entry.instance;
}

template <class T>
void read(const Json& json, const char* key, T& value) {
  try {
    if (json.contains(key)) value = json[key].get<T>();
  } catch (const Json::exception&) {
  }
}

Json place(const DirectoryEntry& e) {
  return Json{{"kind", e.kind},         {"tcp", e.tcp},           {"http", e.http},
              {"viewers", e.viewers},   {"revision", e.revision}, {"frame_p99_us", e.frame_p99_us},
              {"software", e.software}, {"instance", e.instance}};
}

using Watcher = std::unique_ptr<kvWatcher, NatsDeleter<kvWatcher_Destroy>>;

}  // namespace

std::string DirectoryEntry::json() const {
  Json out = place(*this);
  out["session"] = session;
  out["body"] = body;
  out["picture"] = picture;
  out["blades"] = blades;
  out["started_unix_s"] = started_unix_s;
  return out.dump(-1, ' ', false, Json::error_handler_t::replace);
}

bool parse_entry(const std::string& text, DirectoryEntry& entry) {
  const Json json = Json::parse(text, nullptr, false);
  if (!json.is_object()) return false;
  read(json, "session", entry.session);
  read(json, "kind", entry.kind);
  read(json, "instance", entry.instance);
  read(json, "body", entry.body);
  read(json, "tcp", entry.tcp);
  read(json, "http", entry.http);
  read(json, "picture", entry.picture);
  read(json, "software", entry.software);
  read(json, "revision", entry.revision);
  read(json, "viewers", entry.viewers);
  read(json, "blades", entry.blades);
  read(json, "frame_p99_us", entry.frame_p99_us);
  read(json, "started_unix_s", entry.started_unix_s);
  return !entry.session.empty();
}

std::vector<DirectoryEntry> list_directory(const NatsClient& client, int replicas) {
  const KeyValueStore store = client.bucket(kBucket, kExpires_s, replicas);
  kvWatchOptions options;
  kvWatchOptions_Init(&options);
  options.IgnoreDeletes = true;
  options.Timeout = kList_ms;
  kvWatcher* raw = nullptr;
  client.check(kvStore_WatchAll(&raw, store.get(), &options), "sessions");
  const Watcher watcher(raw);
  std::vector<DirectoryEntry> out;
  for (;;) {
    kvEntry* one = nullptr;
    client.check(kvWatcher_Next(&one, watcher.get(), kList_ms), "sessions");
    if (!one) break;  // all that there are
    const KeyValueEntry entry(one);
    DirectoryEntry read;
    if (parse_entry(std::string(static_cast<const char*>(kvEntry_Value(one)),
                                static_cast<std::size_t>(kvEntry_ValueLen(one))),
                    read)) {
      read.renewal = kvEntry_Revision(one);
      out.push_back(std::move(read));
    }
  }
  std::sort(out.begin(), out.end(), [](const DirectoryEntry& a, const DirectoryEntry& b) {
    return std::forward_as_tuple(a.session, b.kind, a.instance) <
           std::forward_as_tuple(b.session, a.kind, b.instance);
  });
  return out;
}

std::optional<DirectoryEntry> find_live_server(const NatsClient& client, const std::string& session,
                                               const std::string& own_tcp, int replicas) {
  std::map<std::string, std::uint64_t> first;
  const auto end = std::chrono::steady_clock::now() + kRenew + std::chrono::seconds(1);
  for (;;) {
    bool any = false;
    for (DirectoryEntry& entry : list_directory(client, replicas)) {
      if (entry.session != session || entry.kind != "server") continue;
      if (!own_tcp.empty() && entry.tcp == own_tcp) continue;
      any = true;
      const auto [seen, is_new] = first.try_emplace(entry.instance, entry.renewal);
      if (seen->second != entry.renewal) return std::move(entry);
    }
    if (!any || std::chrono::steady_clock::now() > end) return std::nullopt;
    std::this_thread::sleep_for(kLookAgain);
  }
}

std::string sessions_json(const std::vector<DirectoryEntry>& entries) {
  Json sessions = Json::array();
  std::map<std::string, std::size_t> found;
  for (const DirectoryEntry& e : entries) {
    const auto [at, is_new] = found.try_emplace(e.session, sessions.size());
    if (is_new) {
      sessions.push_back(Json{{"name", e.session},
                              {"body", e.body},
                              {"picture", e.picture},
                              {"revision", e.revision},
                              {"people", 0},
                              {"blades", Json::array()},
                              {"started_unix_s", e.started_unix_s},
                              {"places", Json::array()}});
    }
    Json& session = sessions[at->second];
    session["people"] = session["people"].get<std::uint64_t>() + e.viewers;
    session["revision"] = std::max(session["revision"].get<std::uint64_t>(), e.revision);
    if (e.kind == "server") session["blades"] = e.blades;
    session["places"].push_back(place(e));
  }
  return sessions.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Directory::Directory(NatsOptions nats, Log log, int replicas)
    : nats_(std::move(nats)), log_(std::move(log)), replicas_(replicas) {}

Directory::~Directory() {
  stop();
}

void Directory::start(Entries ours) {
  ours_ = std::move(ours);
  thread_ = std::thread([this] { run(); });
}

void Directory::stop() {
  if (!thread_.joinable()) return;
  {
    const std::scoped_lock lock(mutex_);
    stopping_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

std::string Directory::json() const {
  return sessions_json(entries());
}

std::vector<DirectoryEntry> Directory::entries() const {
  const std::scoped_lock lock(mutex_);
  return all_;
}

std::string Directory::rival() const {
  const std::scoped_lock lock(mutex_);
  return rival_;
}

// One whose entry is renewed: that of a server that was killed only stays for some seconds.
void Directory::look_for_rival(const std::vector<DirectoryEntry>& all) {
  std::map<std::string, std::uint64_t> others;
  std::string rival;
  for (const DirectoryEntry& entry : all) {
    const std::string key = key_of(entry);
    const std::string ours = entry.session + ".server.";
    const auto is_ours = [&](const std::string& k) { return k.starts_with(ours); };
    if (entry.kind != "server" || std::find(keys_.begin(), keys_.end(), key) != keys_.end() ||
        std::none_of(keys_.begin(), keys_.end(), is_ours))
      continue;
    const auto before = others_.find(key);
    others[key] = before == others_.end() ? entry.renewal : before->second;
    if (others[key] != entry.renewal)
      rival = "session " + entry.session + ": " + (entry.tcp.empty() ? entry.http : entry.tcp);
  }
  others_ = std::move(others);
  std::string before;
  {
    const std::scoped_lock lock(mutex_);
    before = std::exchange(rival_, rival);
  }
  if (!rival.empty() && rival != before) {
    log_(true, nats_.url + ": another server publishes " + rival +
                   "; viewers see now one body, now the other: give each server a cluster.name of its own");
  } else if (rival.empty() && !before.empty()) {
    log_(false, nats_.url + ": no other server publishes " + before + " any more");
  }
}

void Directory::renew(const NatsClient& client, const KeyValueStore& store) {
  std::vector<std::string> keys;
  for (const DirectoryEntry& entry : ours_()) {
    keys.push_back(key_of(entry));
    client.check(kvStore_PutString(nullptr, store.get(), keys.back().c_str(), entry.json().c_str()),
                 "sessions");
  }
  for (const std::string& key : keys_) {
    if (std::find(keys.begin(), keys.end(), key) == keys.end()) kvStore_Delete(store.get(), key.c_str());
  }
  keys_ = std::move(keys);
}

void Directory::run() {
  std::unique_ptr<NatsClient> client;
  KeyValueStore store;
  bool in_trouble = false;
  for (;;) {
    std::vector<DirectoryEntry> all;
    std::string trouble;
    try {
      if (!client || !client->alive()) {
        store.reset();
        client = std::make_unique<NatsClient>(nats_);
        store = client->bucket(kBucket, kExpires_s, replicas_);
      }
      renew(*client, store);
      all = list_directory(*client, replicas_);
      look_for_rival(all);
    } catch (const NatsError& error) {
      store.reset();
      client.reset();
      trouble = error.what();
    }
    if (in_trouble != !trouble.empty()) {
      log_(!trouble.empty(), trouble.empty() ? nats_.url + ": the list of sessions is kept again"
                                             : trouble + "; the list of sessions is as it was before");
    }
    in_trouble = !trouble.empty();
    std::unique_lock lock(mutex_);
    if (trouble.empty()) all_ = std::move(all);
    if (!wake_.wait_for(lock, kRenew, [this] { return stopping_; })) continue;
    if (store) {
      for (const std::string& key : keys_) kvStore_Delete(store.get(), key.c_str());
    }
    return;
  }
}

}  // namespace incise::cluster
