#include "server/relay/session.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/post.hpp>
#include <exception>
#include <utility>

#include "protocol/limits.hpp"
#include "server/base/hex.hpp"
#include "server/relay/upstream_says.hpp"
#include "server/stream/mirror.hpp"

namespace incise::relay {
namespace {

using protocol::View;

constexpr std::chrono::milliseconds kGoodbyes{200};  // for those of operators to reach the origin
constexpr std::size_t kMaxBlades = 64;               // more than any server has
constexpr double kCatchUp_s = 4;                     // less than clients wait for a Welcome

// Whether a server made for one Welcome can go on with the other. Faces are left out: one that has resumed counts those of cuts.
bool same_body(const protocol::Welcome& a, const protocol::Welcome& b) {
  const auto surface = [](const protocol::Welcome& w) {
    return w.surface ? w.surface->path + ' ' + w.surface->content_hash : std::string("none");
  };
  return a.mesh.name == b.mesh.name && a.mesh.content_hash == b.mesh.content_hash &&
         a.mesh.vertices == b.mesh.vertices && a.mesh.tets == b.mesh.tets && a.mesh.box == b.mesh.box &&
         a.mesh.mean_edge_length_m == b.mesh.mean_edge_length_m && a.blade_heel == b.blade_heel &&
         a.blade_tip == b.blade_tip && a.engage_button == b.engage_button &&
         a.max_speed_m_s == b.max_speed_m_s && a.frame_rate_hz == b.frame_rate_hz && a.policy == b.policy &&
         a.fields == b.fields && surface(a) == surface(b);
}

void rethrow(const std::exception_ptr& error) {
  if (error) std::rethrow_exception(error);
}

core::Field core_field(const protocol::Field& field) {
  return {field.facts.name, static_cast<core::Field::On>(field.facts.on), field.facts.components,
          field.values};
}

}  // namespace

Session::Session(std::string name, stream::StreamConfig config, const MakeUpstream& make_upstream)
    : name_(std::move(name)),
      config_(std::move(config)),
      work_(asio::make_work_guard(io_)),
      upstream_(make_upstream(io_)),
      state_(protocol::kMaxVertices, protocol::kMaxTets, View::Volume, 0),
      documents_(name_, *upstream_) {
  config_.catch_up_s = kCatchUp_s;
  figures_.upstream = upstream_->name();
  figures_.trouble = "nothing has come from " + figures_.upstream + " yet";
}

Session::~Session() {
  stop();
}

void Session::start(Reports reports) {
  reports_ = std::move(reports);
  asio::post(io_, [this] { upstream_->start(*this); });
  thread_ = std::thread([this] { io_.run(); });
}

void Session::stop() {
  if (!thread_.joinable()) return;
  asio::post(io_, [this] {
    upstream_->stop();
    if (server_) server_->stop();  // operators' links say goodbye after this
    work_.reset();
    auto late = std::make_shared<asio::steady_timer>(io_, kGoodbyes);
    late->async_wait([this, late](boost::system::error_code) { io_.stop(); });
  });
  thread_.join();
}

// ---- What comes ----

void Session::on_message(const protocol::Message& message, std::int64_t ahead_ns) {
  const protocol::Body& body = message.body;
  if (const auto* delta = std::get_if<protocol::Delta>(&body)) {
    on(*delta, ahead_ns);
  } else if (const auto* pose = std::get_if<protocol::BladePose>(&body)) {
    const std::scoped_lock lock(mutex_);
    auto place = std::find_if(blades_.begin(), blades_.end(),
                              [&](const auto& other) { return other.source == pose->source; });
    if (place == blades_.end()) {
      if (blades_.size() == kMaxBlades) return;
      place = blades_.insert(place, *pose);
    }
    *place = *pose;
    place->arrival_ns -= ahead_ns;
  } else if (const auto* stats = std::get_if<protocol::Stats>(&body)) {
    on(*stats);
  } else if (const auto* welcome = std::get_if<protocol::Welcome>(&body)) {
    on(*welcome);
  } else if (const auto* begin = std::get_if<protocol::SnapshotBegin>(&body)) {
    on(*begin);
  } else if (const auto* chunk = std::get_if<protocol::SnapshotChunk>(&body)) {
    on(*chunk);
  } else if (const auto* end = std::get_if<protocol::SnapshotEnd>(&body)) {
    on(*end);
  } else if (const auto* values = std::get_if<protocol::FieldValues>(&body)) {
    on(*values);
  }
}

// The statistics of a relay say how far the server is from it.
void Session::on(const protocol::Stats& stats) {
  const UpstreamSays upstream = read_upstream(stats.json);
  const int hops = upstream.hops + 1;
  const bool cycle = hops > kMaxHops;
  std::string text, beyond, before, beyond_before;
  if (!cycle) beyond = trouble_at(upstream_->name(), upstream);
  if (cycle) {
    text = "relays follow each other in a cycle, or are more than " + std::to_string(kMaxHops) +
           " in a row: give one of them a server as its upstream";
  }
  {
    const std::scoped_lock lock(mutex_);
    figures_.hops = std::min(hops, kMaxHops + 1);
    figures_.origin = stats;
    figures_.round_trip_ms = 1e-6 * static_cast<double>(upstream_->round_trip().count());
    recording_ = stats.recording;
    before = std::exchange(cycle_, text);
    beyond_before = std::exchange(beyond_, beyond);
    if (!cycle && (figures_.trouble == before || figures_.trouble == beyond_before))
      figures_.trouble = beyond;
  }
  if (beyond != beyond_before && !beyond.empty()) spdlog::warn("{}: {}", name_, beyond);
  if (beyond.empty() && !beyond_before.empty() && !cycle)
    spdlog::info("{}: {} has no more trouble", name_, upstream_->name());
  if (cycle && before.empty()) spdlog::error("{}: {}: {}", name_, upstream_->name(), text);
  if (!cycle && !before.empty()) spdlog::info("{}: {} leads to a server again", name_, upstream_->name());
  if (cycle) upstream_->leave(text);
}

void Session::on_lost(const std::string& why) {
  {
    const std::scoped_lock lock(mutex_);
    beyond_.clear();
    if (why == cycle_) {  // logged when it was found
      figures_.connected = false;
      figures_.trouble = why;
      return;
    }
    if (!figures_.connected && figures_.trouble.ends_with(why)) return;
    figures_.connected = false;
  }
  const std::string to = why.starts_with(upstream_->name() + ": ") ? why : upstream_->name() + ": " + why;
  spdlog::warn("{}: no connection to {}", name_, to);
  set_trouble("no connection to " + to);
}

Held Session::held() const {
  if (!state_.whole() || state_.awaiting_snapshot()) return {};
  Held held{welcome_.session, state_.revision(), state_.state_hash(), {}};
  for (std::uint32_t field = 0; field < state_.fields().all().size(); ++field) held.fields.push_back(field);
  return held;
}

void Session::on(const protocol::Welcome& welcome) {
  const bool another = welcome.session != welcome_.session;
  welcome_ = welcome;
  const bool back = server_ && !figures().connected;
  {
    const std::scoped_lock lock(mutex_);
    if (!figures_.connected) {
      ++figures_.welcomes;
      // In a cycle it is only to see whether that is over.
      spdlog::log(cycle_.empty() ? spdlog::level::info : spdlog::level::debug, "{}: connected to {}, {}",
                  name_, upstream_->name(), welcome.resumed ? "nothing is missing" : "waiting for its state");
    } else if (another) {
      ++figures_.epochs;
    }
    figures_.connected = true;
    if (welcome.resumed) ++figures_.resumed;
    recording_ = welcome.recording;
  }
  if (back && !fetching_) asio::co_spawn(io_, check_look(), rethrow);
  if (!welcome.resumed) {
    state_.forget();
    state_.await_snapshot();
    set_trouble("waiting for the state from " + upstream_->name());
    return;
  }
  if (!state_.whole() || state_.awaiting_snapshot()) {
    refuse({protocol::ApplyError::WrongBase, "deltas were promised for a state that is not held"});
    return;
  }
  set_trouble({});
  if (!same_body(body_, welcome_)) show();
}

void Session::on(const protocol::SnapshotBegin& begin) {
  if (begin.view != View::Volume || begin.box) {
    refuse({protocol::ApplyError::BadShape, "a snapshot of another view, or of a box"});
    return;
  }
  if (const auto result = state_.begin(begin, welcome_.fields); !result) refuse(result);
}

void Session::on(const protocol::SnapshotChunk& chunk) {
  if (!state_.in_snapshot()) return;  // of one that was refused
  if (const auto result = state_.add(chunk); !result) refuse(result);
}

void Session::on(const protocol::SnapshotEnd& end) {
  if (!state_.in_snapshot()) return;
  if (const auto result = state_.end(end); !result) {
    refuse(result);
    return;
  }
  {
    const std::scoped_lock lock(mutex_);
    ++figures_.snapshots;
  }
  const bool serves = server_ != nullptr;
  show();
  if (serves) spdlog::info("{}: has the state again, at revision {}", name_, state_.revision());
}

void Session::on(const protocol::FieldValues& values) {
  if (state_.awaiting_snapshot() && !state_.in_snapshot()) return;
  if (const auto result = state_.add(values); !result) {
    refuse(result);
    return;
  }
  if (state_.in_snapshot() || !values.last || !shown_) return;
  server_->publish_field({values.field, 0, state_.revision(), state_.fields().all().at(values.field).values});
}

void Session::on(const protocol::Delta& delta, std::int64_t ahead_ns) {
  if (state_.awaiting_snapshot()) return;  // sent before the upstream knew
  if (const auto result = state_.apply(delta); !result) {
    refuse(result);
    return;
  }
  {
    const std::scoped_lock lock(mutex_);
    ++figures_.deltas;
    if (delta.revision > delta.base_revision + 1) ++figures_.combined;
  }
  if (!shown_) return;
  protocol::Delta ours = delta;
  for (protocol::Step& step : ours.steps) {
    step.arrival_ns -= ahead_ns;
    step.drain_ns -= ahead_ns;
    step.cut_ns -= ahead_ns;
  }
  if (auto received = stream::received_delta(ours)) {
    server_->publish(std::move(received));
  } else {
    show();
  }
}

void Session::refuse(const protocol::ApplyResult& result) {
  {
    const std::scoped_lock lock(mutex_);
    ++figures_.refused;
  }
  spdlog::warn("{}: what {} sent does not fit revision {}: {}", name_, upstream_->name(), state_.revision(),
               result.text);
  set_trouble("waiting for the state from " + upstream_->name() +
              ", since what it sent did not fit: " + result.text);
  state_.await_snapshot();
  upstream_->resync(result.text);
}

void Session::set_trouble(std::string trouble) {
  const std::scoped_lock lock(mutex_);
  figures_.trouble = !trouble.empty() ? std::move(trouble) : !cycle_.empty() ? cycle_ : beyond_;
}

std::optional<Origin> Session::origin() const {
  {
    const std::scoped_lock lock(mutex_);
    if (!cycle_.empty()) return std::nullopt;
  }
  return upstream_->origin();
}

// ---- The server ----

void Session::show() {
  if (!documents_.fetched_for(welcome_)) {
    shown_ = false;
    if (!std::exchange(fetching_, true)) asio::co_spawn(io_, fetch(), rethrow);
    return;
  }
  try {
    if (server_ && same_body(body_, welcome_)) {
      server_->publish_reset(initial_state());
    } else {
      serve(initial_state());
    }
  } catch (const std::exception& error) {
    spdlog::error("{}: {}", name_, error.what());
    set_trouble(error.what());
    if (reports_.on_failed) reports_.on_failed(error.what());
    return;
  }
  shown_ = true;
  set_trouble({});
}

asio::awaitable<void> Session::fetch() {
  co_await documents_.fetch(welcome_);
  fetching_ = false;
  if (state_.whole() && !state_.awaiting_snapshot()) show();
}

asio::awaitable<void> Session::check_look() {
  std::optional<stream::Documents> found = co_await documents_.fetch_other_look();
  if (!found || fetching_) co_return;
  documents_.set_look(std::move(*found));
  body_ = {};  // the server has the former look: another one is needed
  if (state_.whole() && !state_.awaiting_snapshot()) show();
}

std::shared_ptr<stream::InitialState> Session::initial_state() const {
  auto mirror = std::make_shared<stream::Mirror>();
  mirror->reset(state_.volume(), welcome_.session, documents_.origins());
  auto initial = std::make_shared<stream::InitialState>();
  initial->epoch = welcome_.session;
  initial->mirror = std::move(mirror);
  initial->origins = documents_.origins();
  if (welcome_.restart) initial->restart = std::make_shared<const protocol::Restart>(*welcome_.restart);
  auto fields = std::make_shared<std::vector<core::Field>>();
  for (const protocol::Field& field : state_.fields().all()) fields->push_back(core_field(field));
  if (!fields->empty()) initial->fields = std::move(fields);
  return initial;
}

// Another body is another server: to its viewers the session has ended, as it has at the origin.
void Session::serve(std::shared_ptr<const stream::InitialState> initial) {
  if (server_) {
    spdlog::info("{}: {} has another body or configuration; viewers connect again", name_, upstream_->name());
    server_->stop();
    const std::scoped_lock lock(mutex_);
    server_.reset();
  }
  ++servers_;
  auto server = std::make_shared<stream::Server>(config_, facts(), *initial,
                                                 static_cast<stream::PeerInput&>(*this), providers());
  {
    const std::scoped_lock lock(mutex_);
    server_ = server;
    figures_.body = welcome_.mesh.name;
  }
  // Another server has the same places.
  if (config_.tcp_port >= 0) config_.tcp_port = server->tcp_port();
  if (config_.http_port >= 0) config_.http_port = server->http_port();
  body_ = welcome_;
  set_trouble({});
  server->start();
  spdlog::info("{}: serving {} at revision {}, state hash {}", name_, upstream_->name(), state_.revision(),
               hex(state_.state_hash()));
  if (reports_.on_listening) reports_.on_listening(server->tcp_port(), server->http_port());
}

stream::ServerFacts Session::facts() const {
  stream::ServerFacts facts;
  facts.mesh = welcome_.mesh;
  facts.blade_heel = welcome_.blade_heel;
  facts.blade_tip = welcome_.blade_tip;
  facts.engage_button = welcome_.engage_button;
  facts.max_speed_m_s = welcome_.max_speed_m_s;
  facts.frame_rate_hz = welcome_.frame_rate_hz;
  facts.policy = welcome_.policy;
  if (documents_.origins()) facts.surface = welcome_.surface;
  return facts;
}

stream::Providers Session::providers() {
  stream::Providers providers;
  providers.stats_json = reports_.stats_json;
  providers.metrics_text = reports_.metrics_text;
  providers.sessions_json = reports_.sessions_json;
  providers.audit = reports_.audit;
  providers.documents = documents_.all();
  providers.statistics = [this] {
    protocol::Stats stats = figures().origin;
    if (reports_.stats_json) stats.json = reports_.stats_json();
    return stats;
  };
  providers.blades = [this] {
    const std::scoped_lock lock(mutex_);
    return blades_;
  };
  providers.trouble = [this] { return figures().trouble; };
  providers.recording = [this] {
    const std::scoped_lock lock(mutex_);
    stream::RecordingNow now{recording_, {}};
    if (recording_ == protocol::Recording::Stopped)
      now.trouble = "the server that cuts has stopped recording";
    return now;
  };
  return providers;
}

// ---- Operators and administrators ----

std::unique_ptr<stream::PoseInput> Session::open(std::string_view source_name,
                                                 const std::optional<protocol::BladeEdge>& blade) {
  return open_link({std::string(source_name), blade, false});
}

std::unique_ptr<stream::PoseInput> Session::take_over(std::string_view source_name,
                                                      const std::optional<protocol::BladeEdge>& blade) {
  return open_link({std::string(source_name), blade, true});
}

std::unique_ptr<stream::PoseInput> Session::open_link(OperatorLink::Wanted wanted) {
  auto link =
      std::make_shared<OperatorLink>(io_, origin(), std::move(wanted), [this](const protocol::Force& force) {
        if (server_) server_->publish_force(force);
      });
  link->start();
  const std::scoped_lock lock(mutex_);
  std::erase_if(links_, [](const auto& other) { return other.expired(); });
  links_.push_back(link);
  return lend(std::move(link));
}

std::string Session::no_simulators() const {
  return "this is a relay: simulators, and values of fields, go to the server that cuts";
}

// A refusal for a server that has been replaced meanwhile has nobody to go to.
stream::PeerInput::Later Session::while_served(const Later& later) const {
  return [this, servers = servers_.load(), later](stream::Refusal refusal) {
    if (servers == servers_) later(std::move(refusal));
  };
}

bool Session::reset(const Later& later) {
  const std::optional<Origin> where = origin();
  if (!where) return false;
  asio::post(io_, [this, origin = *where, later = while_served(later)] {
    ask_origin(io_, origin, protocol::Reset{}, later);
  });
  return true;
}

std::string Session::undo(const stream::UndoRequest& request, const Answer& answer) {
  if (request.source) {
    const std::scoped_lock lock(mutex_);
    for (const auto& weak : links_) {
      const auto link = weak.lock();
      if (!link || link->opening() || link->ended() || link->number() != *request.source) continue;
      link->undo({request.others}, while_served(answer));
      return {};
    }
  }
  const std::optional<Origin> where = origin();
  if (request.source || !where) return "there is no connection to the server that cuts";
  asio::post(io_, [this, origin = *where, later = while_served(answer)] {
    ask_origin(io_, origin, protocol::Undo{}, later);
  });
  return {};
}

// ---- Reports ----

Figures Session::figures() const {
  const std::scoped_lock lock(mutex_);
  Figures figures = figures_;
  for (const auto& weak : links_) {
    const auto link = weak.lock();
    if (!link || link->opening() || link->ended()) continue;
    figures.operators.push_back(
        {link->source_name(), link->number(), 1e-6 * static_cast<double>(link->round_trip().count())});
  }
  return figures;
}

stream::StreamCounters Session::counters() const {
  std::shared_ptr<stream::Server> server;
  {
    const std::scoped_lock lock(mutex_);
    server = server_;
  }
  return server ? server->counters() : stream::StreamCounters();
}

}  // namespace incise::relay
