#include "tests/stream/mini_loop.hpp"

#include <algorithm>
#include <atomic>
#include <utility>

namespace incise::stream {
namespace {

constexpr std::size_t kQueue = 8192;

core::Pose pose_of(const protocol::PoseSample& p) {
  return {p.source_ns,
          {p.position.x, p.position.y, p.position.z},
          {p.orientation.w, p.orientation.x, p.orientation.y, p.orientation.z},
          p.buttons};
}

std::int64_t now_ns() {
  return std::chrono::steady_clock::now().time_since_epoch().count();
}

}  // namespace

core::MeshData box_mesh(std::uint32_t n, double cell) {
  core::MeshData mesh;
  const std::uint32_t m = n + 1;
  const auto id = [&](std::uint32_t i, std::uint32_t j, std::uint32_t k) { return (k * m + j) * m + i; };
  for (std::uint32_t k = 0; k < m; ++k) {
    for (std::uint32_t j = 0; j < m; ++j) {
      for (std::uint32_t i = 0; i < m; ++i) mesh.positions.push_back({i * cell, j * cell, k * cell});
    }
  }
  // Kuhn's six tetrahedra: along each order of the axes from the low corner to the high one.
  constexpr int kOrders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
  for (std::uint32_t k = 0; k < n; ++k) {
    for (std::uint32_t j = 0; j < n; ++j) {
      for (std::uint32_t i = 0; i < n; ++i) {
        for (int o = 0; o < 6; ++o) {
          std::uint32_t at[3] = {i, j, k};
          std::array<core::VertexId, 4> tet{};
          tet[0] = id(i, j, k);
          for (int s = 0; s < 3; ++s) {
            ++at[kOrders[o][s]];
            tet[static_cast<std::size_t>(s) + 1] = id(at[0], at[1], at[2]);
          }
          if (o >= 3) std::swap(tet[2], tet[3]);  // the odd orders are left-handed
          mesh.tets.push_back(tet);
        }
      }
    }
  }
  return mesh;
}

std::vector<core::Field> fields_of(const core::MeshData& mesh) {
  std::vector<float> rest;
  std::vector<std::int32_t> label, cell;
  for (const core::Vec3& p : mesh.positions) {
    rest.insert(rest.end(), {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)});
    label.push_back(static_cast<std::int32_t>(label.size()));
  }
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) cell.push_back(static_cast<std::int32_t>(t / 6));
  using On = core::Field::On;
  return {{"rest", On::kVertices, 3, rest}, {"label", On::kVertices, 1, label}, {"cell", On::kTets, 1, cell}};
}

std::vector<protocol::PoseSample> sweep(double y, int poses, std::int64_t t0_ns, double side) {
  std::vector<protocol::PoseSample> out;
  for (int i = 0; i < poses; ++i) {
    protocol::PoseSample p;
    p.source_ns = t0_ns + std::int64_t{i} * 1'000'000;
    p.position = {-0.01 + (side + 0.02) * i / (poses - 1), y, side + 0.01};
    p.buttons = i + 1 < poses ? 1 : 0;  // let go at the end
    out.push_back(p);
  }
  return out;
}

class MiniLoop::Source final : public PoseInput {
 public:
  Source(MiniLoop& loop, std::uint32_t number) : loop_(loop), number_(number) {}
  ~Source() override {
    const std::scoped_lock lock(loop_.mutex_);
    loop_.slots_[number_].closing = true;
  }
  std::uint32_t number() const override { return number_; }
  std::size_t enqueue(std::span<const protocol::PoseSample> poses, std::int64_t) override {
    const std::scoped_lock lock(loop_.mutex_);
    auto& queue = loop_.slots_[number_].poses;
    const std::size_t n = std::min(poses.size(), kQueue - queue.size());
    queue.insert(queue.end(), poses.begin(), poses.begin() + static_cast<std::ptrdiff_t>(n));
    return n;
  }
  bool end_stroke(std::int64_t) override {
    const std::scoped_lock lock(loop_.mutex_);
    loop_.slots_[number_].end_stroke = true;
    return true;
  }
  PoseTotals totals() const override {
    const std::scoped_lock lock(loop_.mutex_);
    return loop_.slots_[number_].totals;
  }
  protocol::Vec3 heel() const override { return {0, 0, 0}; }
  protocol::Vec3 tip() const override { return {0, 0, loop_.config_.blade.tip.z}; }

