#include "server/app/offline/motion_input.hpp"

#include <memory>
#include <utility>

#include "client/cli/usage.hpp"
#include "server/app/body.hpp"
#include "server/app/offline/cut_file.hpp"
#include "server/app/offline/open_capture.hpp"

namespace incise::app {

CutInput read_motion_input(const MotionFiles& files, Engage engage, Progress& progress) {
  RecordedMotion motion = read_recorded_motion(files.motion, files.times);
  warn_if_not_closed(motion, files.motion.string());
  Config config;
  if (!files.config.empty()) {
    config = load_config(files.config);
  } else if (motion.header) {
    config = config_of(*motion.header, files.motion.string());
  } else {
    engage = Engage::kAlways;
  }
  if (!files.blade.empty())
    set_blade(replay::to_core(protocol::parse_blade("--blade", files.blade)), config, motion);
  progress.stage("loading " + files.mesh.filename().string());
  mesh_io::LoadOptions options =
      load_options(config, [&](std::string_view stage, double) { progress.show(-1, stage); });
  options.fields = !files.out.empty();
  auto loaded = mesh_io::load_mesh(files.mesh, options);
  if (std::string warning = fields_left_out(files.out, loaded.fields); !warning.empty()) {
    loaded.fields.clear();
    loaded.warnings.push_back(std::move(warning));
  }
  if (!files.blade.empty()) {
    const std::string fault = blade_fault(config, motion, box_of(loaded.mesh).diagonal());
    if (!fault.empty()) throw client::UsageError("--blade " + fault);
  }
  return cut_input(files.mesh.string(), files.motion.string(), std::move(motion), std::move(config),
                   std::make_shared<const mesh_io::LoadedMesh>(std::move(loaded)), engage);
}

}  // namespace incise::app
