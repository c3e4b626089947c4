#include "server/app/manual.hpp"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cctype>
#include <cstdio>

#include "server/app/version.hpp"

namespace incise::app {
namespace {

// Escapes text for man(7): no macro at a line's start, no escape, hyphens that can be copied.
std::string man_text(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if ((c == '.' || c == '\'') && (out.empty() || out.back() == '\n')) out += "\\&";
    if (c == '\\') {
      out += "\\e";
    } else if (c == '-') {
      out += "\\-";
    } else {
      out += c;
    }
  }
  return out;
}

// Those that --help shows.
std::vector<const CLI::Option*> shown_options(const CLI::App& app) {
  return app.get_options([](const CLI::Option* option) { return !option->get_group().empty(); });
}

std::string placeholder(const CLI::Option& option) {
  if (option.get_expected_max() == 0 || option.get_type_size() == 0) return "";
  return option.get_expected_min() == 0 ? "[" + option.get_type_name() + "]" : option.get_type_name();
}

std::string names(const CLI::Option& option) {
  std::string text;
  if (option.get_positional()) return "\\fI" + man_text(option.get_name(true)) + "\\fP";
  for (const std::string& name : option.get_snames())
    text += (text.empty() ? "" : ", ") + ("\\fB\\-" + name) + "\\fP";
  for (const std::string& name : option.get_lnames()) {
    text += (text.empty() ? "" : ", ") + ("\\fB\\-\\-" + man_text(name)) + "\\fP";
  }
  const std::string value = placeholder(option);
  return value.empty() ? text : text + " \\fI" + man_text(value) + "\\fP";
}

std::string man_options(const CLI::App& app) {
  std::string text;
  for (const CLI::Option* option : shown_options(app)) {
    text += ".TP\n" + names(*option) + "\n" + man_text(option->get_description());
    if (option->get_required()) text += " (required)";
    if (!option->get_default_str().empty()) text += " (default: " + man_text(option->get_default_str()) + ")";
    text += "\n";
  }
  return text;
}

std::string man_synopsis(const CLI::App& app, const std::string& called) {
  std::string text = ".B " + man_text(called) + "\n";
  bool optional = false;
  for (const CLI::Option* option : shown_options(app)) {
    if (option->get_required() || option->get_positional()) {
      text += names(*option) + "\n";
    } else {
      optional = true;
    }
  }
  return text + (optional ? "[\\fIoptions\\fP]\n" : "");
}

std::string upper(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::toupper(c); });
  return text;
}

// The options of an app, as words.
std::string words(const CLI::App& app) {
  std::string text;
  for (const CLI::Option* option : shown_options(app)) {
    for (const std::string& name : option->get_lnames()) text += (text.empty() ? "--" : " --") + name;
  }
  return text;
}

}  // namespace

std::string exit_statuses(int section) {
  return std::string(
             "0: success. 1: it failed; one line on the standard error says why. 2: the command "
             "line is wrong.") +
         (section == 1 ? " 3: incise cut or feel wrote its results, but the blade cut or touched nothing."
                       : "");
}

std::string man_page(const CLI::App& app, int section) {
  const std::string& name = app.get_name();
  // "Does this: and that." -> "does this: and that", as NAME lines are.
  std::string brief = app.get_description();
  if (!brief.empty() && brief.back() == '.') brief.pop_back();
  if (!brief.empty()) brief[0] = static_cast<char>(std::tolower(static_cast<unsigned char>(brief[0])));
  std::string text = ".TH " + upper(name) + " " + std::to_string(section) + " \"\" \"" + kSoftware + "\"\n";
  text += ".SH NAME\n" + man_text(name) + " \\- " + man_text(brief) + "\n.SH SYNOPSIS\n";
  const auto commands = app.get_subcommands([](const CLI::App* sub) { return !sub->get_group().empty(); });
  if (commands.empty()) text += man_synopsis(app, name);
  for (const CLI::App* command : commands)
    text += man_synopsis(*command, name + " " + command->get_name()) + ".br\n";
  text += ".SH OPTIONS\n" + man_options(app);
  if (!commands.empty()) text += ".SH COMMANDS\n";
  for (const CLI::App* command : commands) {
    text += ".SS " + man_text(command->get_name()) + "\n" + man_text(command->get_description()) + ".\n" +
            man_options(*command);
  }
  text += ".SH EXIT STATUS\n" + exit_statuses(section) + "\n";
  return text + ".SH SEE ALSO\n" + (section == 8 ? "\\fBincise\\fP(1)\n" : "\\fBincised\\fP(8)\n");
}

std::string bash_completion(const CLI::App& app) {
  const std::string& name = app.get_name();
  const auto commands = app.get_subcommands([](const CLI::App* sub) { return !sub->get_group().empty(); });
  std::string list, cases;
  for (const CLI::App* command : commands) {
    list += (list.empty() ? "" : " ") + command->get_name();
    cases += "    " + command->get_name() + ") words='" + words(*command) + "' ;;\n";
  }
  return "# Completion of " + name + " for bash.\n_" + name +
         "() {\n"
         "  local current=\"${COMP_WORDS[COMP_CWORD]}\" words='" +
         words(app) + "'\n" +
         (commands.empty() ? "" : "  case \"${COMP_WORDS[1]}\" in\n" + cases + "  esac\n") +
         "  if [[ $current == -* ]]; then\n"
         "    mapfile -t COMPREPLY < <(compgen -W \"$words\" -- \"$current\")\n" +
         (commands.empty() ? ""
                           : "  elif ((COMP_CWORD == 1)); then\n"
                             "    mapfile -t COMPREPLY < <(compgen -W '" +
                                 list + "' -- \"$current\")\n") +
         "  else\n"
         "    mapfile -t COMPREPLY < <(compgen -f -- \"$current\")\n"
         "  fi\n"
         "}\n"
         "complete -o filenames -F _" +
         name + " " + name + "\n";
}

void add_manual_options(CLI::App& app, int section) {
  const auto print_and_end = [](const std::string& text) {
    std::fputs(text.c_str(), stdout);
    throw CLI::Success();
  };
  app.add_flag_callback("--print-man",
                        [&app, section, print_and_end] { print_and_end(man_page(app, section)); })
      ->group("")
      ->trigger_on_parse();
  app.add_flag_callback("--print-completion", [&app, print_and_end] { print_and_end(bash_completion(app)); })
      ->group("")
      ->trigger_on_parse();
}

}  // namespace incise::app