 private:
  MiniLoop& loop_;
  std::uint32_t number_;
};

MiniLoop::MiniLoop(const core::MeshData& mesh, std::uint64_t session) : mesh_(mesh), session_id_(session) {
  double top = 0;
  for (const core::Vec3& p : mesh.positions) top = std::max(top, p.z);
  config_.blade = {{0, 0, 0}, {0, 0, -(top + 0.03)}};
  session_ = std::make_unique<core::CutSession>(mesh_, config_, fields_of(mesh_));
  hash_ = session_->mesh().state_hash();
  live_tets_ = session_->mesh().live_tets();
}

MiniLoop::~MiniLoop() {
  stop();
}

InitialState MiniLoop::initial() const {
  const core::TetMesh& mesh = session_->mesh();
  InitialState state;
  state.epoch = session_id_;
  state.revision = session_->revision();
  for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) state.positions.push_back(mesh.position(v));
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t)) state.tets.push_back(mesh.state(t));
  }
  state.fields = std::make_shared<const std::vector<core::Field>>(session_->fields().all());
  return state;
}

ServerFacts MiniLoop::facts() const {
  ServerFacts facts;
  facts.mesh.name = "box";
  facts.mesh.box = {{0, 0, 0}, {1, 1, 1}};
  facts.mesh.tets = static_cast<std::uint32_t>(mesh_.tets.size());
  facts.mesh.vertices = static_cast<std::uint32_t>(mesh_.positions.size());
  facts.blade_tip = {0, 0, config_.blade.tip.z};
  facts.engage_button = 0;
  facts.max_speed_m_s = config_.speed_limit_m_s;
  facts.frame_rate_hz = 1000;
  facts.policy = "conforming";
  return facts;
}

std::uint64_t MiniLoop::state_hash() const {
  return hash_;
}

void MiniLoop::feed(std::uint32_t source, const std::vector<protocol::PoseSample>& poses,
                    PoseTotals& totals) {
  for (const protocol::PoseSample& p : poses) {
    switch (session_->push(source, pose_of(p))) {
      case core::PoseVerdict::kNewStroke:
        ++totals.too_fast;
        [[fallthrough]];
      case core::PoseVerdict::kAccepted:
        ++totals.accepted;
        totals.last_source_ns = p.source_ns;
        if (recorded_) {
          ++totals.recorded;
          totals.recorded_source_ns = p.source_ns;
        }
        break;
      case core::PoseVerdict::kNotFinite:
        ++totals.not_finite;
        break;
      case core::PoseVerdict::kNotUnit:
        ++totals.not_unit;
        break;
      case core::PoseVerdict::kTimeNotIncreasing:
        ++totals.time_not_rising;
        break;
      case core::PoseVerdict::kUnknownSource:
        break;
    }
  }
}

void MiniLoop::publish_all() {
  for (;;) {
    core::WorkBudget budget = core::WorkBudget::unlimited();
    auto published = std::make_shared<PublishedDelta>();
    if (session_->advance(budget, published->delta) != core::CutSession::Progress::kCommitted) return;
    published->arrival_ns = published->drain_ns = published->cut_ns = now_ns();
    hash_ = published->delta.state_hash;
    live_tets_ = session_->mesh().live_tets();
    const std::uint64_t revision = published->delta.revision;
    const bool stroke_ended = published->delta.stroke_ended;
    if (server_) server_->publish(std::move(published));
    // In this order: who waits for a stroke's end finds the revision that ended it.
    revision_ = revision;
    strokes_ended_ += stroke_ended ? 1 : 0;
  }
}

void MiniLoop::cut(const std::vector<protocol::PoseSample>& poses) {
  PoseTotals totals;
  feed(0, poses, totals);
  publish_all();
}

