#pragma once

#include <string>

namespace CLI {
class App;
}

namespace incise::app {

// `incise sessions`, to the other commands.
void add_cluster_commands(CLI::App& app, int& exit_code);

// "nats://HOST/NAME" (or nats+tls://) to where that session is served, by the directory, which it says on stderr: the server, or a relay first
// where nothing but watching is wanted. Any other address stays as it is. Throws UsageError, std::runtime_error.
std::string find_session(const std::string& address, bool to_watch);

}  // namespace incise::app
