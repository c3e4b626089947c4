#pragma once

#include <string>

namespace CLI {
class App;
}

namespace incise::app {

// Adds the hidden options --print-man and --print-completion, by which the build makes the manual page and the shell's
// completion: from the same descriptions as --help. `section`: of the manual, 1 or 8.
void add_manual_options(CLI::App& app, int section);

// The manual page (man(7) macros) of a program: its options, and its commands with theirs.
std::string man_page(const CLI::App& app, int section);
// A completion for bash: commands, the options of the command that is there, else files.
std::string bash_completion(const CLI::App& app);

}  // namespace incise::app
