// A steady frame allocates nothing and takes no lock: counted, on the thread that runs the frames, with
// operator new replaced and the calls that block wrapped.

#include <dlfcn.h>
#include <gtest/gtest.h>
#include <pthread.h>

#include <cstdlib>
#include <new>

#include "server/base/clock.hpp"
#include "server/loop/frame_loop.hpp"
#include "tests/support/bodies.hpp"

namespace {

thread_local bool counting = false;
thread_local std::uint64_t allocations = 0, locks = 0;

void* allocate(std::size_t size) {
  if (counting) ++allocations;
  if (void* p = std::malloc(size ? size : 1)) return p;
  throw std::bad_alloc();
}

}  // namespace

// Sanitizers have an operator new and mutexes of their own.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define INCISE_COUNTS 0
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define INCISE_COUNTS 0
#endif
#endif
#ifndef INCISE_COUNTS
#define INCISE_COUNTS 1
#endif

#if INCISE_COUNTS
void* operator new(std::size_t size) {
  return allocate(size);
}
void* operator new[](std::size_t size) {
  return allocate(size);
}
void operator delete(void* p) noexcept {
  std::free(p);
}
void operator delete[](void* p) noexcept {
  std::free(p);
}
void operator delete(void* p, std::size_t) noexcept {
  std::free(p);
}
void operator delete[](void* p, std::size_t) noexcept {
  std::free(p);
}

extern "C" int pthread_mutex_lock(pthread_mutex_t* mutex) {
  using Lock = int (*)(pthread_mutex_t*);
  static const auto real = reinterpret_cast<Lock>(dlsym(RTLD_NEXT, "pthread_mutex_lock"));
  if (counting) ++locks;
  return real(mutex);
}
#endif

namespace incise::loop {
namespace {

TEST(SteadyFrame, AllocatesNothingAndTakesNoLock) {
  if (!INCISE_COUNTS) GTEST_SKIP() << "a sanitizer's build: allocations cannot be counted";
  core::CutConfig config;
  config.blade = tests::long_blade();
  // Back and forth outside the body at 1 kHz, batch after batch, so that the core's events do not count here:
  // what the loop itself does in a frame does, with poses, batches, deltas and the journal's queue.
  core::CutSession session(tests::cube(6), config);
  input::PoseSources sources(config.blade);
  struct : DeltaSink {
    void publish(std::shared_ptr<const PublishedDelta> delta) noexcept override {
      last = std::move(delta);
      ++count;
    }
    std::shared_ptr<const PublishedDelta> last;
    std::uint64_t count = 0;
  } sink;
  struct Nowhere : JournalSink {
    void write(const JournalRecord&) override {}
    void flush() override {}
    void sync() override {}
    void close() override {}
  };
  Journal::Options roomy;
  roomy.capacity = 1u << 18;  // frames come faster here than any journal's thread may get a processor
  Journal journal(std::make_unique<Nowhere>(), roomy, [](const std::string&) {});
  FrameLoop loop(session, sources, sink, &journal, {});
  auto source = sources.open("blade");
  constexpr int kWarm = 5'000, kFrames = 100'000;
  for (int i = 0; i < kWarm + kFrames; ++i) {
    input::TimedPose timed;
    timed.pose.t_ns = 1 + std::int64_t{i} * 1'000'000;
    const int phase = i % 1000;
    timed.pose.position = {0.5, 2e-4 * (phase < 500 ? phase : 1000 - phase), 0.1};
    timed.pose.buttons = 1;
    timed.arrival_ns = monotonic_ns();
    ASSERT_EQ(source->enqueue(std::span(&timed, 1)), 1u);
    counting = i >= kWarm;
    loop.frame(monotonic_ns());
    counting = false;
  }
  EXPECT_EQ(allocations, 0u);
  EXPECT_EQ(locks, 0u);
  EXPECT_EQ(loop.stats().journal_lost.load(), 0u);
  EXPECT_GT(sink.count, 100u) << "batches must have been committed for the count to mean anything";
}

// Forces are made in the frame, too: a tip presses on the body, slides over it, lies in it, and leaves.
TEST(SteadyFrame, ForcesAllocateNothing) {
  if (!INCISE_COUNTS) GTEST_SKIP() << "a sanitizer's build: allocations cannot be counted";
  core::CutConfig config;
  config.blade = {{0, 0, 0}, {0, 0, -0.05}};
  core::CutSession session(tests::cube(6), config);
  input::PoseSources sources(config.blade);
  struct : DeltaSink {
    void publish(std::shared_ptr<const PublishedDelta>) noexcept override {}
  } deltas;
  struct : haptics::ForceSink {
    void feel(const haptics::BladeForce& force) noexcept override {
      ++count;
      inside += force.feel.contact && force.feel.contact->penetrated;
    }
    std::uint64_t count = 0, inside = 0;
  } forces;
  FrameLoop loop(session, sources, deltas, nullptr, {});
  haptics::ForceSlots slots;
  loop.offer_forces({}, std::make_unique<haptics::Tissue>(tests::cube(6)), &forces, &slots);
  auto source = sources.open("blade");
  constexpr int kWarm = 1'000, kFrames = 10'000;
  for (int i = 0; i < kWarm + kFrames; ++i) {
    input::TimedPose timed;
    timed.pose.t_ns = 1 + std::int64_t{i} * 1'000'000;
    const int phase = i % 1000;
    const double depth = 1e-5 * (phase < 500 ? phase : 1000 - phase);
    // The first pose of every fifth second is put into the tissue: too fast to have been moved there.
    const bool buried = i / 1000 % 5 == 4;
    timed.pose.position = {0.03 + 2e-5 * phase, 0.05, buried ? 0.08 : 0.151 - depth};
    timed.arrival_ns = monotonic_ns();
    ASSERT_EQ(source->enqueue(std::span(&timed, 1)), 1u);
    counting = i >= kWarm;
    loop.frame(monotonic_ns());
    counting = false;
  }
  EXPECT_EQ(allocations, 0u);
  EXPECT_EQ(locks, 0u);
  EXPECT_GT(forces.count, 5'000u);
  EXPECT_GT(forces.inside, 1'000u);
}

TEST(SteadyFrame, TheCountersCount) {
  if (!INCISE_COUNTS) GTEST_SKIP() << "a sanitizer's build: allocations cannot be counted";
  pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
  const std::uint64_t allocations_before = allocations, locks_before = locks;
  counting = true;
  auto* p = new std::vector<int>(100);
  pthread_mutex_lock(&mutex);
  counting = false;
  pthread_mutex_unlock(&mutex);
  delete p;
  EXPECT_EQ(allocations - allocations_before, 2u);
  EXPECT_EQ(locks - locks_before, 1u);
}

}  // namespace
}  // namespace incise::loop
