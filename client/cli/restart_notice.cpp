#include "client/cli/restart_notice.hpp"

#include <cstdio>
#include <utility>

#include "client/cli/shown_name.hpp"

namespace incise::client {

std::string restart_text(const protocol::Restart& restart, std::uint64_t revision) {
  const std::string admin = "administrator " + shown_name(restart.by);
  if (restart.kind == protocol::RestartKind::Reset)
    return admin + " has reset the body: it is as loaded, all cuts are gone";
  const std::string stroke = restart.role == protocol::Role::Admin
                                 ? admin + " has undone the last stroke of blade " + shown_name(restart.blade)
                                 : "blade " + shown_name(restart.by) + " has undone its last stroke";
  return stroke + ": the body is as it was at revision " + std::to_string(revision);
}

void RestartNotice::operator()(const protocol::Welcome& welcome) {
  const std::uint64_t before = std::exchange(session_, welcome.session);
  if (before == 0 || before == welcome.session || !welcome.restart) return;
  if (welcome.restart->kind == protocol::RestartKind::None) return;  // of a kind that is not known here
  std::fprintf(stderr, "incise: server: %s\n", restart_text(*welcome.restart, welcome.revision).c_str());
}

}  // namespace incise::client
