#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace incise::app {

// Adds --check [FILE], which checks a configuration: FILE, or the one of --config.
inline CLI::Option* add_check_option(CLI::App& app, std::string& check_file) {
  return app
      .add_option(
          "--check", check_file,
          "Check this configuration, or that of --config, and the files that it names, and say what is wrong")
      ->expected(0, 1);
}

// After parsing: leaves in `check_file` what has to be checked, if anything. Returns what is wrong with the options; empty: nothing.
inline std::string find_checked_file(const CLI::Option& check, const std::string& config_file,
                                     std::string& check_file) {
  if (check.count() == 0) return "";
  if (!check_file.empty() && !config_file.empty())
    return "--check " + check_file + " and --config " + config_file +
           ": choose one; either checks a file, the second as --config FILE --check";
  if (check_file.empty()) check_file = config_file;
  return check_file.empty() ? "--check needs a file: --check FILE, or --config FILE --check" : "";
}

}  // namespace incise::app
