#include "server/app/nats_upstream.hpp"

#include <boost/asio/post.hpp>
#include <condition_variable>
#include <mutex>
#include <utility>

namespace incise::app {

struct NatsUpstream::Shared {
  std::mutex mutex;
  std::condition_variable wake;
  relay::Upstream::Sink* sink = nullptr;  // changed on the io_context's thread; null: stopped
  std::uint64_t asked = 0, done = 0;      // guarded by mutex
  bool stopped = false;                   // guarded by mutex
};

NatsUpstream::NatsUpstream(boost::asio::io_context& io, cluster::NatsOptions nats, const std::string& session,
                           FindOrigin origin)
    : io_(io),
      name_(nats.url + "/" + session),
      origin_(std::move(origin)),
      shared_(std::make_shared<Shared>()),
      reader_(std::move(nats), session) {}

NatsUpstream::~NatsUpstream() {
  stop();
}

void NatsUpstream::start(relay::Upstream::Sink& sink) {
  shared_->sink = &sink;
  reader_.start(*this);
}

// What the reader has posted still comes here, and finds no sink.
void NatsUpstream::stop() {
  shared_->sink = nullptr;
  {
    const std::scoped_lock lock(shared_->mutex);
    shared_->stopped = true;
  }
  shared_->wake.notify_all();
  reader_.stop();
}

void NatsUpstream::resync(const std::string&) {
  reader_.resync();
}

void NatsUpstream::there(const std::function<void(relay::Upstream::Sink&)>& what) const {
  std::unique_lock lock(shared_->mutex);
  const std::uint64_t number = ++shared_->asked;
  boost::asio::post(io_, [shared = shared_, &what, number] {
    if (shared->sink) what(*shared->sink);
    {
      const std::scoped_lock held(shared->mutex);
      shared->done = number;
    }
    shared->wake.notify_all();
  });
  shared_->wake.wait(lock, [&] { return shared_->stopped || shared_->done == number; });
}

void NatsUpstream::on_message(const protocol::Message& message, std::int64_t ahead_ns) {
  there([&](relay::Upstream::Sink& sink) { sink.on_message(message, ahead_ns); });
}

void NatsUpstream::on_lost(const std::string& why) {
  there([&](relay::Upstream::Sink& sink) { sink.on_lost(why); });
}

cluster::FeedReader::Held NatsUpstream::held() const {
  cluster::FeedReader::Held out;
  there([&](relay::Upstream::Sink& sink) {
    const relay::Held held = sink.held();
    out = {held.epoch, held.revision, held.state_hash};
  });
  return out;
}

}  // namespace incise::app
