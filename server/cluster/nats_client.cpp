#include "server/cluster/nats_client.hpp"

#include <cerrno>
#include <charconv>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>

namespace incise::cluster {
namespace {

std::vector<std::string> split(const std::string& urls) {
  std::vector<std::string> out;
  for (std::size_t begin = 0; begin <= urls.size();) {
    const std::size_t comma = std::min(urls.find(',', begin), urls.size());
    out.push_back(urls.substr(begin, comma - begin));
    begin = comma + 1;
  }
  return out;
}

struct Url {
  bool tls = false;
  std::string host, port;
};

// Nothing if it is not a URL that we take.
bool parse(const std::string& text, Url& url) {
  std::string rest;
  if (text.starts_with("nats://")) {
    rest = text.substr(7);
  } else if (text.starts_with("tls://")) {
    url.tls = true;
    rest = text.substr(6);
  } else {
    return false;
  }
  const std::size_t bracket = rest.rfind(']'), colon = rest.rfind(':');
  const bool has_port = colon != std::string::npos && (bracket == std::string::npos || colon > bracket);
  url.host = rest.substr(0, has_port ? colon : std::string::npos);
  url.port = has_port ? rest.substr(colon + 1) : "4222";
  int port = 0;
  const auto [end, error] = std::from_chars(url.port.data(), url.port.data() + url.port.size(), port);
  return !url.host.empty() && url.host.find_first_of("/@ ") == std::string::npos && error == std::errc() &&
         end == url.port.data() + url.port.size() && port > 0 && port <= 65535;
}

bool is_loopback(const std::string& host) {
  return host.starts_with("127.") || host == "[::1]" || host == "localhost";
}

struct OptionsDeleter {
  void operator()(natsOptions* o) const { natsOptions_Destroy(o); }
};

constexpr const char* kWantsTls =
    "it wants TLS: write tls://, and name the authority that signed its certificate (ca_file)";

// What the library's short texts mean for whoever set this up.
std::string explained(natsStatus status, const NatsOptions& options, const std::string& detail) {
  switch (status) {
    case NATS_NO_SERVER:
      return "nobody answers; does nats-server run there?";
    case NATS_CONNECTION_AUTH_FAILED:
      return options.credentials_file.empty()
                 ? "it wants credentials, and none were given (credentials_file)"
                 : "it refuses the credentials in " + options.credentials_file.string();
    case NATS_SSL_ERROR:
      // The library begins TLS by itself where the server demands it, without what only tls:// sets up.
      if (options.url.find("tls://") == std::string::npos) return kWantsTls;
      return "TLS: " + (detail.empty() ? std::string("the handshake failed") : detail) +
             (options.ca_file.empty() ? "; the authority that signed its certificate is given by ca_file"
                                      : "");
    case NATS_SECURE_CONNECTION_REQUIRED:
      return kWantsTls;
    case NATS_SECURE_CONNECTION_WANTED:
      return "it has no TLS: write nats://, or give it a certificate";
    case NATS_TIMEOUT:
      return "no answer in time";
    default: {
      const std::string text = detail.empty() ? natsStatus_GetText(status) : detail;
      const bool key = text.find("checksum") != std::string::npos || text.find("seed") != std::string::npos;
      return key ? options.credentials_file.string() + ": " + text : text;
    }
  }
}

void set_up(natsOptions* made, const NatsOptions& options, std::int64_t timeout_ms, std::string& what) {
  const auto need = [&](natsStatus status, const std::string& step) {
    if (status == NATS_OK) return;
    what = step;
    throw natsStatus(status);
  };
  std::vector<std::string> urls = split(options.url);
  std::vector<const char*> servers;
  bool tls = false;
  for (const std::string& url : urls) {
    servers.push_back(url.c_str());
    tls = tls || url.starts_with("tls://");
  }
  need(natsOptions_SetServers(made, servers.data(), static_cast<int>(servers.size())), "address");
  need(natsOptions_SetName(made, options.name.c_str()), "name");
  need(natsOptions_SetTimeout(made, timeout_ms), "timeout");
  need(natsOptions_SetAllowReconnect(made, false), "reconnect");
  need(natsOptions_SetSendAsap(made, true), "send");
  // Half of what it takes to notice a server that has stopped without a word.
  need(natsOptions_SetPingInterval(made, 2000), "ping");
  need(natsOptions_SetMaxPingsOut(made, 2), "ping");
  need(natsOptions_SetWriteDeadline(made, 5000), "write");
  if (tls) {
    need(natsOptions_SetSecure(made, true), "TLS");
    if (!options.ca_file.empty())
      need(natsOptions_LoadCATrustedCertificates(made, options.ca_file.c_str()), options.ca_file.string());
    if (!options.certificate_file.empty()) {
      need(natsOptions_LoadCertificatesChain(made, options.certificate_file.c_str(),
                                             options.private_key_file.c_str()),
           options.certificate_file.string());
    }
  }
  if (options.credentials_file.empty()) return;
  const NatsCredentials who = read_credentials(options.credentials_file);
  if (who.decorated) {
    need(natsOptions_SetUserCredentialsFromFiles(made, options.credentials_file.c_str(), nullptr),
         options.credentials_file.string());
  } else if (!who.token.empty()) {
    need(natsOptions_SetToken(made, who.token.c_str()), "token");
  } else {
    need(natsOptions_SetUserInfo(made, who.user.c_str(), who.password.c_str()), "user");
  }
}

std::string last_detail() {
  natsStatus status = NATS_OK;
  const char* said = nats_GetLastError(&status);
  std::string text = said ? said : "";
  // "(jsm.c:1033): insufficient memory": its source is of no use here.
  if (const std::size_t end = text.find("): "); text.starts_with('(') && end != std::string::npos &&
                                                text.substr(0, end).find(".c:") != std::string::npos)
    text.erase(0, end + 3);
  return text;
}

}  // namespace

NatsCredentials read_credentials(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in)
    throw std::runtime_error(file.string() + ": cannot be opened: " + std::generic_category().message(errno));
  std::string text(std::istreambuf_iterator<char>(in), {});
  NatsCredentials out;
  if (text.find("-----BEGIN NATS USER JWT-----") != std::string::npos) {
    out.decorated = true;
    return out;
  }
  const nlohmann::json json = nlohmann::json::parse(text, nullptr, false);
  const auto word = [&](const char* key) {
    return json.is_object() && json.contains(key) && json[key].is_string() ? json[key].get<std::string>()
                                                                           : "";
  };
  out.user = word("user");
  out.password = word("password");
  out.token = word("token");
  if (out.token.empty() == (out.user.empty() || out.password.empty())) {
    throw std::runtime_error(
        file.string() +
        ": accepted are a .creds file of NATS, {\"user\": \"...\", \"password\": \"...\"} "
        "or {\"token\": \"...\"}");
  }
  return out;
}

