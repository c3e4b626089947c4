#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

namespace incise::stream {

// The files of one directory, by the target of a GET request. Thread: any.
class StaticFiles {
 public:
  struct File {
    std::filesystem::path path;
    std::string mime_type;
    std::string etag;                   // quoted, of size and time of change
    std::filesystem::path packed_path;  // its gzip, where NAME.gz lies beside it; else empty
    std::string packed_etag;
    std::string cache_control;  // names under assets/ carry a hash of their content and never change
  };

  // An empty directory name: no files.
  explicit StaticFiles(const std::string& directory);

  // The file that a target names; "/" is index.html. Nothing for a missing or hidden file (".name", or in such a
  // folder), and for anything outside the directory, however spelt or linked.
  std::optional<File> find(std::string_view target) const;

 private:
  std::filesystem::path root_;  // canonical; empty: none
};

}  // namespace incise::stream
