#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <mutex>
#include <string>
#include <thread>

#include "server/cluster/nats_client.hpp"

namespace incise::cluster {

struct LeaseOptions {
  NatsOptions nats;
  std::string session;
  double length_s = 15;
  int replicas = 1;
  // Beside what may have one writer: which instance wrote it last. On the storage that all instances share.
  std::filesystem::path fence_file;
};

// The right of one instance of several to be a session's writer, by a key in the bucket "incise_leases" and a file.
//
// The holder renews the key by its revision, so that two who try make one who succeeds. It stops two thirds of the lease after the last
// renewal that succeeded was *sent*; another takes the key when it has seen the same revision for the whole lease, by its own clock. So
// clocks need not agree, only run at the same rate. CLOCK_BOOTTIME is used, which goes on while a machine sleeps.
//
// A key that is not there (never was, or the bucket was wiped) gives no such time: then the file tells whether an instance
// may still be writing, and if so whoever makes the key waits for a lease, in which the old holder's renewals fail.
//
// Thread: acquire() and release() from one; held() and fence() from any. Owns: the thread that renews.
class Lease {
 public:
  using Log = std::function<void(bool warning, const std::string& line)>;
  // `on_lost` is called once, on the thread that renews, with the reason: whoever writes must stop within a third of the lease.
  Lease(LeaseOptions options, Log log, std::function<void(const std::string& why)> on_lost);
  // Gives it up as release() does.
  ~Lease();
  Lease(const Lease&) = delete;
  Lease& operator=(const Lease&) = delete;

  // Waits until it is ours, also for NATS. False: `interrupted` has become true. Throws NatsError for what waiting does not mend: refused credentials,
  // a wrong authority, no permission.
  bool acquire(const std::function<bool()>& interrupted);
  // Whether it is ours at this moment. Wait-free.
  bool held() const noexcept;
  // Rises with each holder; 0 before acquire().
  std::uint64_t fence() const { return fence_; }
  // Whether the instance before ended without giving it up: its files may have a last moment that is half written.
  bool crashed_before() const { return crashed_before_; }
  // So that the next instance need not wait. After the last write.
  void release();

 private:
  struct Seen {
    std::uint64_t revision = 0;
    std::int64_t since_ns = 0;
  };
  bool try_acquire(NatsClient& client, Seen& seen);
  void take(std::uint64_t revision, std::int64_t asked_ns, std::uint64_t fence);
  std::string value(bool released) const;
  void renew_until_lost();
  bool renew(std::unique_ptr<NatsClient>& client, std::string& trouble);
  void lose(const std::string& why);

  const LeaseOptions options_;
  const Log log_;
  const std::function<void(const std::string&)> on_lost_;
  const std::string key_, holder_;
  std::uint64_t fence_ = 0, revision_ = 0;
  bool crashed_before_ = false;
  std::string waiting_for_;  // last logged
  std::atomic<std::int64_t> until_ns_{0};
  std::mutex mutex_;
  std::condition_variable wake_;
  bool stopping_ = false;  // guarded by mutex_
  std::thread thread_;
};

}  // namespace incise::cluster
