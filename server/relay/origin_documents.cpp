#include "server/relay/origin_documents.hpp"

#include <spdlog/spdlog.h>

#include <chrono>
#include <exception>
#include <utility>

#include "server/stream/pause.hpp"

namespace incise::relay {
namespace {

constexpr int kFetchTries = 5;
constexpr std::chrono::seconds kFetchAgain{1};
constexpr std::chrono::milliseconds kOriginAgain{100};
constexpr int kOriginTries = 50;

// For what the origin's documents are.
std::string documents_key(const protocol::Welcome& welcome) {
  return welcome.mesh.content_hash + ' ' + (welcome.surface ? welcome.surface->content_hash : std::string());
}

// What "/look.json" says; "": there is none.
std::string look_text(const stream::Documents& documents) {
  const auto look = documents.find("/look.json");
  return look == documents.end() ? std::string() : *look->second.body;
}

}  // namespace

OriginDocuments::OriginDocuments(std::string session, const Upstream& upstream)
    : session_(std::move(session)), upstream_(upstream) {}

bool OriginDocuments::fetched_for(const protocol::Welcome& welcome) const {
  return fetched_for_ == documents_key(welcome);
}

boost::asio::awaitable<void> OriginDocuments::fetch(protocol::Welcome welcome) {
  const bool surface_due = welcome.surface && !welcome.surface->path.empty();
  surface_ = {};
  look_ = {};
  // A directory may have just been asked for the first time.
  std::optional<Origin> origin = upstream_.origin();
  for (int i = 0; !origin && i < kOriginTries; ++i) {
    co_await stream::pause(kOriginAgain);
    origin = upstream_.origin();
  }
  if (!origin)
    spdlog::warn("{}: its server is not known; viewers get no texture coordinates or looks", session_);
  for (int i = 1; origin && i <= kFetchTries; ++i) {
    std::string why;
    try {
      if (surface_due && !surface_.origins) surface_ = co_await fetch_surface(*origin, *welcome.surface);
      look_ = co_await fetch_look(*origin, {});
    } catch (const std::exception& error) {
      why = error.what();
    }
    if (why.empty()) break;
    spdlog::warn("{}: how the body looks cannot be had ({}); {}", session_, why,
                 i < kFetchTries ? "trying again" : "viewers get no texture coordinates or looks");
    if (i < kFetchTries) co_await stream::pause(kFetchAgain);
  }
  fetched_for_ = documents_key(welcome);
}

boost::asio::awaitable<std::optional<stream::Documents>> OriginDocuments::fetch_other_look() const {
  const std::string text = look_text(look_);
  try {
    if (const std::optional<Origin> origin = upstream_.origin()) {
      stream::Documents found = co_await fetch_look(*origin, text);
      if (look_text(found) != text) co_return found;
    }
  } catch (const std::exception& error) {
    spdlog::warn("{}: how the body looks cannot be had ({}); viewers keep what they have", session_,
                 error.what());
  }
  co_return std::nullopt;
}

stream::Documents OriginDocuments::all() const {
  stream::Documents all = surface_.documents;
  all.insert(look_.begin(), look_.end());
  return all;
}

}  // namespace incise::relay
