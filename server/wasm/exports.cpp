// The session in a page, as functions of a WebAssembly module. client/viewer/src/wasm_session.ts calls them.
//
// Bytes go in through a buffer of the module's: incise_input(size) gives its place. Bytes come out through the imports, or through
// incise_output_at() and incise_output_size(). Each function that can fail returns kFailed after it has given the text to failed(). An
// abort (a check that failed, no memory) is a trap: the instance is of no use then, but for incise_capture().

#include <unistd.h>
#include <cstring>
#include <ctime>
#include <exception>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "server/base/clock.hpp"
#include "server/base/hex.hpp"
#include "server/replay/replay.hpp"
#include "server/wasm/local_server.hpp"

#define INCISE_IMPORT(name) __attribute__((import_module("incise"), import_name(name)))
#define INCISE_EXPORT(name) extern "C" __attribute__((export_name(name)))

extern "C" {
INCISE_IMPORT("send") void host_send(std::uint32_t peer, const void* bytes, std::size_t size);
INCISE_IMPORT("close") void host_close(std::uint32_t peer);
INCISE_IMPORT("fetch_capture") void host_fetch_capture(const char* name, std::size_t size);
INCISE_IMPORT("failed") void host_failed(const char* text, std::size_t size);
}

namespace {

using namespace incise;

constexpr double kDone = 0, kNothingToDo = -1, kFailed = -2;

class Page final : public wasm::LocalServer::Host {
 public:
  void send(std::uint32_t peer, std::span<const std::byte> message) override {
    host_send(peer, message.data(), message.size());
  }
  void close(std::uint32_t peer) override { host_close(peer); }
  void fetch_capture(const std::string& name) override { host_fetch_capture(name.data(), name.size()); }
  std::int64_t now_ns() override { return monotonic_ns(); }
  std::int64_t unix_ns() override { return incise::unix_ns(); }
  std::uint64_t random() override {
    std::uint64_t number = 0;
    if (getentropy(&number, sizeof number) != 0) throw std::runtime_error("no random numbers");
    return number;
  }
};

Page page;
std::vector<std::byte> input, output;
std::unique_ptr<wasm::LocalServer> server;

// What `what` returns, or kFailed.
template <class What>
double guarded(What what) {
  try {
    return what();
  } catch (const std::exception& error) {
    host_failed(error.what(), std::strlen(error.what()));
  }
  return kFailed;
}

wasm::LocalServer& live() {
  if (!server) throw std::logic_error("there is no session");
  return *server;
}

std::string text_of(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

// What remains of the input after the first `size` bytes, and those.
struct Split {
  std::span<const std::byte> first, rest;
};
Split split(std::size_t size) {
  const std::span<const std::byte> all(input);
  if (size > all.size()) throw std::logic_error("the input is shorter than that");
  return {all.first(size), all.subspan(size)};
}

protocol::CaptureHeader header_of(std::span<const std::byte> bytes) {
  std::istringstream in(text_of(bytes));
  const protocol::CaptureReader reader(in);
  if (!reader.header_ok()) throw std::runtime_error("the session's header: " + reader.error());
  return reader.header();
}

}  // namespace

INCISE_EXPORT("incise_input") std::byte* incise_input(std::size_t size) {
  input.resize(size);
  return input.data();
}
INCISE_EXPORT("incise_output_at") const std::byte* incise_output_at() {
  return output.data();
}
INCISE_EXPORT("incise_output_size") std::size_t incise_output_size() {
  return output.size();
}

// The input: a capture's header, `header_size` bytes of it, and the body (body_file.hpp).
INCISE_EXPORT("incise_begin") double incise_begin(std::size_t header_size) {
  return guarded([&] {
    const auto [header, body] = split(header_size);
    server = std::make_unique<wasm::LocalServer>(wasm::read_body(body), header_of(header), page);
    return kDone;
  });
}

INCISE_EXPORT("incise_open") double incise_open(std::uint32_t peer) {
  return guarded([&] { return live().open(peer), kDone; });
}
// The input: a message.
INCISE_EXPORT("incise_receive") double incise_receive(std::uint32_t peer) {
  return guarded([&] { return live().receive(peer, input), kDone; });
}
INCISE_EXPORT("incise_closed") double incise_closed(std::uint32_t peer) {
  return guarded([&] { return live().closed(peer), kDone; });
}
// Works for about so long, ms. Returns in how many ms it wants to work again, or kNothingToDo.
INCISE_EXPORT("incise_work") double incise_work(double ms) {
  return guarded([&] {
    const auto due_ns = live().work(monotonic_ns() + static_cast<std::int64_t>(1e6 * ms));
    return due_ns ? std::max(0.0, 1e-6 * static_cast<double>(*due_ns - monotonic_ns())) : kNothingToDo;
  });
}
INCISE_EXPORT("incise_tick") double incise_tick() {
  return guarded([&] { return live().tick(), kDone; });
}
// The output: the recording so far.
INCISE_EXPORT("incise_capture") double incise_capture() {
  return guarded([&] { return output = live().capture(), kDone; });
}
// The input: a capture's name, `name_size` bytes of it; then its bytes, or if `found` is 0 why there are none.
INCISE_EXPORT("incise_offer_capture") double incise_offer_capture(std::size_t name_size, int found) {
  return guarded([&] {
    const auto [name, rest] = split(name_size);
    if (found) {
      live().offer_capture(text_of(name), rest);
    } else {
      live().miss_capture(text_of(name), text_of(rest));
    }
    return kDone;
  });
}

// For tests and measurements. The input: a capture of the session's body. Cuts the body as the capture says, apart from the session. The
// output, JSON: revision, hash, how many recorded hashes there were, the first revision that differs (0: none does), and how long
// the cuts took.
INCISE_EXPORT("incise_replay") double incise_replay() {
  return guarded([&] {
    std::istringstream in(text_of(input));
    replay::RecordedMotion motion = replay::read_capture(in, "the capture");
    const wasm::SessionConfig config = wasm::session_config(motion.header->config_json, "the capture");
    std::map<std::uint64_t, std::uint64_t> marks;
    for (const protocol::BatchMark& mark : motion.marks) marks[mark.revision] = mark.state_hash;
    replay::Replay replay(live().body(), config.cut, config.blades, std::move(motion));
    core::Delta delta;
    std::uint64_t compared = 0, differs = 0;
    const std::int64_t began_ns = monotonic_ns();
    while (!replay.at_end()) {
      if (!replay.advance(delta)) continue;
      const auto mark = marks.find(delta.revision);
      if (mark == marks.end()) continue;
      ++compared;
      if (mark->second != delta.state_hash && differs == 0) differs = delta.revision;
    }
    const std::string json =
        nlohmann::ordered_json{{"revision", replay.revision()},
                               {"state_hash", hex(replay.session().mesh().state_hash())},
                               {"marks", marks.size()},
                               {"compared", compared},
                               {"differs", differs},
                               {"ms", 1e-6 * static_cast<double>(monotonic_ns() - began_ns)}}
            .dump();
    const auto* bytes = reinterpret_cast<const std::byte*>(json.data());
    output.assign(bytes, bytes + json.size());
    return kDone;
  });
}
