#pragma once

#include <boost/asio/awaitable.hpp>
#include <memory>
#include <optional>
#include <string>

#include "protocol/messages.hpp"
#include "server/relay/body_documents.hpp"
#include "server/relay/upstream.hpp"
#include "server/stream/providers.hpp"

namespace incise::relay {

// What a relay has of its origin's documents: those of the body's surface, and how the body looks. Viewers do without what cannot be had.
//
// Thread: the session's.
class OriginDocuments {
 public:
  // `session` is its name, for the log. `upstream` must outlive this.
  OriginDocuments(std::string session, const Upstream& upstream);

  // Whether they are those of this body, as far as they can be had.
  bool fetched_for(const protocol::Welcome& welcome) const;
  // Fetches them, with several tries. One at a time.
  boost::asio::awaitable<void> fetch(protocol::Welcome welcome);
  // How the body looks now. Nothing: as it did, or it cannot be had.
  boost::asio::awaitable<std::optional<stream::Documents>> fetch_other_look() const;
  void set_look(stream::Documents look) { look_ = std::move(look); }

  stream::Documents all() const;
  // What finds the origins of faces; null: there is none.
  const std::shared_ptr<const protocol::OriginTree>& origins() const { return surface_.origins; }

 private:
  const std::string session_;
  const Upstream& upstream_;
  std::optional<std::string> fetched_for_;  // content hashes of the body and its surface
  FetchedSurface surface_;
  stream::Documents look_;
};

}  // namespace incise::relay
