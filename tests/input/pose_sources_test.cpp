#include "server/input/pose_sources.hpp"
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

std::vector<Seen> drain(PoseSources& sources) {
  std::vector<Seen> seen;
  sources.drain([&](std::uint32_t source, const InputEvent& event) {
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

TEST(PoseSources, ASourceSaysThatItOpensThenItsPosesThenThatTheStrokeEnds) {
  PoseSources sources(core::Blade{});
  {
    auto source = sources.open("left hand");
    ASSERT_TRUE(source);
    EXPECT_EQ(source->enqueue(poses(1, 3)), 3u);
  }
  const auto seen = drain(sources);
  ASSERT_EQ(seen.size(), 5u);
  EXPECT_EQ(seen[0].kind, Kind::kOpened);
  for (int i = 1; i <= 3; ++i) {
    EXPECT_EQ(seen[i].kind, Kind::kPose);
    EXPECT_EQ(seen[i].t_ns, i);
  }
  EXPECT_EQ(seen[4].kind, Kind::kEndStroke);
  EXPECT_TRUE(drain(sources).empty());
  EXPECT_EQ(sources.open_count(), 0u);
}

// What a blade has cut is known by its number.
TEST(PoseSources, WhoComesBackGetsItsNumberAndOthersTheOneThatIsFreeForLongest) {
  PoseSources sources(core::Blade{}, {{"device", core::Blade{}}});
  const auto number_of = [&](const std::string& name) {
    const auto source = sources.open(name);
    return source ? source->number() : core::kMaxSources;
  };
  const auto leave = [&] { drain(sources); };
  for (std::uint32_t i = 1; i < core::kMaxSources; ++i) {
    EXPECT_EQ(number_of("hand " + std::to_string(i)), i)
        << "none takes that of another while there is a new one";
    leave();
  }
  EXPECT_EQ(number_of("hand 1"), 1u);
  leave();
  EXPECT_EQ(number_of("device"), 0u);
  leave();
  EXPECT_EQ(number_of("stranger"), 2u) << "hand 1 has been there since";
  leave();
  EXPECT_EQ(number_of("hand 2"), 3u);
}

TEST(PoseSources, MarksTellWhatCameBeforeThem) {
  PoseSources sources(core::Blade{}, {}, 8);
  for (int owner = 0; owner < 5; ++owner) {
    auto source = sources.open("s");
    source->enqueue(poses(1, 2));
    const PoseSources::Marks marks = sources.queued();
    source->enqueue(poses(3, 2));
    sources.drain([&](std::uint32_t number, const InputEvent& event) {
      if (event.kind == Kind::kPose) {
        EXPECT_EQ(sources.taken(number) <= marks[number], event.pose.pose.t_ns <= 2) << event.pose.pose.t_ns;
      }
      return true;
    });
  }
}

TEST(PoseSources, AFullQueueTakesAPartAndLosesNothing) {
  PoseSources sources(core::Blade{}, {}, 8);
  auto source = sources.open("s");  // its opening is in the queue as well
  auto all = poses(1, 20);
  std::size_t pushed = 0;
  std::vector<std::int64_t> seen;
  for (int round = 0; round < 10 && pushed < all.size(); ++round) {
    pushed += source->enqueue(std::span(all).subspan(pushed));
    for (const Seen& s : drain(sources)) {
      if (s.kind == Kind::kPose) seen.push_back(s.t_ns);
    }
  }
  EXPECT_EQ(pushed, 20u);
  ASSERT_EQ(seen.size(), 20u);
  for (std::size_t i = 0; i < seen.size(); ++i) EXPECT_EQ(seen[i], static_cast<std::int64_t>(i) + 1);
}

TEST(PoseSources, ANameHasOneOwnerAtATime) {
  PoseSources sources(core::Blade{});
  auto first = sources.open("blade");
  ASSERT_TRUE(first);
  EXPECT_FALSE(sources.open("blade"));
  EXPECT_TRUE(sources.is_open("blade"));
  EXPECT_TRUE(sources.is_held("blade"));
  first.reset();
  EXPECT_TRUE(sources.is_open("blade"));
  EXPECT_FALSE(sources.is_held("blade")) << "its owner has left it";
  EXPECT_FALSE(sources.open("blade")) << "the loop has not yet ended its stroke";
  drain(sources);
  EXPECT_FALSE(sources.is_open("blade"));
  EXPECT_TRUE(sources.open("blade"));
}

TEST(PoseSources, AnOwnerMayBringABlade) {
  const core::Blade common{{0, 0, 0}, {0, 0, -0.1}}, own{{0, 0, 0.02}, {0, 0, -0.03}};
  PoseSources sources(common);
  std::vector<core::Blade> opened;
  const auto look = [&] {
    sources.drain([&](std::uint32_t, const InputEvent& event) {
      if (event.kind == InputEvent::Kind::kOpened) opened.push_back(event.blade);
      return true;
    });
  };
  {
    auto source = sources.open("blade", own);
    look();
  }
  look();  // it ends
  auto source = sources.open("blade");
  look();
  ASSERT_EQ(opened.size(), 2u);
  EXPECT_EQ(opened[0].tip, own.tip);
  EXPECT_EQ(opened[1].tip, common.tip);
}

TEST(PoseSources, EightSourcesAndNoMore) {
  PoseSources sources(core::Blade{});
  std::vector<PoseSource> handles;
  for (int i = 0; i < 8; ++i) {
    auto source = sources.open("source " + std::to_string(i));
    ASSERT_TRUE(source);
    EXPECT_EQ(source->number(), static_cast<std::uint32_t>(i));
    handles.push_back(std::move(*source));
  }
  EXPECT_FALSE(sources.open("one too many"));
  handles.erase(handles.begin() + 3);
  drain(sources);
  auto again = sources.open("after one left");
  ASSERT_TRUE(again);
  EXPECT_EQ(sources.open_count(), 8u);
}

TEST(PoseSources, ADeclaredNameHasItsOwnNumberAndBlade) {
  const core::Blade special{{0, 0, 0}, {0, 0, -0.02}};
  PoseSources sources(core::Blade{}, {{"left", core::Blade{}}, {"right", special}});
  auto other = sources.open("mouse");
  auto right = sources.open("right");
  ASSERT_TRUE(other && right);
  EXPECT_EQ(other->number(), 2u);
  EXPECT_EQ(right->number(), 1u);
  core::Blade given;
  sources.drain([&](std::uint32_t source, const InputEvent& event) {
    if (source == 1) given = event.blade;
    return true;
  });
  EXPECT_EQ(given, special);
}

TEST(PoseSources, VerdictsComeBackToTheOwnerAndStartAgainWithTheNext) {
  PoseSources sources(core::Blade{});
  auto source = sources.open("s");
  source->enqueue(poses(1, 2));
  std::uint32_t opened = 0;  // the last owner's number
  const auto take_owner = [&] {
    sources.drain([&](std::uint32_t, const InputEvent& event) {
      if (event.kind == InputEvent::Kind::kOpened) opened = event.owner;
      return true;
    });
  };
  take_owner();
  sources.count(0, core::PoseVerdict::kAccepted);
  sources.count(0, core::PoseVerdict::kNotUnit);
  EXPECT_EQ(source->counts().drained, 0u) << "the loop has them; the journal has not";
  sources.acknowledge(0, core::PoseVerdict::kAccepted, 77);
  sources.acknowledge(0, core::PoseVerdict::kNotUnit, 78);
  const SourceCounts counts = source->counts();
  EXPECT_EQ(counts.drained, 2u);
  EXPECT_EQ(counts.count(core::PoseVerdict::kAccepted), 1u);
  EXPECT_EQ(counts.count(core::PoseVerdict::kNotUnit), 1u);
  EXPECT_EQ(counts.last_source_ns, 77);
  EXPECT_EQ(counts.recorded, 0u) << "taken, and lost";
  const std::uint32_t first_owner = opened;
  sources.acknowledge_recorded(0, first_owner, 77);
  EXPECT_EQ(source->counts().recorded, 1u);
  EXPECT_EQ(source->counts().recorded_source_ns, 77);
  sources.count(0, core::PoseVerdict::kAccepted);
  source.reset();
  drain(sources);
  source = sources.open("s");
  EXPECT_EQ(source->counts().recorded, 0u);
  sources.acknowledge(0, core::PoseVerdict::kAccepted, 90);  // the journal comes to the last owner's pose
  sources.acknowledge_recorded(0, first_owner, 90);
  EXPECT_EQ(source->counts().recorded, 0u);
  EXPECT_EQ(source->counts().drained, 0u);
  EXPECT_EQ(source->counts().last_source_ns, 0);
  sources.count(0, core::PoseVerdict::kAccepted);
  sources.acknowledge(0, core::PoseVerdict::kAccepted, 5);
  EXPECT_EQ(source->counts().drained, 1u);
  EXPECT_EQ(source->counts().last_source_ns, 5);
  take_owner();
  EXPECT_NE(opened, first_owner);
  sources.acknowledge_recorded(0, opened, 5);
  EXPECT_EQ(source->counts().recorded, 1u);
  EXPECT_EQ(source->counts().recorded_source_ns, 5);
}

TEST(PoseSources, OnceClosedTheyAcceptNothingMore) {
  PoseSources sources(core::Blade{});
  auto source = sources.open("s");
  EXPECT_EQ(source->enqueue(poses(1, 1)), 1u);
  sources.close();
  EXPECT_EQ(source->enqueue(poses(2, 1)), 0u);
  EXPECT_FALSE(source->end_stroke(0));
  EXPECT_FALSE(sources.open("t"));
  EXPECT_EQ(drain(sources).size(), 2u);
}

TEST(PoseSources, AHandlerThatStopsGoesOnWhereItWas) {
  PoseSources sources(core::Blade{});
  auto source = sources.open("s");
  source->enqueue(poses(1, 5));
  std::vector<std::int64_t> seen;
  for (int call = 0; call < 10; ++call) {
    sources.drain([&](std::uint32_t, const InputEvent& event) {
      if (event.kind == Kind::kPose) seen.push_back(event.pose.pose.t_ns);
      return false;
    });
  }
  EXPECT_EQ(seen, (std::vector<std::int64_t>{1, 2, 3, 4, 5}));
}

// Owners that open, push and vanish from several threads while one drains: each owner's poses arrive whole,
// in order, between its opening and its end. Under ThreadSanitizer also: without a race.
TEST(PoseSources, OwnersComeAndGoWhileTheLoopDrains) {
  PoseSources sources(core::Blade{}, {}, 32);
  constexpr int kThreads = 4, kVisits = 40, kPoses = 50;
  std::atomic<int> running{kThreads};
  std::vector<std::thread> owners;
  for (int thread = 0; thread < kThreads; ++thread) {
    owners.emplace_back([&, thread] {
      for (int visit = 0; visit < kVisits;) {
        auto source = sources.open("owner " + std::to_string(thread));
        if (!source) {
          std::this_thread::yield();
          continue;
        }
        const auto all = poses(1, kPoses);
        for (std::size_t pushed = 0; pushed < all.size();) {
          pushed += source->enqueue(std::span(all).subspan(pushed));
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
  while (running > 0) sources.drain(handle);
  for (auto& owner : owners) owner.join();
  sources.drain(handle);
  sources.drain(handle);
  EXPECT_EQ(ended, kThreads * kVisits);
}

TEST(PoseSources, APoseThatBeginsAStrokeIsAcceptedToo) {
  PoseSources sources(core::Blade{});
  auto source = sources.open("s");
  sources.count(0, core::PoseVerdict::kNewStroke);
  sources.acknowledge(0, core::PoseVerdict::kNewStroke, 5);
  EXPECT_EQ(source->counts().last_source_ns, 5);
}

// The journal counts a pose as recorded before it reports it: a reader in between sees neither.
TEST(PoseSources, NoMorePosesAreRecordedThanAccepted) {
  PoseSources sources(core::Blade{});
  for (std::uint64_t owner = 1; owner <= 2; ++owner) {
    auto source = sources.open("s");
    std::uint32_t number = 0;
    sources.drain([&](std::uint32_t, const InputEvent& event) {
      number = event.owner;
      return true;
    });
    for (std::uint64_t n = 1; n <= 3; ++n) {
      sources.count(0, core::PoseVerdict::kAccepted);
      sources.acknowledge_recorded(0, number, 1);
      EXPECT_EQ(source->counts().recorded, n - 1);
      sources.acknowledge(0, core::PoseVerdict::kAccepted, 1);
      EXPECT_EQ(source->counts().recorded, n);
    }
    sources.count(0, core::PoseVerdict::kAccepted);
    sources.acknowledge(0, core::PoseVerdict::kAccepted, 1);
    EXPECT_EQ(source->counts().recorded, 3u) << "the last one was not";
    source.reset();
    EXPECT_EQ(sources.open_count(), 0u) << "though the loop has not yet ended its stroke";
    drain(sources);
  }
}

}  // namespace
}  // namespace incise::input
