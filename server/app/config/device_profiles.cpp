// Which device profiles the server uses.
#include <algorithm>

#include "server/app/config.hpp"

namespace incise::app {

std::vector<input::DeviceProfile> device_profiles(const Config& config) {
  std::vector<input::DeviceProfile> profiles;
  if (!config.devices.enabled) return profiles;
  try {
    if (!config.devices.profiles.empty())
      profiles = input::load_profiles(config.resolve(config.devices.profiles));
    // A profile of your own replaces the shipped one of the same name.
    for (input::DeviceProfile& shipped : input::load_profiles(shipped_profiles())) {
      const auto same = [&](const input::DeviceProfile& own) { return own.id == shipped.id; };
      if (std::none_of(profiles.begin(), profiles.end(), same)) profiles.push_back(std::move(shipped));
    }
  } catch (const input::ProfileError& error) {
    throw ConfigError(std::string("devices.profiles: ") + error.what());
  }
  return profiles;
}

std::filesystem::path shipped_profiles() {
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
  const std::filesystem::path installed = program.parent_path().parent_path() / "share/incise/devices";
  return std::filesystem::is_directory(installed, error) ? installed : INCISE_DEVICE_PROFILES;
}

}  // namespace incise::app
