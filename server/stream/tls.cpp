#include "server/stream/tls.hpp"

#include <openssl/pem.h>
#include <openssl/x509.h>

#include <ctime>
#include <memory>
#include <stdexcept>

namespace incise::stream {
namespace {

constexpr int kSecondsOfDay = 86'400;
constexpr int kWarnDays = 14;

// From that moment until `time`.
double seconds_until(const ASN1_TIME* time, std::int64_t now_unix_s) {
  const std::unique_ptr<ASN1_TIME, decltype(&ASN1_TIME_free)> now(ASN1_TIME_set(nullptr, now_unix_s),
                                                                  &ASN1_TIME_free);
  int days = 0, seconds = 0;
  if (!now || ASN1_TIME_diff(&days, &seconds, now.get(), time) != 1) return 0;
  return static_cast<double>(days) * kSecondsOfDay + seconds;
}

std::string date_of(const ASN1_TIME* time) {
  std::tm parts{};
  char text[32] = {};
  if (ASN1_TIME_to_tm(time, &parts) != 1 ||
      std::strftime(text, sizeof text, "%Y-%m-%d %H:%M UTC", &parts) == 0)
    return "an unknown time";
  return text;
}

}  // namespace

void load_certificate(boost::asio::ssl::context& tls, const std::string& certificate_file,
                      const std::string& private_key_file) {
  namespace ssl = boost::asio::ssl;
  tls.set_options(ssl::context::default_workarounds | ssl::context::no_sslv2 | ssl::context::no_sslv3 |
                  ssl::context::no_tlsv1 | ssl::context::no_tlsv1_1);
  boost::system::error_code error;
  tls.use_certificate_chain_file(certificate_file, error);
  if (error) {
    throw std::runtime_error("listen.certificate_file: " + certificate_file + ": " + error.message() +
                             "; give a chain of certificates in PEM");
  }
  tls.use_private_key_file(private_key_file, ssl::context::pem, error);
  if (error) {
    throw std::runtime_error("listen.private_key_file: " + private_key_file + ": " + error.message() +
                             "; give the private key, in PEM, of " + certificate_file);
  }
}

std::string validity_warning(const std::string& certificate_file, std::int64_t now_unix_s) {
  const std::unique_ptr<BIO, decltype(&BIO_free)> file(BIO_new_file(certificate_file.c_str(), "r"),
                                                       &BIO_free);
  if (!file) return {};
  const std::unique_ptr<X509, decltype(&X509_free)> certificate(
      PEM_read_bio_X509(file.get(), nullptr, nullptr, nullptr), &X509_free);
  if (!certificate) return {};
  const ASN1_TIME* const from = X509_get0_notBefore(certificate.get());
  const ASN1_TIME* const to = X509_get0_notAfter(certificate.get());
  if (seconds_until(from, now_unix_s) > 0)
    return "it is not valid before " + date_of(from) + ": clients refuse it";
  const double left_s = seconds_until(to, now_unix_s);
  if (left_s <= 0) return "it expired on " + date_of(to) + ": clients refuse it";
  if (left_s <= kWarnDays * kSecondsOfDay) return "it expires on " + date_of(to);
  return {};
}

}  // namespace incise::stream
