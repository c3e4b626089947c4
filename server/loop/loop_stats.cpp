#include "server/loop/loop_stats.hpp"

namespace incise::loop {

const char* to_string(LateCause cause) {
  switch (cause) {
    case LateCause::kWakeUp:
      return "wake-up";
    case LateCause::kInput:
      return "input";
    case LateCause::kCut:
      return "cut";
    case LateCause::kPublish:
      return "publish";
  }
  return "?";
}

}  // namespace incise::loop
