#include "protocol/capture.hpp"

#include <fcntl.h>
#include <sys/types.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <istream>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <type_traits>

#include "protocol/crc32c.hpp"
#include "protocol/limits.hpp"
#include "server/base/hex.hpp"

namespace incise::protocol {
namespace {

constexpr std::size_t kPreambleBytes =
    kCaptureMagic.size() + 4 + 4 + 4;                // magic, version, header length, header CRC
constexpr std::size_t kRecordHeadBytes = 4 + 4 + 1;  // length, CRC, type
// Flags of a PositionsRecord.
constexpr std::uint8_t kWithIds = 1, kSingle = 2;
constexpr std::uint8_t kLastType = std::variant_size_v<CaptureRecord>;
// How far behind wrong bytes the reader looks for a good record, and how long that may be: most records are poses
// and marks, which are short.
constexpr std::size_t kScanBytes = 1u << 20;
constexpr std::size_t kScanRecordBytes = 4096;

// ---- Fields: little-endian, without padding ----

class Put {
 public:
  explicit Put(std::vector<std::byte>& out) : out_(out) {}
  template <class T>
  requires std::is_arithmetic_v<T>
  void operator()(T value) { bytes({reinterpret_cast<const std::byte*>(&value), sizeof value}); }
  template <class E>
  requires std::is_enum_v<E>
  void operator()(E value) { (*this)(static_cast<std::uint8_t>(value)); }
  void operator()(bool value) { (*this)(static_cast<std::uint8_t>(value)); }
  void operator()(const Vec3& v) {
    for (const double x : {v.x, v.y, v.z}) (*this)(x);
  }
  void operator()(const Quat& q) {
    for (const double x : {q.w, q.x, q.y, q.z}) (*this)(x);
  }
  // A text or an array at the end of a record: its length is the record's.
  void rest(const std::string& text) { bytes(std::as_bytes(std::span(text))); }
  template <class T>
  void numbers(const std::vector<T>& values) {
    bytes(std::as_bytes(std::span(values)));
  }

 private:
  void bytes(std::span<const std::byte> b) { out_.insert(out_.end(), b.begin(), b.end()); }
  std::vector<std::byte>& out_;
};

class Get {
 public:
  explicit Get(std::span<const std::byte> bytes) : bytes_(bytes) {}

  // Whether every field was there and nothing is left.
  bool complete() const { return !failed_ && bytes_.empty(); }
  void fail() { failed_ = true; }

  template <class T>
  requires std::is_arithmetic_v<T>
  void operator()(T& value) {
    if (bytes_.size() < sizeof value) {
      failed_ = true;
      return;
    }
    std::memcpy(&value, bytes_.data(), sizeof value);
    bytes_ = bytes_.subspan(sizeof value);
  }
  void operator()(StrokeAction& value) {
    std::uint8_t n = 0;
    (*this)(n);
    if (n > static_cast<std::uint8_t>(StrokeAction::HandOver)) failed_ = true;
    value = static_cast<StrokeAction>(n);
  }
  void operator()(bool& value) {
    std::uint8_t n = 0;
    (*this)(n);
    if (n > 1) failed_ = true;
    value = n == 1;
  }
  void operator()(Vec3& v) {
    for (double* x : {&v.x, &v.y, &v.z}) (*this)(*x);
  }
  void operator()(Quat& q) {
    for (double* x : {&q.w, &q.x, &q.y, &q.z}) (*this)(*x);
  }
  void rest(std::string& text) {
    text.assign(reinterpret_cast<const char*>(bytes_.data()), bytes_.size());
    bytes_ = {};
  }
  template <class T>
  void numbers(std::vector<T>& values, std::uint64_t count) {
    if (count > bytes_.size() / sizeof(T)) {
      failed_ = true;
      return;
    }
    values.resize(count);
    if (count > 0) std::memcpy(values.data(), bytes_.data(), count * sizeof(T));
    bytes_ = bytes_.subspan(count * sizeof(T));
  }

