#include "tests/oracle/swept.hpp"

#include <algorithm>
#include <cmath>

namespace incise::oracle {
namespace {

using core::BladeLine;
using core::cross;
using core::distance;
using core::dot;
using core::length;
using core::lerp;
using core::normalized;

struct Box {
  Vec3 low, high;
  bool misses(const Triangle& t) const {
    Vec3 from = t.corners[0], to = from;
    for (const Vec3& p : t.corners) core::extend(p, from, to);
    return to.x < low.x || from.x > high.x || to.y < low.y || from.y > high.y || to.z < low.z ||
           from.z > high.z;
  }
};

int parts_of(double length_m, double size) {
  return static_cast<int>(std::clamp(std::ceil(length_m / size), 1.0, 4096.0));
}

// The ruled quad with these corners in turn, as triangles.
template <class Add>
void ruled(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d, double size, double tolerance,
           const Box& box, Add add) {
  const int columns = parts_of(std::max(distance(a, b), distance(d, c)), size);
  const double twist = 0.25 * length((c - d) - (b - a)) / columns;
  const int rows =
      std::max(parts_of(std::max(distance(a, d), distance(b, c)), size), parts_of(twist, tolerance));
  const auto at = [&](int row, int column) {
    const double s = static_cast<double>(row) / rows, t = static_cast<double>(column) / columns;
    return lerp(lerp(a, b, t), lerp(d, c, t), s);
  };
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const Vec3 p = at(row, column), q = at(row, column + 1), r = at(row + 1, column + 1),
                 s = at(row + 1, column);
      for (const Triangle& t : {Triangle{{p, q, r}}, Triangle{{p, r, s}}}) {
        if (!box.misses(t)) add(t);
      }
    }
  }
}

// The normal of what is swept between two lines, and whether there is any area to speak of.
bool sweeps(const BladeLine& from, const BladeLine& to, Vec3& normal) {
  const Vec3 along = normalized(to.tip - to.heel);
  const Vec3 motion = normalized((to.heel - from.heel) + (to.tip - from.tip));
  const Vec3 n = cross(along, motion);
  if (length(n) < 1e-3) return false;
  normal = normalized(n);
  return true;
}

class Fins {
 public:
  Fins(double size, double reach, const Box& box, const IsNear& is_near, std::vector<Triangle>& out)
      : size_(size), reach_(reach), box_(box), is_near_(is_near), out_(out) {}

  void begin_stroke(std::uint32_t stroke) { stroke_ = stroke; }

  // Along one end's path: `end` is the rim, `other` the blade's other end.
  void path(const Stroke& stroke, Vec3 BladeLine::*end, Vec3 BladeLine::*other) {
    Vec3 last{};
    double travelled = 0;
    for (std::size_t i = 0; i + 1 < stroke.lines.size(); ++i) {
      const BladeLine &from = stroke.lines[i], &to = stroke.lines[i + 1];
      travel_ = travelled;
      travelled += core::travel(from, to);
      const Vec3 &p = from.*end, &q = to.*end;
      const Vec3 cp = normalized(from.*end - from.*other), cq = normalized(to.*end - to.*other);
      quad(p, q, q + reach_ * cq, p + reach_ * cp);
      Vec3 normal = last;
      sweeps(from, to, normal);
      if (dot(normal, last) < 0) normal = -normal;
      for (const double side : {reach_, -reach_}) {
        quad(p, q, q + side * normal, p + side * normal);
        triangle({{p, p + side * last, p + side * normal}});
      }
      last = normal;
    }
  }
  // Along a line at which the sweep begins or ends; `away` leads away from it.
  void line(const BladeLine& at, double travelled, const Vec3& normal, const Vec3& away) {
    travel_ = travelled;
    for (const Vec3& direction : {away, normal, -normal})
      quad(at.heel, at.tip, at.tip + reach_ * direction, at.heel + reach_ * direction);
    const Vec3 along = normalized(at.tip - at.heel);
    triangle({{at.heel, at.heel + reach_ * away, at.heel - reach_ * along}});
    triangle({{at.tip, at.tip + reach_ * away, at.tip + reach_ * along}});
  }

