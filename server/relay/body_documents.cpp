#include "server/relay/body_documents.hpp"

#include <boost/asio/as_tuple.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/empty_body.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/http/write.hpp>
#include <chrono>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>
#include <utility>

#include "client/link.hpp"

namespace incise::relay {
namespace {

namespace asio = boost::asio;
namespace http = boost::beast::http;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);
constexpr std::chrono::seconds kTime{30};  // for one document

asio::awaitable<client::OpenStream> open_http(const Origin& origin) {
  try {
    co_return co_await client::open_stream(origin.host, origin.http_port, origin.options,
                                           std::chrono::steady_clock::now() + kTime);
  } catch (const std::exception& error) {
    if (origin.http_option.empty()) throw;
    throw std::runtime_error(std::string(error.what()) + "; " + origin.http_option +
                             " says at which port the origin's HTTP is");
  }
}

// Without a body where the answer is 404.
asio::awaitable<stream::Document> http_get_if_any(const Origin& origin, std::string path) {
  const std::string where = origin.host + ":" + std::to_string(origin.http_port) + path;
  client::OpenStream opened = co_await open_http(origin);
  http::request<http::empty_body> request(http::verb::get, path, 11);
  const bool literal_v6 = origin.host.find(':') != std::string::npos;
  request.set(http::field::host,
              (literal_v6 ? "[" + origin.host + "]" : origin.host) + ":" + std::to_string(origin.http_port));
  if (!origin.options.token.empty())
    request.set(http::field::authorization, "Bearer " + origin.options.token);
  const auto [write_error, written] = co_await http::async_write(opened.stream, request, kTuple);
  if (write_error) throw std::runtime_error(where + ": " + write_error.message());
  boost::beast::flat_buffer buffer;
  http::response_parser<http::string_body> parser;
  parser.body_limit(protocol::kMaxMessageBytes);
  const auto [read_error, read] = co_await http::async_read(opened.stream, buffer, parser, kTuple);
  if (read_error) throw std::runtime_error(where + ": " + read_error.message());
  http::response<http::string_body> answer = parser.release();
  opened.stream.close();
  if (answer.result() == http::status::not_found) co_return stream::Document();
  if (answer.result() != http::status::ok)
    throw std::runtime_error(where + ": the answer is " + std::to_string(answer.result_int()));
  const auto type = answer[http::field::content_type];
  stream::Document document;
  document.type = std::string(type.data(), type.size());
  document.body = std::make_shared<const std::string>(std::move(answer.body()));
  co_return document;
}

asio::awaitable<stream::Document> http_get(const Origin& origin, std::string path) {
  stream::Document document = co_await http_get_if_any(origin, path);
  if (!document.body) throw std::runtime_error("the origin has no " + path);
  co_return document;
}

// The paths that look.json names, wherever they are in it.
void collect_paths(const nlohmann::json& json, std::set<std::string>& paths) {
  if (json.is_string() && json.get_ref<const std::string&>().starts_with("/look/")) paths.insert(json);
  if (json.is_structured()) {
    for (const nlohmann::json& member : json) collect_paths(member, paths);
  }
}

}  // namespace

asio::awaitable<FetchedSurface> fetch_surface(Origin origin, protocol::SurfaceFacts facts) {
  FetchedSurface fetched;
  const stream::Document asset_document = co_await http_get(origin, facts.path);
  const std::string& bytes = *asset_document.body;
  const protocol::DecodeResult decoded = protocol::decode(std::as_bytes(std::span(bytes)));
  if (!decoded) throw std::runtime_error(facts.path + " is not a message: " + decoded.error);
  const auto* asset = std::get_if<protocol::SurfaceAsset>(&decoded.message->body);
  if (!asset || asset->triangles.size() != std::size_t{3} * facts.triangles)
    throw std::runtime_error(facts.path + " is not the surface that Welcome announced");
  const std::size_t vertices = asset->positions.size() / 3;
  for (const std::uint32_t v : asset->triangles) {
    if (v >= vertices) throw std::runtime_error(facts.path + " has a triangle of vertices that it has not");
  }
  fetched.origins = std::make_shared<const protocol::OriginTree>(asset->positions, asset->triangles);
  fetched.documents[facts.path] = asset_document;
  for (const protocol::Material& material : asset->materials) {
    const std::string path = facts.path + "/" + material.texture;
    if (material.texture.empty() || fetched.documents.contains(path)) continue;
    stream::Document image = co_await http_get(origin, path);
    fetched.documents[path] = std::move(image);
  }
  co_return fetched;
}

asio::awaitable<stream::Documents> fetch_look(Origin origin, std::string held) {
  const std::string look_path = "/look.json";
  stream::Documents documents;
  const stream::Document look = co_await http_get_if_any(origin, look_path);
  if (!look.body) co_return documents;
  documents[look_path] = look;
  if (*look.body == held) co_return documents;
  std::set<std::string> paths;
  collect_paths(nlohmann::json::parse(*look.body, nullptr, false), paths);
  for (const std::string& path : paths) {
    stream::Document document = co_await http_get(origin, path);
    documents[path] = std::move(document);
  }
  co_return documents;
}

}  // namespace incise::relay
