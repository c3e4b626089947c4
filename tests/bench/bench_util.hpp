#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "server/base/clock.hpp"
#include "server/core/cut/cut_config.hpp"
#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/mesh_data.hpp"
#include "server/core/session/cut_session.hpp"

// What the benches share: meshes, repeated timing, percentiles, and a report as tables or as JSON.
namespace incise::bench {

// Seconds of CPU time of each of some repetitions; the first found caches, branch predictors and allocator cold.
struct Timings {
  double cold = 0;
  std::vector<double> warm;  // the others; the first again where there is only one
};

// Times run(x) for a fresh x = prepare() each time; preparing, and letting go of x, does not count.
template <class Prepare, class Run>
Timings time_repeated(int repetitions, Prepare prepare, Run run) {
  Timings timings;
  for (int i = 0; i < repetitions; ++i) {
    auto subject = prepare();
    const double start = thread_cpu_s();
    run(subject);
    const double seconds = thread_cpu_s() - start;
    if (i == 0) timings.cold = seconds;
    if (i > 0 || repetitions == 1) timings.warm.push_back(seconds);
  }
  return timings;
}

// The smallest sample that at least the share p (0 to 1) of all samples do not exceed; p = 1: the largest. 0 where
// there are no samples.
double percentile(std::vector<double> samples, double p);

using Cell = std::variant<std::string, double, std::int64_t>;
struct Column {
  std::string name;
  int decimals = 0;  // of cells that are doubles
};

// Tables as text to read, or as one JSON object: {"bench": name, "facts": {...}, "tables": {title: [row objects]}}.
class Report {
 public:
  bool json = false;

  void begin(std::string bench) { bench_ = std::move(bench); }
  void fact(std::string name, Cell value) { facts_.emplace_back(std::move(name), std::move(value)); }
  void table(std::string title, std::vector<Column> columns);
  // A row of the table begun last, one cell a column.
  void row(std::vector<Cell> cells);
  // Prints everything to stdout; nothing where no bench began.
  void print() const;

 private:
  struct Table {
    std::string title;
    std::vector<Column> columns;
    std::vector<std::vector<Cell>> rows;
  };
  void print_text() const;
  void print_json() const;

  std::string bench_;
  std::vector<std::pair<std::string, Cell>> facts_;
  std::vector<Table> tables_;
};

Cell hex(std::uint64_t hash);
inline Cell count(std::uint64_t n) {
  return static_cast<std::int64_t>(n);
}

struct NamedMesh {
  std::string name;
  core::MeshData mesh;
};
// A mesh file or surface (mesh_io::load_mesh); coordinates times `scale` are metres. Warnings go to stderr.
NamedMesh load(const std::string& path, double scale);
// The phantom "liver", "cylinder" or "slab" with about `tets` tetrahedra.
NamedMesh phantom(const std::string& kind, std::size_t tets);
// The corners of a mesh's bounding box.
std::pair<core::Vec3, core::Vec3> bounds(const core::MeshData& mesh);
// The folder of real meshes that the environment variable INCISE_DATA names; empty without.
std::string data_folder();

// A cut right through a mesh by a straight sweep: the plane through the middle of its bounding box with the given
// normal, swept by a blade longer than the body.
struct ThroughCut {
  core::BladeLine from, to;
};
ThroughCut through_cut(const core::MeshData& mesh, const core::Vec3& normal);
// The session with that cut pushed as `segments` equal ones, to be advanced.
void push(core::CutSession& session, const ThroughCut& cut, int segments);
// A configuration whose stroke rules no bench's motion runs into.
core::CutConfig bench_config(core::Policy policy);

// What a session did over all its batches.
struct SessionTotals {
  std::uint32_t batches = 0;
  core::CutCounts counts;
  std::int64_t work_units = 0;
};
// Works until nothing waits.
SessionTotals run_all(core::CutSession& session);

}  // namespace incise::bench
