// Relays that are killed, whose origin is, and that are lied to.

#include <gtest/gtest.h>

#include <chrono>
#include <csignal>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "protocol/coalesce.hpp"
#include "server/relay/session.hpp"
#include "server/relay/upstream_says.hpp"
#include "tests/e2e/recovery.hpp"
#include "tests/e2e/served_session.hpp"
#include "tests/relay/relay_process.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::relay {
namespace {

using e2e::PoseDriver;
using e2e::ServedSession;
using e2e::wait_for;
using protocol::View;
using std::chrono::milliseconds;

std::string place(std::uint16_t port) {
  return "127.0.0.1:" + std::to_string(port);
}

// All are at the origin's revision with its hash, once nothing is cut any more.
void expect_all_there(const ServedSession& session, const std::vector<Witness*>& witnesses) {
  ASSERT_TRUE(wait_for([&] { return session.stat("/backlog/batches") == 0.0; }));
  const e2e::Held truth = e2e::what_the_server_has(session);
  for (Witness* witness : witnesses) {
    EXPECT_TRUE(wait_for([&] { return witness->client().revision() == truth.revision; }))
        << witness->client().revision() << " of " << truth.revision << ' ' << witness->client().last_error();
    EXPECT_EQ(witness->seen()[truth.revision], truth.hash);
    EXPECT_EQ(witness->went_back(), 0);
    EXPECT_EQ(witness->resyncs(), 0);
  }
}

TEST(RelayFaults, TheOriginIsKilledAndResumesUnderCutting) {
  ServedSession session("relay_kill", 4000, R"(, "sync": "none")");
  ASSERT_TRUE(session.start(false)) << session.log();
  RelayProcess near(place(session.tcp_port()), session.http_port());
  ASSERT_TRUE(near.start()) << near.log();
  RelayProcess far(near.place(), near.http_port());
  ASSERT_TRUE(far.start()) << far.log();
  client::Options surface;
  surface.view = View::Surface;
  Witness a(near.tcp_port()), b(far.tcp_port()), c(far.tcp_port(), surface);
  for (int i = 0; i < 4; ++i) {
    PoseDriver driver(session, 1000, 0.4, "blade", i % 2 == 0 ? 0 : far.tcp_port());
    const double from = session.stat("/revision").value_or(0);
    ASSERT_TRUE(wait_for([&] { return session.stat("/revision").value_or(0) > from + 40; })) << session.log();
    session.kill();
    ASSERT_TRUE(session.start(true)) << session.log();
    const double resumed = session.stat("/revision").value_or(0);
    ASSERT_TRUE(wait_for([&] { return session.stat("/revision").value_or(0) > resumed + 20; }))
        << "the operator goes on, at the relay, too\n"
        << session.log() << far.log();
    ASSERT_TRUE(driver.settle());
  }
  expect_all_there(session, {&a, &b, &c});
  EXPECT_EQ(a.client().counters().reconnects, 0u) << "viewers stay where they are\n" << near.log();
  EXPECT_EQ(b.client().counters().reconnects, 0u) << far.log();
  EXPECT_EQ(a.epochs(), 0) << "the epoch is the same after a resume";
}

TEST(RelayFaults, RelaysAreKilledUnderCutting) {
  ServedSession session("relay_kills", 4000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  RelayProcess near(place(session.tcp_port()), session.http_port());
  ASSERT_TRUE(near.start()) << near.log();
  RelayProcess far(near.place(), near.http_port());
  ASSERT_TRUE(far.start()) << far.log();
  client::Options boxed;
  boxed.box = protocol::Box{{-1, -1, -1}, {0.02, 1, 1}};
  Witness a(near.tcp_port()), b(far.tcp_port()), c(far.tcp_port(), boxed);
  PoseDriver driver(session, 1000, 0.4);
  for (int i = 0; i < 6; ++i) {
    RelayProcess& victim = i % 2 == 0 ? near : far;
    std::this_thread::sleep_for(milliseconds(150 + 40 * i));
    victim.kill();
    ASSERT_TRUE(victim.start()) << victim.log();
    std::this_thread::sleep_for(milliseconds(200));
  }
  ASSERT_TRUE(driver.settle());
  EXPECT_EQ(driver.accepted(), driver.sent()) << "the origin and its operator notice nothing";
  expect_all_there(session, {&a, &b, &c});
}

// Nobody there has a server, and what one asks of the next comes back to it.
TEST(RelayFaults, ACycleIsNoticedAndLeftOnceItIsMended) {
  ServedSession session("relay_cycle", 3000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  RelayProcess near(place(session.tcp_port()), session.http_port());
  ASSERT_TRUE(near.start()) << near.log();
  RelayProcess far(near.place(), near.http_port());
  ASSERT_TRUE(far.start()) << far.log();
  near.kill();
  near.follow(far.place(), far.http_port());
  ASSERT_TRUE(near.start()) << near.log();
  const auto health = [&](int code) { return near.health() == code && far.health() == code; };
  const auto noticed = [&] { return health(503); };
  ASSERT_TRUE(wait_for(noticed) || wait_for(noticed)) << near.log() << far.log();
  EXPECT_NE(stream::http(far.http_port(), "/healthz").find("relays follow each other in a cycle"),
            std::string::npos);
  // It stays so, also when they look again.
  for (int i = 0; i < 24; ++i) {
    std::this_thread::sleep_for(milliseconds(500));
    EXPECT_TRUE(health(503));
  }
  EXPECT_EQ(near.stat("/relay/hops"), kMaxHops + 1.0);
  EXPECT_EQ(far.stat("/relay/hops"), kMaxHops + 1.0);
  stream::RawPeer operator_there(far.tcp_port());
  protocol::Hello hello;
  hello.role = protocol::Role::Operator;
  hello.view = View::None;
  hello.source_name = "blade";
  operator_there.send(hello);
  const auto refused = operator_there.receive_until<protocol::Error>();
  ASSERT_TRUE(refused);
  EXPECT_EQ(std::get<protocol::Error>(refused->message.body).code, protocol::ErrorCode::NotAvailable)
      << "nobody is sent round";
  for (const RelayProcess* relay : {&near, &far}) {
    const std::string log = relay->log();
    const std::size_t said = log.find("in a cycle");
    ASSERT_NE(said, std::string::npos) << log;
    EXPECT_EQ(log.find("in a cycle", said + 1), std::string::npos) << log;
  }
  near.kill();
  near.follow(place(session.tcp_port()), session.http_port());
  ASSERT_TRUE(near.start()) << near.log();
  EXPECT_TRUE(wait_for([&] { return health(200); })) << near.log() << far.log();
  EXPECT_EQ(far.stat("/relay/hops"), 2.0);
}

TEST(RelayFaults, AnOriginThatIsAwayForAWhileIsWaitedFor) {
  ServedSession session("relay_away", 4000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  Wire wire(session.tcp_port());
  RelayProcess relay(place(wire.port()), session.http_port());
  ASSERT_TRUE(relay.start()) << relay.log();
  RelayProcess far(relay.place(), relay.http_port()), farther(far.place(), far.http_port());
  ASSERT_TRUE(far.start()) << far.log();
  farther.follow(far.place(), far.http_port());
  ASSERT_TRUE(farther.start()) << farther.log();
  Witness viewer(relay.tcp_port());
  EXPECT_EQ(relay.health(), 200);
  EXPECT_EQ(farther.health(), 200);
  PoseDriver driver(session, 1000, 0.3);
  ASSERT_TRUE(wait_for([&] { return viewer.client().revision() > 20; }));
  wire.cut(true);
  EXPECT_TRUE(wait_for([&] { return relay.health() == 503; }));
  EXPECT_NE(stream::http(relay.http_port(), "/healthz").find("no connection to"), std::string::npos);
  // Relays behind it are connected, and nothing reaches them either.
  EXPECT_TRUE(wait_for([&] { return farther.health() == 503; })) << farther.log();
  EXPECT_NE(stream::http(farther.http_port(), "/healthz").find("at " + relay.place() + ": no connection to"),
            std::string::npos)
      << stream::http(farther.http_port(), "/healthz");
  const std::uint64_t then = viewer.client().revision();
  std::this_thread::sleep_for(std::chrono::seconds(3));
  EXPECT_EQ(viewer.client().revision(), then);
  EXPECT_EQ(viewer.client().status(), client::Status::kConnected);
  EXPECT_EQ(relay.stat("/relay/connected"), 0.0);
  EXPECT_EQ(relay.log().find(place(wire.port()) + ": " + place(wire.port())), std::string::npos)
      << "the address once: " << relay.log();
  // Who comes now is shown what there is.
  Witness late(relay.tcp_port());
  EXPECT_TRUE(late.client().wait_for_revision(then, 20));
  wire.cut(false);
  EXPECT_TRUE(wait_for([&] { return relay.health() == 200; })) << relay.log();
  EXPECT_TRUE(wait_for([&] { return farther.health() == 200; })) << farther.log();
  ASSERT_TRUE(driver.settle());
  expect_all_there(session, {&viewer, &late});
  EXPECT_EQ(viewer.client().counters().snapshots, 1u) << "deltas lead on from where it was";
  EXPECT_EQ(viewer.client().counters().reconnects, 0u);
  EXPECT_EQ(relay.stat("/relay/resumed"), 1.0);
  EXPECT_EQ(relay.stat("/relay/snapshots"), 1.0);
}

// An origin that has held deltas back for a slow reader sends several revisions in one, and so do relays. One that stands still, and one
// whose origin does, go on.
TEST(RelayFaults, CombinedDeltasLeadToTheSame) {
  ServedSession session("relay_combined", 6000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  Wire wire(session.tcp_port());
  RelayProcess relay(place(wire.port()), session.http_port());
  ASSERT_TRUE(relay.start()) << relay.log();
  RelayProcess far(relay.place(), relay.http_port());
  ASSERT_TRUE(far.start()) << far.log();
  client::Options surface, boxed, slow;
  surface.view = View::Surface;
  boxed.box = protocol::Box{{-1, -1, -1}, {0.02, 1, 1}};
  slow.max_rate_hz = 3;
  Witness direct(session.tcp_port()), a(relay.tcp_port()), b(relay.tcp_port(), surface),
      c(relay.tcp_port(), boxed), d(relay.tcp_port(), slow), e(far.tcp_port());
  // Between origin and relay every seven become one.
  std::vector<std::vector<std::uint64_t>> kept;
  std::vector<protocol::Message> held;
  wire.meddle([&](std::span<const std::byte> body) -> std::optional<std::vector<std::byte>> {
    kept.emplace_back((body.size() + 7) / 8);
    std::memcpy(kept.back().data(), body.data(), body.size());
    protocol::DecodeResult decoded =
        protocol::decode(std::as_bytes(std::span(kept.back())).first(body.size()));
    if (!decoded || !std::holds_alternative<protocol::Delta>(decoded.message->body)) return std::nullopt;
    held.push_back(std::move(*decoded.message));
    std::vector<std::byte> bytes;
    if (held.size() < 7) return bytes;
    std::vector<protocol::Delta> deltas;
    for (const protocol::Message& message : held) deltas.push_back(std::get<protocol::Delta>(message.body));
    const protocol::Frame frame = protocol::encode(protocol::coalesce(deltas).view(), held.back().envelope);
    bytes.assign(frame.tcp().begin(), frame.tcp().end());
    held.clear();
    kept.clear();
    return bytes;
  });
  {
    PoseDriver driver(session, 1000, 0.4);
    ASSERT_TRUE(wait_for([&] { return session.stat("/revision").value_or(0) > 300; }));
    for (e2e::Process* still : {&relay.process(), &session.server()}) {
      still->signal(SIGSTOP);
      std::this_thread::sleep_for(milliseconds(700));
      still->signal(SIGCONT);
    }
    ASSERT_TRUE(driver.settle());
  }
  EXPECT_TRUE(wait_for([&] { return relay.stat("/relay/combined").value_or(0) > 40; }));
  EXPECT_TRUE(wait_for([&] { return far.stat("/relay/combined") == relay.stat("/relay/combined"); }));
  // What is left over comes with the connection's end: the relay goes on from its own revision.
  wire.meddle(nullptr);
  wire.cut(true);
  wire.cut(false);
  expect_all_there(session, {&direct, &a, &b, &c, &d, &e});
  for (Witness* witness : {&a, &b, &c, &e}) {
    bool equal = true;
    EXPECT_GT(common(witness->seen(), direct.seen(), equal), 40);
    EXPECT_TRUE(equal);
    EXPECT_EQ(witness->client().counters().snapshots, 1u);
    EXPECT_EQ(witness->client().counters().reconnects, 0u);
  }
  EXPECT_EQ(relay.stat("/relay/refused"), 0.0);
}

// A server that announces a hash that is not the state's, and one that changes the state itself.
TEST(RelayFaults, WhatIsWrongNeverReachesViewers) {
  ServedSession session("relay_lies", 4000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  Wire wire(session.tcp_port());
  RelayProcess relay(place(wire.port()), session.http_port());
  ASSERT_TRUE(relay.start()) << relay.log();
  client::Options surface;
  surface.view = View::Surface;
  Witness direct(session.tcp_port()), viewer(relay.tcp_port()), other(relay.tcp_port(), surface);
  PoseDriver driver(session, 1000, 0.3);
  int lies = 0;
  for (const bool in_the_hash : {true, false}) {
    const double from = session.stat("/revision").value_or(0);
    ASSERT_TRUE(wait_for([&] { return session.stat("/revision").value_or(0) > from + 20; }));
    std::atomic<bool> lied{false};
    wire.meddle([&, in_the_hash](std::span<const std::byte> body) -> std::optional<std::vector<std::byte>> {
      if (lied) return std::nullopt;
      protocol::DecodeResult decoded = protocol::decode(body);
      auto* delta = decoded ? std::get_if<protocol::Delta>(&decoded.message->body) : nullptr;
      if (!delta || (!in_the_hash && delta->added_positions.empty())) return std::nullopt;
      std::vector<double> moved(delta->added_positions.begin(), delta->added_positions.end());
      if (in_the_hash) {
        delta->state_hash ^= 1;
      } else {
        moved[0] += 1e-3;
        delta->added_positions = moved;
      }
      lied = true;
      const protocol::Frame frame = protocol::encode(*delta, decoded.message->envelope);
      return std::vector<std::byte>(frame.tcp().begin(), frame.tcp().end());
    });
    ASSERT_TRUE(wait_for([&] { return lied.load(); }));
    ++lies;
    EXPECT_TRUE(wait_for([&] { return relay.stat("/relay/refused") == lies; })) << relay.log();
    EXPECT_TRUE(wait_for([&] { return relay.health() == 200; }));
    std::this_thread::sleep_for(milliseconds(1100));  // another one within a second is another matter
    wire.meddle(nullptr);
  }
  ASSERT_TRUE(driver.settle());
  expect_all_there(session, {&direct, &viewer, &other});
  bool equal = true;
  EXPECT_GT(common(viewer.seen(), direct.seen(), equal), 50);
  common(other.seen(), direct.seen(), equal);
  EXPECT_TRUE(equal) << "no viewer was ever shown a state that the origin did not have";
  EXPECT_EQ(viewer.client().counters().reconnects, 0u);
  EXPECT_EQ(viewer.epochs() + other.epochs(), 0);
}

// Bytes that are no message, messages cut short, a snapshot of another view, promises that do not fit.
TEST(RelayFaults, AMalformedUpstreamIsLeftAndComeBackTo) {
  ServedSession session("relay_noise", 3000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  Wire wire(session.tcp_port());
  RelayProcess relay(place(wire.port()), session.http_port());
  ASSERT_TRUE(relay.start()) << relay.log();
  Witness viewer(relay.tcp_port());
  PoseDriver driver(session, 1000, 0.3);
  const auto with = [](const protocol::Body& body) {
    const protocol::Frame frame = protocol::encode(body, {0, 1});
    return std::vector<std::byte>(frame.tcp().begin(), frame.tcp().end());
  };
  protocol::SnapshotBegin surface;
  surface.view = View::Surface;
  protocol::SnapshotBegin many;
  many.chunks = 60'000;
  many.vertex_count = many.tet_count = 0x3ffffffe;
  protocol::Delta nonsense;
  nonsense.base_revision = 0;
  nonsense.revision = 1'000'000;
  protocol::Stats deep;
  deep.json = std::string(500'000, '[') + std::string(500'000, ']');
  protocol::Stats rude;
  rude.json = R"({"relay": {"trouble": "\"}\n)" + std::string(511, 'x') + R"(\u00e9", "hops": 1}})";
  protocol::Welcome promise;
  promise.resumed = true;
  promise.session = 4711;
  const std::vector<std::vector<std::byte>> noises{
      std::vector<std::byte>(64, std::byte{0xff}),
      std::vector<std::byte>(64, std::byte{0x11}),
      with(surface),
      with(many),
      with(nonsense),
      with(promise),
      with(protocol::SnapshotEnd{5, 5, 5, 5}),
      with(protocol::FieldValues{7, 0, {}, {}, 3, true}),
      with(deep),
      with(rude),
      with(protocol::Error{protocol::ErrorCode::Internal, "not my day", true, 0}),
      with(protocol::Bye{protocol::ByeReason::ServerStops, "the server stops"}),
  };
  for (std::size_t i = 0; i < noises.size(); ++i) {
    SCOPED_TRACE(i);
    std::atomic<bool> sent{false};
    wire.meddle([&](std::span<const std::byte>) -> std::optional<std::vector<std::byte>> {
      if (sent.exchange(true)) return std::nullopt;
      return noises[i];
    });
    ASSERT_TRUE(wait_for([&] { return sent.load(); }));
    // Until true statistics come again, what it said may be shown.
    for (int look = 0; look < 10; ++look) {
      std::this_thread::sleep_for(milliseconds(10));
      const std::string answer = stream::http(relay.http_port(), "/healthz");
      if (answer.empty()) continue;  // another body is another server: it is being replaced
      const std::size_t json = answer.find('{');
      ASSERT_NE(json, std::string::npos) << answer;
      EXPECT_TRUE(nlohmann::json::accept(answer.substr(json))) << answer;
    }
    const double origin = session.stat("/revision").value_or(0);
    EXPECT_TRUE(wait_for([&] { return static_cast<double>(viewer.client().revision()) > origin; }))
        << relay.log();
    EXPECT_TRUE(relay.stat("/relay/connected")) << "its statistics can be had";
    wire.meddle(nullptr);
  }
  ASSERT_TRUE(driver.settle());
  ASSERT_TRUE(wait_for([&] { return session.stat("/backlog/batches") == 0.0; }));
  const e2e::Held truth = e2e::what_the_server_has(session);
  EXPECT_TRUE(wait_for([&] { return e2e::held(viewer.client()) == truth; }));
  EXPECT_EQ(viewer.went_back(), 0);
  EXPECT_EQ(viewer.resyncs(), 0);
}

TEST(RelayFaults, TokensAreCheckedAtTheEdge) {
  ServedSession session("relay_tokens", 3000, "");
  ASSERT_TRUE(session.start(false)) << session.log();
  RelayProcess open(place(session.tcp_port()), session.http_port());
  ASSERT_TRUE(open.start()) << open.log();
  RelayProcess guarded(open.place(), open.http_port(), R"(, "token_file": "tokens.json")");
  std::ofstream(guarded.file("tokens.json"))
      << R"([{"token": "watching-only-0001", "roles": ["viewer"]}, {"token": "hands-on-000000001", "roles": ["viewer", "operator"]}])";
  ASSERT_TRUE(guarded.start()) << guarded.log();
  // The next one has the wrong token for that, and then the right one.
  RelayProcess last(guarded.place(), guarded.http_port(), "", R"(, "token_file": "token")");
  std::ofstream(last.file("token")) << "hands-on-000000001\n";
  ASSERT_TRUE(last.start()) << last.log();

  // One without a token does not come as far as listening.
  e2e::Process bare({"/bin/sh", "-c",
                     "exec " + std::string(INCISE_BIN_DIR) + "/incise-relay --to " + guarded.place() +
                         " --port 0 --http-port 0 2>&1"});
  std::string said;
  for (std::string line = bare.line("2"); !line.empty(); line = bare.line("2", 20)) {
    said += line + "\n";
    if (line.find("no connection to") != std::string::npos) break;
  }
  EXPECT_NE(
      said.find("none was given; give one as relay.token_file, with --token-file FILE or in INCISE_TOKEN"),
      std::string::npos)
      << said;

  const auto verdict = [](std::uint16_t port, protocol::Role role, const std::string& token) {
    stream::RawPeer raw(port);
    protocol::Hello hello;
    hello.role = role;
    hello.source_name = "blade";
    hello.token = token;
    raw.send(hello);
    const auto received = raw.receive();
    if (!received) return std::string("nothing");
    if (const auto* error = std::get_if<protocol::Error>(&received->message.body)) return error->text;
    return std::string(name_of(received->message.body));
  };
  using protocol::Role;
  EXPECT_EQ(verdict(guarded.tcp_port(), Role::Viewer, ""), "role viewer needs a token, and none was given");
  EXPECT_EQ(verdict(guarded.tcp_port(), Role::Viewer, "watching-only-0001"), "Welcome");
  EXPECT_EQ(verdict(guarded.tcp_port(), Role::Operator, "watching-only-0001"),
            "the token is wrong, or does not open role operator");
  EXPECT_EQ(verdict(guarded.tcp_port(), Role::Operator, "hands-on-000000001"), "Welcome");
  EXPECT_EQ(verdict(last.tcp_port(), Role::Viewer, ""), "Welcome") << "it asks for none itself";
  EXPECT_TRUE(wait_for([&] { return verdict(last.tcp_port(), Role::Operator, "") == "Welcome"; }));
  EXPECT_NE(stream::http(guarded.http_port(), "/stats").find("401"), std::string::npos);
  const auto shown = [&] {
    return stream::http(guarded.http_port(), "/stats", "GET", "Authorization: Bearer watching-only-0001\r\n");
  };
  EXPECT_TRUE(wait_for([&] { return shown().find("\"hops\":2") != std::string::npos; }))
      << "once the first has told";
  // A token that opens only watching lets nobody cut through it.
  std::ofstream(last.file("token")) << "watching-only-0001\n";
  last.kill();
  ASSERT_TRUE(last.start()) << last.log();
  EXPECT_EQ(verdict(last.tcp_port(), Role::Operator, ""),
            "the token is wrong, or does not open role operator");
}

}  // namespace
}  // namespace incise::relay
