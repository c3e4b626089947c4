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

// The captures of one directory, each played on a thread and in a session of its own: the loop and the mesh of the server
// know nothing of it.
//
// Thread: the stream's; stop() from main's. Owns: the threads.
class CaptureLibrary final : public stream::ReplayLibrary {
 public:
  // An empty directory offers nothing. `live`, which must outlive this, serves where a capture is of the same mesh.
  CaptureLibrary(std::filesystem::path directory, const Body& live);
  ~CaptureLibrary() override;

  // Files that end in .capture, in order. Not offered: hidden ones, links that lead out of the directory, names that are not
  // UTF-8 text; the log says so once of each of the last two.
  std::vector<std::string> names() override;
  std::unique_ptr<stream::ReplayPlayer> open(const std::string& name, stream::ReplayEvents events) override;
  // Ends all threads. Before what their events go to is gone.
  void stop();

 private:
  class Player;
  struct Playing;
  void forget_ended();

  const std::filesystem::path directory_;
  const Body& live_;
  std::set<std::string> left_out_;               // already logged
  std::list<std::shared_ptr<Playing>> playing_;  // with those that have ended and were not joined yet
};

}  // namespace incise::app
