// incised: the server. Start-up faults end it with one line that says what to do.

#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>

#include "client/cli/usage.hpp"
#include "server/app/body.hpp"
#include "server/app/certificate_check.hpp"
#include "server/app/check_option.hpp"
#include "server/app/config.hpp"
#include "server/app/end_signals.hpp"
#include "server/app/log_setup.hpp"
#include "server/app/manual.hpp"
#include "server/app/recording.hpp"
#include "server/app/server_run.hpp"
#include "server/app/version.hpp"
#include "server/base/clock.hpp"
#include "server/base/standard_output.hpp"

namespace {

int run(int argc, char** argv) {
  CLI::App app("The cut server: holds one mesh, reads blade poses, cuts, and streams what changed.",
               "incised");
  app.set_version_flag("--version", incise::app::kSoftware);
  app.footer("Exit status: " + incise::app::exit_statuses(8));
  std::string config_file, check_file;
  bool print_config = false, resume = false;
  app.add_option("--config", config_file, "Run with this configuration");
  app.add_flag("--resume", resume, "With --config: continue the session that capture.path recorded");
  const CLI::Option* const check = incise::app::add_check_option(app, check_file);
  app.add_flag("--print-config", print_config,
               "Print a configuration with all keys, their defaults and meanings");
  incise::app::add_manual_options(app, 8);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);
    std::fprintf(stderr, "incised: %s; see incised --help\n", error.what());
    return incise::client::kWrongUsage;
  }
  const std::string wrong_check = incise::app::find_checked_file(*check, config_file, check_file);
  if (!wrong_check.empty()) {
    std::fprintf(stderr, "incised: %s; see incised --help\n", wrong_check.c_str());
    return incise::client::kWrongUsage;
  }
  const std::int64_t now_s = incise::unix_ns() / 1'000'000'000;
  try {
    if (print_config) {
      std::fputs(incise::app::commented({}).c_str(), stdout);
      return 0;
    }
    if (!check_file.empty()) {
      const incise::app::Config config = incise::app::load_config(check_file);
      incise::app::check_config(config, check_file);
      incise::app::check_recording(config, check_file);
      std::vector<std::string> warnings = incise::app::check_body(config, check_file);
      for (std::string& warning : incise::app::certificate_warnings(config, now_s))
        warnings.push_back(std::move(warning));
      for (const std::string& warning : warnings)
        std::printf("%s: warning: %s\n", check_file.c_str(), warning.c_str());
      std::printf("%s: good\n", check_file.c_str());
      return 0;
    }
    if (config_file.empty()) {
      if (resume) {
        std::fputs("incised: --resume needs --config; see incised --help\n", stderr);
        return incise::client::kWrongUsage;
      }
      std::fputs(app.help().c_str(), stdout);
      return 0;
    }
    const incise::app::Config config = incise::app::load_config(config_file);
    incise::app::check_config(config, config_file);
    incise::app::check_recording(config, config_file);
    const incise::app::EndSignals signals;
    incise::app::start_log(config.log, "incised");
    for (const std::string& warning : incise::app::certificate_warnings(config, now_s))
      spdlog::warn("{}", warning);
    try {
      incise::app::run_server(config, resume, signals);
    } catch (...) {
      spdlog::shutdown();  // so that the log comes before the reason
      throw;
    }
    spdlog::shutdown();
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "incised: %s\n", error.what());
    return incise::client::kFailed;
  }
}

}  // namespace

int main(int argc, char** argv) {
  return incise::end_standard_output("incised", run(argc, argv));
}
