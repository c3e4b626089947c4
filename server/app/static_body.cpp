// incise-static-body CAPTURE DIRECTORY [CONFIG]: what a page without a server needs to be a session with the body and the configuration that the
// capture was recorded with, and to offer the capture as a recording (client/viewer/PAGE.md). How the body looks, its volume image
// too, is as CONFIG says, or else as the capture's configuration does.
#include <algorithm>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "protocol/capture.hpp"
#include "server/app/look.hpp"
#include "server/app/offline/open_capture.hpp"
#include "server/app/surface_asset.hpp"
#include "server/app/version.hpp"
#include "server/replay/session_view.hpp"
#include "server/wasm/body_file.hpp"

namespace incise::app {
namespace {

namespace fs = std::filesystem;

protocol::Welcome greeting(const Replayable& opened, const core::CutSession& session) {
  protocol::Welcome welcome;
  welcome.view = protocol::View::Volume;
  // The hash as the capture has it, by which the page knows that this is its body.
  welcome.mesh = replay::mesh_facts(opened.body.name, opened.motion.header->mesh_content_hash,
                                    opened.body.loaded.mesh, session.mesh());
  welcome.blade_heel = replay::to_protocol(opened.config.cut.blade.heel);
  welcome.blade_tip = replay::to_protocol(opened.config.cut.blade.tip);
  welcome.engage_button = replay::engage_button(opened.config.cut);
  welcome.max_speed_m_s = opened.config.cut.speed_limit_m_s;
  welcome.policy = replay::policy_name(opened.config.cut);
  welcome.server_version = kVersion;
  return welcome;
}

// What the HTTP port would serve of the body. A file host has no folder of a file's name: "/surface/0.png" is "surface_0.png".
void write_documents(const stream::Documents& documents, const fs::path& directory) {
  for (const auto& [path, document] : documents) {
    std::string name = path.substr(1);
    std::replace(name.begin(), name.end(), '/', '_');
    std::ofstream out(directory / name, std::ios::binary);
    out << *document.body;
    if (!out.flush()) throw std::runtime_error((directory / name).string() + ": cannot be written");
  }
}

stream::Documents look_of(const Replayable& opened, const fs::path& config_file,
                          std::vector<std::string>& warnings) {
  if (!config_file.empty())
    return served_look(load_config(config_file), opened.body.loaded.mesh, config_file.string(), warnings);
  // A capture does not say which folder the paths in its configuration began in.
  Config config = opened.config;
  if (drop_look_files(config))
    warnings.push_back(
        "the image and textures of the configuration are left out: name its file as the third argument");
  return served_look(config, opened.body.loaded.mesh, "the capture's configuration", warnings);
}

void make(const fs::path& capture, const fs::path& directory, const fs::path& config_file) {
  const Replayable opened = open_capture(capture, {}, IfDamaged::kRefuse);
  const core::CutSession session(opened.body.loaded.mesh, opened.config.cut);
  fs::create_directories(directory);
  std::vector<std::string> warnings;
  const mesh_io::Surface* const surface = opened.body.loaded.surface.get();
  ServedSurface served = served_surface(surface, warnings);
  served.documents.merge(look_of(opened, config_file, warnings));
  write_documents(served.documents, directory);
  for (const std::string& warning : warnings) std::fprintf(stderr, "%s\n", warning.c_str());
  protocol::Welcome welcome = greeting(opened, session);
  const bool shown = served.facts && !served.facts->path.empty();
  if (shown) welcome.surface = served.facts;
  std::ofstream body(directory / "body.bin", std::ios::binary);
  protocol::SurfaceAsset asset;
  if (shown) asset = asset_of(*surface);
  wasm::write_body(body, welcome, session, shown ? &asset : nullptr);
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
  if (argc != 3 && argc != 4) {
    std::fprintf(stderr, "usage: incise-static-body CAPTURE DIRECTORY [CONFIG]\n");
    return 2;
  }
  try {
    incise::app::make(argv[1], argv[2], argc == 4 ? argv[3] : "");
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  return 0;
}
