// A TCP byte stream in pieces: the messages that come out do not depend on where the pieces end. The first
// byte chooses the pieces.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "protocol/framing.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise::protocol;

namespace {

struct Cut {
  std::vector<std::vector<std::byte>> messages;
  bool failed = false;
  std::size_t pending = 0;
};

Cut cut(std::span<const std::byte> stream, std::size_t piece) {
  Cut out;
  FrameReader reader(kMaxHandshakeBytes);
  while (!stream.empty() && !reader.failed()) {
    std::span<const std::byte> input = stream.first(std::min(piece, stream.size()));
    stream = stream.subspan(input.size());
    while (reader.read(input) == FrameReader::Status::Complete) {
      out.messages.emplace_back(reader.body().begin(), reader.body().end());
    }
  }
  out.failed = reader.failed();
  out.pending = out.failed ? 0 : reader.pending_bytes();
  FUZZ_CHECK(out.failed == !reader.error().empty());
  return out;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::span<const std::byte> stream(reinterpret_cast<const std::byte*>(data + 1), size - 1);
  const Cut whole = cut(stream, size);
  const Cut pieces = cut(stream, 1 + data[0] % 64);
  FUZZ_CHECK(whole.messages == pieces.messages);
  FUZZ_CHECK(whole.failed == pieces.failed);
  FUZZ_CHECK(whole.pending == pieces.pending);
  for (const auto& message : whole.messages) decode(message);
  return 0;
}
