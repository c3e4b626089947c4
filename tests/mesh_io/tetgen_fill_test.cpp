#include "server/mesh_io/tetgen_fill.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <map>

#include "server/core/geometry/quality.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/phantom.hpp"
#include "server/mesh_io/tet_repair.hpp"
#include "server/mesh_io/tetgen_process.hpp"
#include "tests/mesh_io/test_meshes.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;

ClosedSurface closed(const Surface& surface) {
  std::vector<std::string> warnings;
  return check_surface(surface, "FILE", warnings);
}

FillOptions uncached(std::size_t target = 2000) {
  FillOptions options;
  options.use_cache = false;
  options.target_tets = target;
  return options;
}

Fill fill(const Surface& surface, const FillOptions& options) {
  std::vector<std::string> warnings;
  return fill_surface(closed(surface), "FILE", options, warnings);
}

double volume_of(const core::MeshData& mesh, std::int32_t region = -1) {
  double volume = 0;
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) {
    const auto& v = mesh.tets[t];
    if (region >= 0 && mesh.regions[t] != region) continue;
    volume += core::signed_volume(mesh.positions[v[0]], mesh.positions[v[1]], mesh.positions[v[2]],
                                  mesh.positions[v[3]]);
  }
  return volume;
}

void expect_valid(core::MeshData mesh) {
  std::vector<std::string> warnings;
  repair_tets(mesh, "FILE", 0, warnings);
  EXPECT_TRUE(warnings.empty()) << warnings[0];
  EXPECT_EQ(core::validate(core::TetMesh(mesh)), "");
}

#define EXPECT_SAYS(text, part) EXPECT_NE((text).find(part), std::string::npos) << (text)

TEST(TetgenFill, CubeIsFilledToTheTarget) {
  for (const std::size_t target : {300u, 5000u, 40000u}) {
    const Fill filled = fill(cube(), uncached(target));
    EXPECT_NEAR(static_cast<double>(filled.mesh.tets.size()) / static_cast<double>(target), 1, 0.25)
        << target;
    EXPECT_NEAR(volume_of(filled.mesh), 1, 1e-9);
    EXPECT_FALSE(filled.from_cache);
    expect_valid(filled.mesh);
  }
}

