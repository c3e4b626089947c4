// Runs every file of the folders given through a fuzz target: the committed corpus as an ordinary test. Each
// is also run cut short, which costs nothing to keep: at every length, or where there are many at about a thousand of them.

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

int main(int argc, char** argv) {
  std::size_t files = 0, runs = 0;
  for (int i = 1; i < argc; ++i) {
    for (const auto& entry : std::filesystem::recursive_directory_iterator(argv[i])) {
      if (!entry.is_regular_file()) continue;
      std::ifstream in(entry.path(), std::ios::binary);
      const std::string bytes((std::istreambuf_iterator<char>(in)), {});
      std::printf("%s\n", entry.path().c_str());
      std::fflush(stdout);  // so that the file is known when the next line does not come
      const std::size_t step = bytes.size() / 1000 | 1;  // odd, so that no field's size divides it
      for (std::size_t n = 0; n < bytes.size(); n += step) {
        // A buffer of just this size: a sanitizer then sees a byte read behind it.
        const std::vector<std::uint8_t> input(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(n));
        LLVMFuzzerTestOneInput(input.data(), input.size());
        ++runs;
      }
      const std::vector<std::uint8_t> input(bytes.begin(), bytes.end());
      LLVMFuzzerTestOneInput(input.data(), input.size());
      ++files;
    }
  }
  std::printf("%zu files, %zu inputs\n", files, runs + files);
  return files > 0 ? 0 : 1;
}
