#include "server/app/offline/feel_plot.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <set>

namespace incise::app {
namespace {

// Pixels.
constexpr double kWidth = 760, kHeight = 400, kLeft = 64, kRight = 742, kTop = 44, kBottom = 344;
constexpr double kLetter = 6.3, kRow = 20;  // the mean width of a letter; a row of the legend

// The colours of Okabe and Ito, which most colour-blind readers can tell apart.
constexpr const char* kStyle =
    "text{font:13px Helvetica,Arial,sans-serif;fill:#1a1a1a}\n"
    ".tick{font-size:12px;fill:#555}\n"
    "path{fill:none;stroke-linejoin:round}\n"
    ".page{fill:#fff}.engaged{fill:#f0f2f5}.inside{fill:#d9e4f1}\n"
    ".grid{stroke:#888;stroke-opacity:.3;stroke-width:.8}.axis{stroke:#555;stroke-width:1}\n"
    ".force{stroke:#1a1a1a;stroke-width:1.7}.tissue{stroke:#666;stroke-width:1;stroke-dasharray:4 3}\n"
    ".part{stroke-width:1.1}.x{stroke:#d55e00}.y{stroke:#009e73}.z{stroke:#2b8fd0}.mark{fill:#d55e00}\n"
    ".blade{stroke-width:1.5}.s0{stroke:#2b8fd0}.s1{stroke:#d55e00}.s2{stroke:#009e73}.s3{stroke:#cc79a7}\n"
    ".s4{stroke:#c98b00}.s5{stroke:#7a6fd0}.s6{stroke:#8c6d31}.s7{stroke:#808080}\n"
    "@media(prefers-color-scheme:dark){\n"
    "text{fill:#f0f0f0}.tick{fill:#b5b5b5}.axis{stroke:#b5b5b5}.force{stroke:#f0f0f0}.tissue{stroke:#aaa}\n"
    ".page{fill:#15181c}.engaged{fill:#1d232a}.inside{fill:#273a50}}\n";

std::string number(double value, int digits) {
  char text[48];
  std::snprintf(text, sizeof text, "%.*f", digits, value);
  std::string out = text;
  if (out.find_first_not_of("-0.") == std::string::npos && out.front() == '-') out.erase(0, 1);
  return out;
}

// Pixels, to a tenth.
std::string px(double value) {
  std::string text = number(value, 1);
  if (text.ends_with(".0")) text.erase(text.size() - 2);
  return text;
}

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '&') {
      out += "&amp;";
    } else if (c == '<') {
      out += "&lt;";
    } else if (c == '>') {
      out += "&gt;";
    } else {
      out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
    }
  }
  return out;
}

// 1, 2 or 5 times a power of ten, so that about `count` steps make `span`.
double nice_step(double span, int count) {
  const double raw = span / count, power = std::pow(10, std::floor(std::log10(raw)));
  for (const double times : {1.0, 2.0, 5.0}) {
    if (raw <= times * power * (1 + 1e-9)) return times * power;
  }
  return 10 * power;
}

double seconds(std::int64_t ns) {
  return static_cast<double>(ns) * 1e-9;
}

class Figure {
 public:
  Figure(const std::vector<FeltPose>& poses, const std::vector<std::string>& names)
      : poses_(poses), names_(names) {
    std::size_t limited = 0;
    for (const FeltPose& pose : poses) {
      sources_.insert(pose.source);
      limited += pose.limited && length(pose.tissue - pose.hand) > 1e-3;
    }
    // For a pixel's width at least.
    limited_ =
        limited > 0 && static_cast<double>(limited) * (kRight - kLeft) >= static_cast<double>(poses.size());
    find_ranges();
  }

  std::string text() {
    shade();
    axes();
    curves();
    punctures();
    axis_names();
    const double above = kRow * key_row_, height = kHeight + above;
    const std::string box = "width=\"" + px(kWidth) + "\" height=\"" + px(height) + "\"";
    return "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 " + px(-above) + " " + px(kWidth) + " " +
           px(height) + "\" " + box +
           " role=\"img\">\n<title>Force on the hand over time</title>\n<style>\n" + kStyle +
           "</style>\n<rect class=\"page\" y=\"" + px(-above) + "\" " + box + "/>\n" + body_ +
           "<g transform=\"translate(0 " + px(-above) + ")\">\n" + keys_ + "</g>\n</svg>\n";
  }

 private:
  using Value = std::function<double(const FeltPose&)>;
  using Test = std::function<bool(const FeltPose&)>;

  bool single() const { return sources_.size() <= 1; }
  double x(std::int64_t ns) const { return kLeft + (kRight - kLeft) * seconds(ns) / duration_s_; }
  double y(double newtons) const { return kBottom - (kBottom - kTop) * (newtons - low_) / (high_ - low_); }