// With Y TetGen adds no vertex to the surface, and next to large triangles none inside: they are split first.
TEST(TetgenFill, OnlyTrianglesTooLargeForTheTargetAreSplit) {
  std::vector<std::string> warnings;
  const Fill fine = fill_surface(closed(cube()), "FILE", uncached(5000), warnings);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_SAYS(warnings[0],
              "FILE: triangles too large for 5000 tetrahedra are split: the surface's 12 become ");
  EXPECT_NEAR(volume_of(fine.mesh), 1, 1e-9);
  const Surface phantom = make_phantom_surface(PhantomKind::kSlab, 5000);
  warnings.clear();
  const Fill kept = fill_surface(closed(phantom), "FILE", uncached(5000), warnings);
  EXPECT_TRUE(warnings.empty()) << warnings[0];
  EXPECT_EQ(boundary_surface(kept.mesh.positions, kept.mesh.tets).triangles.size(), phantom.triangles.size());
  // Twelve times as many would fit beneath these triangles as well, as slivers.
  const Fill finer = fill_surface(closed(phantom), "FILE", uncached(60'000), warnings);
  EXPECT_EQ(warnings.size(), 1u);
  const Surface boundary = boundary_surface(finer.mesh.positions, finer.mesh.tets);
  double longest = 0;
  for (const auto& t : boundary.triangles) {
    for (std::size_t i = 0; i < 3; ++i) {
      const core::Vec3& a = boundary.positions[t[i]];
      longest = std::max(longest, core::length(boundary.positions[t[(i + 1) % 3]] - a));
    }
  }
  EXPECT_LT(longest, 2.01 * std::cbrt(6 * std::sqrt(2.0) * volume_of(finer.mesh) / 60'000));
}

TEST(TetgenFill, AnySizeOfBody) {
  for (const double side : {1e-4, 0.1, 1e5}) {
    const Fill filled = fill(cube({0, 0, 0}, side), uncached());
    EXPECT_NEAR(static_cast<double>(filled.mesh.tets.size()) / 2000, 1, 0.25) << side;
  }
}

TEST(TetgenFill, CavityIsLeftEmpty) {
  const Fill filled = fill(both(cube({0, 0, 0}, 3), inside_out(cube({1, 1, 1}))), uncached());
  EXPECT_NEAR(volume_of(filled.mesh), 26, 1e-6);
  expect_valid(filled.mesh);
}

TEST(TetgenFill, InclusionHasARegionOfItsOwn) {
  const Fill filled = fill(both(cube({0, 0, 0}, 3), cube({1, 1, 1})), uncached());
  ASSERT_EQ(filled.mesh.regions.size(), filled.mesh.tets.size());
  EXPECT_NEAR(volume_of(filled.mesh, 0), 26, 1e-6);
  EXPECT_NEAR(volume_of(filled.mesh, 1), 1, 1e-6);
  expect_valid(filled.mesh);
}

TEST(TetgenFill, SeparateBodiesAreBothFilled) {
  EXPECT_NEAR(volume_of(fill(both(cube(), cube({2, 0, 0})), uncached()).mesh), 2, 1e-9);
}

TEST(TetgenFill, BoundOfTheSwitchesIsKept) {
  FillOptions options = uncached(1'000'000);
  options.tetgen_switches = "pYq1.4a0.01";
  std::vector<std::string> warnings;
  const Fill filled = fill_surface(closed(cube()), "FILE", options, warnings);
  EXPECT_TRUE(warnings.empty());
  EXPECT_LT(filled.mesh.tets.size(), 2000u);
  options.target_tets = 0;
  options.tetgen_switches = "pY";
  EXPECT_LT(fill(cube(), options).mesh.tets.size(), 20u);
}

TEST(TetgenFill, TooFineASurfaceIsSaid) {
  const Surface surface = make_phantom_surface(PhantomKind::kSlab, 20'000);
  std::vector<std::string> warnings;
  const Fill filled = fill_surface(closed(surface), "FILE", uncached(500), warnings);
  EXPECT_GT(filled.mesh.tets.size(), 2000u);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_SAYS(warnings[0], "tetrahedra instead of the 500 wanted: the surface's triangles are too fine");
}

TEST(TetgenFill, SwitchesThatCannotBeUsed) {
  for (const char* switches : {"", "Yq1.4", "prq1.4", "pY; rm", "p Y", "pY\n"}) {
    FillOptions options = uncached();
    options.tetgen_switches = switches;
    EXPECT_SAYS(error_of([&] { fill(cube(), options); }), "the TetGen switches '") << switches;
  }
  // The convex hull is not the body.
  FillOptions options = uncached();
  options.tetgen_switches = "pcY";
  const Surface two = both(cube(), cube({2, 0, 0}));
  EXPECT_SAYS(error_of([&] { fill(two, options); }), "filled 2.99999");
}

TEST(TetgenFill, StagesAreReported) {
  FillOptions options = uncached();
  std::vector<std::string> stages;
  options.progress = [&stages](std::string_view stage, double seconds) {
    EXPECT_GE(seconds, 0);
    stages.emplace_back(stage);
  };
  fill(cube(), options);
  EXPECT_NE(std::find(stages.begin(), stages.end(), "recovering boundaries"), stages.end());
  EXPECT_NE(std::find(stages.begin(), stages.end(), "refining mesh"), stages.end());
}

// ------------------------------------------------------------------------------------------- a child that
// fails

std::string error_with_child(const std::string& script,
                             std::chrono::milliseconds limit = std::chrono::seconds(60)) {
  const TestDirectory directory;
  const auto program = directory.write("tetgen.sh", "#!/bin/sh\n" + script);
  std::filesystem::permissions(program, std::filesystem::perms::owner_all);
  const ScopedVariable variable("INCISE_TETGEN", program.string());
  FillOptions options = uncached();
  options.time_limit = limit;
  return error_of([&] { fill(cube(), options); });
}

TEST(TetgenFill, ChildThatDies) {
  const std::string error =
      error_with_child("echo 'Recovering boundaries...'\necho 'something bad'\nkill -SEGV $$\n");
  EXPECT_SAYS(error, "FILE: TetGen (switches pYq1.4a");
  EXPECT_SAYS(error,
              "died of signal 11 (Segmentation fault), while recovering boundaries, saying 'something bad'");
}

TEST(TetgenFill, ChildThatFails) {
  EXPECT_SAYS(error_with_child("echo oops >&2; exit 3\n"), "failed with exit code 3, saying 'oops'");
}

TEST(TetgenFill, ChildThatNeverEnds) {
  using std::chrono::milliseconds;
  EXPECT_SAYS(error_with_child("echo 'Refining mesh...'\nexec sleep 1000\n", milliseconds(300)),
              "was stopped after 0.3 s, while refining mesh");
  // Also where it closes its output, or floods it.
  EXPECT_SAYS(error_with_child("exec sleep 1000 >/dev/null 2>&1\n", milliseconds(300)), "was stopped after");
  EXPECT_SAYS(error_with_child("exec yes\n", milliseconds(300)), "was stopped after");
}

// A signal that ends this process, even SIGKILL, leaves nothing of the surface on the disk where nothing is.
TEST(TetgenFill, NothingIsOnTheDiskMeanwhile) {
  const TestDirectory temporary;
  const ScopedVariable variable("TMPDIR", (temporary / "").string());
  EXPECT_SAYS(
      error_with_child("[ -s \"$7\" ] && echo \"$(ls -A \"$TMPDIR\" | grep -c incise-fill) on the disk, "
                       "$(readlink \"$7\" \"$8\" | grep -c memfd) in memory\"\nexit 3\n"),
      "failed with exit code 3, saying '0 on the disk, 2 in memory'");
}

TEST(TetgenFill, ChildThatLeavesNothing) {
  EXPECT_SAYS(error_with_child("exit 0\n"), "left no readable result");
  EXPECT_SAYS(error_with_child("for last; do :; done\necho rubbish > \"$last\"\n"),
              "left no readable result");
}

TEST(TetgenFill, ChildThatFindsNoVolume) {
  const TestDirectory directory;
  std::string empty("INCTETS1");
  empty.resize(empty.size() + 24);
  const auto result = directory.write("empty", empty);
  EXPECT_SAYS(error_with_child("for last; do :; done\ncp '" + result.string() + "' \"$last\"\n"),
              "found no volume to fill");
}

TEST(TetgenFill, ChildThatIsNotThere) {
  const ScopedVariable variable("INCISE_TETGEN", "/nowhere/incise-tetgen");
  EXPECT_SAYS(error_of([] { fill(cube(), uncached()); }),
              "the program '/nowhere/incise-tetgen' that fills surfaces cannot be started: No such file");
}

// The real TetGen on surfaces that check_surface would refuse: it must never take this process with it.
TEST(TetgenFill, RealTetgenOnBadSurfaces) {
  ClosedSurface crossing;
  crossing.surface = both(cube(), cube({0.5, 0.4, 0.3}));
  crossing.volume = 2;
  ClosedSurface open;
  open.surface = cube();
  open.surface.triangles.resize(9);
  open.volume = 1;
  std::vector<std::string> warnings;
  for (const ClosedSurface* bad : {&crossing, &open}) {
    EXPECT_SAYS(error_of([&] { fill_surface(*bad, "FILE", uncached(), warnings); }),
                "FILE: TetGen (switches ");
  }
}

TEST(TetgenFill, MemoryLimit) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "sanitizers map terabytes: the child sets no limit then";
#endif
  FillOptions options = uncached(300'000);
  options.memory_limit_mb = 40;
  EXPECT_SAYS(error_of([&] { fill(cube(), options); }), "FILE: TetGen (switches ");
}

TEST(TetgenFill, TimeLimitOfTheRealChild) {
  FillOptions options = uncached(4'000'000);
  // In one millisecond some machines run the first attempt, whose result is then as good as can be had.
  options.time_limit = std::chrono::milliseconds(0);
  EXPECT_SAYS(error_of([&] { fill(cube(), options); }), "was stopped after 0 s");
}

TEST(TetgenFill, ChildExplainsItself) {
  const TestDirectory directory;
  const std::string help = (directory / "help").string();
  ASSERT_EQ(std::system(("'" + tetgen_program() + "' --help > '" + help + "'").c_str()), 0);
  std::ifstream in(help);
  const std::string text((std::istreambuf_iterator<char>(in)), {});
  EXPECT_SAYS(text, "AGPL-3.0-or-later");
  for (const char* arguments : {"", "--switches pY", "--switches pY --memory-mb x a b", "--switches pY a b c",
                                "--switches pY /nowhere/in /nowhere/out"}) {
    EXPECT_NE(std::system(("'" + tetgen_program() + "' " + arguments + " 2>/dev/null").c_str()), 0)
        << arguments;
  }
}

// ---------------------------------------------------------------------------------------------------- the
// cache

class FillCache : public ::testing::Test {
 protected:
  FillCache() {
    options_.target_tets = 2000;
    options_.cache_dir = directory_ / "cache";
  }
  std::vector<std::filesystem::path> entries() const {
    std::vector<std::filesystem::path> found;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(options_.cache_dir)) {
      if (entry.is_regular_file()) found.push_back(entry.path());
    }
    return found;
  }

  TestDirectory directory_;
  FillOptions options_;
};

TEST_F(FillCache, SecondFillComesFromTheCache) {
  std::vector<std::string> warnings, warnings_again;
  const Fill first = fill_surface(closed(cube()), "FILE", options_, warnings);
  const ScopedVariable variable("INCISE_TETGEN", "/nowhere");  // the second needs no TetGen
  const Fill second = fill_surface(closed(cube()), "FILE", options_, warnings_again);
  ASSERT_FALSE(warnings.empty());
  EXPECT_SAYS(warnings.front(), "triangles too large for 2000 tetrahedra are split: the surface's ");
  EXPECT_EQ(warnings_again, warnings);
  EXPECT_FALSE(first.from_cache);
  EXPECT_TRUE(second.from_cache);
  EXPECT_EQ(mesh_hash(first.mesh), mesh_hash(second.mesh));
  EXPECT_EQ(entries().size(), 1u);
}

TEST_F(FillCache, OtherSurfaceSwitchesOrTargetIsAnotherEntry) {
  fill(cube(), options_);
  EXPECT_FALSE(fill(cube({0, 0, 1e-9}), options_).from_cache);
  options_.target_tets = 2001;
  EXPECT_FALSE(fill(cube(), options_).from_cache);
  options_.tetgen_switches = "pYq1.3";
  EXPECT_FALSE(fill(cube(), options_).from_cache);
  EXPECT_EQ(entries().size(), 4u);
}

TEST_F(FillCache, CorruptEntriesAreMadeAnew) {
  const std::string good = mesh_hash(fill(cube(), options_).mesh);
  const auto entry = entries().at(0);
  const auto size = std::filesystem::file_size(entry);
  const auto damage = [&](std::uintmax_t at) {
    std::fstream file(entry, std::ios::binary | std::ios::in | std::ios::out);
    file.seekg(static_cast<std::streamoff>(at));
    const char byte = static_cast<char>(file.get() ^ 1);
    file.seekp(static_cast<std::streamoff>(at));
    file.put(byte);
  };
  for (const auto at : {std::uintmax_t{0}, std::uintmax_t{9}, size / 2, size - 1}) {
    damage(at);
    const Fill again = fill(cube(), options_);
    EXPECT_FALSE(again.from_cache) << at;
    EXPECT_EQ(mesh_hash(again.mesh), good);
    EXPECT_TRUE(fill(cube(), options_).from_cache) << at;
  }
  for (const auto length : {std::uintmax_t{0}, std::uintmax_t{10}, size - 1}) {
    std::filesystem::resize_file(entry, length);
    EXPECT_FALSE(fill(cube(), options_).from_cache) << length;
    EXPECT_TRUE(fill(cube(), options_).from_cache) << length;
  }
}

TEST_F(FillCache, PlaceThatCannotBeWrittenIsAWarning) {
  directory_.write("file", "x");
  options_.cache_dir = directory_ / "file/below";
  std::vector<std::string> warnings;
  const Fill filled = fill_surface(closed(cube()), "FILE", options_, warnings);
  EXPECT_GT(filled.mesh.tets.size(), 1000u);
  ASSERT_FALSE(warnings.empty());
  EXPECT_SAYS(warnings.back(), "the fill is not kept for the next start");
}

TEST_F(FillCache, DefaultPlaceFollowsTheEnvironment) {
  options_.cache_dir.clear();
  const ScopedVariable variable("XDG_CACHE_HOME", (directory_ / "xdg").string());
  fill(cube(), options_);
  EXPECT_TRUE(std::filesystem::exists(directory_ / "xdg/incise/fills"));
}

TEST_F(FillCache, LoadedSurfaceSaysWhereItCameFrom) {
  write_surface(directory_ / "cube.off", cube());
  LoadOptions options;
  options.fill = options_;
  const LoadedMesh first = load_mesh(directory_ / "cube.off", options);
  const LoadedMesh second = load_mesh(directory_ / "cube.off", options);
  EXPECT_TRUE(first.filled);
  EXPECT_FALSE(first.from_cache);
  EXPECT_TRUE(second.from_cache);
  EXPECT_EQ(first.content_hash, second.content_hash);
  EXPECT_EQ(first.content_hash.size(), 64u);
}

}  // namespace
}  // namespace incise::mesh_io
