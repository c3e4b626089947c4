#pragma once

#include <filesystem>
#include <string>

#include "protocol/motion.hpp"
#include "server/app/offline/cut_run.hpp"
#include "server/app/offline/terminal.hpp"

namespace incise::app {

// What the command line names.
struct MotionFiles {
  std::filesystem::path motion, mesh;
  std::filesystem::path config;  // empty: the capture's if the motion is one, else the defaults
  std::string blade;             // "hx,hy,hz:tx,ty,tz", for every source; empty: the configuration's
  protocol::Times times = protocol::Times::kSkip;
  std::filesystem::path out = {};  // where the mesh goes, with its fields or a warning; empty: nowhere
};

// Reads both: common to `incise cut` and `incise feel`. Throws what the readers throw.
CutInput read_motion_input(const MotionFiles& files, Engage engage, Progress& progress);

}  // namespace incise::app
