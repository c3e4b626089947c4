#include "server/app/cluster_link.hpp"

#include <fcntl.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "client/cli/usage.hpp"
#include "server/app/advertised.hpp"
#include "server/app/log_setup.hpp"
#include "server/app/nats_options.hpp"
#include "server/app/standby_answers.hpp"
#include "server/app/stream_setup.hpp"
#include "server/app/version.hpp"
#include "server/base/clock.hpp"
#include "server/base/hex.hpp"

namespace incise::app {
namespace {

constexpr std::int64_t kAskTime_ms = 1000;

cluster::PublisherOptions publisher_options(const Config& config) {
  const Config::Cluster& cluster = config.cluster;
  cluster::PublisherOptions options;
  options.nats = nats_options(config);
  options.session = cluster.name;
  options.in_memory = cluster.storage == "memory";
  options.replicas = static_cast<int>(cluster.replicas);
  options.stream_bytes = cluster.stream_megabytes << 20;
  options.keep_s = cluster.keep_minutes * 60;
  options.join_bytes = static_cast<std::size_t>(cluster.join_megabytes) << 20;
  options.queue_bytes = static_cast<std::size_t>(cluster.queue_megabytes) << 20;
  return options;
}

}  // namespace

ClusterLink::ClusterLink(const Config& config) : config_(config) {
  if (config.cluster.nats.empty()) return;
  directory_ = std::make_unique<cluster::Directory>(nats_options(config), log_line,
                                                    static_cast<int>(config.cluster.replicas));
  if (!config.cluster.failover)
    publisher_ = std::make_unique<cluster::FeedPublisher>(publisher_options(config), log_line);
}

bool ClusterLink::acquire(const EndSignals& signals) {
  if (!config_.cluster.failover) {
    refuse_name_in_use();
    return true;
  }
  cluster::LeaseOptions options;
  options.nats = nats_options(config_);
  options.session = config_.cluster.name;
  options.length_s = config_.cluster.lease_s;
  options.replicas = static_cast<int>(config_.cluster.replicas);
  options.fence_file = config_.resolve(config_.capture.path);
  options.fence_file += ".fence";
  lease_ =
      std::make_unique<cluster::Lease>(options, log_line, [name = options.session](const std::string& why) {
        // At once, and without the usual end, which writes: another instance may begin to.
        std::fprintf(
            stderr,
            "incised: the lease of session %s is lost: %s; another instance may go on with the session\n",
            name.c_str(), why.c_str());
        std::fflush(stderr);
        _exit(client::kFailed);
      });
  if (!stand_by(signals)) return false;
  spdlog::info("the session {} is ours (instance {})", config_.cluster.name, lease_->fence());
  if (lease_->crashed_before()) take_over_capture();
  publisher_ = std::make_unique<cluster::FeedPublisher>(publisher_options(config_), log_line, may_write(),
                                                        lease_->fence());
  return true;
}

// Where NATS cannot be asked, the session starts all the same; the directory notices the other one later.
void ClusterLink::refuse_name_in_use() const {
  if (config_.cluster.nats.empty()) return;
  const std::int64_t port = config_.listen.tcp_port;
  const std::string own =
      port > 0 ? advertised(config_, static_cast<std::uint16_t>(port), false) : std::string();
  std::optional<cluster::DirectoryEntry> other;
  try {
    const cluster::NatsClient client(nats_options(config_), kAskTime_ms);
    other = cluster::find_live_server(client, config_.cluster.name, own,
                                      static_cast<int>(config_.cluster.replicas));
  } catch (const cluster::NatsError&) {
    return;
  }
  if (!other) return;
  throw std::runtime_error("cluster.name: session " + config_.cluster.name + " is published on " +
                           config_.cluster.nats + " by another incised (" +
                           (other->tcp.empty() ? other->http : other->tcp) +
                           "); give each server a name of its own, or both cluster.failover");
}

cluster::PublisherCounters ClusterLink::counters() const {
  cluster::PublisherCounters counters = publisher_->counters();
  const std::string rival = directory_->rival();
  if (counters.trouble.empty() && !rival.empty()) counters.trouble = "another server publishes " + rival;
  return counters;
}

// Until the lease is ours. False: a signal came first.
bool ClusterLink::stand_by(const EndSignals& signals) {
  std::optional<StandbyAnswers> answers;
  bool tried = false;
  // A free port that the system chooses is one that nobody asks at.
  bool answer = config_.listen.http_port > 0;
  return lease_->acquire([&] {
    if (std::exchange(tried, true) && std::exchange(answer, false)) {
      try {
        answers.emplace(stream_config(config_), config_.cluster.name);
      } catch (const std::runtime_error& error) {
        spdlog::warn("{}; /healthz does not answer while this instance stands by", error.what());
      }
    }
    return signals.pending();
  });
}

// The instance before may only have stood still, with a write on its way: it has the old file open, and this is another.
void ClusterLink::take_over_capture() const {
  const std::filesystem::path path = config_.resolve(config_.capture.path);
  if (!std::filesystem::exists(path)) return;
  std::filesystem::path copy = path;
  copy += ".taking";
  std::filesystem::copy_file(path, copy, std::filesystem::copy_options::overwrite_existing);
  const int fd = ::open(copy.c_str(), O_RDONLY | O_CLOEXEC);
  const bool synced = fd >= 0 && ::fsync(fd) == 0;
  const int error = errno;
  if (fd >= 0) ::close(fd);
  if (!synced) throw std::system_error(error, std::generic_category(), copy.string());
  std::filesystem::rename(copy, path);
}

bool ClusterLink::resumes() const {
  std::error_code error;
  return lease_ && std::filesystem::exists(config_.resolve(config_.capture.path), error);
}

std::function<bool()> ClusterLink::may_write() const {
  if (!lease_) return nullptr;
  return [lease = lease_.get()] { return lease->held(); };
}

void ClusterLink::start(stream::Server& server, std::function<cluster::DirectoryEntry()> entry) {
  if (!publisher_) return;
  publisher_->start([&server](protocol::View view, std::function<void(stream::WholeState)> ready) {
    server.request_state(view, std::move(ready));
  });
  const std::string instance = hex(fresh_session_id());
  directory_->start([this, &server, entry = std::move(entry), instance] {
    cluster::DirectoryEntry now = entry();
    now.session = config_.cluster.name;
    now.instance = instance;
    now.tcp = advertised(config_, server.tcp_port(), false);
    now.http = advertised(config_, server.http_port(), true);
    now.picture = config_.cluster.picture;
    now.software = kSoftware;
    return std::vector{now};
  });
}

void ClusterLink::stop() {
  if (directory_) directory_->stop();
  if (publisher_) publisher_->stop();
}

void ClusterLink::release() {
  if (lease_) lease_->release();
}

}  // namespace incise::app
