#include "server/stream/snapshot_keeper.hpp"

#include <algorithm>
#include <string>
#include <utility>

#include "protocol/surface.hpp"
#include "server/base/check.hpp"
#include "server/base/thread_name.hpp"
#include "server/stream/mirror.hpp"

namespace incise::stream {
namespace {

constexpr std::size_t kMostToSet_bytes = 128u << 20;  // values of fields that may wait

}  // namespace

protocol::FieldFacts facts_of(const core::Field& field) {
  return {field.name, static_cast<protocol::FieldOn>(field.on), static_cast<std::uint32_t>(field.components),
          field.values.index() == 1};
}

SnapshotKeeper::SnapshotKeeper() : thread_([this] { run(); }) {}

SnapshotKeeper::~SnapshotKeeper() {
  {
    const std::scoped_lock lock(mutex_);
    stopping_ = true;
  }
  wake_.notify_one();
  thread_.join();
}

void SnapshotKeeper::enqueue(Task task) {
  {
    const std::scoped_lock lock(mutex_);
    tasks_.push_back(std::move(task));
  }
  wake_.notify_one();
}

void SnapshotKeeper::reset(std::shared_ptr<const InitialState> initial) {
  enqueue(std::move(initial));
}
void SnapshotKeeper::apply(std::shared_ptr<const PublishedDelta> delta) {
  enqueue(std::move(delta));
}
void SnapshotKeeper::apply(std::shared_ptr<const ReceivedDelta> delta) {
  enqueue(std::move(delta));
}
void SnapshotKeeper::request(protocol::View view, const std::optional<protocol::Box>& box, bool fields,
                             Ready ready) {
  enqueue(Request{view, box, fields, std::move(ready)});
}

bool SnapshotKeeper::set(NewFieldValues values, bool always) {
  const std::size_t bytes = std::visit([](const auto& v) { return 4 * v.size(); }, values.values);
  {
    const std::scoped_lock lock(mutex_);
    if (bytes_to_set_ > kMostToSet_bytes && !always) return false;
    bytes_to_set_ += bytes;
  }
  enqueue(std::move(values));
  return true;
}
void SnapshotKeeper::request_fields(std::vector<std::uint32_t> fields, FieldsReady ready) {
  enqueue(FieldsRequest{std::move(fields), std::move(ready)});
}

void SnapshotKeeper::run() {
  name_thread("snapshots");
  std::vector<Task> tasks;
  for (;;) {
    tasks.clear();
    {
      std::unique_lock lock(mutex_);
      wake_.wait(lock, [&] { return stopping_ || !tasks_.empty(); });
      if (stopping_) return;
      tasks.swap(tasks_);
      bytes_to_set_ = 0;
    }
    for (Task& task : tasks) {
      if (auto* initial = std::get_if<std::shared_ptr<const InitialState>>(&task)) {
        reset_to(**initial);
      } else if (auto* delta = std::get_if<std::shared_ptr<const PublishedDelta>>(&task)) {
        apply_now(arrays_.assign(**delta, replica_));
      } else if (auto* received = std::get_if<std::shared_ptr<const ReceivedDelta>>(&task)) {
        apply_now((*received)->delta());
      } else if (const auto* values = std::get_if<NewFieldValues>(&task)) {
        set_now(*values);
      } else if (const auto* wanted = std::get_if<FieldsRequest>(&task)) {
        std::vector<SharedFrames> frames;
        for (const std::uint32_t field : wanted->fields) frames.push_back(field_frames(field));
        wanted->ready(epoch_, std::move(frames));
      } else {
        const Request& request = std::get<Request>(task);
        request.ready(encode(request));
      }
      task = Task{};  // releases the delta at once
    }
  }
}

void SnapshotKeeper::reset_to(const InitialState& initial) {
  epoch_ = initial.epoch;
  std::vector<protocol::Field> fields;
  if (initial.fields) {
    for (const core::Field& field : *initial.fields) fields.push_back({facts_of(field), field.values});
  }
  field_frames_.assign(fields.size(), nullptr);
  fields_.load(std::move(fields));
  if (initial.mirror) {
    replica_ = initial.mirror->volume();
    surface_ = initial.mirror->surface();
    surface_epoch_ = epoch_;
  } else {
    surface_.set_origins(initial.origins);
    const std::string problem = load_initial(initial, replica_);
    INCISE_CHECK(problem.empty(), problem);
  }
  if (fields_.all().empty()) return;
  vertex_since_.assign(replica_.vertex_count(), replica_.revision());
  tet_since_.assign(replica_.tet_slots(), replica_.revision());
}

void SnapshotKeeper::apply_now(const protocol::Delta& delta) {
  const protocol::ApplyResult result = replica_.apply(delta);
  INCISE_CHECK(result, result.text);
  if (fields_.all().empty()) return;
  const protocol::ApplyResult carried = fields_.apply(delta);
  INCISE_CHECK(carried, carried.text);
  vertex_since_.resize(replica_.vertex_count(), delta.revision);
  for (const std::uint32_t v : delta.blend_ids) vertex_since_[v] = delta.revision;
  tet_since_.resize(replica_.tet_slots(), delta.revision);
  field_frames_.assign(fields_.all().size(), nullptr);
}

void SnapshotKeeper::set_now(const NewFieldValues& given) {
  protocol::Field& field = fields_.at(given.field);
  const std::vector<std::uint64_t>& since =
      field.facts.on == protocol::FieldOn::Vertices ? vertex_since_ : tet_since_;
  const std::size_t components = field.facts.components;
  std::visit(
      [&](auto& held) {
        const auto& values = std::get<std::decay_t<decltype(held)>>(given.values);
        for (std::size_t i = 0; i * components < values.size(); ++i) {
          const std::size_t id = given.first + i;
          if (id >= std::min(field.rows(), since.size()) || since[id] > given.revision) continue;
          std::copy_n(&values[components * i], components, &held[components * id]);
        }
      },
      field.values);
  field_frames_[given.field] = nullptr;
  last_[static_cast<std::size_t>(protocol::View::Volume)].reset();
}

SharedFrames SnapshotKeeper::field_frames(std::uint32_t field) {
  SharedFrames& frames = field_frames_[field];
  if (frames) return frames;
  std::vector<SharedFrame> made;
  protocol::FieldWriter writer(fields_.all()[field], field, replica_.revision(), protocol::kChunkElements);
  while (writer.next()) made.push_back(make_frame(writer.message()));
  return frames = std::make_shared<const std::vector<SharedFrame>>(std::move(made));
}

std::shared_ptr<const Snapshot> SnapshotKeeper::encode(const Request& request) {
  const auto& [view, box, with_fields, ready] = request;
  std::weak_ptr<const Snapshot>& last = last_[static_cast<std::size_t>(view)];
  if (auto same = last.lock(); same && !box && same->epoch == epoch_ &&
                               same->begin.revision == replica_.revision() &&
                               (!with_fields || same->fields.size() == fields_.all().size())) {
    return same;
  }
  auto snapshot = std::make_shared<Snapshot>();
  snapshot->epoch = epoch_;
  const auto add = [&](const protocol::SnapshotChunk& chunk) {
    snapshot->chunks.push_back(make_frame(chunk));
    snapshot->bytes += snapshot->chunks.back()->tcp().size();
  };
  const auto encode_all = [&](auto writer, auto&&... hash) {
    protocol::SnapshotBegin& begin = snapshot->begin = writer.begin();
    snapshot->piece_ids.assign(begin.piece_ids.begin(), begin.piece_ids.end());
    snapshot->piece_names.assign(begin.piece_names.begin(), begin.piece_names.end());
    begin.piece_ids = snapshot->piece_ids;
    begin.piece_names = snapshot->piece_names;
    while (writer.next()) add(writer.chunk());
    snapshot->end = make_frame(writer.end(hash...));
  };
  constexpr auto kCause = protocol::SnapshotCause::Join;
  if (view == protocol::View::Surface) {
    if (surface_.revision() != replica_.revision() || surface_epoch_ != epoch_) surface_.load(replica_);
    surface_epoch_ = epoch_;
    if (box) {
      snapshot->part = std::make_shared<BoxPart>(BoxPart{*box, protocol::SurfaceReplica()});
      auto& part = std::get<protocol::SurfaceReplica>(snapshot->part->held);
      part.load_part(surface_, *box);
      encode_all(protocol::SurfaceSnapshotWriter(part, kCause), replica_.state_hash());
      snapshot->begin.box = box;
    } else {
      encode_all(protocol::SurfaceSnapshotWriter(surface_, kCause), replica_.state_hash());
    }
    snapshot->begin.tet_count = replica_.live_tets();
  } else if (box) {
    snapshot->part = std::make_shared<BoxPart>(BoxPart{*box, protocol::VolumePart()});
    auto& part = std::get<protocol::VolumePart>(snapshot->part->held);
    part.load_part(replica_, *box);
    encode_all(protocol::VolumePartWriter(part, *box, kCause), replica_.state_hash());
  } else {
    encode_all(protocol::SnapshotWriter(replica_, kCause));
    for (std::uint32_t field = 0; with_fields && field < fields_.all().size(); ++field)
      snapshot->fields.push_back(field_frames(field));
  }
  if (!box) last = snapshot;
  return snapshot;
}

}  // namespace incise::stream
