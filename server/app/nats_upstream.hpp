#pragma once

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "server/cluster/feed_reader.hpp"
#include "server/relay/upstream.hpp"

namespace incise::app {

// A session that a server publishes on NATS, for a relay. Operators' links and textures go to the server itself.
//
// Thread: the io_context's. The reader's own thread waits while the sink takes a message, so the message's arrays last.
class NatsUpstream final : public relay::Upstream, private cluster::FeedReader::Sink {
 public:
  using FindOrigin = std::function<std::optional<relay::Origin>()>;  // from any thread
  NatsUpstream(boost::asio::io_context& io, cluster::NatsOptions nats, const std::string& session,
               FindOrigin origin);
  ~NatsUpstream() override;

  void start(relay::Upstream::Sink& sink) override;
  void stop() override;
  void resync(const std::string& reason) override;
  std::optional<relay::Origin> origin() const override { return origin_(); }
  std::string name() const override { return name_; }

 private:
  void on_message(const protocol::Message& message, std::int64_t ahead_ns) override;
  void on_lost(const std::string& why) override;
  cluster::FeedReader::Held held() const override;
  // Runs it on the io_context's thread, and returns when that is done, or the upstream stops.
  void there(const std::function<void(relay::Upstream::Sink&)>& what) const;

  struct Shared;
  boost::asio::io_context& io_;
  const std::string name_;
  const FindOrigin origin_;
  const std::shared_ptr<Shared> shared_;
  cluster::FeedReader reader_;
};

}  // namespace incise::app