  void find_ranges() {
    for (const FeltPose& pose : poses_) {
      duration_s_ = std::max(duration_s_, seconds(pose.time_ns));
      high_ = std::max({high_, length(pose.hand), limited_ && single() ? length(pose.tissue) : 0});
      if (single()) low_ = std::min({low_, pose.hand.x, pose.hand.y, pose.hand.z});
    }
    if (!(duration_s_ > 0)) duration_s_ = 1;
    if (!(high_ - low_ > 1e-9)) high_ = 1;
    step_ = nice_step(high_ - low_, 6);
    high_ = step_ * std::ceil(high_ / step_ - 1e-9);
    low_ = step_ * std::floor(low_ / step_ + 1e-9);
  }

  void text_at(double at_x, double at_y, const char* more, const std::string& words) {
    body_ += "<text x=\"" + px(at_x) + "\" y=\"" + px(at_y) + "\" " + more + ">" + words + "</text>\n";
  }

  // Adds an entry to the legend: `shape` is drawn in a box of 22 x 10 pixels.
  void key(const std::string& shape, const std::string& words) {
    const double width = 28 + kLetter * static_cast<double>(words.size());
    if (key_x_ > kLeft && key_x_ + width > kRight) {
      key_x_ = kLeft;
      ++key_row_;
    }
    keys_ += "<g transform=\"translate(" + px(key_x_) + " " + px(16 + kRow * key_row_) + ")\">" + shape +
             "<text x=\"28\" y=\"9\">" + escaped(words) + "</text></g>\n";
    key_x_ += width + 18;
  }
  void line_key(const std::string& style, const std::string& words) {
    key("<path class=\"" + style + "\" d=\"M0 5H22\"/>", words);
  }

  // Shades the times at which `test` holds, up to the next pose of that source. Returns whether there are any.
  bool shade(const std::string& style, const Test& test) {
    std::vector<std::pair<double, double>> spans;  // pixels
    for (const std::uint32_t source : sources_) {
      const FeltPose* before = nullptr;
      for (const FeltPose& pose : poses_) {
        if (pose.source != source) continue;
        if (before && test(*before)) spans.emplace_back(x(before->time_ns), x(pose.time_ns));
        before = &pose;
      }
    }
    std::sort(spans.begin(), spans.end());
    for (std::size_t i = 0; i < spans.size();) {
      auto [from, to] = spans[i];
      for (++i; i < spans.size() && spans[i].first < to + 0.5; ++i) to = std::max(to, spans[i].second);
      body_ += "<rect class=\"" + style + "\" x=\"" + px(from) + "\" y=\"" + px(kTop) + "\" width=\"" +
               px(std::max(to - from, 0.5)) + "\" height=\"" + px(kBottom - kTop) + "\"/>\n";
    }
    return !spans.empty();
  }

  void shade() {
    const Test engaged = [](const FeltPose& pose) { return pose.engaged; };
    const auto box = [](const char* style) {
      return "<rect class=\"" + std::string(style) + "\" width=\"22\" height=\"10\"/>";
    };
    // A blade that is engaged all the time shows nothing by it.
    shows_engaged_ = !std::all_of(poses_.begin(), poses_.end(), engaged) && shade("engaged", engaged);
    shows_inside_ = shade("inside", [](const FeltPose& pose) { return pose.inside; });
    if (single()) {
      line_key("force", "|F|");
      if (limited_) line_key("tissue", "|F| without limits");
      for (const char* part : {"x", "y", "z"}) line_key(std::string("part ") + part, std::string("F") + part);
    } else {
      for (const std::uint32_t source : sources_) line_key(blade_style(source), names_[source]);
    }
    if (shows_engaged_) key(box("engaged"), "engaged");
    if (shows_inside_) key(box("inside"), "inside");
  }

