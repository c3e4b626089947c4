#include "tests/oracle/meetings.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <optional>

#include "server/base/check.hpp"

namespace incise::oracle {
namespace {

using core::cross;
using core::length;
using core::normalized;
constexpr double kTurn = 2 * std::numbers::pi;

// Where a way goes: points in the plane across the blade's direction, in h.
struct Point {
  double x = 0, y = 0;
};
using Way = std::vector<Point>;

// Makes the strokes of one meeting.
class Maker {
 public:
  Maker(const core::MeshData& mesh, double h, std::string_view kind, std::uint64_t seed, bool along_axes)
      : random_(seed * 1'000'003 + kind_number(kind)), mesh_(mesh), h_(h) {
    Vec3 low = mesh.positions.at(0), high = low;
    for (const Vec3& p : mesh.positions) core::extend(p, low, high);
    size_ = core::distance(low, high);
    const auto& tet = mesh.tets[random_.below(mesh.tets.size())];
    for (core::VertexId v : tet) centre_ += 0.25 * mesh.positions[v];
    // Towards the middle, so that most loops lie in the body.
    centre_ = core::lerp(centre_, 0.5 * (low + high), random_.uniform(0, 0.6));
    axis_ = random_.direction();
    u_ = normalized(cross(axis_, std::abs(axis_.x) < 0.6 ? Vec3{1, 0, 0} : Vec3{0, 1, 0}));
    v_ = cross(axis_, u_);
    meeting_.kind = kind;
    meeting_.seed = seed;
    meeting_.overlap_h = random_.one_of({-0.25, 0.0, 0.5, 2.0});
    meeting_.step_h = random_.one_of({0.03, 0.1, 0.3, 1.0});
    meeting_.batch_h = random_.one_of({0.1, 0.25, 1.0});
    meeting_.blade = {{0, 0, 0}, {0, 0, 2.4 * size_}};
    radius_h_ = random_.uniform(2, std::clamp(0.25 * size_ / h_, 2.5, 6.0));
    meeting_.along_axes = along_axes;
    if (along_axes) lie_along_axes(mesh);
  }

  Meeting make() {
    const std::string& kind = meeting_.kind;
    const double o = meeting_.overlap_h;
    if (kind == "circle" || kind == "plunge") {
      loop(circle(radius_h_, 1), o, kind == "plunge");
    } else if (kind == "ellipse") {
      loop(circle(radius_h_, random_.uniform(0.45, 0.9)), o, false);
    } else if (kind == "polygon") {
      loop(polygon(), o, false);
    } else if (kind == "lasso") {
      stroke(lasso(o));
    } else if (kind == "spiral") {
      stroke(spiral(o));
    } else if (kind == "cone") {
      cone(o);
    } else if (kind == "nested") {
      loop(circle(radius_h_, 1), o, false);
      loop(circle(radius_h_ + random_.uniform(1.5, 2.5), 1), random_.one_of({-0.25, 0.0, 0.5, 2.0}), false);
    } else if (kind == "grid") {
      grid();
    } else if (kind == "square") {
      square(o);
    } else if (kind == "lid") {
      slit();
      loop(circle(radius_h_, 1), random_.one_of({0.0, 0.5}), false, o);
    } else if (kind == "box") {
      square(random_.one_of({0.0, 0.5, 2.0}), o);
      slit();
    } else if (kind == "rows" || kind == "strips") {
      rows();
    } else if (kind == "helix") {
      helix();
    } else if (kind == "halves") {
      stroke(arc(radius_h_, 0, 0.5, o));
      stroke(arc(radius_h_, 0.5, 0.5, o));
    } else {
      pair(kind, o);
    }
    return std::move(meeting_);
  }

 private:
  static std::uint64_t kind_number(std::string_view kind) {
    const auto at = std::find(std::begin(kMeetingKinds), std::end(kMeetingKinds), kind);
    INCISE_CHECK(at != std::end(kMeetingKinds));
    return static_cast<std::uint64_t>(at - std::begin(kMeetingKinds)) * 7919;
  }
  Vec3 at(const Point& p) const { return centre_ + (h_ * p.x) * u_ + (h_ * p.y) * v_; }

