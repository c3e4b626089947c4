// What the commands say where several hands cut one body.

#include <gtest/gtest.h>

#include <optional>
#include <string>
#include <utility>

#include "client/cli/restart_notice.hpp"

namespace incise::client {
namespace {

using protocol::Restart;
using protocol::RestartKind;
using protocol::Role;

TEST(RestartNotice, SaysOnceWhoHasUndoneOrResetWhat) {
  EXPECT_EQ(restart_text({RestartKind::Undo, Role::Operator, "left", 1, "left"}, 12),
            "blade \"left\" has undone its last stroke: the body is as it was at revision 12");
  EXPECT_EQ(restart_text({RestartKind::Undo, Role::Admin, "ward 3", 1, "left"}, 12),
            "administrator \"ward 3\" has undone the last stroke of blade \"left\": the body is as it was at "
            "revision 12");
  EXPECT_EQ(restart_text({RestartKind::Reset, Role::Admin, "a\x1b[31m\"b", 0, ""}, 0),
            "administrator \"a?[31m?b\" has reset the body: it is as loaded, all cuts are gone");

  RestartNotice notice;
  const auto said = [&](std::uint64_t session, std::optional<Restart> restart) {
    protocol::Welcome welcome;
    welcome.session = session;
    welcome.restart = std::move(restart);
    ::testing::internal::CaptureStderr();
    notice(welcome);
    return ::testing::internal::GetCapturedStderr();
  };
  const Restart reset{RestartKind::Reset, Role::Admin, "x", 0, ""};
  EXPECT_EQ(said(1, reset), "") << "it came before this client did";
  EXPECT_EQ(said(1, reset), "") << "the same ids: it was connected again";
  EXPECT_EQ(said(2, std::nullopt), "") << "an older server, or another body";
  EXPECT_EQ(said(3, reset),
            "incise: server: administrator \"x\" has reset the body: it is as loaded, all cuts are gone\n");
  EXPECT_EQ(said(4, Restart{}), "") << "of a kind that is not known here";
}

}  // namespace
}  // namespace incise::client
