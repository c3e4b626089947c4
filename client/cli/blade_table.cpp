#include "client/cli/blade_table.hpp"

#include <cinttypes>
#include <cstdio>

#include "client/cli/shown_name.hpp"

namespace incise::client {
namespace {

constexpr std::size_t kNameColumns = 22;

std::string fitted(const std::string& name) {
  const std::string text = printable(name);
  return text.size() <= kNameColumns ? text : text.substr(0, kNameColumns - 2) + "..";
}

}  // namespace

std::string blade_table(const std::vector<protocol::BladeStats>& blades) {
  if (blades.empty()) return {};
  char line[128];
  std::snprintf(line, sizeof line, "%-22s %10s %9s %8s %10s  %s\n", "blade", "poses", "rejected", "strokes",
                "cut faces", "in a stroke");
  std::string table = line;
  for (const protocol::BladeStats& blade : blades) {
    std::snprintf(line, sizeof line, "%-22s %10" PRIu64 " %9" PRIu64 " %8" PRIu32 " %10" PRIu64 "  %s\n",
                  fitted(blade.name).c_str(), blade.poses, blade.rejected, blade.strokes, blade.cut_faces,
                  blade.in_stroke ? "yes" : "no");
    table += line;
  }
  return table;
}

}  // namespace incise::client
