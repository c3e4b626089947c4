#pragma once

#include <nats/nats.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace incise::cluster {

// What went wrong with NATS: one line that names the server, what was asked of it and what it said.
struct NatsError : std::runtime_error {
  NatsError(natsStatus given, const std::string& text) : std::runtime_error(text), status(given) {}
  natsStatus status;
};

// Where NATS is, and who we are there.
struct NatsOptions {
  std::string url;   // "nats://host:port" or "tls://host:port", several with commas
  std::string name;  // what the connection is called there
  std::filesystem::path credentials_file, ca_file, certificate_file, private_key_file;
};

// Who we are, by a file: NATS's own .creds, or JSON, {"user": "...", "password": "..."} or {"token": "..."}.
struct NatsCredentials {
  std::string user, password, token;
  bool decorated = false;  // a .creds file, which the library reads itself
};
// Throws std::runtime_error, its text beginning with the file.
NatsCredentials read_credentials(const std::filesystem::path& file);
// "" if such URLs can be used, else what is wrong with them.
std::string trouble_of_urls(const std::string& urls);
// Whether what is sent there is protected: TLS, or it does not leave the machine.
bool is_protected(const NatsOptions& options);

template <auto Destroy>
struct NatsDeleter {
  template <class T>
  void operator()(T* p) const {
    Destroy(p);
  }
};
using NatsMessage = std::unique_ptr<natsMsg, NatsDeleter<natsMsg_Destroy>>;
using NatsSubscription = std::unique_ptr<natsSubscription, NatsDeleter<natsSubscription_Destroy>>;
using KeyValueStore = std::unique_ptr<kvStore, NatsDeleter<kvStore_Destroy>>;
using KeyValueEntry = std::unique_ptr<kvEntry, NatsDeleter<kvEntry_Destroy>>;

// One connection, which never reconnects by itself: its user begins again, since what it must do then (publish a snapshot, look
// at its lease) is its own. Thread: one at a time; alive() any.
class NatsClient {
 public:
  // For acknowledgements of what publish_async() sends that say no: called on a thread of the library.
  using OnRefused = void (*)(jsCtx*, jsPubAckErr*, void* closure);
  // Connects within `timeout_ms`. Throws NatsError: a name that is not found, nobody there, a certificate or a password that is refused.
  explicit NatsClient(const NatsOptions& options, std::int64_t timeout_ms = 3000, OnRefused refused = nullptr,
                      void* closure = nullptr);
  ~NatsClient();
  NatsClient(const NatsClient&) = delete;
  NatsClient& operator=(const NatsClient&) = delete;

  bool alive() const;
  // Why it ended, or the last thing that the server complained of; "" if nothing.
  std::string last_error() const;
  natsConnection* connection() const { return connection_; }
  jsCtx* jetstream() const { return jetstream_; }
  // The largest message that the server takes, headers included.
  std::size_t max_payload() const;

  // Throws NatsError where `status` is not NATS_OK: "nats://host:4222: WHAT: WHY".
  void check(natsStatus status, const std::string& what) const;

  // The number in `stream` of the newest message of `subject`; 0: there is none, or no such stream. Throws NatsError.
  std::uint64_t newest(const std::string& stream, const std::string& subject) const;

  // The bucket; makes it, with entries that expire after `ttl_s` (0: never), where there is none.
  KeyValueStore bucket(const std::string& name, double ttl_s, int replicas) const;

 private:
  std::string url_;
  natsConnection* connection_ = nullptr;
  jsCtx* jetstream_ = nullptr;
};

// The value of a message's header; "" if it has none of that name.
std::string header(natsMsg* message, const char* name);
// The same as a number in base 10 or 16; 0 if it is not one.
std::uint64_t header_number(natsMsg* message, const char* name, int base = 10);

}  // namespace incise::cluster
