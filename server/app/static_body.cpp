// incise-static-body CAPTURE DIRECTORY: what a page without a server needs to be a session with the body and the configuration that the
// capture was recorded with, and to offer the capture as a recording (client/viewer/PAGE.md).
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "protocol/capture.hpp"
#include "server/app/offline/open_capture.hpp"
#include "server/app/version.hpp"
#include "server/replay/session_view.hpp"
#include "server/wasm/body_file.hpp"

namespace incise::app {
namespace {

namespace fs = std::filesystem;

protocol::Welcome greeting(const Replayable& opened, const core::CutSession& session) {
  protocol::Welcome welcome;
  welcome.view = protocol::View::Volume;
  welcome.mesh = replay::mesh_facts(opened.body.name, opened.body.loaded.content_hash,
                                    opened.body.loaded.mesh, session.mesh());
  welcome.blade_heel = replay::to_protocol(opened.config.cut.blade.heel);
  welcome.blade_tip = replay::to_protocol(opened.config.cut.blade.tip);
  welcome.engage_button = replay::engage_button(opened.config.cut);
  welcome.max_speed_m_s = opened.config.cut.speed_limit_m_s;
  welcome.policy = replay::policy_name(opened.config.cut);
  welcome.server_version = kVersion;
  return welcome;
}

void make(const fs::path& capture, const fs::path& directory) {
  const Replayable opened = open_capture(capture, {});
  const core::CutSession session(opened.body.loaded.mesh, opened.config.cut);
  fs::create_directories(directory);
  std::ofstream body(directory / "body.bin", std::ios::binary);
  wasm::write_body(body, greeting(opened, session), session);
  // The header alone is a capture, too.
  protocol::FileSink sink((directory / "header.capture").string(), true);
  protocol::CaptureWriter header(sink, *opened.motion.header);
  if (header.flush())
    throw std::runtime_error((directory / "header.capture").string() + ": cannot be written");
  fs::copy_file(capture, directory / capture.filename(), fs::copy_options::overwrite_existing);
  std::ofstream list(directory / "captures.json");
  list << nlohmann::json::array({capture.filename().string()}) << '\n';
  if (!body.flush() || !list.flush()) throw std::runtime_error(directory.string() + ": cannot be written");
}

}  // namespace
}  // namespace incise::app

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: incise-static-body CAPTURE DIRECTORY\n");
    return 2;
  }
  try {
    incise::app::make(argv[1], argv[2]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  return 0;
}
