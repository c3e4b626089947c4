#include "server/mesh_io/hash.hpp"

#include <openssl/evp.h>

#include <bit>

#include "server/base/check.hpp"

namespace incise::mesh_io {

static_assert(std::endian::native == std::endian::little, "numbers are hashed as they lie in memory");

struct ContentHash::State {
  EVP_MD_CTX* context = EVP_MD_CTX_new();
  ~State() { EVP_MD_CTX_free(context); }
};

ContentHash::ContentHash() : state_(std::make_unique<State>()) {
  INCISE_CHECK(EVP_DigestInit_ex(state_->context, EVP_sha256(), nullptr) == 1);
}
ContentHash::ContentHash(const ContentHash& other) : state_(std::make_unique<State>()) {
  INCISE_CHECK(EVP_MD_CTX_copy_ex(state_->context, other.state_->context) == 1);
}
ContentHash::~ContentHash() = default;

void ContentHash::add(const void* bytes, std::size_t count) {
  INCISE_CHECK(EVP_DigestUpdate(state_->context, bytes, count) == 1);
}

std::string ContentHash::hex() {
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned int length = 0;
  INCISE_CHECK(EVP_DigestFinal_ex(state_->context, digest, &length) == 1);
  std::string text;
  for (unsigned int i = 0; i < length; ++i) {
    text += "0123456789abcdef"[digest[i] >> 4];
    text += "0123456789abcdef"[digest[i] & 15];
  }
  return text;
}

}  // namespace incise::mesh_io
