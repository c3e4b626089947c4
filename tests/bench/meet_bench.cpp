#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>

#include "protocol/motion.hpp"
#include "tests/bench/bench_util.hpp"
#include "tests/bench/benches.hpp"
#include "tests/oracle/hands.hpp"
#include "tests/oracle/judge.hpp"
#include "tests/oracle/meetings.hpp"

// Random cuts that meet, and recorded motions of real hands, on any mesh: judged by the oracle (tests/oracle).
namespace incise::bench {
namespace {

using oracle::Verdict;

struct Options {
  std::vector<std::string> meshes, kinds{std::begin(oracle::kMeetingKinds), std::end(oracle::kMeetingKinds)};
  double scale = 1;
  int count = 2;
  std::uint64_t seed = 1;
  int poses = 1000;
  double batch_h = 0;  // 0: each meeting's own
  bool at_once = false, saved = false, along_axes = false, each = false;
};

// What the rows of one table add up.
struct Totals {
  std::int64_t cuts = 0, wrong = 0, joined = 0, torn = 0, crumbs = 0, small_crumbs = 0, fragments = 0,
               invalid = 0, crowded = 0;
  std::vector<double> growth, angle_lost, volume, alone, alone_mean, merged, seconds, event_us, batch_s;

  void append(const Totals& t) {
    for (auto field : {&Totals::cuts, &Totals::wrong, &Totals::joined, &Totals::torn, &Totals::crumbs,
                       &Totals::small_crumbs, &Totals::fragments, &Totals::invalid, &Totals::crowded})
      this->*field += t.*field;
    for (auto field :
         {&Totals::growth, &Totals::angle_lost, &Totals::volume, &Totals::alone, &Totals::alone_mean,
          &Totals::merged, &Totals::seconds, &Totals::event_us, &Totals::batch_s})
      (this->*field).insert((this->*field).end(), (t.*field).begin(), (t.*field).end());
  }
  void add(const Verdict& v, const oracle::Body& body) {
    ++cuts;
    wrong += !v.right();
    joined += v.joined > 0;
    torn += v.torn > 0;
    crumbs += v.crumbs;
    small_crumbs += v.small_crumbs;
    fragments += v.fragments;
    invalid += !v.invalid.empty() || v.inverted > 0;
    crowded += v.crowded_edges;
    growth.push_back(v.growth);
    angle_lost.push_back(std::min(body.min_angle_deg, 3.0) - v.min_angle_deg);
    volume.push_back(std::abs(v.volume_change));
    alone.push_back(v.alone_max_h);
    alone_mean.push_back(v.alone_mean_h);
    merged.push_back(v.merged_max_h);
  }
};

const std::vector<Column> kColumns = {{"kind"},          {"cuts"},           {"wrong"},
                                      {"joined"},        {"torn"},           {"crumbs"},
                                      {"of 1-3"},        {"fragments"},      {"invalid"},
                                      {"growth p50", 2}, {"most", 2},        {"angle lost", 2},
                                      {"volume %", 4},   {"alone p50 h", 3}, {"most", 3},
                                      {"mean", 4},       {"merged", 3},      {"crowded edges"},
                                      {"ms", 1},         {"us an event", 1}, {"batch p99 ms", 2},
                                      {"longest", 1}};

void add_row(Report& report, const std::string& name, const Totals& t) {
  report.row({name,
              t.cuts,
              t.wrong,
              t.joined,
              t.torn,
              t.crumbs,
              t.small_crumbs,
              t.fragments,
              t.invalid,
              percentile(t.growth, 0.5),
              percentile(t.growth, 1),
              percentile(t.angle_lost, 1),
              100 * percentile(t.volume, 1),
              percentile(t.alone, 0.5),
              percentile(t.alone, 1),
              percentile(t.alone_mean, 0.5),
              percentile(t.merged, 1),
              t.crowded,
              1e3 * percentile(t.seconds, 0.5),
              percentile(t.event_us, 0.5),
              1e3 * percentile(t.batch_s, 0.99),
              1e3 * percentile(t.batch_s, 1)});
}

// Cuts with poses that come in, pose by pose in turn, each hand with a blade of its own, timing each batch.
void run_timed(core::CutSession& session, std::span<const oracle::Hand> hands, Totals& totals) {
  core::WorkBudget budget = core::WorkBudget::unlimited();
  core::Delta delta;
  double all = 0;
  std::uint64_t events = 0;
  const auto work = [&] {
    for (;;) {
      const double start = thread_cpu_s();
      if (session.advance(budget, delta) != core::CutSession::Progress::kCommitted) return;
      const double seconds = thread_cpu_s() - start;
      totals.batch_s.push_back(seconds);
      all += seconds;
      events += session.committed_counts().events;
    }
  };
  std::size_t most = 0;
  for (const oracle::Hand& hand : hands) most = std::max(most, hand.poses.size());
  for (std::size_t i = 0; i < most; ++i) {
    for (std::uint32_t blade = 0; blade < hands.size(); ++blade) {
      if (i == hands[blade].poses.size()) session.end_stroke(blade);
      if (i < hands[blade].poses.size()) session.push(blade, hands[blade].poses[i]);
      work();
    }
  }
  for (std::uint32_t blade = 0; blade < hands.size(); ++blade) session.end_stroke(blade);
  work();
  totals.seconds.push_back(all);
  totals.event_us.push_back(1e6 * all / static_cast<double>(std::max<std::uint64_t>(events, 1)));
}

void print(const NamedMesh& mesh, const std::string& name, const Verdict& v, bool each) {
  if (!each && v.right()) return;
  const core::Vec3& at = v.joined > 0 ? v.joined_at : v.torn > 0 ? v.torn_at : v.crumb_at;
  std::fprintf(stderr, "%s %s, %s: %s; at %.5g %.5g %.5g\n", v.right() ? "right" : "WRONG", mesh.name.c_str(),
               name.c_str(), to_string(v).c_str(), at.x, at.y, at.z);
}

void run_meetings(const Options& options, const NamedMesh& mesh, const oracle::Body& body,
                  const std::string& kind, Totals& totals) {
  for (int i = 0; i < options.count; ++i) {
    auto meeting = oracle::random_meeting(mesh.mesh, body.h, kind,
                                          options.seed + static_cast<std::uint64_t>(i), options.along_axes);
    if (options.batch_h > 0) meeting.batch_h = options.batch_h;
    auto session = std::make_unique<core::CutSession>(mesh.mesh, oracle::meeting_config(meeting));
    const double start = thread_cpu_s();
    if (options.saved) {
      session = oracle::cut_saved(meeting, mesh.mesh);
    } else {
      options.at_once ? oracle::cut_at_once(meeting, *session) : oracle::cut(meeting, *session);
    }
    totals.seconds.push_back(thread_cpu_s() - start);
    const auto strokes = oracle::strokes_of(meeting);
    const Verdict v = oracle::judge(body, strokes, session->mesh());
    totals.add(v, body);
    print(mesh, meeting.name(), v, options.each);
  }
}

void run_hands(const Options& options, const NamedMesh& mesh, const oracle::Body& body, Totals& totals) {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(data_folder() + "/motions"))
    if (entry.path().extension() == ".csv") names.push_back(entry.path().string());
  std::sort(names.begin(), names.end());
  for (const std::string& name : names) {
    const protocol::Motion motion = protocol::read_motion(name);
    for (int i = 0; i < options.count; ++i) {
      const std::uint64_t seed = options.seed + static_cast<std::uint64_t>(i);
      std::vector<oracle::Hand> hands;
      for (std::uint64_t other = 0; other < (options.at_once ? 2 : 1); ++other)
        hands.push_back(oracle::place_hand(motion.samples, mesh.mesh, seed + other,
                                           static_cast<std::size_t>(options.poses)));
      core::CutSession session(mesh.mesh, hands[0].config);
      std::vector<oracle::Stroke> strokes;
      for (std::uint32_t blade = 0; blade < hands.size(); ++blade) {
        session.set_blade(blade, hands[blade].config.blade);
        for (oracle::Stroke& stroke :
             oracle::strokes_of(hands[blade].poses, hands[blade].config.blade, hands[0].config))
          strokes.push_back(std::move(stroke));
      }
      run_timed(session, hands, totals);
      const Verdict v = oracle::judge(body, strokes, session.mesh());
      totals.add(v, body);
      char text[200];
      std::snprintf(text, sizeof text, "%s, seed %llu, %.0f us an event, %.0f ms in all",
                    std::filesystem::path(name).stem().c_str(), static_cast<unsigned long long>(seed),
                    totals.event_us.back(), 1e3 * totals.seconds.back());
      print(mesh, text, v, options.each);
    }
  }
}

std::vector<NamedMesh> meshes_of(const Options& options) {
  std::vector<NamedMesh> meshes;
  for (const std::string& path : options.meshes) meshes.push_back(load(path, options.scale));
  if (!meshes.empty()) return meshes;
  meshes = {phantom("cylinder", 4000), phantom("liver", 8000), phantom("slab", 6000)};
  if (data_folder().empty()) return meshes;
  for (const char* name :
       {"seed_1720.node", "seed_3234.node", "armadillo_3717.node", "liver_6564.node", "sofa_liver2.msh",
        "sofa_volumetricTongue.vtu", "bullet_ditto.vtk", "wound_1476.node", "bunny_27226.node",
        "intestine_52567.node", "liver_80298.node", "brain_81833.node"})
    meshes.push_back(load(data_folder() + "/meshes/" + name, 1));
  return meshes;
}

void run(const Options& options, Report& report) {
  report.begin("meet");
  report.fact("seed", count(options.seed));
  const bool hands = options.kinds == std::vector<std::string>{"hands"};
  if (hands && data_folder().empty()) throw std::runtime_error("INCISE_DATA names no folder with motions");
  std::map<std::string, Totals> by_kind, by_mesh;
  Totals all;
  for (const NamedMesh& mesh : meshes_of(options)) {
    const oracle::Body body(mesh.mesh);
    for (const std::string& kind : options.kinds) {
      Totals one;
      kind == "hands" ? run_hands(options, mesh, body, one) : run_meetings(options, mesh, body, kind, one);
      for (Totals* sum : {&by_kind[kind], &by_mesh[mesh.name], &all}) sum->append(one);
    }
  }
  report.table("cuts that meet, by kind", kColumns);
  for (const std::string& kind : options.kinds) add_row(report, kind, by_kind[kind]);
  report.table("the same, by mesh", kColumns);
  for (const auto& [name, totals] : by_mesh) add_row(report, name, totals);
  add_row(report, "all", all);
}

}  // namespace

