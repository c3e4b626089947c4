#include "server/stream/static_files.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

namespace incise::stream {
namespace {

namespace fs = std::filesystem;

class StaticFilesTest : public ::testing::Test {
 protected:
  StaticFilesTest() {
    fs::create_directories(root / "assets");
    fs::create_directories(base / "site-secret");
    write(root / "index.html", "<p>");
    write(root / "a b.txt", "x");
    write(root / "assets" / "app-1a2b.js", "js");
    write(base / "secret.txt", "secret");
    write(base / "site-secret" / "index.html", "secret");
    fs::create_directories(root / ".git");
    write(root / ".git" / "config", "secret");
    write(root / ".hidden", "secret");
    fs::create_symlink(root / ".hidden", root / "unhidden.txt");
    fs::create_symlink(root / "index.html", root / ".page.html");
    fs::create_symlink(base / "secret.txt", root / "link.txt");
    fs::create_symlink(root / "index.html", root / "inside.html");
  }
  ~StaticFilesTest() override { fs::remove_all(base); }
  static void write(const fs::path& path, const std::string& text) { std::ofstream(path) << text; }

  fs::path base = fs::temp_directory_path() / ("incise_static_" + std::to_string(::getpid()));
  fs::path root = base / "site";
};

TEST_F(StaticFilesTest, FindsFilesWithTheirTypes) {
  const StaticFiles files(root);
  ASSERT_TRUE(files.find("/"));
  EXPECT_EQ(files.find("/")->mime_type, "text/html; charset=utf-8");
  EXPECT_EQ(files.find("/")->cache_control, "no-cache");
  ASSERT_TRUE(files.find("/index.html?x=1#y"));
  ASSERT_TRUE(files.find("/a%20b.txt"));
  EXPECT_EQ(files.find("/a%20b.txt")->mime_type, "text/plain; charset=utf-8");
  ASSERT_TRUE(files.find("/assets/app-1a2b.js"));
  EXPECT_EQ(files.find("/assets/app-1a2b.js")->mime_type, "text/javascript; charset=utf-8");
  EXPECT_NE(files.find("/assets/app-1a2b.js")->cache_control.find("immutable"), std::string::npos);
  EXPECT_TRUE(files.find("/inside.html"));
}

TEST_F(StaticFilesTest, StaysWithinTheDirectory) {
  const StaticFiles files(root);
  for (const char* target : {"/../secret.txt",
                             "/%2e%2e/secret.txt",
                             "/..%2fsecret.txt",
                             "/assets/../../secret.txt",
                             "//../secret.txt",
                             "/link.txt",
                             "/../site-secret/index.html",
                             "/../site-secret/",
                             "\\..\\secret.txt",
                             "/..\\secret.txt",
                             "/%5c..%5csecret.txt",
                             "/%00",
                             "/index.html%00.txt",
                             "/%",
                             "/%2",
                             "/%zz",
                             "",
                             "index.html",
                             "/.hidden",
                             "/%2ehidden",
                             "/assets/../.hidden",
                             "/.git/config",
                             "/unhidden.txt",
                             "/.page.html",
                             "/assets",
                             "/assets/",
                             "/none.html",
                             "/etc/passwd",
                             "//etc/passwd"}) {
    EXPECT_FALSE(files.find(target)) << target;
  }
}

TEST_F(StaticFilesTest, ADirectoryMayLieInAHiddenOne) {
  fs::create_directories(base / ".local" / "viewer");
  write(base / ".local" / "viewer" / "index.html", "<p>");
  EXPECT_TRUE(StaticFiles(base / ".local" / "viewer").find("/"));
}

TEST_F(StaticFilesTest, TagsChangeWithTheContent) {
  const StaticFiles files(root);
  const std::string before = files.find("/index.html")->etag;
  EXPECT_EQ(files.find("/index.html")->etag, before);
  write(root / "index.html", "<p>more");
  EXPECT_NE(files.find("/index.html")->etag, before);
}

TEST(StaticFiles, WithoutADirectoryThereIsNothing) {
  EXPECT_FALSE(StaticFiles("").find("/"));
  EXPECT_FALSE(StaticFiles("/no/such/directory").find("/"));
}

}  // namespace
}  // namespace incise::stream
