// A volume image: an error that names the file in one line, or numbers as promised. The first line of the input is the file's ending, the rest is the file.

#include <unistd.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/volume_image.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise::mesh_io;

namespace {

class Directory {
 public:
  Directory()
      : path_(std::filesystem::temp_directory_path() / ("incise-fuzz-image-" + std::to_string(::getpid()))) {
    std::filesystem::create_directories(path_);
    std::ofstream(path_ / "a.raw", std::ios::binary) << std::string(4096, 'a');
  }
  ~Directory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  std::filesystem::path write(const std::string& name, const std::string& bytes) const {
    std::ofstream(path_ / name, std::ios::binary) << bytes;
    return path_ / name;
  }

 private:
  std::filesystem::path path_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const Directory directory;
  const std::string input(reinterpret_cast<const char*>(data), size);
  const std::size_t line_end = input.find('\n');
  if (line_end == input.npos) return 0;
  const std::string ending = input.substr(0, line_end);
  if (ending != "nrrd" && ending != "nhdr" && ending != "nii" && ending != "nii.gz") return 0;
  try {
    const VolumeImage image =
        read_volume_image(directory.write("image." + ending, input.substr(line_end + 1)));
    std::size_t samples = 1;
    for (std::size_t i = 0; i < 3; ++i) {
      FUZZ_CHECK(image.size[i] >= 1 && image.size[i] <= kMaxImageSide && image.size[i] <= image.file_size[i]);
      samples *= image.size[i];
    }
    FUZZ_CHECK(image.values.size() == samples);
    for (const float value : image.values) FUZZ_CHECK(std::isfinite(value));
    inverse(image.mm_from_unit, "image");
  } catch (const MeshError& error) {
    const std::string text = error.what();
    FUZZ_CHECK(text.find("image") != text.npos && text.find('\n') == text.npos);
  }
  return 0;
}
