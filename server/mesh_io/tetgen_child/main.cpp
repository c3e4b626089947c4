// incise-tetgen: fills one closed surface with tetrahedra, in a process of its own.
//
// TetGen (Hang Si, WIAS Berlin) is under the GNU Affero General Public License, version 3 or later, and so is
// this program, which is linked with it: SPDX-License-Identifier: AGPL-3.0-or-later. The rest of Incise is
// under the Apache License 2.0, does not link TetGen, and only starts this program and exchanges files with
// it.
//
// On bad input TetGen throws an int through frames that cannot be unwound, corrupts the heap, or never ends.
// So it runs here, under limits, and the caller (server/mesh_io/tetgen_fill.cpp) learns the outcome from the
// exit status.

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <tetgen.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "server/mesh_io/tetgen_child/exchange.hpp"

namespace {

using namespace incise::mesh_io;

constexpr const char* kUsage =
    "Usage: incise-tetgen --switches SWITCHES --memory-mb N --cpu-s N INPUT OUTPUT\n"
    "\n"
    "Fills a closed surface with tetrahedra by TetGen. Incise starts it; INPUT and OUTPUT are binary files "
    "in the\n"
    "layout of server/mesh_io/tetgen_child/exchange.hpp.\n"
    "\n"
    "  --switches S   TetGen's switches, for example pYq1.4a1e-9\n"
    "  --memory-mb N  limit of the address space; 0: none\n"
    "  --cpu-s N      limit of the processor time; 0: none\n"
    "\n"
    "This program contains TetGen and is therefore under the GNU Affero General Public License, version 3 or "
    "later\n"
    "(AGPL-3.0-or-later). The rest of Incise is under the Apache License 2.0 and does not link TetGen.\n";

[[noreturn]] void die(const std::string& message) {
  std::fprintf(stderr, "incise-tetgen: %s\n", message.c_str());
  std::exit(2);
}

unsigned long number(const char* text, const char* option) {
  char* end = nullptr;
  const unsigned long value = std::strtoul(text, &end, 10);
  if (*text < '0' || *text > '9' || *end != '\0') die(std::string(option) + " takes a whole number");
  return value;
}

void limit(__rlimit_resource resource, rlim_t value) {
  const rlimit both{value, value};
  if (setrlimit(resource, &both) != 0) die("a resource limit cannot be set");
}

void set_limits(unsigned long memory_mb, unsigned long cpu_s) {
  // Nobody reads the core file of a crash that is expected.
  limit(RLIMIT_CORE, 0);
  if (cpu_s > 0) limit(RLIMIT_CPU, cpu_s);
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // these map terabytes of shadow memory
  if (memory_mb > 0) limit(RLIMIT_AS, static_cast<rlim_t>(memory_mb) << 20);
#endif
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // so that no orphan runs on for minutes
}

template <class T>
void read_values(std::FILE* file, T* values, std::size_t count) {
  if (std::fread(values, sizeof(T), count, file) != count) die("the input is cut short");
}

template <class T>
void write_values(std::FILE* file, const T* values, std::size_t count) {
  if (count > 0 && std::fwrite(values, sizeof(T), count, file) != count) die("the output cannot be written");
}

void read_input(const char* path, tetgenio& io) {
  std::FILE* file = std::fopen(path, "rb");
  if (!file) die("the input cannot be opened");
  FillInputHeader header;
  read_values(file, &header, 1);
  if (std::memcmp(header.magic, kFillInputMagic, sizeof header.magic) != 0) die("the input is not a surface");
  io.firstnumber = 0;
  io.numberofpoints = static_cast<int>(header.points);
  io.pointlist = new double[3 * header.points];
  read_values(file, io.pointlist, 3 * header.points);
  std::vector<std::int32_t> triangles(3 * header.triangles);
  read_values(file, triangles.data(), triangles.size());
  io.numberoffacets = static_cast<int>(header.triangles);
  io.facetlist = new tetgenio::facet[header.triangles];
  io.facetmarkerlist = new int[header.triangles];
  for (std::size_t i = 0; i < header.triangles; ++i) {
    tetgenio::facet& facet = io.facetlist[i];
    tetgenio::init(&facet);
    facet.numberofpolygons = 1;
    facet.polygonlist = new tetgenio::polygon[1];
    facet.polygonlist[0].numberofvertices = 3;
    facet.polygonlist[0].vertexlist = new int[3];
    std::copy_n(triangles.data() + 3 * i, 3, facet.polygonlist[0].vertexlist);
    io.facetmarkerlist[i] = 1;
  }
  io.numberofholes = static_cast<int>(header.holes);
  if (header.holes > 0) io.holelist = new double[3 * header.holes];
  read_values(file, io.holelist, 3 * header.holes);
  io.numberofregions = static_cast<int>(header.regions);
  if (header.regions > 0) io.regionlist = new double[5 * header.regions];
  read_values(file, io.regionlist, 5 * header.regions);
  std::fclose(file);
}

void write_output(const char* path, const tetgenio& io) {
  std::FILE* file = std::fopen(path, "wb");
  if (!file) die("the output cannot be opened");
  FillOutputHeader header;
  std::memcpy(header.magic, kFillOutputMagic, sizeof header.magic);
  header.points = static_cast<std::uint64_t>(io.numberofpoints);
  header.tets = static_cast<std::uint64_t>(io.numberoftetrahedra);
  header.has_regions = io.numberoftetrahedronattributes > 0;
  write_values(file, &header, 1);
  write_values(file, io.pointlist, 3 * header.points);
  for (std::size_t t = 0; t < header.tets; ++t) {
    write_values(file, io.tetrahedronlist + t * static_cast<std::size_t>(io.numberofcorners), 4);
  }
  for (std::size_t t = 0; header.has_regions && t < header.tets; ++t) {
    const double region =
        io.tetrahedronattributelist[t * static_cast<std::size_t>(io.numberoftetrahedronattributes)];
    const auto id = static_cast<std::int32_t>(region);
    write_values(file, &id, 1);
  }
  if (std::fclose(file) != 0) die("the output cannot be written");
}

}  // namespace

int main(int argc, char** argv) {
  std::string switches, input, output;
  unsigned long memory_mb = 0, cpu_s = 0;
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    const bool has_value = i + 1 < argc;
    if (argument == "--help") {
      std::fputs(kUsage, stdout);
      return 0;
    } else if (argument == "--switches" && has_value) {
      switches = argv[++i];
    } else if (argument == "--memory-mb" && has_value) {
      memory_mb = number(argv[++i], "--memory-mb");
    } else if (argument == "--cpu-s" && has_value) {
      cpu_s = number(argv[++i], "--cpu-s");
    } else if (input.empty()) {
      input = argument;
    } else if (output.empty()) {
      output = argument;
    } else {
      die("'" + argument + "' is one argument too many; see --help");
    }
  }
  if (switches.empty() || output.empty()) die("--switches, INPUT and OUTPUT are needed; see --help");
  set_limits(memory_mb, cpu_s);
  // The caller reads TetGen's stages as they come.
  std::setvbuf(stdout, nullptr, _IOLBF, 4096);
  // Never freed: TetGen's destructors could go wrong too, and the process ends here.
  auto& in = *new tetgenio;
  auto& out = *new tetgenio;
  read_input(input.c_str(), in);
  tetrahedralize(switches.data(), &in, &out);
  write_output(output.c_str(), out);
  std::fflush(nullptr);
  _exit(0);
}
