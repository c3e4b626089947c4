#include "server/stream/static_files.hpp"

#include <algorithm>
#include <array>
#include <system_error>
#include <utility>

namespace incise::stream {
namespace {

namespace fs = std::filesystem;

constexpr std::array<std::pair<std::string_view, std::string_view>, 17> kMimeTypes{{
    {".html", "text/html; charset=utf-8"},
    {".js", "text/javascript; charset=utf-8"},
    {".mjs", "text/javascript; charset=utf-8"},
    {".css", "text/css; charset=utf-8"},
    {".json", "application/json"},
    {".map", "application/json"},
    {".txt", "text/plain; charset=utf-8"},
    {".fbs", "text/plain; charset=utf-8"},
    {".svg", "image/svg+xml"},
    {".png", "image/png"},
    {".jpg", "image/jpeg"},
    {".webp", "image/webp"},
    {".ico", "image/x-icon"},
    {".wasm", "application/wasm"},
    {".woff2", "font/woff2"},
    {".webmanifest", "application/manifest+json"},
    {".glb", "model/gltf-binary"},
}};

int hex_digit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

// The path of a target, percent-decoded once. Nothing if it is malformed.
std::optional<std::string> decoded_path(std::string_view target) {
  target = target.substr(0, target.find_first_of("?#"));
  if (target.empty() || target.front() != '/') return std::nullopt;
  std::string path;
  for (std::size_t i = 0; i < target.size(); ++i) {
    char c = target[i];
    if (c == '%') {
      if (i + 2 >= target.size()) return std::nullopt;
      const int high = hex_digit(target[i + 1]), low = hex_digit(target[i + 2]);
      if (high < 0 || low < 0) return std::nullopt;
      c = static_cast<char>(16 * high + low);
      i += 2;
    }
    if (c == '\0' || c == '\\') return std::nullopt;
    path += c;
  }
  return path;
}

bool is_hidden(const fs::path& name) {
  const std::string& text = name.native();
  return text.starts_with('.') && text != "." && text != "..";
}

}  // namespace

StaticFiles::StaticFiles(const std::string& directory) {
  if (directory.empty()) return;
  std::error_code error;
  root_ = fs::canonical(directory, error);
  if (error) root_.clear();
}

std::optional<StaticFiles::File> StaticFiles::find(std::string_view target) const {
  if (root_.empty()) return std::nullopt;
  const std::optional<std::string> decoded = decoded_path(target);
  if (!decoded) return std::nullopt;
  fs::path relative = fs::path(*decoded).relative_path();
  if (decoded->back() == '/') relative /= "index.html";
  std::error_code error;
  const fs::path path = fs::canonical(root_ / relative, error);
  if (error) return std::nullopt;
  // The resolved path counts, after every ".." and every link.
  const auto [in_root, rest] = std::mismatch(root_.begin(), root_.end(), path.begin(), path.end());
  if (in_root != root_.end()) return std::nullopt;
  if (std::any_of(relative.begin(), relative.end(), is_hidden) || std::any_of(rest, path.end(), is_hidden)) {
    return std::nullopt;
  }
  if (!fs::is_regular_file(path, error) || error) return std::nullopt;
  const auto size = fs::file_size(path, error);
  const auto changed = fs::last_write_time(path, error);
  if (error) return std::nullopt;

  File file;
  file.path = path;
  const std::string extension = path.extension().string();
  const auto known = std::find_if(kMimeTypes.begin(), kMimeTypes.end(),
                                  [&](const auto& entry) { return entry.first == extension; });
  file.mime_type = known == kMimeTypes.end() ? "application/octet-stream" : std::string(known->second);
  const std::string version = std::to_string(size) + '-' + std::to_string(changed.time_since_epoch().count());
  file.etag = '"' + version + '"';
  fs::path packed = path;
  packed += ".gz";
  if (fs::symlink_status(packed, error).type() == fs::file_type::regular) {
    file.packed_path = packed;
    file.packed_etag = '"' + version + "-gz\"";
  }
  const bool hashed = rest != path.end() && *rest == "assets";
  file.cache_control = hashed ? "public, max-age=31536000, immutable" : "no-cache";
  return file;
}

}  // namespace incise::stream
