#include "server/cluster/lease.hpp"

#include <fcntl.h>
#include <sys/random.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <nlohmann/json.hpp>
#include <utility>

#include "server/base/clock.hpp"
#include "server/base/hex.hpp"

namespace incise::cluster {
namespace {

using Json = nlohmann::ordered_json;
constexpr const char* kBucket = "incise_leases";
constexpr std::chrono::milliseconds kRetry{500};

std::int64_t boot_ns() {
  return clock_ns(CLOCK_BOOTTIME);
}

std::string host_name() {
  char name[256] = {};
  gethostname(name, sizeof name - 1);
  return name;
}

std::string fresh_holder() {
  std::uint64_t id = 0;
  if (getrandom(&id, sizeof id, 0) != sizeof id) id = static_cast<std::uint64_t>(monotonic_ns());
  return host_name() + " (process " + std::to_string(getpid()) + ", " + hex(id) + ")";
}

// Who holds it, or held it last.
struct Holder {
  std::string name;
  std::uint64_t fence = 0;
  bool released = false;
};

Holder parse(const std::string& text) {
  const Json json = Json::parse(text, nullptr, false);
  if (!json.is_object()) return {};
  Holder out;
  if (json.contains("holder") && json["holder"].is_string()) out.name = json["holder"];
  if (json.contains("fence") && json["fence"].is_number_unsigned()) out.fence = json["fence"];
  out.released = json.contains("released") && json["released"].is_boolean() && json["released"];
  return out;
}

// Nothing, not released, if there is no such file.
bool read_file(const std::filesystem::path& path, Holder& holder) {
  std::ifstream in(path, std::ios::binary);
  if (!in) return false;
  holder = parse(std::string(std::istreambuf_iterator<char>(in), {}));
  return true;
}

// Replaces the file at once, and waits for the disk.
void write_file(const std::filesystem::path& path, const std::string& text) {
  std::filesystem::path next = path;
  next += ".new";
  const int fd = ::open(next.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0640);
  const bool good = fd >= 0 && ::write(fd, text.data(), text.size()) == static_cast<ssize_t>(text.size()) &&
                    ::fsync(fd) == 0;
  const int error = errno;
  if (fd >= 0) ::close(fd);
  if (!good) throw std::system_error(error, std::generic_category(), next.string());
  std::filesystem::rename(next, path);
}

bool waiting_helps(natsStatus status) {
  return status == NATS_NO_SERVER || status == NATS_TIMEOUT || status == NATS_CONNECTION_CLOSED ||
         status == NATS_IO_ERROR || status == NATS_NO_RESPONDERS || status == NATS_NOT_FOUND ||
         status == NATS_CONNECTION_DISCONNECTED || status == NATS_STALE_CONNECTION;
}

std::int64_t ns(double seconds) {
  return static_cast<std::int64_t>(seconds * 1e9);
}

}  // namespace

Lease::Lease(LeaseOptions options, Log log, std::function<void(const std::string&)> on_lost)
    : options_(std::move(options)),
      log_(std::move(log)),
      on_lost_(std::move(on_lost)),
      key_(options_.session),
      holder_(fresh_holder()) {}

Lease::~Lease() {
  release();
}

std::string Lease::value(bool released) const {
  Json json{{"holder", holder_}, {"fence", fence_}, {"lease_s", options_.length_s}};
  if (released) json["released"] = true;
  return json.dump();
}

bool Lease::held() const noexcept {
  return boot_ns() < until_ns_.load(std::memory_order_acquire);
}

bool Lease::acquire(const std::function<bool()>& interrupted) {
  Seen seen;
  std::unique_ptr<NatsClient> client;
  while (!interrupted()) {
    try {
      if (!client || !client->alive()) client = std::make_unique<NatsClient>(options_.nats);
      if (try_acquire(*client, seen)) {
        thread_ = std::thread([this] { renew_until_lost(); });
        return true;
      }
    } catch (const NatsError& error) {
      client.reset();
      if (!waiting_helps(error.status)) throw;
      if (waiting_for_ != error.what())
        log_(true, std::string(error.what()) + "; waiting, since the session needs its lease");
      waiting_for_ = error.what();
    }
    std::this_thread::sleep_for(kRetry);
  }
  return false;
}

bool Lease::try_acquire(NatsClient& client, Seen& seen) {
  const KeyValueStore store = client.bucket(kBucket, 0, options_.replicas);
  Holder filed;
  const bool has_file = read_file(options_.fence_file, filed);
  kvEntry* raw = nullptr;
  natsStatus status = kvStore_Get(&raw, store.get(), key_.c_str());
  const KeyValueEntry entry(raw);
  const std::int64_t asked_ns = boot_ns();
  std::uint64_t revision = 0;
  if (status == NATS_NOT_FOUND) {
    fence_ = filed.fence + 1;
    const std::string text = value(false);
    status = kvStore_Create(&revision, store.get(), key_.c_str(), text.data(), static_cast<int>(text.size()));
    if (status != NATS_OK) return false;  // another was quicker
    take(revision, asked_ns, fence_);
    if (!has_file || filed.released) return true;
    log_(true, "the lease of session " + options_.session + " was not there, but " + filed.name +
                   " did not give it up: waiting " + std::to_string(static_cast<int>(options_.length_s)) +
                   " s, so that it has stopped");
    // Renewed meanwhile, and nothing is written: until_ns_ is in the past.
    until_ns_.store(0, std::memory_order_release);
    const std::int64_t from_ns = boot_ns();
    std::int64_t renewed_ns = asked_ns;
    while (boot_ns() - from_ns < ns(options_.length_s)) {
      std::this_thread::sleep_for(kRetry);
      renewed_ns = boot_ns();
      status = kvStore_Update(&revision, store.get(), key_.c_str(), text.data(),
                              static_cast<int>(text.size()), revision);
      if (status != NATS_OK) client.check(status, "lease of session " + options_.session);
    }
    read_file(options_.fence_file, filed);
    fence_ = std::max(fence_, filed.fence + 1);
    crashed_before_ = true;
    take(revision, renewed_ns, fence_);
    return true;
  }
  client.check(status, "lease of session " + options_.session);
  const Holder holder = parse(std::string(static_cast<const char*>(kvEntry_Value(entry.get())),
                                          static_cast<std::size_t>(kvEntry_ValueLen(entry.get()))));
  const std::uint64_t now_revision = kvEntry_Revision(entry.get());
  if (now_revision != seen.revision) seen = {now_revision, boot_ns()};
  if (!holder.released && boot_ns() - seen.since_ns < ns(options_.length_s)) {
    if (waiting_for_ != holder.name)
      log_(false, "session " + options_.session + " is held by " + holder.name + "; standing by");
    waiting_for_ = holder.name;
    return false;
  }
  fence_ = std::max(holder.fence, filed.fence) + 1;
  const std::string text = value(false);
  status = kvStore_Update(&revision, store.get(), key_.c_str(), text.data(), static_cast<int>(text.size()),
                          now_revision);
  if (status != NATS_OK) {
    seen = {};  // another was quicker, or it was renewed at the last moment
    return false;
  }
  crashed_before_ = !holder.released;
  if (crashed_before_)
    log_(true, "session " + options_.session + ": " + holder.name + " has gone; taking it over");
  take(revision, asked_ns, fence_);
  return true;
}

void Lease::take(std::uint64_t revision, std::int64_t asked_ns, std::uint64_t fence) {
  revision_ = revision;
  fence_ = fence;
  until_ns_.store(asked_ns + ns(options_.length_s * 2 / 3), std::memory_order_release);
  // The file says that somebody writes, before anything is written.
  write_file(options_.fence_file, value(false) + "\n");
}

void Lease::renew_until_lost() {
  std::unique_ptr<NatsClient> client;
  std::string trouble;
  const auto every = std::chrono::nanoseconds(ns(options_.length_s / 9));
  for (;;) {
    {
      std::unique_lock lock(mutex_);
      if (wake_.wait_for(lock, every, [this] { return stopping_; })) return;
    }
    if (!held())
      return lose(trouble.empty() ? "it was not renewed in time: the process stood still" : trouble);
    if (!renew(client, trouble)) return lose(trouble);
    if (!held()) return lose(trouble.empty() ? "it was not renewed in time" : trouble);
  }
}

// False: another has it.
bool Lease::renew(std::unique_ptr<NatsClient>& client, std::string& trouble) {
  const std::string text = value(false);
  try {
    const auto limit_ms =
        std::max<std::int64_t>(100, static_cast<std::int64_t>(options_.length_s * 1000 / 9));
    if (!client || !client->alive()) client = std::make_unique<NatsClient>(options_.nats, limit_ms);
    const KeyValueStore store = client->bucket(kBucket, 0, options_.replicas);
    const std::int64_t asked_ns = boot_ns();
    std::uint64_t revision = 0;
    natsStatus status = kvStore_Update(&revision, store.get(), key_.c_str(), text.data(),
                                       static_cast<int>(text.size()), revision_);
    if (status != NATS_OK) {
      kvEntry* raw = nullptr;
      const natsStatus got = kvStore_Get(&raw, store.get(), key_.c_str());
      const KeyValueEntry entry(raw);
      if (got == NATS_OK) {
        const Holder holder = parse(std::string(static_cast<const char*>(kvEntry_Value(entry.get())),
                                                static_cast<std::size_t>(kvEntry_ValueLen(entry.get()))));
        if (holder.name != holder_) {
          trouble = holder.name + " has it";
          return false;
        }
        revision_ =
            kvEntry_Revision(entry.get());  // our own renewal, whose answer was lost: the next one counts
        return true;
      }
      if (got != NATS_NOT_FOUND) client->check(status, "lease of session " + options_.session);
      // The bucket was wiped. Whoever is first makes the key again; another one would wait for a lease.
      client->check(
          kvStore_Create(&revision, store.get(), key_.c_str(), text.data(), static_cast<int>(text.size())),
          "lease of session " + options_.session);
      log_(true, "the lease of session " + options_.session + " was gone, and is made again");
    }
    revision_ = revision;
    until_ns_.store(asked_ns + ns(options_.length_s * 2 / 3), std::memory_order_release);
    trouble.clear();
  } catch (const NatsError& error) {
    client.reset();
    if (trouble.empty()) log_(true, std::string("the lease is not renewed: ") + error.what());
    trouble = error.what();
  }
  return true;
}

void Lease::lose(const std::string& why) {
  until_ns_.store(0, std::memory_order_release);
  on_lost_(why);
}

void Lease::release() {
  if (!thread_.joinable()) return;
  {
    const std::scoped_lock lock(mutex_);
    stopping_ = true;
  }
  wake_.notify_all();
  thread_.join();
  if (!held()) return;
  until_ns_.store(0, std::memory_order_release);
  const std::string text = value(true);
  try {
    write_file(options_.fence_file, text + "\n");
    const NatsClient client(options_.nats);
    const KeyValueStore store = client.bucket(kBucket, 0, options_.replicas);
    std::uint64_t revision = 0;
    kvStore_Update(&revision, store.get(), key_.c_str(), text.data(), static_cast<int>(text.size()),
                   revision_);
  } catch (const std::exception& error) {
    log_(true, std::string("the lease is not given up, so the next instance waits for it: ") + error.what());
  }
}

}  // namespace incise::cluster
