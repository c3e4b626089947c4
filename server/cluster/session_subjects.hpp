#pragma once

#include <algorithm>
#include <string>
#include <string_view>

#include "protocol/messages.hpp"

namespace incise::cluster {

// Whether this can be a session's name: 1 to 64 letters, digits, "-" and "_", since it is a part of NATS's subjects and keys.
inline bool is_session_name(std::string_view name) {
  const auto good = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_';
  };
  return !name.empty() && name.size() <= 64 && std::all_of(name.begin(), name.end(), good);
}

// Where a session is on NATS (server/cluster/NATS.md). All is below "incise.NAME.", so that an account can be limited to one session.
class SessionSubjects {
 public:
  explicit SessionSubjects(const std::string& session)
      : stream_("incise_" + session), root_("incise." + session) {}

  // The JetStream stream of both views.
  const std::string& stream() const { return stream_; }
  std::string of_view(protocol::View view) const {
    return root_ + (view == protocol::View::Surface ? ".surface" : ".volume");
  }
  std::string all(protocol::View view) const { return of_view(view) + ".>"; }
  std::string welcome(protocol::View view) const { return of_view(view) + ".welcome"; }
  std::string snapshot(protocol::View view) const { return of_view(view) + ".snapshot"; }
  std::string delta(protocol::View view) const { return of_view(view) + ".delta"; }
  // Statistics and blades, not kept.
  std::string live() const { return root_ + ".live"; }

 private:
  std::string stream_, root_;
};

// Headers of a message. Numbers are in base 10, epochs and hashes in base 16.
inline constexpr const char* kEpochHeader = "Incise-Epoch";
// Of the state after it.
inline constexpr const char* kRevisionHeader = "Incise-Revision";
// A delta's: the state hash before it.
inline constexpr const char* kBaseHashHeader = "Incise-Base-Hash";
// "2/5": the second of five parts of one protocol message; absent where there is one.
inline constexpr const char* kPartHeader = "Incise-Part";
// Welcome's: how often clients have set fields; Unix time less the sender's monotonic clock, ns.
inline constexpr const char* kFieldsSetHeader = "Incise-Fields-Set";
inline constexpr const char* kClockHeader = "Incise-Clock";
// Names the run of the program that published it, base 16.
inline constexpr const char* kInstanceHeader = "Incise-Instance";
// Rises each time that another instance takes the session over; 0 without failover.
inline constexpr const char* kFenceHeader = "Incise-Fence";

}  // namespace incise::cluster