 private:
  // With its first corner on the rim.
  void triangle(const Triangle& t) {
    if (!box_.misses(t) && is_near_(t.corners[0], reach_, stroke_, travel_)) out_.push_back(t);
  }
  // The rim runs from a to b.
  void quad(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
    const int n = parts_of(distance(a, b), size_);
    for (int i = 0; i < n; ++i) {
      const double s = static_cast<double>(i) / n, e = static_cast<double>(i + 1) / n;
      const Vec3 p = lerp(a, b, s), q = lerp(a, b, e), r = lerp(d, c, e), o = lerp(d, c, s);
      const Triangle first{{p, q, r}}, second{{p, r, o}};
      if (box_.misses(first) && box_.misses(second)) continue;
      if (!is_near_(0.5 * (p + q), reach_, stroke_, travel_)) continue;
      out_.push_back(first);
      out_.push_back(second);
    }
  }

  const double size_, reach_;
  const Box& box_;
  const IsNear& is_near_;
  std::vector<Triangle>& out_;
  std::uint32_t stroke_ = 0;
  double travel_ = 0;
};

}  // namespace

std::vector<Stroke> strokes_of(std::span<const core::Pose> poses, const core::Blade& blade,
                               const core::CutConfig& config) {
  std::vector<Stroke> strokes;
  bool cutting = false;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const BladeLine now = core::blade_line(blade, poses[i]);
    const bool engaged = config.always_engaged || (poses[i].buttons & config.engage_buttons) != 0;
    if (cutting) {
      const double dt = 1e-9 * static_cast<double>(poses[i].t_ns - poses[i - 1].t_ns);
      const double step = core::travel(core::blade_line(blade, poses[i - 1]), now);
      if (dt > config.gap_limit_s || step > config.speed_limit_m_s * dt) cutting = false;
    }
    if (cutting) {
      // The motion up to the release still cuts.
      if (core::travel(strokes.back().lines.back(), now) > 0) strokes.back().lines.push_back(now);
      cutting = engaged;
    } else if (engaged) {
      strokes.push_back({{now}});
      cutting = true;
    }
  }
  std::erase_if(strokes, [](const Stroke& s) { return s.lines.size() < 2; });
  return strokes;
}

std::vector<SweptPart> swept_surface(std::span<const Stroke> strokes, double size, double tolerance,
                                     const Vec3& low, const Vec3& high) {
  const Box box{low, high};
  std::vector<SweptPart> parts;
  for (std::uint32_t s = 0; s < strokes.size(); ++s) {
    double travelled = 0;
    const auto& lines = strokes[s].lines;
    for (std::size_t i = 0; i + 1 < lines.size(); ++i) {
      const BladeLine &from = lines[i], &to = lines[i + 1];
      ruled(from.heel, from.tip, to.tip, to.heel, size, tolerance, box, [&](const Triangle& t) {
        parts.push_back({t, s, travelled});
      });
      travelled += core::travel(from, to);
    }
  }
  return parts;
}

std::vector<Triangle> rim_fins(std::span<const Stroke> strokes, double size, double reach, const Vec3& low,
                               const Vec3& high, bool turns, const IsNear& is_near) {
  const Box box{low, high};
  std::vector<Triangle> out;
  Fins fins(size, reach, box, is_near, out);
  for (std::uint32_t s = 0; s < strokes.size(); ++s) {
    const auto& lines = strokes[s].lines;
    fins.begin_stroke(s);
    fins.path(strokes[s], &BladeLine::heel, &BladeLine::tip);
    fins.path(strokes[s], &BladeLine::tip, &BladeLine::heel);
    // Where it first and last sweeps any area.
    Vec3 normal;
    double travelled = 0;
    bool begun = false;
    BladeLine last;
    Vec3 last_normal, last_ahead;
    double last_travel = 0;
    for (std::size_t i = 0; i + 1 < lines.size(); ++i) {
      if (sweeps(lines[i], lines[i + 1], normal)) {
        const Vec3 ahead = normalized(cross(normal, lines[i].tip - lines[i].heel));
        if (!begun) fins.line(lines[i], travelled, normal, -ahead);
        if (turns && begun && dot(ahead, last_ahead) < 0)
          fins.line(lines[i], travelled, last_normal, last_ahead);
        begun = true;
        last_ahead = ahead;
        last = lines[i + 1];
        last_normal = normal;
        last_travel = travelled;
      }
      travelled += core::travel(lines[i], lines[i + 1]);
    }
    if (begun)
      fins.line(last, last_travel, last_normal, normalized(cross(last_normal, last.tip - last.heel)));
  }
  return out;
}

}  // namespace incise::oracle
