#pragma once

// The commands of `incise` that need no server. Each returns the program's exit status (0 only on success), prints
// its result on stdout and warnings on stderr, and throws std::exception with one line that says what is wrong and what to
// do: client::UsageError if the command line is wrong.

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "protocol/motion.hpp"
#include "server/app/offline/recorded_motion.hpp"

namespace CLI {
class App;
}

namespace incise::app {

struct CutCommand {
  std::filesystem::path mesh, poses, out, report;
  std::string blade;             // "hx,hy,hz:tx,ty,tz"; empty: the configuration's
  std::filesystem::path config;  // empty: the capture's if poses are one, else the defaults
  std::string policy, prefer;  // empty: the configuration's; policy "compare": tries all, and writes no mesh
  protocol::Times times = protocol::Times::kSkip;
  bool json = false;
};
// Exit status of `incise cut` if it wrote its results but the blade cut nothing.
inline constexpr int kNothingCut = 3;
// Cuts a mesh by a motion, the blade always engaged; writes the mesh and a report, or compares the policies.
int run_cut(const CutCommand& command);

struct FeelCommand {
  std::filesystem::path motion, mesh, out, svg;
  std::string blade;             // as CutCommand's
  std::filesystem::path config;  // as CutCommand's
  protocol::Times times = protocol::Times::kSkip;
  bool json = false;
};
// Exit status of `incise feel` if it wrote its results but the blade touched nothing.
inline constexpr int kNothingTouched = 3;
// The force on the hand that moves a blade through a mesh and cuts it: as a table, as CSV, as a plot.
int run_feel(const FeelCommand& command);

struct ReplayCommand {
  std::filesystem::path capture;
  std::filesystem::path mesh;  // instead of the one that the capture names
  IfDamaged if_damaged = IfDamaged::kRefuse;
  bool verify = false;
  bool json = false;
};
// Replays a capture and compares the hash of every batch: 1 if one differs.
int run_replay(const ReplayCommand& command);

struct InfoCommand {
  std::filesystem::path file;
  std::filesystem::path config;
  bool json = false;
};
// What a file is, and the facts about it: mesh, surface, motion, capture or configuration.
int run_info(const InfoCommand& command);

struct PhantomCommand {
  std::string kind;
  std::uint64_t size = 60'000;  // tetrahedra
  bool capsule = false;         // those with a face at the outside are region 1
  std::filesystem::path out;
  bool json = false;
};
// Makes a test body: tetrahedra, or their surface, by the ending of `out`.
int run_phantom(const PhantomCommand& command);

struct ExportCommand {
  std::filesystem::path capture, mesh, out;
  std::filesystem::path config;           // whose looks a file with materials has; empty: the capture's
  std::optional<std::uint64_t> revision;  // nothing: the last
  IfDamaged if_damaged = IfDamaged::kRefuse;
  bool json = false;
};
// Replays a capture up to a revision and writes the mesh there.
int run_export(const ExportCommand& command);

struct ConvertCommand {
  std::filesystem::path motion, out, config, mesh;
  protocol::Times times = protocol::Times::kSkip;
  IfDamaged if_damaged = IfDamaged::kRefuse;
  bool json = false;
};
// Turns a motion (TUM, CSV, or a capture, whose configuration then is the default) into a capture of cutting a mesh with
// it, with batch marks.
int run_convert(const ConvertCommand& command);

struct SweepCommand {
  std::filesystem::path spec, out;
  std::optional<std::uint64_t> workers, sample;
  std::string dask;
  bool json = false;
};
// Cuts a data set: becomes the Python program incise.sweep, and returns only by an exception.
int run_sweep(const SweepCommand& command);

struct DoctorCommand {
  std::filesystem::path config;  // of the server; empty: the defaults
  bool json = false;
};
// Checks what a server needs from this machine (limits, clock, ports, devices, directories) and says how to fix what is
// missing. 1: it would not start, or not work.
int run_doctor(const DoctorCommand& command);

struct DevicesCommand {
  std::filesystem::path config;  // its devices section counts
  std::filesystem::path check;   // a profile
  bool monitor = false;
  std::string device;  // "vvvv:pppp", with :serial or not; empty: all that fit a profile
  double for_s = 0;    // 0: until interrupted
  bool json = false;
};
// Lists the HID devices of this machine and the profile that fits each, or why none does; or shows their reports live; or
// checks a profile.
int run_devices(const DevicesCommand& command);

// Adds all of these to `app`; the command that runs sets `exit_code`.
void add_offline_commands(CLI::App& app, int& exit_code);

}  // namespace incise::app
