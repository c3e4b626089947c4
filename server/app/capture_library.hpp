#pragma once

#include <filesystem>
#include <functional>
#include <list>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "server/app/body.hpp"
#include "server/stream/replay_library.hpp"

namespace incise::app {

// The captures of one directory. Each plays on its own thread and in its own session, apart from the server's loop and
// mesh.
//
// Thread: the stream's; stop() from main's. Owns: the threads.
class CaptureLibrary final : public stream::ReplayLibrary {
 public:
  // An empty directory offers nothing. `live` is used for captures of the same mesh; it must outlive this.
  CaptureLibrary(std::filesystem::path directory, const Body& live);
  ~CaptureLibrary() override;

  // Files that end in .capture, in order. Left out: hidden files, links that lead out of the directory, names that are not
  // UTF-8 text; the last two are logged once each.
  std::vector<std::string> names() override;
  std::unique_ptr<stream::ReplayPlayer> open(const std::string& name, stream::ReplayEvents events) override;
  // Ends all threads. Call it while the receivers of their events exist.
  void stop();

 private:
  class Player;
  struct Playing;
  void forget_ended();

  const std::filesystem::path directory_;
  const Body& live_;
  std::set<std::string> left_out_;               // already logged
  std::list<std::shared_ptr<Playing>> playing_;  // including those that have ended and are not joined yet
};

}  // namespace incise::app
