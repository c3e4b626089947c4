#include "client/cli/blade_table.hpp"

#include <cinttypes>
#include <cstdio>

#include "protocol/printable.hpp"

namespace incise::client {
namespace {

constexpr std::size_t kNameColumns = 22;

// Padded to its column.
std::string fitted(const std::string& name) {
  std::string text = protocol::printable(name);
  const std::size_t columns = protocol::characters(text);
  if (columns > kNameColumns) return protocol::printable(text, kNameColumns - 2) + "..";
  return text.append(kNameColumns - columns, ' ');
}

}  // namespace

std::string blade_table(const std::vector<protocol::BladeStats>& blades) {
  if (blades.empty()) return {};
  char line[256];  // a name of characters of four bytes
  std::snprintf(line, sizeof line, "%-22s %10s %9s %8s %10s  %s\n", "blade", "poses", "rejected", "strokes",
                "cut faces", "in a stroke");
  std::string table = line;
  for (const protocol::BladeStats& blade : blades) {
    std::snprintf(line, sizeof line, "%s %10" PRIu64 " %9" PRIu64 " %8" PRIu32 " %10" PRIu64 "  %s\n",
                  fitted(blade.name).c_str(), blade.poses, blade.rejected, blade.strokes, blade.cut_faces,
                  blade.in_stroke ? "yes" : "no");
    table += line;
  }
  return table;
}

}  // namespace incise::client
