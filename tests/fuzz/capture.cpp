// A capture file: the reader ends in one of its four ways, and what it read is a capture again, byte for
// byte, when it is written behind the same header.

#include <cstddef>
#include <cstdint>
#include <span>
#include <sstream>
#include <string>

#include "protocol/capture.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise::protocol;

namespace {

class StringSink final : public CaptureSink {
 public:
  std::string bytes;
  std::error_code append(std::span<const std::byte> data) override {
    bytes.append(reinterpret_cast<const char*>(data.data()), data.size());
    return {};
  }
  std::error_code truncate(std::uint64_t size) override {
    bytes.resize(size);
    return {};
  }
  std::error_code sync() override { return {}; }
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string input(reinterpret_cast<const char*>(data), size);
  std::istringstream in(input);
  CaptureReader reader(in);
  StringSink sink;
  sink.bytes = input.substr(0, reader.good_bytes());
  CaptureWriter writer(sink, reader.good_bytes(), 0);
  CaptureRecord record;
  CaptureReader::Status status;
  while ((status = reader.next(record)) == CaptureReader::Status::Record) writer.append(record);
  FUZZ_CHECK(reader.good_bytes() <= size);
  FUZZ_CHECK((status == CaptureReader::Status::End) == reader.error().empty());
  FUZZ_CHECK(status != CaptureReader::Status::End || reader.good_bytes() == size);
  FUZZ_CHECK(!writer.flush());
  if (reader.unknown_records() == 0) {
    FUZZ_CHECK(sink.bytes == input.substr(0, reader.good_bytes()));
  }
  return 0;
}