 private:
  std::span<const std::byte> bytes_;
  bool failed_ = false;
};

// The fields of each record in their order on disk, for Put and Get alike.
template <class Io, class R>
void fields(Io& io, R& r) {
  using T = std::remove_const_t<R>;
  if constexpr (std::is_same_v<T, PoseRecord>) {
    io(r.source);
    io(r.pose.buttons);
    io(r.pose.source_ns);
    io(r.arrival_ns);
    io(r.pose.position);
    io(r.pose.orientation);
  } else if constexpr (std::is_same_v<T, StrokeRecord>) {
    io(r.source);
    io(r.action);
    io(r.source_ns);
    io(r.arrival_ns);
  } else if constexpr (std::is_same_v<T, BladeRecord>) {
    io(r.source);
    io(r.arrival_ns);
    io(r.blade.heel);
    io(r.blade.tip);
  } else if constexpr (std::is_same_v<T, BatchMark>) {
    io(r.revision);
    io(r.state_hash);
    io(r.source);
    io(r.stroke);
    io(r.batch);
    io(r.stroke_ended);
    io(r.frame);
  } else if constexpr (std::is_same_v<T, NoteRecord>) {
    io.rest(r.json);
  } else if constexpr (std::is_same_v<T, GapRecord>) {
    io(r.records);
    io(r.bytes);
    io(r.from_ns);
    io(r.to_ns);
    io.rest(r.reason);
  } else if constexpr (std::is_same_v<T, CheckpointRecord>) {
    io(r.id);
  } else if constexpr (std::is_same_v<T, ResetRecord>) {
    io(r.session);
    io(r.arrival_ns);
  } else if constexpr (std::is_same_v<T, UndoRecord>) {
    io(r.session);
    io(r.arrival_ns);
    io(r.source);
    io(r.pose_source_ns);
    io(r.pose_arrival_ns);
    io(r.revision);
  } else if constexpr (std::is_same_v<T, EndRecord>) {
    io(r.records);
  } else {
    static_assert(std::is_same_v<T, PositionsRecord>);
    io(r.frame);
    io(r.revision);
    io(r.source_ns);
    io(r.arrival_ns);
    io(r.first);
    if constexpr (std::is_same_v<Io, Put>) {
      io(static_cast<std::uint32_t>(r.positions.size() / 3));
      io(static_cast<std::uint8_t>((r.ids.empty() ? 0 : kWithIds) | (r.single ? kSingle : 0)));
      io.numbers(r.ids);
      if (r.single) {
        io.numbers(std::vector<float>(r.positions.begin(), r.positions.end()));
      } else {
        io.numbers(r.positions);
      }
    } else {
      std::uint32_t count = 0;
      std::uint8_t flags = 0;
      io(count);
      io(flags);
      if ((flags & ~(kWithIds | kSingle)) != 0) io.fail();
      if ((flags & kWithIds) != 0) io.numbers(r.ids, count);
      r.single = (flags & kSingle) != 0;
      if (r.single) {
        std::vector<float> floats;
        io.numbers(floats, std::uint64_t{3} * count);
        r.positions.assign(floats.begin(), floats.end());
      } else {
        io.numbers(r.positions, std::uint64_t{3} * count);
      }
    }
  }
}

template <std::size_t... I>
bool decode_record(std::uint8_t type, std::span<const std::byte> payload, CaptureRecord& out,
                   std::index_sequence<I...>) {
  const auto read = [&]<std::size_t N>(std::integral_constant<std::size_t, N>) {
    std::variant_alternative_t<N, CaptureRecord> record;
    Get get(payload);
    fields(get, record);
    if (!get.complete()) return false;
    out = std::move(record);
    return true;
  };
  bool good = false;
  ((type == I + 1 ? void(good = read(std::integral_constant<std::size_t, I>())) : void()), ...);
  return good;
}

// What stands in front of a record's payload.
struct Head {
  std::uint32_t length = 0;  // of the payload
  std::uint32_t crc = 0;     // of type and payload
  std::uint8_t type = 0;
};

Head read_head(const std::byte* bytes) {
  Head head;
  std::memcpy(&head.length, bytes, 4);
  std::memcpy(&head.crc, bytes + 4, 4);
  std::memcpy(&head.type, bytes + 8, 1);
  return head;
}

bool crc_matches(const Head& head, const std::byte* bytes) {
  return crc32c({bytes + 8, std::size_t{1} + head.length}) == head.crc;
}

}  // namespace

CaptureBeginning capture_beginning(std::string_view first) {
  if (first.starts_with(kCaptureMagic)) return CaptureBeginning::Whole;
  return kCaptureMagic.starts_with(first) ? CaptureBeginning::Torn : CaptureBeginning::Other;
}

CaptureBeginning capture_beginning(std::istream& in) {
  std::string first(kCaptureMagic.size(), '\0');
  in.read(first.data(), static_cast<std::streamsize>(first.size()));
  first.resize(static_cast<std::size_t>(in.gcount()));
  in.clear();
  in.seekg(0);
  return capture_beginning(first);
}

// ---- Sinks ----

FileSink::FileSink(const std::string& path, bool fresh)
    : fd_(::open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC | (fresh ? O_TRUNC : 0), 0644)) {
  if (fd_ < 0) throw std::system_error(errno, std::generic_category(), path);
}

