// Who may send what: every role, every message.

#include <gtest/gtest.h>

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
