#pragma once

#include <functional>
#include <memory>
#include <string>
#include <system_error>
#include <utility>

#include "protocol/capture.hpp"
#include "server/loop/journal.hpp"

namespace incise::app {

// Writes a journal to a capture file. Thread: one at a time.
class CaptureJournal final : public loop::JournalSink {
 public:
  // A new capture; replaces whatever is at `path`. Throws std::system_error.
  CaptureJournal(const std::string& path, const protocol::CaptureHeader& header);
  // Continues a capture whose whole records end at `offset` and number `records`.
  CaptureJournal(const std::string& path, std::uint64_t offset, std::uint64_t records);
  // From here on flush() fails, as on a full disk, while less than this share of the file system is free to us: other files
  // and the checkpoints need room, too.
  void keep_free(double share) { keep_free_ = share; }
  // From here on flush() fails while this is false: another process may write the file.
  void write_while(std::function<bool()> may_write) { may_write_ = std::move(may_write); }
  void write(const loop::JournalRecord& record) override;
  void flush() override;
  void sync() override;
  // Writes the end mark to the disk: the capture was closed, not cut off.
  void close() override;
  // Between two flushes this also counts what waits; call it after a flush.
  Position position() const override;

 private:
  bool has_room();
  std::uint64_t room_to_go_on() const;
  std::string path_;
  std::function<bool()> may_write_;  // empty: always
  double keep_free_ = 0;
  std::error_code failure_;      // of the last flush
  bool low_ = false;             // there was no room at the last look
  std::uint64_t next_look_ = 0;  // at this length of the file
  protocol::FileSink sink_;
  protocol::CaptureWriter writer_;
};

}  // namespace incise::app