FileSink::~FileSink() {
  ::close(fd_);
}

std::error_code FileSink::append(std::span<const std::byte> bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd_, bytes.data(), bytes.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return {errno, std::generic_category()};
    bytes = bytes.subspan(static_cast<std::size_t>(n));
  }
  return {};
}

std::error_code FileSink::truncate(std::uint64_t size) {
  if (::ftruncate(fd_, static_cast<off_t>(size)) != 0) return {errno, std::generic_category()};
  return {};
}

std::error_code FileSink::sync() {
  if (::fdatasync(fd_) != 0) return {errno, std::generic_category()};
  return {};
}

// ---- Writing ----

CaptureWriter::CaptureWriter(CaptureSink& sink, const CaptureHeader& header) : sink_(sink) {
  const auto config = nlohmann::json::parse(header.config_json, nullptr, false);
  if (!config.is_object()) throw std::invalid_argument("capture header: the configuration is no JSON object");
  const nlohmann::json json{
      {"format", "incise-capture"},
      {"mesh", {{"path", header.mesh_path}, {"content_hash", header.mesh_content_hash}}},
      {"session", hex(header.session)},
      {"created_unix_ns", header.created_unix_ns},
      {"software", header.software},
      {"config", config},
  };
  const std::string text = json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  if (text.size() > kMaxCaptureHeaderBytes) {
    throw std::invalid_argument("capture header of " + std::to_string(text.size()) +
                                " bytes, accepted are at most " + std::to_string(kMaxCaptureHeaderBytes));
  }
  const std::span<const std::byte> magic = std::as_bytes(std::span(kCaptureMagic));
  buffer_.assign(magic.begin(), magic.end());
  Put put(buffer_);
  put(kCaptureVersion);
  put(static_cast<std::uint32_t>(text.size()));
  put(crc32c(std::as_bytes(std::span(text))));
  put.rest(text);
  header_bytes_ = buffer_.size();
}

CaptureWriter::CaptureWriter(CaptureSink& sink, std::uint64_t offset, std::uint64_t records)
    : sink_(sink), written_(offset), records_(records), cut_back_(true) {}

void CaptureWriter::append(const CaptureRecord& record) {
  if (const auto* p = std::get_if<PositionsRecord>(&record)) {
    if (p->positions.size() % 3 != 0 || (!p->ids.empty() && p->positions.size() != 3 * p->ids.size())) {
      throw std::length_error("capture record: " + std::to_string(p->positions.size()) + " coordinates for " +
                              std::to_string(p->ids.size()) + " vertices");
    }
  }
  const std::size_t start = buffer_.size();
  buffer_.resize(start + 8);
  Put put(buffer_);
  put(static_cast<std::uint8_t>(record.index() + 1));
  std::visit([&](const auto& r) { fields(put, r); }, record);
  const std::size_t length = buffer_.size() - start - kRecordHeadBytes;
  if (length > kMaxCaptureRecordBytes) {
    buffer_.resize(start);
    throw std::length_error("capture record of " + std::to_string(length) + " bytes, accepted are at most " +
                            std::to_string(kMaxCaptureRecordBytes));
  }
  const auto length32 = static_cast<std::uint32_t>(length);
  const std::uint32_t crc = crc32c(std::span(buffer_).subspan(start + 8));
  std::memcpy(&buffer_[start], &length32, 4);
  std::memcpy(&buffer_[start + 4], &crc, 4);
  ++records_;
  ++pending_records_;
}

