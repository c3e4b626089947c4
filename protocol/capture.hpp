#pragma once

// The capture: what the loop drained, in order, with marks that carry the state hash. One append-only file,
// which a replay verifies and a restarted server resumes from. PROTOCOL.md, "Capture", specifies every
// byte.

#include <cstddef>
#include <cstdint>
#include <iosfwd>
#include <span>
#include <string>
#include <string_view>
#include <system_error>
#include <variant>
#include <vector>

#include "protocol/messages.hpp"

namespace incise::protocol {

// The first bytes of every capture.
inline constexpr std::string_view kCaptureMagic = "INCISCAP";
inline constexpr std::uint32_t kCaptureVersion = 1;

enum class CaptureBeginning {
  Whole,  // as every capture begins
  Torn,   // with a part of that, or empty: a crash may have left it
  Other,  // this is no capture
};
// Of a file by its first bytes: kCaptureMagic.size() of them, or all that there are.
CaptureBeginning capture_beginning(std::string_view first);
// Of a stream, which is at its beginning before and after.
CaptureBeginning capture_beginning(std::istream& in);

// What a capture is of. On disk it is JSON, so that later versions may add keys.
struct CaptureHeader {
  std::string mesh_path;          // as it was given to the server
  std::string mesh_content_hash;  // of the mesh as loaded
  std::uint64_t session = 0;
  std::int64_t created_unix_ns = 0;
  std::string software;            // name and version of what wrote it
  std::string config_json = "{}";  // the whole configuration: a JSON object
};

struct PoseRecord {
  std::uint32_t source = 0;
  PoseSample pose;
  std::int64_t arrival_ns = 0;  // server's monotonic clock
  friend bool operator==(const PoseRecord&, const PoseRecord&) = default;
};

// A blade engaged or lifted otherwise than by its button.
struct StrokeRecord {
  std::uint32_t source = 0;
  StrokeAction action = StrokeAction::Engage;
  std::int64_t source_ns = 0;
  std::int64_t arrival_ns = 0;
  friend bool operator==(const StrokeRecord&, const StrokeRecord&) = default;
};

// From here on the blade has another holder, whose clock may have another origin, and this shape.
struct BladeRecord {
  std::uint32_t source = 0;
  std::int64_t arrival_ns = 0;
  BladeEdge blade;
  friend bool operator==(const BladeRecord&, const BladeRecord&) = default;
};

// A batch was committed: the state has this hash at this revision.
struct BatchMark {
  std::uint64_t revision = 0;
  std::uint64_t state_hash = 0;
  std::uint32_t source = 0, stroke = 0, batch = 0;
  bool stroke_ended = false;
  std::uint64_t frame = 0;  // of the loop, since it started
  friend bool operator==(const BatchMark&, const BatchMark&) = default;
};

// For people and tools; a replay passes over it.
struct NoteRecord {
  std::string json;
  friend bool operator==(const NoteRecord&, const NoteRecord&) = default;
};

// Records are missing here: the disk was full or too slow. A replay cannot cross the gap, only start behind it
// from a checkpoint.
struct GapRecord {
  std::uint64_t records = 0, bytes = 0;  // that were dropped
  std::int64_t from_ns = 0, to_ns = 0;   // server's monotonic clock
  std::string reason;
  friend bool operator==(const GapRecord&, const GapRecord&) = default;
};

// A checkpoint may exist for this place: a file with this id holds the state that replaying all earlier records gives.
struct CheckpointRecord {
  std::uint64_t id = 0;  // random
  friend bool operator==(const CheckpointRecord&, const CheckpointRecord&) = default;
};

// Positions from a simulator, which the loop has taken. ids empty: first, first + 1, ...
struct PositionsRecord {
  std::uint64_t frame = 0;
  std::uint64_t revision = 0;
  std::int64_t source_ns = 0, arrival_ns = 0;
  std::uint32_t first = 0;
  std::vector<std::uint32_t> ids;
  std::vector<double> positions;
  bool single = false;  // they are stored as floats, which they must be
  friend bool operator==(const PositionsRecord&, const PositionsRecord&) = default;
};

// Back to the mesh as loaded, revision 0.
struct ResetRecord {
  std::uint64_t session = 0;  // from here on
  std::int64_t arrival_ns = 0;
  friend bool operator==(const ResetRecord&, const ResetRecord&) = default;
};

// The last stroke was undone: back to the state before this pose, which began it.
struct UndoRecord {
  std::uint64_t session = 0;  // from here on
  std::int64_t arrival_ns = 0;
  std::uint32_t source = 0;
  std::int64_t pose_source_ns = 0, pose_arrival_ns = 0;
  std::uint64_t revision = 0;  // of that state
  friend bool operator==(const UndoRecord&, const UndoRecord&) = default;
};

// The capture was closed, not cut off.
struct EndRecord {
  std::uint64_t records = 0;  // before this one
  friend bool operator==(const EndRecord&, const EndRecord&) = default;
};

// index() + 1 is the type on disk. A reader passes over types that it does not know.
using CaptureRecord =
    std::variant<PoseRecord, StrokeRecord, BatchMark, NoteRecord, GapRecord, CheckpointRecord,
                 PositionsRecord, ResetRecord, EndRecord, BladeRecord, UndoRecord>;

// Where a capture is written to. Errors come back as codes: a full disk is no reason to stop cutting.
class CaptureSink {
 public:
  virtual ~CaptureSink() = default;
  // All of `bytes` at the end; on an error an unknown part of them may be there.
  virtual std::error_code append(std::span<const std::byte> bytes) = 0;
  virtual std::error_code truncate(std::uint64_t size) = 0;
  // Returns when what was appended survives a loss of power.
  virtual std::error_code sync() = 0;
};

// A file descriptor. Owns: the descriptor.
class FileSink final : public CaptureSink {
 public:
  // Opens or creates `path` for appending; `fresh` empties it. Throws std::system_error naming the path.
  FileSink(const std::string& path, bool fresh);
  ~FileSink() override;
  FileSink(const FileSink&) = delete;
  FileSink& operator=(const FileSink&) = delete;

