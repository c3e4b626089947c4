#include "server/app/token_file.hpp"

#include <cerrno>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <system_error>

#include "protocol/role_names.hpp"
#include "server/app/config.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::json;

constexpr const char* kAccepted =
    "[{\"token\": a text of 16 to 1024 characters, \"roles\": a list of \"viewer\", \"operator\", "
    "\"simulator\", \"admin\", \"metrics\"}, ...]";

[[noreturn]] void refuse(const std::filesystem::path& path, const std::string& what) {
  throw ConfigError("listen.token_file " + path.string() + ": " + what + "; accepted is " + kAccepted);
}

stream::AccessToken read_token(const Json& entry, const std::string& at, const std::filesystem::path& path) {
  if (!entry.is_object() || entry.size() != 2 || !entry.contains("token") || !entry.contains("roles")) {
    refuse(path, at + " is not an object of token and roles");
  }
  stream::AccessToken token;
  if (entry["token"].is_string()) token.token = entry["token"].get<std::string>();
  if (token.token.size() < 16 || token.token.size() > 1024)
    refuse(path, at + ": the token's length is out of range");
  if (!entry["roles"].is_array() || entry["roles"].empty()) refuse(path, at + ": no roles");
  for (const Json& role : entry["roles"]) {
    if (role == "metrics") continue;  // every token has this right
    const auto known = role.is_string() ? protocol::role_named(role.get<std::string>()) : std::nullopt;
    if (!known)
      refuse(path,
             at + ": found role " + role.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
    token.roles.push_back(*known);
  }
  return token;
}

}  // namespace

std::vector<stream::AccessToken> read_tokens(const std::filesystem::path& path) {
  std::error_code error;
  std::ifstream in(path, std::ios::binary);
  if (!in || std::filesystem::is_directory(path, error))
    refuse(path, "cannot be opened: " + std::generic_category().message(in ? EISDIR : errno));
  const Json root = Json::parse(in, nullptr, false);
  if (!root.is_array() || root.empty() || root.size() > 10'000) refuse(path, "found no list of tokens");
  std::vector<stream::AccessToken> tokens;
  for (std::size_t i = 0; i < root.size(); ++i) {
    tokens.push_back(read_token(root[i], "entry " + std::to_string(i + 1), path));
  }
  return tokens;
}

}  // namespace incise::app
