#include <CLI/CLI.hpp>
#include <memory>

#include "server/app/offline/commands.hpp"

namespace incise::app {

namespace {

std::string whole_number(const std::string& text) {
  const bool good = !text.empty() && text.find_first_not_of("0123456789") == std::string::npos;
  return good ? "" : "found " + text + "; accepted is a whole number, 0 or more";
}

void add_strict(CLI::App& command, protocol::Times& times) {
  command.add_flag_callback(
      "--strict", [&times] { times = protocol::Times::kRefuse; },
      "Refuse a motion whose times do not rise, instead of skipping samples");
}

}  // namespace

void add_offline_commands(CLI::App& app, int& exit_code) {
  {
    auto command = std::make_shared<CutCommand>();
    CLI::App* sub = app.add_subcommand(
        "cut", "Cut a mesh by a recorded motion, without a server; exits with 3 where nothing was cut");
    sub->add_option("--mesh", command->mesh,
                    "A mesh of tetrahedra, or a closed surface to fill; TetGen by its common name")
        ->required();
    sub->add_option("--poses", command->poses, "The motion: a capture, TUM or CSV")->required();
    sub->add_option("--blade", command->blade, "hx,hy,hz:tx,ty,tz: heel and tip in the tool's frame, metres");
    sub->add_option("--config", command->config, "A configuration: its cut, blade and mesh sections count");
    sub->add_option("--policy", command->policy, "conforming or croll; compare: a table of all, and no mesh")
        ->check(CLI::IsMember({"conforming", "croll", "compare"}));
    sub->add_option("--prefer", command->prefer, "no-growth, balanced or exact")
        ->check(CLI::IsMember({"no-growth", "balanced", "exact"}));
    sub->add_option("--out", command->out,
                    "Where the cut mesh goes: .vtu, .vtk, .msh, .msh2, .mesh, .node, or a surface's ending "
                    "(required, but for --policy compare)");
    sub->add_option("--report", command->report, "Where the report goes: JSON");
    add_strict(*sub, command->times);
    sub->add_flag("--json", command->json, "Print the report as JSON");
    sub->callback([command, &exit_code] { exit_code = run_cut(*command); });
  }
  {
    auto command = std::make_shared<ReplayCommand>();
    CLI::App* sub = app.add_subcommand("replay", "Replay a capture and compare the hash of every batch");
    sub->add_option("capture", command->capture, "The capture")->required();
    sub->add_option("--mesh", command->mesh, "The mesh, where the capture's is elsewhere now");
    sub->add_flag("--verify", command->verify, "Stop at the first batch that differs, and fail");
    sub->add_flag("--json", command->json, "Print the result as JSON");
    sub->callback([command, &exit_code] { exit_code = run_replay(*command); });
  }
  {
    auto command = std::make_shared<InfoCommand>();
    CLI::App* sub =
        app.add_subcommand("info", "Say what a file is: mesh, surface, motion, capture or configuration");
    sub->add_option("file", command->file, "The file")->required();
    sub->add_option("--config", command->config, "A configuration: how a mesh is to be read");
    sub->add_flag("--json", command->json, "Print the facts as JSON");
    sub->callback([command, &exit_code] { exit_code = run_info(*command); });
  }
  {
    auto command = std::make_shared<PhantomCommand>();
    CLI::App* sub = app.add_subcommand("phantom", "Make a test body: liver, cylinder or slab");
    sub->add_option("kind", command->kind, "liver, cylinder or slab")->required();
    sub->add_option("--size", command->size, "Tetrahedra, about")->check(whole_number)->capture_default_str();
    sub->add_option(
           "--out", command->out,
           "Where it goes: .node, .vtu, .vtk, .msh, .msh2, .mesh, or a surface's ending for its surface")
        ->required();
    sub->add_flag("--json", command->json, "Print the facts as JSON");
    sub->callback([command, &exit_code] { exit_code = run_phantom(*command); });
  }
  {
    auto command = std::make_shared<ExportCommand>();
    CLI::App* sub = app.add_subcommand("export", "Write the mesh of a capture, at its end or at a revision");
    sub->add_option("capture", command->capture, "The capture")->required();
    sub->add_option("--mesh", command->mesh, "The mesh, where the capture's is elsewhere now");
    sub->add_option("--revision", command->revision, "The revision; the last one if not given")
        ->check(whole_number);
    sub->add_option("--out", command->out,
                    "Where it goes: .vtu, .vtk, .msh, .msh2, .mesh, .node, or a surface's ending")
        ->required();
    sub->add_flag("--json", command->json, "Print the facts as JSON");
    sub->callback([command, &exit_code] { exit_code = run_export(*command); });
  }
  {
    auto command = std::make_shared<ConvertCommand>();
    CLI::App* sub = app.add_subcommand("convert", "Make a motion into a capture of cutting a mesh with it");
    sub->add_option("motion", command->motion, "The motion: TUM or CSV")->required();
    sub->add_option("--mesh", command->mesh, "The mesh; the configuration's if not given");
    sub->add_option("--config", command->config,
                    "A configuration; without one the blade is always engaged, 5 cm long below the tool");
    sub->add_option("--out", command->out, "Where the capture goes")->required();
    add_strict(*sub, command->times);
    sub->add_flag("--json", command->json, "Print the facts as JSON");
    sub->callback([command, &exit_code] { exit_code = run_convert(*command); });
  }
  {
    auto command = std::make_shared<DoctorCommand>();
    CLI::App* sub = app.add_subcommand("doctor", "Look for what would keep a server from working well here");
    sub->add_option("--config", command->config, "The server's configuration; the defaults if not given");
    sub->add_flag("--json", command->json, "Print JSON");
    sub->callback([command, &exit_code] { exit_code = run_doctor(*command); });
  }
  {
    auto command = std::make_shared<DevicesCommand>();
    CLI::App* sub =
        app.add_subcommand("devices", "List HID devices and their profiles, or show what they say");
    sub->add_option("--config", command->config, "A configuration: its devices section counts");
    sub->add_option("--check", command->check, "Check a device profile and say what is wrong with it");
    sub->add_flag("--monitor", command->monitor, "Show reports and axes as they come, until interrupted");
    sub->add_option(
        "--device", command->device,
        "Only this one: vvvv:pppp, with :serial or not; --monitor then shows it without a profile, too");
    sub->add_option("--for", command->for_s, "With --monitor: end after so many seconds")
        ->check(CLI::NonNegativeNumber);
    sub->add_flag("--json", command->json, "Print JSON");
    sub->callback([command, &exit_code] { exit_code = run_devices(*command); });
  }
}

}  // namespace incise::app