void MiniLoop::start() {
  running_ = true;
  thread_ = std::thread([this] {
    while (running_) {
      work();
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    work();
  });
}

void MiniLoop::stop() {
  running_ = false;
  if (thread_.joinable()) thread_.join();
}

void MiniLoop::work() {
  if (held_) return;
  if (reset_.exchange(false)) {
    session_ = std::make_unique<core::CutSession>(mesh_, config_, fields_of(mesh_));
    ++session_id_;
    revision_ = 0;
    hash_ = session_->mesh().state_hash();
    live_tets_ = session_->mesh().live_tets();
    server_->publish_reset(std::make_shared<const InitialState>(initial()));
  }
  for (std::uint32_t i = 0; i < slots_.size(); ++i) {
    std::vector<protocol::PoseSample> poses;
    bool closing = false, end = false;
    PoseTotals totals;
    {
      const std::scoped_lock lock(mutex_);
      poses.swap(slots_[i].poses);
      closing = slots_[i].closing;
      end = std::exchange(slots_[i].end_stroke, false);
      totals = slots_[i].totals;
    }
    feed(i, poses, totals);
    if (closing || end) session_->end_stroke(i);
    publish_all();
    const std::scoped_lock lock(mutex_);
    slots_[i].totals = totals;
    if (closing) slots_[i].open = slots_[i].closing = false;
  }
}

std::unique_ptr<PoseInput> MiniLoop::open(std::string_view source_name,
                                          const std::optional<protocol::BladeEdge>&) {
  const std::scoped_lock lock(mutex_);
  for (const Slot& slot : slots_) {
    if (slot.open && slot.name == source_name) return nullptr;
  }
  for (std::uint32_t i = 0; i < slots_.size(); ++i) {
    if (slots_[i].open) continue;
    slots_[i] = {};
    slots_[i].open = true;
    slots_[i].name = source_name;
    return std::make_unique<Source>(*this, i);
  }
  return nullptr;
}

bool MiniLoop::reset(const Later& /*later*/) {
  return reset_ = true;
}

std::string MiniLoop::undo(const UndoRequest& /*request*/, const Answer& answer) {
  const std::scoped_lock lock(mutex_);
  undos_.push_back(answer);
  return {};
}

std::vector<PeerInput::Answer> MiniLoop::asked_undos() const {
  const std::scoped_lock lock(mutex_);
  return undos_;
}

bool MiniLoop::is_held(std::string_view source_name) const {
  const std::scoped_lock lock(mutex_);
  for (const Slot& slot : slots_) {
    if (slot.open && !slot.closing && slot.name == source_name) return true;
  }
  return false;
}

std::vector<std::string> MiniLoop::holders() const {
  const std::scoped_lock lock(mutex_);
  std::vector<std::string> names;
  for (const Slot& slot : slots_)
    if (slot.open && !slot.closing) names.push_back(slot.name);
  return names;
}

std::size_t MiniLoop::open_count() const {
  const std::scoped_lock lock(mutex_);
  std::size_t open = 0;
  for (const Slot& slot : slots_) open += slot.open;
  return open;
}

bool eventually(const std::function<bool()>& condition, double seconds) {
  // Once a wait has failed the test has failed: the conditions that depend on that one must not wait as long again.
  static std::atomic<bool> failed{false};
  const double limit_s = failed ? std::min(seconds, 5.0) : seconds;
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(limit_s);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) {
      failed = true;
      return false;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return true;
}

StreamConfig test_config() {
  StreamConfig config;
  config.tcp_port = 0;
  config.http_port = 0;
  return config;
}

TestServer::TestServer(std::uint32_t n, StreamConfig config, Providers providers)
    : loop(box_mesh(n)),
      server(std::move(config), loop.facts(), loop.initial(), loop, std::move(providers)),
      side(0.01 * n) {
  loop.attach(server);
  server.start();
}

TestServer::~TestServer() {
  server.stop();  // ends the operators' sources first: they refer to the loop
  loop.stop();
}

void TestServer::cut(int count) {
  for (int i = 0; i < count; ++i, ++strokes) {
    // Planes in an order that never comes back to the same place.
    const double y = side * (0.5 + 0.45 * (((strokes * 37) % 64) / 32.0 - 1));
    const int poses = std::max(80, static_cast<int>(1000 * side));  // slow enough to count as one stroke
    loop.cut(sweep(y, poses, std::int64_t{strokes} * 1'000'000'000 + 1, side));
  }
  wait_for_mirror();
}

void TestServer::wait_for_mirror() {
  eventually([&] { return server.counters().revision == loop.revision() && server.counters().queued == 0; });
}

}  // namespace incise::stream
