#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>
#include <string_view>

#include "protocol/messages.hpp"

namespace incise::protocol {

// Roles as files, logs and errors name them.
inline constexpr std::array<const char*, 4> kRoleNames{"viewer", "operator", "simulator", "admin"};

inline const char* name_of(Role role) {
  return kRoleNames[static_cast<std::size_t>(role)];
}
inline std::optional<Role> role_named(std::string_view name) {
  const auto found = std::find(kRoleNames.begin(), kRoleNames.end(), name);
  if (found == kRoleNames.end()) return std::nullopt;
  return static_cast<Role>(found - kRoleNames.begin());
}

}  // namespace incise::protocol
