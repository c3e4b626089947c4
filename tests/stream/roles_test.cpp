// Who may send what: every role, every message.

#include <gtest/gtest.h>

#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/stream/viewer.hpp"

namespace incise::stream {
namespace {

using protocol::ErrorCode;
using protocol::Role;

constexpr Role kRoles[] = {Role::Viewer, Role::Operator, Role::Simulator, Role::Admin};

// The error that answers a message, if any. A ping sent after it tells when the answer must have arrived.
std::optional<ErrorCode> answer(TestServer& test, Role role, const protocol::Body& message) {
  RawPeer peer(test.server.tcp_port());
  protocol::Hello greeting = hello(role, protocol::View::None);
  greeting.take_over = role == Role::Operator;  // from the one before, whom the server may still see
  peer.send(greeting);
  EXPECT_TRUE(peer.receive_until<protocol::Welcome>());
  peer.send(message, 2);
  peer.send(protocol::Ping{3, 0}, 3);
  std::optional<ErrorCode> code;
  for (;;) {
    const auto received = peer.receive();
    if (!received) {
      ADD_FAILURE() << "the session ended";
      return code;
    }
    if (const auto* error = std::get_if<protocol::Error>(&received->message.body)) code = error->code;
    if (std::holds_alternative<protocol::Pong>(received->message.body)) return code;
  }
}

TEST(Roles, EachMayWhatItIsForAndNothingElse) {
  TestServer test(2);
  test.loop.start();
  const std::vector<protocol::PoseSample> poses = sweep(0.03, 3, 1);
  const std::vector<float> positions{0, 0, 0};
  protocol::Positions deformation;
  deformation.f32 = positions;
  struct Case {
    const char* name;
    protocol::Body message;
    std::vector<Role> allowed;
  };
  const std::vector<Role> all(std::begin(kRoles), std::end(kRoles));
  const std::vector<Case> cases{
      {"PoseBatch", protocol::PoseBatch{poses}, {Role::Operator}},
      {"StrokeControl", protocol::StrokeControl{protocol::StrokeAction::Engage, 0}, {Role::Operator}},
      {"Positions", deformation, {Role::Simulator}},
      {"Reset", protocol::Reset{}, {Role::Admin}},
      {"Undo", protocol::Undo{}, {Role::Operator, Role::Admin}},
      {"ReplayControl", protocol::ReplayControl{}, {Role::Viewer, Role::Admin}},
      {"Subscribe", protocol::Subscribe{}, all},
      {"Resync", protocol::Resync{}, all},
      {"Pong", protocol::Pong{}, all},
  };
  for (const Case& one : cases) {
    for (const Role role : kRoles) {
      const bool allowed = std::find(one.allowed.begin(), one.allowed.end(), role) != one.allowed.end();
      const std::optional<ErrorCode> code = answer(test, role, one.message);
      EXPECT_EQ(code != ErrorCode::Forbidden, allowed) << one.name << " from role " << static_cast<int>(role);
    }
  }
  // Messages that only a server sends are refused from every role.
  for (const Role role : kRoles) {
    EXPECT_EQ(answer(test, role, protocol::PoseReport{}), ErrorCode::BadState);
    EXPECT_EQ(answer(test, role, hello(role, protocol::View::None)), ErrorCode::BadState);
  }
}

// An undo counts once it is done, also where its asker has gone. A late refusal says which request it answers.
TEST(Roles, AnUndoIsAnsweredWhenItIsDoneOrCannotBe) {
  std::mutex mutex;
  std::vector<std::string> audited;
  Providers providers;
  providers.audit = [&](Audit kind, const std::string&, const std::string& line) {
    const std::scoped_lock lock(mutex);
    if (kind == Audit::kReset) audited.push_back(line.substr(0, line.find('"')));
  };
  const auto lines = [&] {
    const std::scoped_lock lock(mutex);
    return audited;
  };
  TestServer test(2, test_config(), std::move(providers));
  RawPeer stays(test.server.tcp_port());
  stays.send(hello(Role::Admin, protocol::View::None));
  ASSERT_TRUE(stays.receive_until<protocol::Welcome>());
  stays.send(protocol::Undo{}, 17);
  ASSERT_TRUE(eventually([&] { return test.loop.asked_undos().size() == 1; }));
  {
    RawPeer leaves(test.server.tcp_port());
    leaves.send(hello(Role::Admin, protocol::View::None));
    ASSERT_TRUE(leaves.receive_until<protocol::Welcome>());
    for (const std::uint64_t sequence : {2, 3}) leaves.send(protocol::Undo{}, sequence);
    ASSERT_TRUE(eventually([&] { return test.loop.asked_undos().size() == 3; }));
  }
  ASSERT_TRUE(eventually([&] { return test.server.counters().peers == 1; }));
  EXPECT_EQ(test.server.counters().undos, 0u) << "none is done yet";
  const auto undos = test.loop.asked_undos();
  undos[1](Refusal{ErrorCode::NotAvailable, "Undo: not now"});
  undos[2](std::nullopt);
  undos[0](Refusal{ErrorCode::NotAvailable, "Undo: not now"});
  const auto received = stays.receive_until<protocol::Error>();
  ASSERT_TRUE(received);
  const auto& error = std::get<protocol::Error>(received->message.body);
  EXPECT_EQ(error.in_reply_to, 17u);
  EXPECT_EQ(error.text, "Undo: not now");
  EXPECT_FALSE(error.fatal);
  EXPECT_EQ(test.server.counters().undos, 1u);
  const std::string asked = "an undo is asked for by ", refused = "the undo that ";
  EXPECT_EQ(lines(), (std::vector<std::string>{asked, asked, asked, refused, "the last stroke is undone for ",
                                               refused}));
}

// What a simulator may send positions of: vertices that exist, at a revision that exists.
TEST(Roles, PositionsOfAnotherMeshOrATimeToComeAreRefused) {
  TestServer test(2);
  constexpr std::uint32_t kVertices = 27;
  const auto positions = [](std::uint64_t revision, std::uint32_t first, const std::vector<float>& numbers,
                            std::span<const std::uint32_t> ids = {}) {
    protocol::Positions message;
    message.revision = revision;
    message.first = first;
    message.f32 = numbers;
    message.ids = ids;
    return message;
  };
  const std::vector<float> one{0, 0, 0}, two(6), none;
  const std::vector<std::uint32_t> last{kVertices - 1}, beyond{kVertices};
  const auto code = [&](const protocol::Positions& message) {
    return answer(test, Role::Simulator, message);
  };
  // This server's loop takes none: what is well formed is refused for that.
  EXPECT_EQ(code(positions(0, 0, one)), ErrorCode::NotAvailable);
  EXPECT_EQ(code(positions(0, kVertices - 2, two)), ErrorCode::NotAvailable);
  EXPECT_EQ(code(positions(0, 0, one, last)), ErrorCode::NotAvailable);
  EXPECT_EQ(code(positions(1, 0, one)), ErrorCode::BadRequest);
  EXPECT_EQ(code(positions(0, 0, none)), ErrorCode::BadRequest);
  EXPECT_EQ(code(positions(0, kVertices - 1, two)), ErrorCode::BadRequest);
  EXPECT_EQ(code(positions(0, 0, one, beyond)), ErrorCode::BadRequest);
}

}  // namespace
}  // namespace incise::stream