  void axes() {
    const int digits = std::max(0, static_cast<int>(-std::floor(std::log10(step_) + 1e-9)));
    for (int i = 0; low_ + i * step_ <= high_ + 1e-9 * step_; ++i) {
      const double newtons = low_ + i * step_;
      grid_line(kLeft, y(newtons), kRight, y(newtons));
      text_at(kLeft - 8, y(newtons) + 4, "class=\"tick\" text-anchor=\"end\"", tick(newtons, digits));
    }
    const double step_s = nice_step(duration_s_, 8);
    const int time_digits = std::max(0, static_cast<int>(-std::floor(std::log10(step_s) + 1e-9)));
    for (int i = 0; i * step_s <= duration_s_ * (1 + 1e-9); ++i) {
      const double at = kLeft + (kRight - kLeft) * i * step_s / duration_s_;
      grid_line(at, kTop, at, kBottom);
      text_at(at, kBottom + 18, "class=\"tick\" text-anchor=\"middle\"", tick(i * step_s, time_digits));
    }
    body_ += "<path class=\"axis\" d=\"M" + px(kLeft) + " " + px(kTop) + "V" + px(kBottom) + "H" +
             px(kRight) + "M" + px(kLeft) + " " + px(y(0)) + "H" + px(kRight) + "\"/>\n";
  }
  static std::string tick(double value, int digits) {
    std::string text = number(value, digits);
    if (text.front() == '-') text.replace(0, 1, "\u2212");
    return text;
  }
  void grid_line(double x1, double y1, double x2, double y2) {
    body_ += "<path class=\"grid\" d=\"M" + px(x1) + " " + px(y1) + "L" + px(x2) + " " + px(y2) + "\"/>\n";
  }

  void axis_names() {
    text_at((kLeft + kRight) / 2, kBottom + 42, "text-anchor=\"middle\"", "Time (s)");
    text_at(
        0, 0,
        ("text-anchor=\"middle\" transform=\"translate(18 " + px((kTop + kBottom) / 2) + ") rotate(-90)\"")
            .c_str(),
        "Force on the hand (N)");
  }

  static std::string blade_style(std::uint32_t source) { return "blade s" + std::to_string(source % 8); }

  void curves() {
    if (!single()) {
      for (const std::uint32_t source : sources_)
        curve(blade_style(source), source, [](const FeltPose& p) { return length(p.hand); });
      return;
    }
    const std::uint32_t source = sources_.empty() ? 0 : *sources_.begin();
    curve("part x", source, [](const FeltPose& p) { return p.hand.x; });
    curve("part y", source, [](const FeltPose& p) { return p.hand.y; });
    curve("part z", source, [](const FeltPose& p) { return p.hand.z; });
    if (limited_) curve("tissue", source, [](const FeltPose& p) { return length(p.tissue); });
    curve("force", source, [](const FeltPose& p) { return length(p.hand); });
  }

  // Of all values in one pixel's width the first, the least, the largest and the last are drawn, in their order.
  void curve(const std::string& style, std::uint32_t source, const Value& value) {
    struct Point {
      double x, y;
      bool jumped;
    };
    std::vector<Point> column, drawn;
    const auto flush = [&] {
      const auto [low, high] = std::minmax_element(column.begin(), column.end(),
                                                   [](const Point& a, const Point& b) { return a.y < b.y; });
      const std::set<std::size_t> keep{0, static_cast<std::size_t>(low - column.begin()),
                                       static_cast<std::size_t>(high - column.begin()), column.size() - 1};
      for (const std::size_t i : keep) drawn.push_back(column[i]);
      column.clear();
    };
    for (const FeltPose& pose : poses_) {
      if (pose.source != source) continue;
      const Point point{x(pose.time_ns), y(value(pose)), pose.jumped};
      if (!column.empty() && (point.jumped || std::floor(point.x) != std::floor(column.front().x))) flush();
      column.push_back(point);
    }
    if (!column.empty()) flush();
    std::string d;
    for (const Point& point : drawn)
      d += (d.empty() || point.jumped ? "M" : "L") + px(point.x) + " " + px(point.y);
    if (!d.empty()) body_ += "<path class=\"" + style + "\" d=\"" + d + "\"/>\n";
  }

  void punctures() {
    bool any = false;
    double last_x = -1e9;
    for (const FeltPose& pose : poses_) {
      const double at = x(pose.time_ns);
      if (!pose.entered || at < last_x + 1) continue;
      last_x = at;
      any = true;
      body_ += "<path class=\"mark\" d=\"M" + px(at) + " " + px(kTop + 8) + "l-4.5 -8h9z\"/>\n";
    }
    if (any) key("<path class=\"mark\" d=\"M11 9l-4.5 -8h9z\"/>", "puncture");
  }

  const std::vector<FeltPose>& poses_;
  const std::vector<std::string>& names_;
  std::set<std::uint32_t> sources_;
  bool limited_ = false;  // somewhere, so that it can be seen
  bool shows_engaged_ = false, shows_inside_ = false;
  double duration_s_ = 0, low_ = 0, high_ = 0, step_ = 1;
  double key_x_ = kLeft;
  int key_row_ = 0;
  std::string body_, keys_;
};

}  // namespace

std::string force_plot(const std::vector<FeltPose>& poses, const std::vector<std::string>& names) {
  return Figure(poses, names).text();
}

}  // namespace incise::app
