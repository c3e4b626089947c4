#include <CLI/CLI.hpp>
#include <memory>

#include "client/cli/option_checks.hpp"
#include "server/app/offline/commands.hpp"
#include "server/mesh_io/phantom.hpp"

namespace incise::app {

namespace {

void add_strict(CLI::App& command, protocol::Times& times) {
  command.add_flag_callback(
      "--strict", [&times] { times = protocol::Times::kRefuse; },
      "Refuse a motion whose times do not rise, instead of skipping samples");
}

void add_until_damage(CLI::App& command, IfDamaged& if_damaged) {
  command.add_flag_callback(
      "--until-damage", [&if_damaged] { if_damaged = IfDamaged::kEndThere; },
      "Where a capture has wrong bytes, use what is before them, and say how much that is");
}

constexpr const char* kBladeHelp =
    "hx,hy,hz:tx,ty,tz: heel and tip in the tool's frame, metres; the configuration's or the capture's if "
    "not "
    "given, without one 5 cm long below the tool (0,0,0:0,0,-0.05)";

void add_cut(CLI::App& app, int& exit_code) {
  auto command = std::make_shared<CutCommand>();
  CLI::App* sub = app.add_subcommand("cut",
                                     "Cut a mesh by a recorded motion, without a server, the blade engaged "
                                     "throughout; exits with 3 if nothing was cut");
  sub->add_option("--mesh", command->mesh,
                  "A mesh of tetrahedra, or a closed surface to fill; TetGen by its common name")
      ->required();
  sub->add_option("--poses", command->poses, "The motion: a capture, TUM or CSV")->required();
  sub->add_option("--blade", command->blade, kBladeHelp)->check(client::blade_edge());
  sub->add_option("--config", command->config, "A configuration: its sections cut, blade and mesh are used");
  sub->add_option("--policy", command->policy,
                  "conforming or croll; compare: a table of all policies, and no mesh")
      ->check(CLI::IsMember({"conforming", "croll", "compare"}));
  sub->add_option("--prefer", command->prefer, "no-growth, balanced or exact")
      ->check(CLI::IsMember({"no-growth", "balanced", "exact"}));
  sub->add_option(
      "--out", command->out,
      "Where to write the cut mesh: .vtu, .vtk, .msh, .msh2, .mesh, .node, a surface's ending, or .glb "
      "(required, but for --policy compare)");
  sub->add_option("--report", command->report, "Where to write the report: JSON");
  add_strict(*sub, command->times);
  sub->add_flag("--json", command->json, "Print the report as JSON");
  sub->callback([command, &exit_code] { exit_code = run_cut(*command); });
}

void add_feel(CLI::App& app, int& exit_code) {
  auto command = std::make_shared<FeelCommand>();
  CLI::App* sub =
      app.add_subcommand("feel",
                         "Compute the force on the hand of a recorded motion, without a device: at each "
                         "pose, and in TUM and CSV each "
                         "millisecond between two poses, interpolated; exits with 3 without contact");
  sub->add_option("motion", command->motion, "The motion: a capture, TUM or CSV")->required();
  sub->add_option("--mesh", command->mesh,
                  "A mesh of tetrahedra, or a closed surface to fill; TetGen by its common name")
      ->required();
  sub->add_option("--blade", command->blade, kBladeHelp)->check(client::blade_edge());
  sub->add_option("--config", command->config,
                  "A configuration: its sections haptics, materials, cut, blade and mesh are used; without "
                  "one the blade is always engaged");
  sub->add_option("--out", command->out, "Where to write the force over time: CSV");
  sub->add_option("--svg", command->svg, "Where to plot the force over time: SVG");
  add_strict(*sub, command->times);
  sub->add_flag("--json", command->json, "Print the figures as JSON");
  sub->callback([command, &exit_code] { exit_code = run_feel(*command); });
}

void add_replay(CLI::App& app, int& exit_code) {
  auto command = std::make_shared<ReplayCommand>();
  CLI::App* sub = app.add_subcommand("replay", "Replay a capture and compare the hash of every batch");
  sub->add_option("capture", command->capture, "The capture")->required();
  sub->add_option("--mesh", command->mesh, "The mesh, if the capture's has moved");
  sub->add_flag("--verify", command->verify, "Stop at the first batch that differs, and fail");
  add_until_damage(*sub, command->if_damaged);
  sub->add_flag("--json", command->json, "Print the result as JSON");
  sub->callback([command, &exit_code] { exit_code = run_replay(*command); });
}

void add_info(CLI::App& app, int& exit_code) {
  auto command = std::make_shared<InfoCommand>();
  CLI::App* sub = app.add_subcommand(
      "info", "Describe a file: mesh, surface, volume image, motion, capture or configuration");
  sub->add_option("file", command->file, "The file")->required();
  sub->add_option("--config", command->config, "A configuration: how to read a mesh");
  sub->add_flag("--json", command->json, "Print the facts as JSON");
  sub->callback([command, &exit_code] { exit_code = run_info(*command); });
}

void add_phantom(CLI::App& app, int& exit_code) {
  auto command = std::make_shared<PhantomCommand>();
  CLI::App* sub = app.add_subcommand("phantom", "Make a test body: liver, cylinder or slab");
  sub->add_option("kind", command->kind, "liver, cylinder or slab")->required();
  sub->add_option("--size", command->size, "Tetrahedra, about")
      ->check(client::whole_number(mesh_io::kMinPhantomTets, mesh_io::kMaxPhantomTets))
      ->capture_default_str();
  sub->add_flag(
      "--capsule", command->capsule,
      "Make the outermost tetrahedra region 1, for a capsule with a feel of its own (config/tissues.json)");
  sub->add_option("--out", command->out,
                  "Where to write it: .node, .vtu, .vtk, .msh, .msh2, .mesh, or a surface's ending or .glb "
                  "for its surface")
      ->required();
  sub->add_flag("--json", command->json, "Print the facts as JSON");
  sub->callback([command, &exit_code] { exit_code = run_phantom(*command); });
}

void add_export(CLI::App& app, int& exit_code) {
  auto command = std::make_shared<ExportCommand>();
  CLI::App* sub = app.add_subcommand("export", "Write the mesh of a capture, at its end or at a revision");
  sub->add_option("capture", command->capture, "The capture")->required();
  sub->add_option("--mesh", command->mesh, "The mesh, if the capture's has moved");
  sub->add_option("--config", command->config,
                  "The server's configuration, for the textures of its materials in a .glb or .obj");
  sub->add_option("--revision", command->revision, "The revision; the last one if not given")
      ->check(client::whole_number());
  sub->add_option("--out", command->out,
                  "Where to write it: .vtu, .vtk, .msh, .msh2, .mesh, .node, a surface's ending, or .glb")
      ->required();
  add_until_damage(*sub, command->if_damaged);
  sub->add_flag("--json", command->json, "Print the facts as JSON");
  sub->callback([command, &exit_code] { exit_code = run_export(*command); });
}

void add_convert(CLI::App& app, int& exit_code) {
  auto command = std::make_shared<ConvertCommand>();
  CLI::App* sub = app.add_subcommand("convert", "Turn a motion into a capture of cutting a mesh with it");
  sub->add_option("motion", command->motion, "The motion: TUM, CSV, or a capture")->required();
  sub->add_option("--mesh", command->mesh,
                  "The mesh; if not given, the configuration's, or that of the capture");
  sub->add_option("--config", command->config,
                  "A configuration; without one the blade is always engaged, 5 cm long below the tool");
  sub->add_option("--out", command->out, "Where to write the capture")->required();
  add_strict(*sub, command->times);
  add_until_damage(*sub, command->if_damaged);
  sub->add_flag("--json", command->json, "Print the facts as JSON");
  sub->callback([command, &exit_code] { exit_code = run_convert(*command); });
}

void add_sweep(CLI::App& app, int& exit_code) {
  auto command = std::make_shared<SweepCommand>();
  CLI::App* sub = app.add_subcommand(
      "sweep", "Cut a data set, bodies x motions x parameters, into HDF5 files; started again, it goes on");
  sub->add_option("spec", command->spec, "What to cut: JSON (client/CLIENTS.md)")->required();
  sub->add_option("--out", command->out,
                  "The data set's directory; with --sample a file, where the cut mesh is written");
  sub->add_option("--workers", command->workers, "Local processes; one for each processor if not given")
      ->check(client::whole_number(1, 1024));
  sub->add_option("--dask", command->dask, "The scheduler of a Dask cluster to run on: tcp://HOST:PORT");
  sub->add_option("--sample", command->sample, "Make this sample alone and print its state hash")
      ->check(client::whole_number());
  sub->add_flag("--json", command->json, "Print the result as JSON");
  sub->callback([command, &exit_code] { exit_code = run_sweep(*command); });
}

void add_doctor(CLI::App& app, int& exit_code) {
  auto command = std::make_shared<DoctorCommand>();
  CLI::App* sub =
      app.add_subcommand("doctor", "Find what would keep a server from working well on this machine");
  sub->add_option("--config", command->config, "The server's configuration; the defaults if not given");
  sub->add_flag("--json", command->json, "Print JSON");
  sub->callback([command, &exit_code] { exit_code = run_doctor(*command); });
}

void add_devices(CLI::App& app, int& exit_code) {
  auto command = std::make_shared<DevicesCommand>();
  CLI::App* sub = app.add_subcommand("devices", "List HID devices and their profiles, or show their reports");
  sub->add_option("--config", command->config, "A configuration: its section devices is used");
  sub->add_option("--check", command->check, "Check a device profile and say what is wrong with it");
  sub->add_flag("--monitor", command->monitor, "Show reports and axes as they arrive, until interrupted");
  sub->add_option(
      "--device", command->device,
      "Only this one: vvvv:pppp, with :serial or not; --monitor then shows it even without a profile");
  sub->add_option("--for", command->for_s, "With --monitor: end after so many seconds")
      ->check(client::number_from(0));
  sub->add_flag("--json", command->json, "Print JSON");
  sub->callback([command, &exit_code] { exit_code = run_devices(*command); });
}

}  // namespace

void add_offline_commands(CLI::App& app, int& exit_code) {
  for (const auto add : {add_cut, add_feel, add_replay, add_info, add_phantom, add_export, add_convert,
                         add_sweep, add_doctor, add_devices})
    add(app, exit_code);
}

}  // namespace incise::app
