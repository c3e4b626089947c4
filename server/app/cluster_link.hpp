#pragma once

#include <functional>
#include <memory>
#include <string>

#include "server/app/config.hpp"
#include "server/app/end_signals.hpp"
#include "server/cluster/directory.hpp"
#include "server/cluster/feed_publisher.hpp"
#include "server/cluster/lease.hpp"
#include "server/stream/server.hpp"

namespace incise::app {

// A server's part on NATS: its lease, what it publishes, its entry in the directory. Without cluster.nats it has none, and does nothing.
//
// Thread: the main thread; listener(), counters() and sessions_json() from any. Outlives the server, and stop() comes before that ends.
class ClusterLink {
 public:
  explicit ClusterLink(const Config& config);

  // Without cluster.failover: throws std::runtime_error where another server publishes under the same name.
  // With it: waits until the session is this process's. False: a signal came first. Throws NatsError if waiting would not help. Once it
  // has the session, the process ends at once, with a line on stderr, if it loses it.
  bool acquire(const EndSignals& signals);
  // Whether the session goes on with its capture, though --resume was not given.
  bool resumes() const;
  // Null: nobody else can have the session.
  std::function<bool()> may_write() const;

  // Begins to publish and to be listed. `entry`: the server now, but for its name and places; called on another thread until stop().
  void start(stream::Server& server, std::function<cluster::DirectoryEntry()> entry);
  // Publishes what waits, and is listed no more.
  void stop();
  // Gives the lease up, after the last write.
  void release();

  explicit operator bool() const { return publisher_ != nullptr; }
  stream::FeedListener* listener() { return publisher_.get(); }
  // The publisher's, and who else publishes the session.
  cluster::PublisherCounters counters() const;
  std::string sessions_json() const { return directory_->json(); }

 private:
  void refuse_name_in_use() const;
  bool stand_by(const EndSignals& signals);
  void take_over_capture() const;
  const Config& config_;
  std::unique_ptr<cluster::Lease> lease_;
  std::unique_ptr<cluster::FeedPublisher> publisher_;
  std::unique_ptr<cluster::Directory> directory_;
};

}  // namespace incise::app
