#pragma once

// Messages to bytes and back. On TCP a message is a 32-bit little-endian length and that many bytes; on
// WebSocket it is one binary frame. The bytes are a FlatBuffer of incise.fbs.

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/limits.hpp"
#include "protocol/messages.hpp"

namespace incise::protocol {

// A message ready to send, to any number of peers over either transport.
class Frame {
 public:
  Frame() = default;
  // `bytes`: the length prefix and the message.
  explicit Frame(std::vector<std::byte> bytes) : bytes_(std::move(bytes)) {}

  // For TCP: with the length in front.
  std::span<const std::byte> tcp() const { return bytes_; }
  // For WebSocket: the message alone.
  std::span<const std::byte> body() const { return std::span(bytes_).subspan(bytes_.empty() ? 0 : 4); }

 private:
  std::vector<std::byte> bytes_;
};

// What stands around a body: the sender's number of the message and its monotonic clock, ns.
struct Envelope {
  std::uint64_t sequence = 0;
  std::int64_t sent_ns = 0;
};

// The message as bytes. Copies each array once. Throws std::length_error where it would exceed
// kMaxMessageBytes: who may build such a delta sends a snapshot instead, in chunks.
Frame encode(const Body& body, Envelope envelope = {});

// A message received. Its arrays point into the bytes it was decoded from, or where those were not 8-aligned
// into a copy that it owns: keep the bytes as long as the arrays are used.
struct Message {
  Envelope envelope;
  Body body;
  std::shared_ptr<const void> storage;  // the aligned copy, if one was needed
};

// A message, or what is wrong with the bytes.
struct DecodeResult {
  std::optional<Message> message;
  ErrorCode code = ErrorCode::Unknown;  // BadFrame or TooLong, where there is no message
  std::string error;                    // one line: which field, what was found, what is accepted

  explicit operator bool() const { return message.has_value(); }
};

// Decodes one message (without the length prefix) that a peer sent. Checks, in this order: the length against
// `max_bytes`; the identifier; every offset (FlatBuffers' verifier); that arrays which belong together have
// matching lengths, numbers are finite and coordinates within kMaxCoordinate, enumerations known, texts
// within their limits. Checks that need a state (ids in range, order of messages) are left to its
// holder. Never throws because of the bytes; allocates no more than a small multiple of their number.
DecodeResult decode(std::span<const std::byte> bytes, std::size_t max_bytes = kMaxMessageBytes);

// Cuts a TCP byte stream into messages. Holds at most one message and grows with what has arrived, not with
// what the prefix claims. Thread: one, at a time.
//
//   std::span<const std::byte> input = received;
//   while (reader.read(input) == FrameReader::Status::Complete) handle(reader.body());
//   if (reader.failed()) close(reader.error());
class FrameReader {
 public:
  enum class Status {
    NeedMore,  // all input is taken in
    Complete,  // body() holds one message; call again with the rest of the input
    Failed,    // the stream cannot be cut any further: no call changes that
  };

  explicit FrameReader(std::size_t max_bytes = kMaxMessageBytes) : max_bytes_(max_bytes) {}

  // Another cap from the next message on, e.g. once the peer is known.
  void set_max_bytes(std::size_t max_bytes) { max_bytes_ = max_bytes; }

  // Takes from the front of `input` up to the end of one message.
  Status read(std::span<const std::byte>& input);

  // The last complete message, 8-aligned; valid until the next read.
  std::span<const std::byte> body() const;
  bool failed() const { return failed_; }
  // Why, in one line; empty while not failed.
  const std::string& error() const { return error_; }
  // Bytes of the message that is under way. Not 0 at the end of a stream: it was cut off.
  std::size_t pending_bytes() const { return complete_ ? 0 : prefix_have_ + have_; }

 private:
  std::size_t max_bytes_;
  std::size_t prefix_have_ = 0;
  std::byte prefix_[4] = {};
  std::size_t size_ = 0;  // of the message, once its prefix is there
  std::size_t have_ = 0;
  std::vector<std::uint64_t> buffer_;
  bool complete_ = false;
  bool failed_ = false;
  std::string error_;
};

}  // namespace incise::protocol
