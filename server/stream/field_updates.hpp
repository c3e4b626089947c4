#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "server/stream/feed.hpp"
#include "server/stream/outbox.hpp"

namespace incise::stream {

// New values of fields, for one peer: which of them it lacks, and those on their way to it. Meanwhile it gets no delta, since values
// belong to a revision.
//
// Thread: the stream thread.
class FieldUpdates {
 public:
  explicit FieldUpdates(Outbox& outbox) : outbox_(outbox) {}

  // A snapshot is requested of the feed now; it is what the peer holds; the peer holds something older.
  void note_requested(const Feed& feed) { requested_ = feed.fields_set(); }
  void note_held() { held_ = requested_; }
  void note_unknown() { held_.clear(); }

  bool on_their_way() const { return request_ != 0; }
  // If the peer, which holds the feed's state as it is now, lacks values of `fields`: requests them and sends them when they come, then
  // calls `done`.
  void bring(Feed& feed, const std::vector<std::uint32_t>& fields, std::function<void()> done);
  // Drops what is on its way.
  void forget() { request_ = 0; }

 private:
  Outbox& outbox_;
  std::vector<std::uint64_t> held_, requested_;   // Feed::fields_set(); shorter: nothing is known
  std::uint64_t last_request_ = 0, request_ = 0;  // 0: none
};

}  // namespace incise::stream
