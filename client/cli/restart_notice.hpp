#pragma once

#include <cstdint>
#include <string>

#include "protocol/messages.hpp"

namespace incise::client {

// What was undone or reset, and who asked for it: one line.
std::string restart_text(const protocol::Restart& restart, std::uint64_t revision);

// The same as a JSON object: event ("undo", "reset"), revision, by, role; of an undo also blade and others.
std::string restart_json(const protocol::Restart& restart, std::uint64_t revision);

// For Callbacks::on_welcome: a line on stderr where somebody has made the ids start again.
class RestartNotice {
 public:
  // Whether it was news.
  bool operator()(const protocol::Welcome& welcome);

 private:
  std::uint64_t session_ = 0;  // 0: none yet
};

}  // namespace incise::client
