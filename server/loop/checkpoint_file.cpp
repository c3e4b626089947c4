#include "server/loop/checkpoint_file.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <span>
#include <system_error>

#include "protocol/crc32c.hpp"

namespace incise::loop {
namespace {

constexpr char kMagic[8] = {'I', 'N', 'C', 'I', 'S', 'C', 'K', 'P'};
constexpr std::uint32_t kVersion = 1;
constexpr std::size_t kPreambleBytes = 16;  // magic, version, CRC of the rest
constexpr std::size_t kHeadBytes = kPreambleBytes + 6 * 8;

// The numbers of the head in their order on disk.
template <class C, class Field>
void head(C& checkpoint, Field field) {
  field(checkpoint.id);
  field(checkpoint.session);
  field(checkpoint.offset);
  field(checkpoint.records);
  field(checkpoint.revision);
  field(checkpoint.state_hash);
}

[[noreturn]] void fail(const std::string& path) {
  throw std::system_error(errno, std::generic_category(), path);
}

void write_all(int fd, std::span<const std::byte> bytes, const std::string& path) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) fail(path);
    bytes = bytes.subspan(static_cast<std::size_t>(n));
  }
}

// A descriptor that is closed at the end.
struct Descriptor {
  explicit Descriptor(int opened) : fd(opened) {}
  ~Descriptor() {
    if (fd >= 0) ::close(fd);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  const int fd;
};

}  // namespace

std::string checkpoint_path(const std::string& journal, int number) {
  return journal + ".checkpoint-" + std::to_string(number);
}

void write_checkpoint(const std::string& path, const Checkpoint& checkpoint) {
  std::array<std::byte, kHeadBytes> first;
  std::memcpy(first.data(), kMagic, sizeof kMagic);
  std::memcpy(&first[8], &kVersion, 4);
  std::size_t at = kPreambleBytes;
  head(checkpoint, [&](std::uint64_t value) {
    std::memcpy(&first[at], &value, 8);
    at += 8;
  });
  const std::uint32_t crc = protocol::crc32c(std::span(first).subspan(kPreambleBytes), checkpoint.state);
  std::memcpy(&first[12], &crc, 4);

  const std::string beside = path + ".part";
  try {
    const Descriptor file(::open(beside.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
    if (file.fd < 0) fail(beside);
    write_all(file.fd, first, beside);
    write_all(file.fd, checkpoint.state, beside);
    if (::fsync(file.fd) != 0) fail(beside);
  } catch (...) {
    ::unlink(beside.c_str());  // on a full disk others need its bytes
    throw;
  }
  if (std::rename(beside.c_str(), path.c_str()) != 0) fail(path);
  const std::filesystem::path parent = std::filesystem::path(path).parent_path();
  const Descriptor folder(::open(parent.empty() ? "." : parent.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (folder.fd < 0 || ::fsync(folder.fd) != 0) fail(parent.string());
}

bool begins_as_checkpoint(const std::string& path) {
  std::array<char, sizeof kMagic> first{};
  std::ifstream in(path, std::ios::binary);
  return in.read(first.data(), first.size()) && std::memcmp(first.data(), kMagic, sizeof kMagic) == 0;
}

std::optional<Checkpoint> read_checkpoint(const std::string& path, std::string& error) {
  error.clear();
  const auto refuse = [&](const char* what) {
    error = path + ": " + what;
    return std::nullopt;
  };
  std::error_code code;
  const auto size = std::filesystem::file_size(path, code);
  if (code == std::errc::no_such_file_or_directory) return std::nullopt;
  std::ifstream in(path, std::ios::binary);
  if (code || !in) return refuse("cannot be opened");
  if (size < kHeadBytes) return refuse("is too short for a checkpoint");
  std::array<std::byte, kHeadBytes> first;
  in.read(reinterpret_cast<char*>(first.data()), kHeadBytes);
  std::uint32_t version = 0, crc = 0;
  std::memcpy(&version, &first[8], 4);
  std::memcpy(&crc, &first[12], 4);
  if (!in || std::memcmp(first.data(), kMagic, sizeof kMagic) != 0) return refuse("is not a checkpoint");
  if (version != kVersion) return refuse("is a checkpoint of another version");
  Checkpoint checkpoint;
  checkpoint.state.resize(static_cast<std::size_t>(size) - kHeadBytes);
  in.read(reinterpret_cast<char*>(checkpoint.state.data()),
          static_cast<std::streamsize>(checkpoint.state.size()));
  if (!in || protocol::crc32c(std::span(first).subspan(kPreambleBytes), checkpoint.state) != crc)
    return refuse("is damaged: its checksum is wrong");
  std::size_t at = kPreambleBytes;
  head(checkpoint, [&](std::uint64_t& value) {
    std::memcpy(&value, &first[at], 8);
    at += 8;
  });
  return checkpoint;
}

}  // namespace incise::loop
