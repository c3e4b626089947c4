// Tokens at the doors of a server (TCP, WebSocket, HTTP), and what is written down of those who come to them.

#include <gtest/gtest.h>

#include <algorithm>
#include <mutex>

#include "server/base/clock.hpp"
#include "server/stream/guess_limiter.hpp"
#include "server/stream/mirror.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/stream/viewer.hpp"

namespace incise::stream {
namespace {

using protocol::ErrorCode;
using protocol::Role;
using protocol::View;

class AccessTest : public ::testing::Test {
 protected:
  AccessTest() {
    StreamConfig config = test_config();
    config.tokens = {{"a viewer's token", {Role::Viewer}},
                     {"an operator's token", {Role::Operator}},
                     {"an admin's token", {Role::Admin}},
                     {"a scraper's token", {}}};
    Providers providers;
    providers.stats_json = [] { return std::string("{\"frames\":1}"); };
    providers.audit = [this](Audit, const std::string& address, const std::string& line) {
      EXPECT_EQ(address, "127.0.0.1");
      const std::scoped_lock lock(mutex);
      lines.push_back(line);
    };
    providers.documents["/surface"] = {"text/plain", std::make_shared<std::string>("a body")};
    test = std::make_unique<TestServer>(2, config, providers);
    test->loop.start();
  }

  static protocol::Hello with_token(Role role, const std::string& token) {
    protocol::Hello h = hello(role, View::None);
    h.token = token;
    h.client_name = "a \x1b[31mtest";
    return h;
  }
  // The first answer to a Hello with that token.
  protocol::Message answer(Role role, const std::string& token) {
    RawPeer peer(test->server.tcp_port());
    peer.send(with_token(role, token), 5);
    auto received = peer.receive();
    return received ? std::move(received->message) : protocol::Message{};
  }
  std::string get(const std::string& target, const std::string& authorization = "") {
    return http(test->server.http_port(), target, "GET",
                authorization.empty() ? "" : "Authorization: " + authorization + "\r\n");
  }
  std::string status(const std::string& target, const std::string& authorization = "") {
    return get(target, authorization).substr(9, 3);
  }
  bool told(const std::string& a, const std::string& b) {
    const std::scoped_lock lock(mutex);
    return std::any_of(lines.begin(), lines.end(), [&](const std::string& line) {
      return line.find(a) != line.npos && line.find(b) != line.npos;
    });
  }