  // Turns the frame to the axes, and moves its centre and its radius to planes of vertices, or leaves them between two.
  void lie_along_axes(const core::MeshData& mesh) {
    const Vec3 unit[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    const std::size_t first = random_.below(3), way = 1 + random_.below(2);
    axis_ = (random_.below(2) == 0 ? 1 : -1) * unit[first];
    u_ = unit[(first + way) % 3];
    v_ = unit[(first + 3 - way) % 3];
    const auto component = [](Vec3& p, std::size_t axis) -> double& {
      return axis == 0 ? p.x : axis == 1 ? p.y : p.z;
    };
    for (std::size_t axis = 0; axis < 3; ++axis) {
      double& coordinate = component(centre_, axis);
      const double wanted = coordinate;
      if (random_.below(2) == 0) continue;
      coordinate = INFINITY;
      for (Vec3 p : mesh.positions) {
        if (std::abs(component(p, axis) - wanted) < std::abs(coordinate - wanted))
          coordinate = component(p, axis);
      }
    }
    if (random_.below(2) == 0) return;
    double nearest = INFINITY;
    for (const Vec3& p : mesh.positions) {
      const double radius = std::abs(core::dot(p - centre_, u_)) / h_;
      if (std::abs(radius - radius_h_) < std::abs(nearest - radius_h_)) nearest = radius;
    }
    if (nearest > 1.5) radius_h_ = nearest;
  }
  // Where a way around begins: anywhere, or on an axis.
  double turn() {
    const double angle = random_.uniform(0, kTurn);
    return meeting_.along_axes ? kTurn / 4 * std::floor(4 * angle / kTurn) : angle;
  }
  // Of the steps of a way around, in whole quarters along the axes.
  int around(double turns, double radius) const {
    const double n = turns * kTurn * radius / meeting_.step_h;
    return meeting_.along_axes ? 4 * static_cast<int>(std::ceil(n / 4)) : static_cast<int>(std::ceil(n));
  }

  // A closed way that begins and ends at one point.
  Way circle(double radius, double ratio) {
    const double from = turn();
    Way way;
    const int n = around(1, radius);
    for (int i = 0; i <= n; ++i) {
      const double angle = from + kTurn * i / n;
      way.push_back({radius * std::cos(angle), ratio * radius * std::sin(angle)});
    }
    way.back() = way.front();
    return way;
  }
  Way arc(double radius, double from, double turns, double overlap) const {
    // Longer by the overlap at either end, along the circle.
    const double more = overlap / radius;
    const double first = kTurn * from - more, span = kTurn * turns + 2 * more;
    const int n = static_cast<int>(std::ceil(span * radius / meeting_.step_h));
    Way way;
    for (int i = 0; i <= n; ++i) {
      const double angle = first + span * i / n;
      way.push_back({radius * std::cos(angle), radius * std::sin(angle)});
    }
    return way;
  }
  Way polygon() {
    const std::size_t corners = 3 + random_.below(4);
    const double from = turn(), start = random_.uniform(0.1, 0.9);
    std::vector<Point> corner;
    for (std::size_t i = 0; i < corners; ++i) {
      const double angle = from + kTurn * static_cast<double>(i) / static_cast<double>(corners);
      const double r = radius_h_ * random_.uniform(0.9, 1.3);
      corner.push_back({r * std::cos(angle), r * std::sin(angle)});
    }
    // Begins on the first side, or at its corner.
    const double along = random_.below(3) == 0 ? 0 : start;
    Way way{between(corner[0], corner[1], along)};
    for (std::size_t i = 1; i <= corners; ++i) go_to(way, corner[i % corners]);
    go_to(way, way.front());
    return way;
  }
  Way lasso(double overlap) {
    const double r = radius_h_, from = turn();
    const double tail = std::min(r + 2, 0.4 * size_ / h_);
    // In along a tangent and around; then on along the first turn, or out across the way in.
    Way way{turned({-tail, -r}, from)};
    go_to(way, turned({0, -r}, from));
    const double across = random_.below(3) == 0 ? 0 : random_.uniform(0.5, 1.2) / r;
    const int n = static_cast<int>(std::ceil(kTurn * r / meeting_.step_h));
    const double end = kTurn - across + (across == 0 ? overlap / r : 0);
    for (int i = 1; i <= n; ++i) {
      const double angle = end * i / n;
      way.push_back(turned({r * std::sin(angle), -r * std::cos(angle)}, from));
    }
    if (across > 0) go_to(way, turned({-r * std::sin(across), -r - overlap}, from));
    return way;
  }
  Way spiral(double overlap) {
    const double pitch = 1.5, from = turn(), turns = 1.25;
    const int n = around(turns, radius_h_);
    Way way;
    for (int i = 0; i <= n; ++i) {
      const double s = turns * i / n, r = radius_h_ + pitch - pitch * s;
      way.push_back({r * std::cos(from + kTurn * s), r * std::sin(from + kTurn * s)});
    }
    const double out = (radius_h_ + pitch - pitch * 0.25 + overlap) / (radius_h_ + pitch - pitch * turns);
    go_to(way, {out * way.back().x, out * way.back().y});
    return way;
  }
  static Point between(const Point& a, const Point& b, double t) {
    return {a.x + t * (b.x - a.x), a.y + t * (b.y - a.y)};
  }
  static Point turned(const Point& p, double angle) {
    return {p.x * std::cos(angle) - p.y * std::sin(angle), p.x * std::sin(angle) + p.y * std::cos(angle)};
  }
  void go_to(Way& way, Point to) const {
    const Point from = way.back();
    const int n =
        std::max(1, static_cast<int>(std::ceil(std::hypot(to.x - from.x, to.y - from.y) / meeting_.step_h)));
    for (int i = 1; i < n; ++i) way.push_back(between(from, to, static_cast<double>(i) / n));
    way.push_back(to);
  }

  // A closed way, left off short of its end or gone on with by the overlap.
  void loop(Way way, double overlap, bool plunge, std::optional<double> depth = {}) {
    const Way once = way;
    for (std::size_t i = 1; overlap > 0; ++i) {
      const Point &a = once[i - 1], &b = once[i];
      const double l = std::hypot(b.x - a.x, b.y - a.y);
      way.push_back(l <= overlap ? b : between(a, b, overlap / l));
      overlap -= l;
    }
    while (overlap < 0) {
      const Point b = way.back();
      way.pop_back();
      const double l = std::hypot(b.x - way.back().x, b.y - way.back().y);
      if (l > -overlap) way.push_back(between(b, way.back(), -overlap / l));
      overlap += l;
    }
    stroke(way, plunge, depth);
  }

  void begin_stroke() { meeting_.strokes.emplace_back(); }
  void push(core::Pose pose) {
    pose.t_ns = 1'000'000 * ++count_;
    pose.buttons = 1;
    meeting_.strokes.back().push_back(pose);
  }
  // How far before a point the heel is, by the blade's length, where the tip is `depth` h beyond the point; without: well outside of the body at either end, as the blade is straight.
  double heel_before(std::optional<double> depth) const {
    return depth ? meeting_.blade.tip.z - h_ * *depth : 1.2 * size_;
  }
  void stroke(const Way& way, bool plunge = false, std::optional<double> depth = {}) {
    begin_stroke();
    const Vec3 up = -heel_before(depth) * axis_;
    const double out = 1.3 * size_, step = 20 * meeting_.step_h * h_;
    for (double d = out; plunge && d > 0; d -= step)
      push(pose_along(at(way.front()) + up - d * axis_, axis_));
    for (const Point& p : way) push(pose_along(at(p) + up, axis_));
    for (double d = step; plunge && d < out; d += step)
      push(pose_along(at(way.back()) + up - d * axis_, axis_));
  }
  void cone(double overlap) {
    begin_stroke();
    const double beyond = random_.one_of({0.0, 0.5, 2.0}) * h_, slope = random_.uniform(0.3, 0.8);
    meeting_.blade.tip.z = 1.5 * size_;
    const double r = size_ / h_;  // of the heel's way where the overlap counts: half of the blade is inside
    const double turns = 1 + 2 * overlap / (r * slope * kTurn);
    const int n = static_cast<int>(std::ceil(kTurn * r / std::max(meeting_.step_h, 0.1)));
    const double from = turn();
    for (int i = 0; i <= n; ++i) {
      const double angle = from + kTurn * turns * i / n;
      const Vec3 d = normalized(axis_ + slope * (std::cos(angle) * u_ + std::sin(angle) * v_));
      push(pose_along(centre_ + beyond * d - meeting_.blade.tip.z * d, d));
    }
  }
  // Straight, from one point to another, by a blade of its own direction.
  void straight(const Vec3& from, const Vec3& to, const Vec3& direction, std::optional<double> depth = {}) {
    begin_stroke();
    const double way = core::distance(from, to) / h_;
    const int n = std::max(1, static_cast<int>(std::ceil(way / meeting_.step_h)));
    for (int i = 0; i <= n; ++i)
      push(pose_along(core::lerp(from, to, static_cast<double>(i) / n) - heel_before(depth) * direction,
                      direction));
  }
  void straight(const Point& a, const Point& b) { straight(at(a), at(b), axis_); }

  void grid() {
    const std::size_t across[2] = {2 + random_.below(2), 2 + random_.below(2)};
    const double far = size_ / h_, angle = turn();
    for (int way = 0; way < 2; ++way) {
      double x = random_.uniform(-3, 0);
      for (std::size_t i = 0; i < across[way]; ++i, x += random_.uniform(2, 3.5)) {
        const Point a = way == 0 ? Point{x, -far} : Point{-far, x},
                    b = way == 0 ? Point{x, far} : Point{far, x};
        straight(turned(a, angle), turned(b, angle));
      }
    }
  }
  void square(double overlap, std::optional<double> depth = {}) {
    const double angle = turn(), a = radius_h_, e = a + overlap;
    for (const auto& [from, to] :
         {std::pair{Point{-e, -a}, Point{e, -a}}, std::pair{Point{a, -e}, Point{a, e}},
          std::pair{Point{e, a}, Point{-e, a}}, std::pair{Point{-a, e}, Point{-a, -e}}})
      straight(at(turned(from, angle)), at(turned(to, angle)), axis_, depth);
  }
  // Under a lid or a box of the radius: the blade comes in from one side, and its tip ends in the body beyond the other.
  void slit() {
    const double out =
        radius_h_ * (meeting_.kind == "box" ? std::numbers::sqrt2 : 1) + random_.one_of({0.0, 0.5, 1.5});
    const bool flip = random_.below(2) == 0;
    const Vec3 direction = flip ? v_ : u_;
    const Point tip[2] = {flip ? Point{-out, out} : Point{out, -out}, {out, out}};
    straight(at(tip[0]), at(tip[1]), direction, 0);
  }
  // One cut right through, then another that meets it.
  void pair(const std::string& kind, double overlap) {
    const double far = size_ / h_;
    straight(Point{0, -far}, Point{0, far});
    const double angle = (meeting_.along_axes ? 0.25 * static_cast<double>(1 + random_.below(3))
                                              : random_.uniform(0.15, 0.85)) *
                         0.5 * kTurn;
    // At `angle` from the first one's way.
    const Point away{far * std::sin(angle), far * std::cos(angle)};
    const double past = overlap / std::sin(angle) / far;
    const Point end{-past * away.x, -past * away.y};
    if (kind == "ends_in") {
      straight(away, end);
    } else if (kind == "starts_in") {
      straight(end, away);
    } else if (kind == "along") {
      const double beside = random_.uniform(0, 0.2),
                   turn = random_.below(2) == 0 ? 0 : random_.uniform(0, 0.05);
      Point a = turned({beside, -far}, turn), b = turned({beside, far}, turn);
      if (random_.below(2) == 0) std::swap(a, b);
      straight(a, b);
    } else {
      const Vec3 direction = normalized(axis_ + slant() * u_ + slant() * v_);
      const Point back{-away.x, -away.y};
      straight(at(away), at(back), direction);
    }
  }

  double slant() {
    const double s = random_.uniform(-0.7, 0.7);
    return meeting_.along_axes ? 0.5 * std::round(2 * s) : s;
  }

  // From where to where the body is along a direction, in h from the centre, and an element more.
  std::array<double, 2> extent(const Vec3& direction) const {
    std::array<double, 2> out{INFINITY, -INFINITY};
    for (const Vec3& p : mesh_.positions) {
      const double at = core::dot(p - centre_, direction) / h_;
      out = {std::min(out[0], at - 1), std::max(out[1], at + 1)};
    }
    return out;
  }
  // A blade of 0.6 to 3 elements; returns how far below one row the next one is.
  double shorten_blade() {
    const double blade_h = random_.uniform(0.6, 3);
    meeting_.blade.tip.z = blade_h * h_;
    meeting_.overlap_h = random_.one_of({0.0, 0.15, 0.3, 0.5});
    meeting_.step_h = std::max(meeting_.step_h, 0.1);
    return std::max(blade_h - meeting_.overlap_h, 0.3);
  }
  void rows() {
    const double pitch = shorten_blade();
    const auto [left, right] = extent(u_);
    const auto [top, bottom] = extent(axis_);
    const int n = static_cast<int>(std::ceil((right - left) / meeting_.step_h));
    bool back = false;
    if (meeting_.kind == "rows") begin_stroke();
    for (double z = top; z < bottom; z += pitch, back = !back) {
      if (meeting_.kind == "strips") begin_stroke();
      for (int i = 0; i <= n; ++i) {
        const double part = static_cast<double>(back ? n - i : i) / n;
        push(pose_along(at({left + part * (right - left), 0}) + h_ * z * axis_, axis_));
      }
    }
  }
  void helix() {
    const double pitch = shorten_blade();
    const auto [top, bottom] = extent(axis_);
    const int n = around(1, radius_h_);
    const double from = turn();
    begin_stroke();
    for (int i = 0; top + pitch * (i - n) / n < bottom; ++i) {
      const double angle = from + kTurn * i / n;
      push(pose_along(
          at({radius_h_ * std::cos(angle), radius_h_ * std::sin(angle)}) + h_ * (top + pitch * i / n) * axis_,
          axis_));
    }
  }

  Random random_;
  const core::MeshData& mesh_;
  double h_, size_ = 0, radius_h_ = 0;
  Vec3 centre_{}, axis_, u_, v_;
  std::int64_t count_ = 0;
  Meeting meeting_;
};

}  // namespace

Vec3 Random::direction() {
  for (;;) {
    const Vec3 d{uniform(-1, 1), uniform(-1, 1), uniform(-1, 1)};
    const double l = length(d);
    if (l > 0.1 && l < 1) return (1 / l) * d;
  }
}

core::Pose pose_along(const Vec3& heel, const Vec3& direction) {
  // The shortest turn of z to the direction.
  const double w = 1 + direction.z;
  core::Quat q = w > 1e-6 ? core::Quat{w, -direction.y, direction.x, 0} : core::Quat{0, 1, 0, 0};
  const double l = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  core::Pose pose;
  pose.position = heel;
  pose.orientation = {q.w / l, q.x / l, q.y / l, q.z / l};
  return pose;
}

std::string Meeting::name() const {
  char text[160];
  std::snprintf(text, sizeof text, "%s%s, seed %llu, overlap %g h, poses %g h apart, batches of %g h",
                kind.c_str(), along_axes ? " along the axes" : "", static_cast<unsigned long long>(seed),
                overlap_h, step_h, batch_h);
  return text;
}

Meeting random_meeting(const core::MeshData& mesh, double h, std::string_view kind, std::uint64_t seed,
                       bool along_axes) {
  return Maker(mesh, h, kind, seed, along_axes).make();
}

core::CutConfig meeting_config(const Meeting& meeting) {
  core::CutConfig config;
  config.blade = meeting.blade;
  config.speed_limit_m_s = 1e9;
  config.gap_limit_s = 1e9;
  config.batch_h = meeting.batch_h;
  return config;
}

void drain(core::CutSession& session, std::int64_t budget_units) {
  core::Delta delta;
  for (;;) {
    core::WorkBudget budget{budget_units};
    if (session.advance(budget, delta) == core::CutSession::Progress::kIdle) return;
  }
}

void cut(std::span<const core::Pose> stroke, core::CutSession& session, std::int64_t budget_units) {
  for (const core::Pose& pose : stroke) {
    INCISE_CHECK(core::accepted(session.push(0, pose)));
    drain(session, budget_units);
  }
  session.end_stroke(0);
  drain(session, budget_units);
}

void cut(const Meeting& meeting, core::CutSession& session, std::int64_t budget_units) {
  for (const auto& stroke : meeting.strokes) cut(stroke, session, budget_units);
}

std::unique_ptr<core::CutSession> cut_saved(const Meeting& meeting, const core::MeshData& mesh) {
  std::unique_ptr<core::CutSession> session;
  for (const auto& stroke : meeting.strokes) {
    session =
        std::make_unique<core::CutSession>(session ? session->export_data() : mesh, meeting_config(meeting));
    cut(stroke, *session, INT64_MAX);
  }
  return session;
}

void cut_at_once(const Meeting& meeting, core::CutSession& session, std::int64_t budget_units) {
  for (std::size_t first = 0; first < meeting.strokes.size(); first += core::kMaxSources) {
    const auto count = std::min<std::size_t>(meeting.strokes.size() - first, core::kMaxSources);
    const auto strokes = std::span(meeting.strokes).subspan(first, count);
    std::size_t most = 0;
    for (const auto& stroke : strokes) most = std::max(most, stroke.size());
    for (std::size_t i = 0; i < most; ++i) {
      for (std::uint32_t blade = 0; blade < count; ++blade) {
        if (i < strokes[blade].size()) INCISE_CHECK(core::accepted(session.push(blade, strokes[blade][i])));
        drain(session, budget_units);
      }
    }
    for (std::uint32_t blade = 0; blade < count; ++blade) session.end_stroke(blade);
    drain(session, budget_units);
  }
}

std::vector<Stroke> strokes_of(const Meeting& meeting) {
  std::vector<Stroke> all;
  for (const auto& stroke : meeting.strokes) {
    for (Stroke& s : strokes_of(stroke, meeting.blade, meeting_config(meeting))) all.push_back(std::move(s));
  }
  return all;
}

}  // namespace incise::oracle
