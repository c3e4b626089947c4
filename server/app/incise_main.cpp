// incise: the command-line client. Commands that need a server are those of client/cli; the others work on files.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>

#include "server/app/manual.hpp"
#include "server/app/offline/commands.hpp"
#include "server/app/version.hpp"
#if INCISE_NETWORK_COMMANDS
#include "client/cli/commands.hpp"
#endif

int main(int argc, char** argv) {
  CLI::App app("Cut tetrahedral meshes with a moving blade: on files, or with a running incised.", "incise");
  app.set_version_flag("--version", incise::app::kSoftware);
  app.require_subcommand(0, 1);
  int exit_code = 0;
  incise::app::add_offline_commands(app, exit_code);
#if INCISE_NETWORK_COMMANDS
  incise::client::add_network_commands(app, exit_code);
#endif
  incise::app::add_manual_options(app, 1);
  try {
    app.parse(argc, argv);
    if (app.get_subcommands().empty()) std::fputs(app.help().c_str(), stdout);
  } catch (const CLI::ParseError& error) {
    // --help and --version end as an "error" of code 0.
    if (error.get_exit_code() == 0) return app.exit(error);
    std::fprintf(
        stderr, "incise: %s; see incise %s--help\n", error.what(),
        app.get_subcommands().empty() ? "" : (app.get_subcommands().front()->get_name() + " ").c_str());
    return 2;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "incise: %s\n", error.what());
    return 1;
  }
  return exit_code;
}