std::string trouble_of_urls(const std::string& urls) {
  for (const std::string& text : split(urls)) {
    Url url;
    if (!parse(text, url)) return "\"" + text + "\"";
  }
  return "";
}

bool is_protected(const NatsOptions& options) {
  for (const std::string& text : split(options.url)) {
    Url url;
    if (!parse(text, url) || !(url.tls || is_loopback(url.host))) return false;
  }
  return true;
}

NatsClient::NatsClient(const NatsOptions& options, std::int64_t timeout_ms, OnRefused refused, void* closure)
    : url_(options.url) {
  natsOptions* raw = nullptr;
  natsStatus status = natsOptions_Create(&raw);
  const std::unique_ptr<natsOptions, OptionsDeleter> made(raw);
  std::string what;
  try {
    if (status != NATS_OK) throw natsStatus(status);
    set_up(made.get(), options, timeout_ms, what);
    // Not to stderr, where the library would write it.
    natsOptions_SetErrorHandler(
        made.get(), [](natsConnection*, natsSubscription*, natsStatus, void*) {}, nullptr);
    status = natsConnection_Connect(&connection_, made.get());
    if (status != NATS_OK) throw natsStatus(status);
  } catch (const natsStatus failed) {
    throw NatsError(
        failed, url_ + ": " + (what.empty() ? "" : what + ": ") + explained(failed, options, last_detail()));
  } catch (const std::runtime_error& error) {
    throw NatsError(NATS_ERR, error.what());
  }
  jsOptions js;
  jsOptions_Init(&js);
  js.Wait = timeout_ms;
  js.PublishAsync.MaxPending = 256;  // of half a megabyte at most, kept until they are acknowledged
  js.PublishAsync.ErrHandler = refused;
  js.PublishAsync.ErrHandlerClosure = closure;
  js.PublishAsync.StallWait = 2000;
  status = natsConnection_JetStream(&jetstream_, connection_, &js);
  if (status != NATS_OK) {
    natsConnection_Destroy(connection_);
    throw NatsError(status, url_ + ": JetStream: " + last_detail());
  }
}

