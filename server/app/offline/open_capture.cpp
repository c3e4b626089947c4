#include "server/app/offline/open_capture.hpp"

#include <string_view>

#include "server/app/offline/terminal.hpp"

namespace incise::app {
namespace {

bool mesh_is_there(const std::filesystem::path& path) {
  std::filesystem::path node = path;
  node += ".node";
  std::error_code error;
  return std::filesystem::exists(path, error) || std::filesystem::exists(node, error);
}

}  // namespace

void warn_if_not_closed(RecordedMotion& motion, const std::string& name) {
  if (!motion.header || motion.closed || !motion.end_error.empty()) return;
  motion.warnings.push_back(name +
                            ": was not closed, since what recorded it was killed or records still; "
                            "the session may have gone on after its end");
}

Replayable open_capture(const std::filesystem::path& capture, const std::filesystem::path& mesh,
                        IfDamaged if_damaged, bool fields, BeforeResets before_resets) {
  Replayable opened;
  opened.motion = read_whole_capture(capture, if_damaged, before_resets);
  const protocol::CaptureHeader& header = *opened.motion.header;
  opened.config = config_of(header, capture.string());
  warn_if_not_closed(opened.motion, capture.string());
  if (!mesh.empty()) {
    opened.config.mesh.phantom.clear();
    opened.config.mesh.path = std::filesystem::absolute(mesh).string();
  } else if (!opened.config.mesh.path.empty()) {
    // First the path given to the server, relative to its configuration; then beside the capture.
    opened.config.mesh.path = header.mesh_path;
    const std::filesystem::path beside =
        capture.parent_path() / std::filesystem::path(header.mesh_path).filename();
    if (!mesh_is_there(header.mesh_path) && mesh_is_there(beside)) opened.config.mesh.path = beside.string();
  }
  Progress filling("loading the mesh");
  opened.body = load_body(
      opened.config, [&](std::string_view stage, double) { filling.show(-1, stage); }, fields);
  if (!opened.body.loaded.has_hash(header.mesh_content_hash)) {
    throw std::runtime_error(capture.string() + ": was recorded with another mesh: its hash is " +
                             header.mesh_content_hash + ", that of " + opened.body.name + " is " +
                             opened.body.loaded.content_hash + "; give the right one with --mesh");
  }
  return opened;
}

}  // namespace incise::app