void add_meet_bench(CLI::App& app, Report& report) {
  const auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("meet", "Random cuts that meet, and motions of hands, judged by geometry alone");
  command->add_option("--mesh", options->meshes, "Mesh files; without: phantoms, and INCISE_DATA's");
  command->add_option("--scale", options->scale, "Metres in a unit of the files")->capture_default_str();
  std::vector<std::string> kinds = options->kinds;
  kinds.emplace_back("hands");
  command->add_option("--kind", options->kinds, "Which: circle, polygon, ... or hands, INCISE_DATA's motions")
      ->delimiter(',')
      ->check(CLI::IsMember(kinds));
  command->add_option("--count", options->count, "Of each kind, on each mesh")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command->add_option("--seed", options->seed, "Of the first one; the others count on")
      ->capture_default_str();
  command->add_option("--poses", options->poses, "Of each motion, the most")
      ->check(CLI::Range(10, 1000000))
      ->capture_default_str();
  command->add_option("--batch", options->batch_h, "cut.batch_h of all; without: each one's own")
      ->check(CLI::Range(0.05, 2.0));
  command->add_flag("--at-once", options->at_once,
                    "All strokes at once, each by a blade of its own; of hands two");
  command
      ->add_flag("--saved", options->saved,
                 "Each stroke in a session of its own, in the body that the one before has left")
      ->excludes("--at-once");
  command->add_flag("--along-axes", options->along_axes,
                    "Blades and strokes along the axes, in planes of vertices");
  command->add_flag("--each", options->each, "Say a line about each, not only about wrong ones");
  command->callback([options, &report] { run(*options, report); });
}

}  // namespace incise::bench
