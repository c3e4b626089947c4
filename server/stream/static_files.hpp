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
    std::filesystem::path packed_path;  // the same with gzip, where it lies beside it (NAME.gz); else empty
    std::string packed_etag;
    std::string cache_control;  // names under assets/ carry a hash of their content and never change
  };

  // An empty directory offers nothing.
  explicit StaticFiles(const std::string& directory);

  // The file that a target names, "/" being index.html. Nothing where it names none, a hidden one (".name", or in such a
  // folder), or anything that lies outside of the directory, by whatever spelling or link.
  std::optional<File> find(std::string_view target) const;

 private:
  std::filesystem::path root_;  // canonical; empty: none
};

}  // namespace incise::stream
