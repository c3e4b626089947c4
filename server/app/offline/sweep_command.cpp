#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <system_error>
#include <vector>

#include "client/cli/usage.hpp"
#include "server/app/offline/commands.hpp"

namespace incise::app {
namespace {

namespace fs = std::filesystem;

constexpr const char* kPython = "/usr/bin/python3";  // Debian's, for which the package incise is built

// Puts the Python package that was built or installed with this program before all others.
void prefer_own_package() {
  std::error_code error;
  const fs::path bin = fs::read_symlink("/proc/self/exe", error).parent_path();
  for (const char* place : {"../python", "../lib/python3/dist-packages"}) {
    const fs::path packages = bin / place;
    if (!fs::exists(packages / "incise" / "sweep.py", error)) continue;
    const char* given = std::getenv("PYTHONPATH");
    const std::string path = packages.string() + (given && *given ? std::string(":") + given : "");
    setenv("PYTHONPATH", path.c_str(), 1);
    return;
  }
  if (std::getenv("PYTHONPATH")) return;
  throw std::runtime_error(
      "sweep needs the Python package incise: install python3-incise, or name its folder in PYTHONPATH");
}

}  // namespace

int run_sweep(const SweepCommand& command) {
  if (command.out.empty() && !command.sample)
    throw client::UsageError("--out is required: where the data set goes");
  if (!command.dask.empty() && command.workers)
    throw client::UsageError("--workers is of local processes; with --dask the cluster has its own");
  prefer_own_package();
  // -P: whatever lies in the working directory is no module of ours.
  std::vector<std::string> arguments{kPython, "-P", "-m", "incise.sweep", command.spec.string()};
  const auto add = [&arguments](const char* option, const std::string& value) {
    arguments.insert(arguments.end(), {option, value});
  };
  if (!command.out.empty()) add("--out", command.out.string());
  if (command.workers) add("--workers", std::to_string(*command.workers));
  if (!command.dask.empty()) add("--dask", command.dask);
  if (command.sample) add("--sample", std::to_string(*command.sample));
  if (command.json) arguments.emplace_back("--json");
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  argv.push_back(nullptr);
  execv(kPython, argv.data());
  throw std::runtime_error(std::string(kPython) + ": cannot be started: " +
                           std::generic_category().message(errno) + "; install python3");
}

}  // namespace incise::app
