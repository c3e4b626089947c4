// One session of the server, from a peer who may send anything. The input is a TCP stream, or with a first byte above 127
// the payload of WebSocket frames. For any input the session ends, its blade is free, and it has sent only messages.

#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/error.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <span>
#include <variant>

#include "server/stream/hub.hpp"
#include "server/stream/session.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise;
using namespace incise::stream;

namespace {

// Takes every pose, and frees a blade at once.
class OpenHand final : public InputSink {
 public:
  class Source final : public PoseSource {
   public:
    explicit Source(bool& held) : held_(held) { held_ = true; }
    ~Source() override { held_ = false; }
    std::uint32_t number() const override { return 0; }
    std::size_t push(std::span<const protocol::PoseSample> poses, std::int64_t) override {
      totals_.accepted += poses.size();
      return poses.size();
    }
    bool end_stroke(std::int64_t) override { return true; }
    PoseTotals totals() const override { return totals_; }
    protocol::Vec3 heel() const override { return {}; }
    protocol::Vec3 tip() const override { return {0, 0, -1}; }

   private:
    bool& held_;
    PoseTotals totals_;
  };
  std::unique_ptr<PoseSource> open(std::string_view, const std::optional<protocol::BladeEdge>&) override {
    return held ? nullptr : std::make_unique<Source>(held);
  }
  bool held = false;
};

// Gives a session the input's messages, and checks what it answers.
class InputTransport final : public Transport {
 public:
  InputTransport(asio::io_context& io, std::span<const std::byte> input, bool web)
      : io_(io), input_(input), web_(web) {}

  asio::awaitable<Received> read() override {
    if (web_) {
      if (input_.size() < 2) co_return Received::end(asio::error::eof);
      const std::size_t size = std::min(input_.size() - 2, std::to_integer<std::size_t>(input_[0]) +
                                                               256 * std::to_integer<std::size_t>(input_[1]));
      const auto body = input_.subspan(2, size);
      input_ = input_.subspan(2 + size);
      co_return Received::message(body);
    }
    switch (reader_.read(input_)) {
      case protocol::FrameReader::Status::Complete:
        co_return Received::message(reader_.body());
      case protocol::FrameReader::Status::Failed:
        co_return Received::bad(reader_.error(), true);
      case protocol::FrameReader::Status::NeedMore:
        break;
    }
    co_return Received::end(asio::error::eof);
  }
  void set_max_bytes(std::size_t max_bytes) override { reader_.set_max_bytes(max_bytes); }
  void write(std::span<const SharedFrame> frames,
             std::function<void(boost::system::error_code)> done) override {
    for (const SharedFrame& frame : frames) FUZZ_CHECK(protocol::decode(frame->body()));
    asio::post(io_, [done = std::move(done)] { done({}); });
  }
  asio::awaitable<void> discard() override { co_return; }
  void shut_down(std::shared_ptr<void>) override {}
  void close() override {}
  std::string peer() const override { return "input"; }
  asio::any_io_executor executor() override { return io_.get_executor(); }

 private:
  asio::io_context& io_;
  std::span<const std::byte> input_;
  bool web_;
  protocol::FrameReader reader_{protocol::kMaxHandshakeBytes};
};

struct World {
  World() : hub(io, config, {}, hand, {}) {
    auto initial = std::make_shared<InitialState>();
    initial->session = 1;
    initial->positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    initial->tets = {{0, {0, 1, 2, 3}, 0, 0, 15}};
    hub.reset(initial);
  }
  StreamConfig config;
  asio::io_context io{1};
  OpenHand hand;
  Hub hub;
};

// Session::run() holds its session only from its first step on.
asio::awaitable<void> run(std::shared_ptr<Session> session) {
  co_await session->run();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static World world;
  if (size == 0) return 0;
  const std::span<const std::byte> input(reinterpret_cast<const std::byte*>(data) + 1, size - 1);
  bool ended = false;
  {
    asio::ip::tcp::socket none(world.io);
    const auto session = std::make_shared<Session>(
        world.hub, std::make_unique<InputTransport>(world.io, input, data[0] > 127), *world.hub.admit(none));
    asio::co_spawn(world.io, run(session), [&](std::exception_ptr thrown) {
      FUZZ_CHECK(!thrown);
      ended = true;
    });
  }
  world.io.restart();
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(5);
  while (!ended && std::chrono::steady_clock::now() < end)
    world.io.run_one_for(std::chrono::milliseconds(100));
  FUZZ_CHECK(ended);
  world.io.poll();
  FUZZ_CHECK(!world.hand.held);
  FUZZ_CHECK(world.hub.idle());
  return 0;
}
