#include "server/stream/field_updates.hpp"

#include <memory>
#include <utility>

namespace incise::stream {

void FieldUpdates::bring(Feed& feed, const std::vector<std::uint32_t>& fields, std::function<void()> done) {
  const std::vector<std::uint64_t>& now = feed.fields_set();
  std::vector<std::uint32_t> lacking;
  for (const std::uint32_t field : fields) {
    if (field >= held_.size() || held_[field] != now[field]) lacking.push_back(field);
  }
  if (lacking.empty()) return;
  note_requested(feed);
  request_ = ++last_request_;
  feed.request_fields(std::move(lacking),
                      [this, weak = std::weak_ptr<void>(outbox_.keep()), request = request_,
                       done = std::move(done)](std::uint64_t, const std::vector<SharedFrames>& values) {
                        const auto alive = weak.lock();
                        if (!alive || request != request_) return;
                        request_ = 0;
                        note_held();
                        for (const SharedFrames& frames : values) {
                          for (const SharedFrame& frame : *frames) outbox_.send_state(frame);
                        }
                        done();
                      });
}

}  // namespace incise::stream
