#include "server/input/input_hub.hpp"
#include "server/base/clock.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

namespace incise::input {
namespace {

using Kind = InputEvent::Kind;

struct Seen {
  std::uint32_t source;
  Kind kind;
  std::int64_t t_ns;
};

std::vector<Seen> drain(InputHub& hub) {
  std::vector<Seen> seen;
  hub.drain([&](std::uint32_t source, const InputEvent& event) {
    seen.push_back({source, event.kind, event.pose.pose.t_ns});
    return true;
  });
  return seen;
}

std::vector<TimedPose> poses(std::int64_t first, std::size_t count) {
  std::vector<TimedPose> made(count);
  for (std::size_t i = 0; i < count; ++i) {
    made[i].pose.t_ns = first + static_cast<std::int64_t>(i);
    made[i].arrival_ns = monotonic_ns();
  }
  return made;
}

TEST(InputHub, ASourceSaysThatItOpensThenItsPosesThenThatTheStrokeEnds) {
  InputHub hub(core::Blade{});
  {
    auto source = hub.open_source("left hand");
    ASSERT_TRUE(source);
    EXPECT_EQ(source->push(poses(1, 3)), 3u);
  }
  const auto seen = drain(hub);
  ASSERT_EQ(seen.size(), 5u);
  EXPECT_EQ(seen[0].kind, Kind::kOpened);
  for (int i = 1; i <= 3; ++i) {
    EXPECT_EQ(seen[i].kind, Kind::kPose);
    EXPECT_EQ(seen[i].t_ns, i);
  }
  EXPECT_EQ(seen[4].kind, Kind::kEndStroke);
  EXPECT_TRUE(drain(hub).empty());
  EXPECT_EQ(hub.open_sources(), 0u);
}

TEST(InputHub, AFullQueueTakesAPartAndLosesNothing) {
  InputHub hub(core::Blade{}, {}, 8);
  auto source = hub.open_source("s");  // its opening is in the queue as well
  auto all = poses(1, 20);
  std::size_t pushed = 0;
  std::vector<std::int64_t> seen;
  for (int round = 0; round < 10 && pushed < all.size(); ++round) {
    pushed += source->push(std::span(all).subspan(pushed));
    for (const Seen& s : drain(hub)) {
      if (s.kind == Kind::kPose) seen.push_back(s.t_ns);
    }
  }
  EXPECT_EQ(pushed, 20u);
  ASSERT_EQ(seen.size(), 20u);
  for (std::size_t i = 0; i < seen.size(); ++i) EXPECT_EQ(seen[i], static_cast<std::int64_t>(i) + 1);
}

TEST(InputHub, ANameHasOneOwnerAtATime) {
  InputHub hub(core::Blade{});
  auto first = hub.open_source("blade");
  ASSERT_TRUE(first);
  EXPECT_FALSE(hub.open_source("blade"));
  EXPECT_TRUE(hub.is_open("blade"));
  first.reset();
  EXPECT_FALSE(hub.open_source("blade")) << "the loop has not yet ended its stroke";
  drain(hub);
  EXPECT_FALSE(hub.is_open("blade"));
  EXPECT_TRUE(hub.open_source("blade"));
}

TEST(InputHub, AnOwnerMayBringABlade) {
  const core::Blade common{{0, 0, 0}, {0, 0, -0.1}}, own{{0, 0, 0.02}, {0, 0, -0.03}};
  InputHub hub(common);
  std::vector<core::Blade> opened;
  const auto look = [&] {
    hub.drain([&](std::uint32_t, const InputEvent& event) {
      if (event.kind == InputEvent::Kind::kOpened) opened.push_back(event.blade);
      return true;
    });
  };
  {
    auto source = hub.open_source("blade", own);
    look();
  }
  look();  // it ends
  auto source = hub.open_source("blade");
  look();
  ASSERT_EQ(opened.size(), 2u);
  EXPECT_EQ(opened[0].tip, own.tip);
  EXPECT_EQ(opened[1].tip, common.tip);
}

TEST(InputHub, EightSourcesAndNoMore) {
  InputHub hub(core::Blade{});
  std::vector<SourceHandle> handles;
  for (int i = 0; i < 8; ++i) {
    auto source = hub.open_source("source " + std::to_string(i));
    ASSERT_TRUE(source);
    EXPECT_EQ(source->number(), static_cast<std::uint32_t>(i));
    handles.push_back(std::move(*source));
  }
  EXPECT_FALSE(hub.open_source("one too many"));
  handles.erase(handles.begin() + 3);
  drain(hub);
  auto again = hub.open_source("after one left");
  ASSERT_TRUE(again);
  EXPECT_EQ(hub.open_sources(), 8u);
}

TEST(InputHub, ADeclaredNameHasItsOwnNumberAndBlade) {
  const core::Blade special{{0, 0, 0}, {0, 0, -0.02}};
  InputHub hub(core::Blade{}, {{"left", core::Blade{}}, {"right", special}});
  auto other = hub.open_source("mouse");
  auto right = hub.open_source("right");
  ASSERT_TRUE(other && right);
  EXPECT_EQ(other->number(), 2u);
  EXPECT_EQ(right->number(), 1u);
  core::Blade given;
  hub.drain([&](std::uint32_t source, const InputEvent& event) {
    if (source == 1) given = event.blade;
    return true;
  });
  EXPECT_EQ(given, special);
}

TEST(InputHub, VerdictsComeBackToTheOwnerAndStartAgainWithTheNext) {
  InputHub hub(core::Blade{});
  auto source = hub.open_source("s");
  source->push(poses(1, 2));
  std::uint32_t opened = 0;  // the last owner's number
  const auto take_owner = [&] {
    hub.drain([&](std::uint32_t, const InputEvent& event) {
      if (event.kind == InputEvent::Kind::kOpened) opened = event.owner;
      return true;
    });
  };
  take_owner();
  hub.count(0, core::PoseVerdict::kAccepted);
  hub.count(0, core::PoseVerdict::kNotUnit);
  EXPECT_EQ(source->counts().drained, 0u) << "the loop has them; the journal has not";
  hub.tell(0, core::PoseVerdict::kAccepted, 77);
  hub.tell(0, core::PoseVerdict::kNotUnit, 78);
  const SourceCounts counts = source->counts();
  EXPECT_EQ(counts.drained, 2u);
  EXPECT_EQ(counts.count(core::PoseVerdict::kAccepted), 1u);
  EXPECT_EQ(counts.count(core::PoseVerdict::kNotUnit), 1u);
  EXPECT_EQ(counts.last_source_ns, 77);
  EXPECT_EQ(counts.recorded, 0u) << "taken, and lost";
  const std::uint32_t first_owner = opened;
  hub.tell_recorded(0, first_owner, 77);
  EXPECT_EQ(source->counts().recorded, 1u);
  EXPECT_EQ(source->counts().recorded_source_ns, 77);
  hub.count(0, core::PoseVerdict::kAccepted);
  source.reset();
  drain(hub);
  source = hub.open_source("s");
  EXPECT_EQ(source->counts().recorded, 0u);
  hub.tell(0, core::PoseVerdict::kAccepted, 90);  // the journal comes to the last owner's pose
  hub.tell_recorded(0, first_owner, 90);
  EXPECT_EQ(source->counts().recorded, 0u);
  EXPECT_EQ(source->counts().drained, 0u);
  EXPECT_EQ(source->counts().last_source_ns, 0);
  hub.count(0, core::PoseVerdict::kAccepted);
  hub.tell(0, core::PoseVerdict::kAccepted, 5);
  EXPECT_EQ(source->counts().drained, 1u);
  EXPECT_EQ(source->counts().last_source_ns, 5);
  take_owner();
  EXPECT_NE(opened, first_owner);
  hub.tell_recorded(0, opened, 5);
  EXPECT_EQ(source->counts().recorded, 1u);
  EXPECT_EQ(source->counts().recorded_source_ns, 5);
}

TEST(InputHub, AClosedHubTakesNothingMore) {
  InputHub hub(core::Blade{});
  auto source = hub.open_source("s");
  EXPECT_EQ(source->push(poses(1, 1)), 1u);
  hub.close();
  EXPECT_EQ(source->push(poses(2, 1)), 0u);
  EXPECT_FALSE(source->end_stroke(0));
  EXPECT_FALSE(hub.open_source("t"));
  EXPECT_EQ(drain(hub).size(), 2u);
}

TEST(InputHub, AHandlerThatStopsGoesOnWhereItWas) {
  InputHub hub(core::Blade{});
  auto source = hub.open_source("s");
  source->push(poses(1, 5));
  std::vector<std::int64_t> seen;
  for (int call = 0; call < 10; ++call) {
    hub.drain([&](std::uint32_t, const InputEvent& event) {
      if (event.kind == Kind::kPose) seen.push_back(event.pose.pose.t_ns);
      return false;
    });
  }
  EXPECT_EQ(seen, (std::vector<std::int64_t>{1, 2, 3, 4, 5}));
}

// Owners that open, push and vanish from several threads while one drains: each owner's poses arrive whole,
// in order, between its opening and its end. Under ThreadSanitizer also: without a race.
TEST(InputHub, OwnersComeAndGoWhileTheLoopDrains) {
  InputHub hub(core::Blade{}, {}, 32);
  constexpr int kThreads = 4, kVisits = 40, kPoses = 50;
  std::atomic<int> running{kThreads};
  std::vector<std::thread> owners;
  for (int thread = 0; thread < kThreads; ++thread) {
    owners.emplace_back([&, thread] {
      for (int visit = 0; visit < kVisits;) {
        auto source = hub.open_source("owner " + std::to_string(thread));
        if (!source) {
          std::this_thread::yield();
          continue;
        }
        const auto all = poses(1, kPoses);
        for (std::size_t pushed = 0; pushed < all.size();) {
          pushed += source->push(std::span(all).subspan(pushed));
          std::this_thread::yield();
        }
        ++visit;
      }
      --running;
    });
  }
  std::array<std::int64_t, core::kMaxSources> next{};  // 0: nobody
  int ended = 0;
  const auto handle = [&](std::uint32_t source, const InputEvent& event) {
    switch (event.kind) {
      case Kind::kOpened:
        EXPECT_EQ(next[source], 0);
        next[source] = 1;
        break;
      case Kind::kPose:
        EXPECT_EQ(event.pose.pose.t_ns, next[source]++);
        break;
      case Kind::kEndStroke:
        EXPECT_EQ(next[source], kPoses + 1);
        next[source] = 0;
        ++ended;
    }
    return true;
  };
  while (running > 0) hub.drain(handle);
  for (auto& owner : owners) owner.join();
  hub.drain(handle);
  hub.drain(handle);
  EXPECT_EQ(ended, kThreads * kVisits);
}

TEST(InputHub, APoseThatBeginsAStrokeIsAcceptedToo) {
  InputHub hub(core::Blade{});
  auto source = hub.open_source("s");
  hub.count(0, core::PoseVerdict::kNewStroke);
  hub.tell(0, core::PoseVerdict::kNewStroke, 5);
  EXPECT_EQ(source->counts().last_source_ns, 5);
}

// The journal counts a pose as recorded before it tells of it: whoever looks in between sees neither.
TEST(InputHub, NoMorePosesAreRecordedThanAccepted) {
  InputHub hub(core::Blade{});
  for (std::uint64_t owner = 1; owner <= 2; ++owner) {
    auto source = hub.open_source("s");
    std::uint32_t number = 0;
    hub.drain([&](std::uint32_t, const InputEvent& event) {
      number = event.owner;
      return true;
    });
    for (std::uint64_t n = 1; n <= 3; ++n) {
      hub.count(0, core::PoseVerdict::kAccepted);
      hub.tell_recorded(0, number, 1);
      EXPECT_EQ(source->counts().recorded, n - 1);
      hub.tell(0, core::PoseVerdict::kAccepted, 1);
      EXPECT_EQ(source->counts().recorded, n);
    }
    hub.count(0, core::PoseVerdict::kAccepted);
    hub.tell(0, core::PoseVerdict::kAccepted, 1);
    EXPECT_EQ(source->counts().recorded, 3u) << "the last one was not";
    source.reset();
    EXPECT_EQ(hub.open_sources(), 0u) << "though the loop has not yet ended its stroke";
    drain(hub);
  }
}

}  // namespace
}  // namespace incise::input
