#pragma once

#include <filesystem>
#include <vector>

#include "server/stream/stream_config.hpp"

namespace incise::app {

// Reads the file that listen.token_file names. Throws ConfigError; its text names the place and never a token.
std::vector<stream::AccessToken> read_tokens(const std::filesystem::path& path);

}  // namespace incise::app
