#include "server/loop/checkpoint_file.hpp"

#include <fcntl.h>
#include <unistd.h>

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
  std::vector<std::byte> bytes(kHeadBytes + checkpoint.state.size());
  std::memcpy(bytes.data(), kMagic, sizeof kMagic);
  std::memcpy(&bytes[8], &kVersion, 4);
  std::size_t at = kPreambleBytes;
  head(checkpoint, [&](std::uint64_t value) {
    std::memcpy(&bytes[at], &value, 8);
    at += 8;
  });
  if (!checkpoint.state.empty()) std::memcpy(&bytes[at], checkpoint.state.data(), checkpoint.state.size());
  const std::uint32_t crc = protocol::crc32c(std::span(bytes).subspan(kPreambleBytes));
  std::memcpy(&bytes[12], &crc, 4);

  const std::string beside = path + ".part";
  try {
    const Descriptor file(::open(beside.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
    if (file.fd < 0) fail(beside);
    write_all(file.fd, bytes, beside);
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
  std::byte first[kHeadBytes];
  in.read(reinterpret_cast<char*>(first), kHeadBytes);
  std::uint32_t version = 0, crc = 0;
  std::memcpy(&version, first + 8, 4);
  std::memcpy(&crc, first + 12, 4);
  if (!in || std::memcmp(first, kMagic, sizeof kMagic) != 0) return refuse("is not a checkpoint");
  if (version != kVersion) return refuse("is a checkpoint of another version");
  std::vector<std::byte> bytes(static_cast<std::size_t>(size) - kPreambleBytes);
  std::memcpy(bytes.data(), first + kPreambleBytes, kHeadBytes - kPreambleBytes);
  const std::size_t had = kHeadBytes - kPreambleBytes;
  in.read(reinterpret_cast<char*>(bytes.data() + had), static_cast<std::streamsize>(bytes.size() - had));
  if (!in || protocol::crc32c(bytes) != crc) return refuse("is damaged: its checksum is wrong");
  Checkpoint checkpoint;
  std::size_t at = 0;
  head(checkpoint, [&](std::uint64_t& value) {
    std::memcpy(&value, &bytes[at], 8);
    at += 8;
  });
  bytes.erase(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(at));
  checkpoint.state = std::move(bytes);
  return checkpoint;
}

}  // namespace incise::loop
