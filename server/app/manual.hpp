#pragma once

#include <string>

namespace CLI {
class App;
}

namespace incise::app {

// Adds the hidden options --print-man and --print-completion: the build uses them to write the manual page and the shell's
// completion from the descriptions that --help shows. `section`: of the manual, 1 or 8.
void add_manual_options(CLI::App& app, int section);

// What the exit statuses mean.
std::string exit_statuses(int section);
// The manual page (man(7) macros) of a program: its options, and its commands with theirs.
std::string man_page(const CLI::App& app, int section);
// A completion for bash: commands, the options of the present command, else files.
std::string bash_completion(const CLI::App& app);

}  // namespace incise::app