std::error_code CaptureWriter::flush() {
  if (cut_back_) {
    if (const std::error_code error = sink_.truncate(written_)) return error;
    cut_back_ = false;
  }
  if (buffer_.empty()) return {};
  if (const std::error_code error = sink_.append(buffer_)) {
    cut_back_ = true;
    return error;
  }
  written_ += buffer_.size();
  buffer_.clear();
  header_bytes_ = 0;
  pending_records_ = 0;
  return {};
}

CaptureWriter::Dropped CaptureWriter::drop_pending() {
  const Dropped dropped{pending_records_, buffer_.size() - header_bytes_};
  buffer_.resize(header_bytes_);
  records_ -= pending_records_;
  pending_records_ = 0;
  return dropped;
}

// ---- Reading ----

CaptureReader::CaptureReader(std::istream& in) : in_(in) {
  read_header();
}

CaptureReader::Status CaptureReader::stop(Status status, const std::string& what) {
  status_ = status;
  if (status != Status::End) error_ = "offset " + std::to_string(good_) + ": " + what;
  return status;
}

// Makes at least `bytes` unused ones available, as far as the stream has them.
bool CaptureReader::fill(std::size_t bytes) {
  constexpr std::size_t kReadBytes = 64u << 10;
  while (window_.size() - window_begin_ < bytes) {
    if (!in_) return false;  // a read came short before: there is no more
    if (window_begin_ > 0) {
      window_.erase(window_.begin(), window_.begin() + static_cast<std::ptrdiff_t>(window_begin_));
      window_begin_ = 0;
    }
    // Piecewise, so that a length that lies allocates what the file has and not what it says.
    const std::size_t have = window_.size();
    window_.resize(have + kReadBytes);
    in_.read(reinterpret_cast<char*>(window_.data() + have), static_cast<std::streamsize>(kReadBytes));
    const auto got = static_cast<std::size_t>(in_.gcount());
    window_.resize(have + got);
    if (got == 0) return false;
  }
  return true;
}

void CaptureReader::read_header() {
  fill(kPreambleBytes);
  const std::string_view magic(reinterpret_cast<const char*>(window_.data()),
                               std::min(window_.size(), kCaptureMagic.size()));
  if (magic.empty() || capture_beginning(magic) == CaptureBeginning::Other) {
    stop(Status::Corrupt, "does not begin with " + std::string(kCaptureMagic));
    return;
  }
  if (window_.size() < kPreambleBytes) {
    stop(Status::Torn, "the header is incomplete");
    return;
  }
  std::uint32_t version = 0, length = 0, crc = 0;
  std::memcpy(&version, &window_[8], 4);
  std::memcpy(&length, &window_[12], 4);
  std::memcpy(&crc, &window_[16], 4);
  if (version != kCaptureVersion) {
    stop(Status::Corrupt,
         "capture version " + std::to_string(version) + ", accepted is " + std::to_string(kCaptureVersion));
    return;
  }
  if (length > kMaxCaptureHeaderBytes) {
    stop(Status::Corrupt, "header of " + std::to_string(length) + " bytes, accepted are at most " +
                              std::to_string(kMaxCaptureHeaderBytes));
    return;
  }
  if (!fill(kPreambleBytes + length)) {
    stop(Status::Torn, "the header is incomplete");
    return;
  }
  const std::span<const std::byte> text(window_.data() + kPreambleBytes, length);
  if (crc32c(text) != crc) {
    stop(Status::Corrupt, "the header's checksum is wrong");
    return;
  }
  const auto* first = reinterpret_cast<const char*>(text.data());
  const auto json = nlohmann::json::parse(first, first + text.size(), nullptr, false);
  try {
    if (json.at("format") != "incise-capture") throw std::invalid_argument("format is not incise-capture");
    header_.mesh_path = json.at("mesh").at("path").get<std::string>();
    header_.mesh_content_hash = json.at("mesh").at("content_hash").get<std::string>();
    header_.session = std::stoull(json.at("session").get<std::string>(), nullptr, 16);
    header_.created_unix_ns = json.at("created_unix_ns").get<std::int64_t>();
    header_.software = json.at("software").get<std::string>();
    if (!json.at("config").is_object()) throw std::invalid_argument("config is no object");
    header_.config_json = json.at("config").dump();
  } catch (const std::exception& e) {
    stop(Status::Corrupt, std::string("the header is not what it should be: ") + e.what());
    return;
  }
  window_begin_ = kPreambleBytes + length;
  good_ = window_begin_;
}

