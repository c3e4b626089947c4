// incise: the command-line client. Commands that need a server are those of client/cli; the others work on files.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <exception>
#include <memory>
#include <numeric>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "client/cli/usage.hpp"
#include "server/app/cluster_commands.hpp"
#include "server/app/manual.hpp"
#include "server/app/offline/commands.hpp"
#include "server/app/version.hpp"
#include "server/base/standard_output.hpp"
#if INCISE_NETWORK_COMMANDS
#include "client/cli/commands.hpp"
#include "server/app/offline/streamed_motion.hpp"
#endif

namespace {

// How many letters must be changed, added or removed to turn one word into the other.
std::size_t distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = std::exchange(row[0], i);
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = std::exchange(row[j], std::min({row[j] + 1, row[j - 1] + 1, replaced}));
    }
  }
  return row.back();
}

// The word that was probably meant; empty if none is close.
std::string meant(const std::string& word, const std::vector<std::string>& known) {
  std::string best;
  std::size_t least = 1 + std::min<std::size_t>(word.size() / 3, 3);
  for (const std::string& one : known) {
    const std::size_t off = one.rfind(word, 0) == 0 && word.size() > 3 ? 1 : distance(word, one);
    if (off >= least) continue;
    least = off;
    best = one;
  }
  return best;
}

std::string unknown(const std::string& what, const std::string& word, const std::vector<std::string>& known) {
  const std::string probably = meant(word, known);
  return "unknown " + what + " " + word + (probably.empty() ? "" : " (did you mean " + probably + "?)");
}

std::vector<std::string> commands_of(const CLI::App& app) {
  std::vector<std::string> commands;
  for (const CLI::App* sub : app.get_subcommands([](const CLI::App*) { return true; }))
    commands.push_back(sub->get_name());
  return commands;
}

// What is wrong with a command line. An unknown option or command comes first, since other faults often follow from it.
std::string problem(const CLI::App& app, int argc, char** argv, const std::string& otherwise) {
  const bool called = !app.get_subcommands().empty();
  const CLI::App& command = called ? *app.get_subcommands().front() : app;
  std::vector<std::string> options;
  for (const CLI::Option* option : command.get_options()) {
    for (const std::string& name : option->get_lnames()) options.push_back("--" + name);
  }
  if (!called && argc > 1 && argv[1][0] != '-') return unknown("command", argv[1], commands_of(app));
  for (int i = 1; i < argc; ++i) {
    const std::string word = std::string(argv[i]).substr(0, std::string(argv[i]).find('='));
    if (word == "--") break;
    if (word.rfind("--", 0) == 0 && std::find(options.begin(), options.end(), word) == options.end())
      return unknown("option", word, options);
  }
  return otherwise;
}

// `incise help`, which many try first: what --help prints.
void add_help(CLI::App& app) {
  CLI::App* const sub = app.add_subcommand("help", "Print this help, or that of a command");
  auto name = std::make_shared<std::string>();
  sub->add_option("command", *name, "The command");
  sub->callback([&app, name] {
    std::string text;
    // App::help() gives the help of the command that was called: this one.
    if (name->empty())
      text = app.get_formatter()->make_help(&app, app.get_name(), CLI::AppFormatMode::Normal);
    for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; }))
      if (command->get_name() == *name) text = command->help(app.get_name());
    if (text.empty())
      throw incise::client::UsageError(unknown("command", *name, commands_of(app)) + "; see incise --help");
    std::fputs(text.c_str(), stdout);
  });
}

int run(int argc, char** argv) {
  CLI::App app("Cut tetrahedral meshes with a moving blade: on files, or with a running incised.", "incise");
  app.set_version_flag("--version", incise::app::kSoftware);
  app.require_subcommand(0, 1);
  app.footer("Exit status: " + incise::app::exit_statuses(1));
  int exit_code = incise::client::kSuccess;
  incise::app::add_offline_commands(app, exit_code);
#if INCISE_NETWORK_COMMANDS
  incise::client::add_network_commands(app, exit_code, incise::app::read_streamed_motion,
                                       incise::app::find_session);
  incise::app::add_cluster_commands(app, exit_code);
#endif
  add_help(app);
  incise::app::add_manual_options(app, 1);
  try {
    app.parse(argc, argv);
    if (app.get_subcommands().empty()) std::fputs(app.help().c_str(), stdout);
  } catch (const CLI::ParseError& error) {
    // --help and --version arrive as an "error" of code 0.
    if (error.get_exit_code() == 0) return app.exit(error);
    std::fprintf(
        stderr, "incise: %s; see incise %s--help\n", problem(app, argc, argv, error.what()).c_str(),
        app.get_subcommands().empty() ? "" : (app.get_subcommands().front()->get_name() + " ").c_str());
    return incise::client::kWrongUsage;
  } catch (const incise::client::UsageError& error) {
    std::fprintf(stderr, "incise: %s\n", error.what());
    return incise::client::kWrongUsage;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "incise: %s\n", error.what());
    return incise::client::kFailed;
  }
  return exit_code;
}

}  // namespace

int main(int argc, char** argv) {
  return incise::end_standard_output("incise", run(argc, argv));
}