  std::mutex mutex;
  std::vector<std::string> lines;  // guarded by mutex
  std::unique_ptr<TestServer> test;
};

TEST_F(AccessTest, FiguresAndCapturesWantATokenHealthAndThePageDoNot) {
  EXPECT_EQ(status("/healthz"), "200");
  EXPECT_EQ(status("/none.html"), "404");
  const std::string refused = get("/metrics");
  EXPECT_EQ(refused.substr(9, 3), "401");
  EXPECT_NE(refused.find("WWW-Authenticate: Bearer"), std::string::npos);
  EXPECT_EQ(refused.find("incise_stream_"), std::string::npos);
  for (const char* target : {"/stats", "/stats?x=1", "/metrics", "/captures", "/surface", "/surface?x"}) {
    EXPECT_EQ(status(target), "401") << target;
    EXPECT_EQ(status(target, "Basic YTpi"), "401") << target;
    EXPECT_EQ(status(target, "Bearer"), "401") << target;
    EXPECT_EQ(http(test->server.http_port(), target, "HEAD").substr(9, 3), "401") << target;
  }
  const auto statuses = [&](const std::string& token) {
    return status("/stats", "Bearer " + token) + status("/metrics", "bearer  " + token) +
           status("/captures", "BEARER " + token) + status("/surface", "Bearer " + token);
  };
  EXPECT_EQ(statuses("a viewer's token"), "200200200200");
  EXPECT_EQ(statuses("an admin's token"), "200200200200");
  EXPECT_EQ(statuses("an operator's token"), "200200403200");
  EXPECT_EQ(statuses("a scraper's token"), "200200403403");
  // That one opens no session.
  const protocol::Message message = answer(Role::Viewer, "a scraper's token");
  ASSERT_TRUE(std::holds_alternative<protocol::Error>(message.body));
  EXPECT_EQ(std::get<protocol::Error>(message.body).code, ErrorCode::Unauthorized);
}

TEST_F(AccessTest, WrongTokensAreCountedLoggedAndAnsweredLaterEachTime) {
  EXPECT_TRUE(std::holds_alternative<protocol::Error>(answer(Role::Viewer, "").body));
  EXPECT_TRUE(std::holds_alternative<protocol::Error>(answer(Role::Admin, "a viewer's token").body));
  EXPECT_EQ(test->server.counters().refused, 2u);
  EXPECT_EQ(test->server.counters().wrong_tokens, 0u) << "neither is a guess";
  for (const std::int64_t delay_ms : {0, 0, 0, 250, 500}) {
    const std::int64_t sent_ns = monotonic_ns();
    const protocol::Message message = answer(Role::Operator, "a guessed token");
    ASSERT_TRUE(std::holds_alternative<protocol::Error>(message.body));
    const auto& error = std::get<protocol::Error>(message.body);
    EXPECT_EQ(error.code, ErrorCode::Unauthorized);
    EXPECT_EQ(error.in_reply_to, 5u);
    EXPECT_GE(message.envelope.sent_ns - sent_ns, delay_ms * 1'000'000);
  }
  const std::int64_t sent_ns = monotonic_ns();
  EXPECT_EQ(status("/stats", "Bearer a guessed token"), "401");
  EXPECT_GE(monotonic_ns() - sent_ns, 1'000'000'000) << "both doors count together";
  EXPECT_EQ(test->server.counters().wrong_tokens, 6u);
  EXPECT_EQ(test->server.counters().refused, 8u);
  // Who has a token is let in from the same address.
  EXPECT_TRUE(std::holds_alternative<protocol::Welcome>(answer(Role::Viewer, "a viewer's token").body));
  const std::string metrics = get("/metrics", "Bearer a scraper's token");
  EXPECT_NE(metrics.find("\nincise_stream_refused_total 8\n"), std::string::npos) << metrics;
  EXPECT_NE(metrics.find("\nincise_stream_wrong_tokens_total 6\n"), std::string::npos);

  EXPECT_TRUE(told("role operator refused to \"a ?[31mtest\" at 127.0.0.1:", ": a wrong token"));
  EXPECT_TRUE(told("role admin refused", "does not open"));
  EXPECT_TRUE(told("role viewer refused", "no token"));
  EXPECT_TRUE(told("/stats refused to 127.0.0.1:", ": a wrong token"));
  EXPECT_FALSE(told("token", "guess")) << "what was tried stays out of the log";
}

TEST_F(AccessTest, ManyGuessesAtOnceAreNotLookedAtAndHoldNoSockets) {
  constexpr std::size_t kGuesses = 200;
  std::vector<std::unique_ptr<RawPeer>> guessers;
  for (std::size_t i = 0; i < kGuesses; ++i) {
    guessers.push_back(std::make_unique<RawPeer>(test->server.tcp_port()));
    guessers.back()->send(with_token(Role::Viewer, "a guessed token"), 5);
  }
  const auto looked_at = [&] { return test->server.counters().wrong_tokens; };
  const auto not_looked_at = [&] { return test->server.counters().tokens_not_looked_at; };
  // A connection that waits for its answer may be closed for a newer one before its Hello was read.
  ASSERT_TRUE(eventually(
      [&] { return looked_at() + not_looked_at() + test->server.counters().half_open_closed >= kGuesses; }));
  EXPECT_GT(not_looked_at(), 0u);
  RawPeer one_more(test->server.tcp_port());
  one_more.send(with_token(Role::Viewer, "a guessed token"), 9);
  const auto received = one_more.receive_until<protocol::Error>();
  ASSERT_TRUE(received);
  const auto& error = std::get<protocol::Error>(received->message.body);
  EXPECT_TRUE(error.fatal);
  EXPECT_EQ(error.in_reply_to, 9u);
  // At the other door, too, with the time after which it is worth coming back.
  std::string answer_text;
  ASSERT_TRUE(eventually([&] {
    answer_text = get("/stats", "Bearer a guessed token");
    return answer_text.substr(9, 3) == "429";
  }));
  const std::size_t header = answer_text.find("\r\nRetry-After: ");
  ASSERT_NE(header, std::string::npos) << answer_text;
  const int retry_s = std::stoi(answer_text.substr(header + 15));
  EXPECT_GE(retry_s, 1);
  EXPECT_LE(retry_s, 1 + GuessLimiter::kMaxDelay_ns / 1'000'000'000);
  // What waits ends by itself, and the address is let in again.
  ASSERT_TRUE(eventually([&] {
    return std::holds_alternative<protocol::Welcome>(answer(Role::Viewer, "a viewer's token").body);
  }));
  ASSERT_TRUE(eventually([&] { return test->server.counters().connections == 0; }));
}

TEST_F(AccessTest, ResetsTakeoversAndHandOversAreCountedAndLogged) {
  RawPeer first(test->server.tcp_port());
  first.send(with_token(Role::Operator, "an operator's token"));
  ASSERT_TRUE(first.receive_until<protocol::Welcome>());
  RawPeer second(test->server.tcp_port());
  protocol::Hello take = with_token(Role::Operator, "an operator's token");
  take.take_over = true;
  second.send(take);
  ASSERT_TRUE(second.receive_until<protocol::Welcome>());
  EXPECT_TRUE(told("blade \"blade\" taken over by \"a ?[31mtest\" at 127.0.0.1:",
                   " from \"a ?[31mtest\" at 127.0.0.1:"));
  second.send(protocol::StrokeControl{protocol::StrokeAction::HandOver, 0}, 2);
  ASSERT_TRUE(second.receive_until<protocol::Bye>());
  EXPECT_TRUE(told("blade \"blade\" handed over by", "at 127.0.0.1:"));
  RawPeer third(test->server.tcp_port());
  third.send(take);
  ASSERT_TRUE(third.receive_until<protocol::Welcome>());
  third.send(protocol::StrokeControl{protocol::StrokeAction::HandOver, 0}, 2);
  ASSERT_TRUE(third.receive_until<protocol::Bye>());
  RawPeer admin(test->server.tcp_port());
  admin.send(with_token(Role::Admin, "an admin's token"));
  ASSERT_TRUE(admin.receive_until<protocol::Welcome>());
  admin.send(protocol::Reset{}, 2);
  ASSERT_TRUE(admin.receive_until<protocol::Welcome>());
  EXPECT_TRUE(told("a reset of the mesh is asked for by", "at 127.0.0.1:"));
  const StreamCounters c = test->server.counters();
  EXPECT_EQ(c.takeovers, 1u);
  EXPECT_EQ(c.handovers, 2u);
  EXPECT_EQ(c.resets, 1u);
  const std::string metrics = get("/metrics", "Bearer a scraper's token");
  EXPECT_NE(metrics.find("\nincise_stream_takeovers_total 1\n"), std::string::npos);
  EXPECT_NE(metrics.find("\nincise_stream_handovers_total 2\n"), std::string::npos);
  EXPECT_NE(metrics.find("\nincise_stream_resets_total 1\n"), std::string::npos);
  EXPECT_EQ(c.refused, 0u);
}

TEST_F(AccessTest, OperatorsThatJoinAndLeaveAreLogged) {
  const auto join = [&](const char* blade) {
    auto peer = std::make_unique<RawPeer>(test->server.tcp_port());
    protocol::Hello wish = with_token(Role::Operator, "an operator's token");
    wish.source_name = blade;
    peer->send(wish);
    EXPECT_TRUE(peer->receive_until<protocol::Welcome>());
    return peer;
  };
  auto left = join("left"), right = join("right");
  EXPECT_TRUE(
      eventually([&] { return told("blade \"left\" is held by \"a ?[31mtest\" at 127.0.0.1:", ""); }));
  EXPECT_TRUE(
      eventually([&] { return told("blade \"right\" is held by \"a ?[31mtest\" at 127.0.0.1:", ""); }));
  left->send(protocol::Bye{}, 2);
  right.reset();
  EXPECT_TRUE(
      eventually([&] { return told("blade \"left\" is free: \"a ?[31mtest\" at", ": it has left"); }));
  EXPECT_TRUE(eventually(
      [&] { return told("blade \"right\" is free: \"a ?[31mtest\" at", ": its connection was lost"); }));
  const std::scoped_lock lock(mutex);
  EXPECT_EQ(lines.size(), 4u) << "each is said once";
}

}  // namespace
}  // namespace incise::stream