  std::error_code append(std::span<const std::byte> bytes) override;
  std::error_code truncate(std::uint64_t size) override;
  std::error_code sync() override;

 private:
  int fd_ = -1;
};

// Encodes records and writes them whole to the sink. Thread: one, at a time, not the
// loop's.
//
// After an error the sink is cut back to the last whole flush before anything else is written, so that only
// the last record of a capture can be torn.
class CaptureWriter {
 public:
  // A new capture: the header waits in the buffer as if it were the first record. Throws
  // std::invalid_argument if config_json is not a JSON object or the header is longer than
  // kMaxCaptureHeaderBytes.
  CaptureWriter(CaptureSink& sink, const CaptureHeader& header);
  // Continues a capture that has `records` whole records, up to `offset` (CaptureReader::good_bytes()); the
  // first flush cuts off what follows them.
  CaptureWriter(CaptureSink& sink, std::uint64_t offset, std::uint64_t records);

  // Puts a record into the buffer. Throws std::length_error if it is longer than kMaxCaptureRecordBytes,
  // or has not three coordinates for each vertex.
  void append(const CaptureRecord& record);
  // Writes the buffer. On an error it keeps all of it, to be tried again or dropped.
  std::error_code flush();
  // Makes what was flushed durable.
  std::error_code sync() { return sink_.sync(); }

  struct Dropped {
    std::uint64_t records = 0, bytes = 0;
  };
  // Empties the buffer; a gap record should then say so. A header that was never written stays.
  Dropped drop_pending();

  std::size_t pending_bytes() const { return buffer_.size(); }
  std::uint64_t written_bytes() const { return written_; }
  // All that were appended and not dropped, the header not counted.
  std::uint64_t records() const { return records_; }

 private:
  CaptureSink& sink_;
  std::vector<std::byte> buffer_;
  std::size_t header_bytes_ = 0;  // at the front of buffer_, while not written
  std::uint64_t written_ = 0;
  std::uint64_t records_ = 0;
  std::uint64_t pending_records_ = 0;
  bool cut_back_ = false;  // the sink may hold more than written_
};

// Reads a capture from the front, trusting none of it. Never throws because of the bytes; allocates no
// more than the stream holds. Thread: one, at a time.
//
//   CaptureReader reader(in);
//   CaptureRecord record;
//   while (reader.next(record) == CaptureReader::Status::Record) replay(record);
class CaptureReader {
 public:
  enum class Status {
    Record,   // another one
    End,      // all was read; closed() says whether an EndRecord was the last
    Torn,     // the last record is incomplete: what a crash leaves. All before it is good
    Corrupt,  // not a capture, or wrong bytes with good records behind them
  };

  // Reads and checks the header. `in` must outlive the reader.
  explicit CaptureReader(std::istream& in);

  // Goes on at `offset`, the place of record number `records` (from 0), as a checkpoint says. If no record begins
  // there, next() gives Torn or Corrupt. Call it before the first next(), with a good header.
  void skip_to(std::uint64_t offset, std::uint64_t records);

  // Whether the header is good: without it next() gives Torn or Corrupt at once.
  bool header_ok() const { return status_ == Status::Record; }
  const CaptureHeader& header() const { return header_; }

  Status next(CaptureRecord& record);

  // Torn, Corrupt: one line with the offset and what is wrong there.
  const std::string& error() const { return error_; }
  // Up to here all is good: where a resumed capture goes on.
  std::uint64_t good_bytes() const { return good_; }
  // Records read, unknown ones included.
  std::uint64_t records() const { return records_; }
  std::uint64_t unknown_records() const { return unknown_; }
  bool closed() const { return closed_; }

 private:
  Status stop(Status status, const std::string& what);
  Status bad_record(std::size_t claimed, const std::string& what);
  bool fill(std::size_t bytes);
  void read_header();

  std::istream& in_;
  std::vector<std::byte> window_;  // bytes from offset good_ on
  std::size_t window_begin_ = 0;   // of them, those already used
  CaptureHeader header_;
  Status status_ = Status::Record;
  std::string error_;
  std::uint64_t good_ = 0;
  std::uint64_t records_ = 0, unknown_ = 0;
  bool closed_ = false;
};

}  // namespace incise::protocol