void CaptureReader::skip_to(std::uint64_t offset, std::uint64_t records) {
  if (!header_ok() || offset < good_) return;
  in_.clear();
  in_.seekg(static_cast<std::streamoff>(offset));
  window_.clear();
  window_begin_ = 0;
  good_ = offset;
  records_ = records;
}

// A record that cannot be read: torn where nothing good comes behind it, else corrupt. `claimed`: its bytes,
// by its own account.
CaptureReader::Status CaptureReader::bad_record(std::size_t claimed, const std::string& what) {
  fill(kScanBytes);
  const std::span<const std::byte> rest = std::span(window_).subspan(window_begin_);
  for (std::size_t i = 1; i + kRecordHeadBytes <= std::min(rest.size(), kScanBytes); ++i) {
    const Head head = read_head(&rest[i]);
    if (head.type == 0 || head.type > kLastType || head.length > kScanRecordBytes) continue;
    if (i + kRecordHeadBytes + head.length > rest.size() || !crc_matches(head, &rest[i])) continue;
    return stop(Status::Corrupt, what + "; a good record follows at offset " + std::to_string(good_ + i));
  }
  return stop(Status::Torn, what + " (by its own account it has " + std::to_string(claimed) +
                                " bytes); the " + std::to_string(rest.size()) +
                                " bytes from there on hold no good record");
}

CaptureReader::Status CaptureReader::next(CaptureRecord& record) {
  while (status_ == Status::Record) {
    fill(kRecordHeadBytes);
    const std::size_t have = window_.size() - window_begin_;
    if (have == 0) return stop(Status::End, "");
    if (have < kRecordHeadBytes) return bad_record(kRecordHeadBytes, "a record's beginning is incomplete");
    const Head head = read_head(&window_[window_begin_]);
    const std::size_t size = kRecordHeadBytes + std::size_t{head.length};
    if (head.length > kMaxCaptureRecordBytes) {
      return bad_record(size, "record of " + std::to_string(head.length) + " bytes, accepted are at most " +
                                  std::to_string(kMaxCaptureRecordBytes));
    }
    if (!fill(size)) return bad_record(size, "the last record is incomplete");
    const std::byte* bytes = &window_[window_begin_];
    if (!crc_matches(head, bytes)) return bad_record(size, "a record's checksum is wrong");
    const bool known = head.type >= 1 && head.type <= kLastType;
    if (known && !decode_record(head.type, {bytes + kRecordHeadBytes, head.length}, record,
                                std::make_index_sequence<std::variant_size_v<CaptureRecord>>())) {
      // The checksum is right, so this is how it was written.
      return stop(Status::Corrupt, "record of type " + std::to_string(head.type) + " with wrong contents");
    }
    window_begin_ += size;
    good_ += size;
    ++records_;
    closed_ = known && std::holds_alternative<EndRecord>(record);
    if (known) return Status::Record;
    ++unknown_;
  }
  return status_;
}

}  // namespace incise::protocol
