// A configuration: an error of one line that names the file, or values that survive being printed and read again.

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "server/app/config.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise::app;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    const Config config = parse_config(text, "config");
    const std::string once = compact(config);
    FUZZ_CHECK(compact(parse_config(once, "once")) == once);
    FUZZ_CHECK(compact(parse_config(commented(config), "commented")) == once);
  } catch (const ConfigError& error) {
    const std::string message = error.what();
    FUZZ_CHECK(message.starts_with("config") && message.find('\n') == message.npos);
  }
  return 0;
}