NatsClient::~NatsClient() {
  // First, so that no callback runs any more when the context goes.
  natsConnection_Close(connection_);
  jsCtx_Destroy(jetstream_);
  natsConnection_Destroy(connection_);
}

bool NatsClient::alive() const {
  return natsConnection_Status(connection_) == NATS_CONN_STATUS_CONNECTED;
}

std::string NatsClient::last_error() const {
  const char* text = nullptr;
  natsConnection_GetLastError(connection_, &text);
  return text ? text : "";
}

std::size_t NatsClient::max_payload() const {
  return static_cast<std::size_t>(natsConnection_GetMaxPayload(connection_));
}

void NatsClient::check(natsStatus status, const std::string& what) const {
  if (status == NATS_OK) return;
  std::string why = last_detail();
  // What was not permitted, the server says of the connection, and the request gets no answer.
  if (const std::string said = last_error();
      status == NATS_TIMEOUT && said.find("ermissions") != std::string::npos)
    why = said;
  if (why.empty()) why = natsStatus_GetText(status);
  if (status == NATS_TIMEOUT && why.find("ermissions") == std::string::npos) why = "no answer in time";
  if (status == NATS_NO_RESPONDERS)
    why = "nobody answers: JetStream is not enabled there (nats-server -js), or not for this account";
  throw NatsError(status, url_ + ": " + what + ": " + why);
}

std::uint64_t NatsClient::newest(const std::string& stream, const std::string& subject) const {
  natsMsg* raw = nullptr;
  jsErrCode code{};
  const natsStatus status = js_GetLastMsg(&raw, jetstream_, stream.c_str(), subject.c_str(), nullptr, &code);
  const NatsMessage message(raw);
  if (status == NATS_NOT_FOUND || code == JSStreamNotFoundErr || code == JSNoMessageFoundErr) return 0;
  check(status, stream);
  return natsMsg_GetSequence(message.get());
}

KeyValueStore NatsClient::bucket(const std::string& name, double ttl_s, int replicas) const {
  kvStore* store = nullptr;
  natsStatus status = js_KeyValue(&store, jetstream_, name.c_str());
  if (status == NATS_NOT_FOUND) {
    kvConfig config;
    kvConfig_Init(&config);
    config.Bucket = name.c_str();
    config.History = 1;
    config.TTL = static_cast<std::int64_t>(ttl_s * 1e9);
    config.Replicas = replicas;
    status = js_CreateKeyValue(&store, jetstream_, &config);
    // Another may have made it meanwhile.
    if (status != NATS_OK && js_KeyValue(&store, jetstream_, name.c_str()) == NATS_OK) status = NATS_OK;
  }
  check(status, "bucket " + name);
  return KeyValueStore(store);
}

std::string header(natsMsg* message, const char* name) {
  const char* value = nullptr;
  return natsMsgHeader_Get(message, name, &value) == NATS_OK && value ? value : "";
}

std::uint64_t header_number(natsMsg* message, const char* name, int base) {
  const std::string text = header(message, name);
  std::uint64_t value = 0;
  std::from_chars(text.data(), text.data() + text.size(), value, base);
  return value;
}

}  // namespace incise::cluster
