#include "client/cli/restart_notice.hpp"

#include <cstdio>
#include <nlohmann/json.hpp>
#include <utility>

#include "client/cli/shown_name.hpp"
#include "protocol/role_names.hpp"

namespace incise::client {

std::string restart_text(const protocol::Restart& restart, std::uint64_t revision) {
  const std::string admin = "administrator " + shown_name(restart.by);
  if (restart.kind == protocol::RestartKind::Reset)
    return admin + " has reset the body: it is as loaded, all cuts are gone";
  const std::string stroke = restart.role == protocol::Role::Admin
                                 ? admin + " has undone the last stroke of blade " + shown_name(restart.blade)
                                 : "blade " + shown_name(restart.by) + " has undone its last stroke";
  std::string others;
  for (std::size_t i = 0; i < restart.others.size(); ++i)
    others += (i == 0                          ? ", and with it what "
               : i + 1 < restart.others.size() ? ", "
                                               : " and ") +
              shown_name(restart.others[i]);
  if (!others.empty()) others += restart.others.size() == 1 ? " has cut since" : " have cut since";
  return stroke + others + ": the body is as it was at revision " + std::to_string(revision);
}

std::string restart_json(const protocol::Restart& restart, std::uint64_t revision) {
  const bool undo = restart.kind == protocol::RestartKind::Undo;
  nlohmann::ordered_json line{{"event", undo ? "undo" : "reset"},
                              {"revision", revision},
                              {"by", restart.by},
                              {"role", protocol::name_of(restart.role)}};
  if (undo) line.update({{"blade", restart.blade}, {"others", restart.others}});
  // Names are what clients have sent.
  return line.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

bool RestartNotice::operator()(const protocol::Welcome& welcome) {
  const std::uint64_t before = std::exchange(session_, welcome.session);
  if (before == 0 || before == welcome.session || !welcome.restart) return false;
  if (welcome.restart->kind == protocol::RestartKind::None) return false;  // of a kind that is not known here
  std::fprintf(stderr, "incise: server: %s\n", restart_text(*welcome.restart, welcome.revision).c_str());
  return true;
}

}  // namespace incise::client
