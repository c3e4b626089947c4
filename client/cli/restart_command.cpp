#include <chrono>
#include <cstdio>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>

#include "client/cli/commands.hpp"
#include "client/cli/restart_notice.hpp"

namespace incise::client {
namespace {

using std::chrono::steady_clock;

// The server answers an undo after ten seconds at most, when it has waited for strokes to end.
constexpr std::chrono::seconds kPatience{15};

}  // namespace

protocol::Welcome restart_as_admin(const Address& where, Options options, protocol::RestartKind kind) {
  options.role = protocol::Role::Admin;
  options.view = protocol::View::None;
  std::mutex mutex;
  std::string refusal;  // guarded by mutex
  Callbacks callbacks;
  callbacks.on_error = [&](const protocol::Error& error) {
    const std::scoped_lock lock(mutex);
    refusal = error.text;
  };
  const auto client = connect(where, options, std::move(callbacks));
  const std::uint64_t before = client->welcome().session;
  if (kind == protocol::RestartKind::Undo) {
    client->undo();
  } else {
    client->reset();
  }
  const auto began = steady_clock::now();
  for (;;) {
    protocol::Welcome now = client->welcome();
    // Somebody else may have been quicker; an older server does not say who it was.
    if (now.session != before && (!now.restart || now.restart->by == options.client_name)) return now;
    {
      const std::scoped_lock lock(mutex);
      if (!refusal.empty()) throw std::runtime_error(refusal);
    }
    if (client->status() != Status::kConnected) throw std::runtime_error(client->last_error());
    if (steady_clock::now() - began > kPatience)
      throw std::runtime_error("the server has not answered within " + std::to_string(kPatience.count()) +
                               " s; try again");
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

int run_restart(const RestartCommand& command) {
  Address where;
  Options options = command.server.options(where);
  const bool undo = command.kind == protocol::RestartKind::Undo;
  options.client_name = undo ? "incise undo" : "incise reset";  // the others are told
  protocol::Welcome after;
  try {
    after = restart_as_admin(where, options, command.kind);
  } catch (const ConnectError&) {
    throw;  // names the server
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(command.server.address + ": " + error.what());
  }
  protocol::Restart done;
  done.kind = command.kind;
  done.role = protocol::Role::Admin;
  done.by = options.client_name;
  if (after.restart) done = *after.restart;
  std::printf("%s\n", command.json ? restart_json(done, after.revision).c_str()
                                   : restart_text(done, after.revision).c_str());
  return 0;
}

}  // namespace incise::client
