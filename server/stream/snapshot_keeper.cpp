#include "server/stream/snapshot_keeper.hpp"

#include <string>
#include <utility>

#include "protocol/surface.hpp"
#include "server/base/check.hpp"
#include "server/stream/mirror.hpp"

namespace incise::stream {

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
void SnapshotKeeper::request(protocol::View view, const std::optional<protocol::Box>& box, bool fields,
                             Ready ready) {
  enqueue(Request{view, box, fields, std::move(ready)});
}

void SnapshotKeeper::run() {
  std::vector<Task> tasks;
  for (;;) {
    tasks.clear();
    {
      std::unique_lock lock(mutex_);
      wake_.wait(lock, [&] { return stopping_ || !tasks_.empty(); });
      if (stopping_) return;
      tasks.swap(tasks_);
    }
    for (Task& task : tasks) {
      if (auto* initial = std::get_if<std::shared_ptr<const InitialState>>(&task)) {
        reset_to(**initial);
      } else if (auto* delta = std::get_if<std::shared_ptr<const PublishedDelta>>(&task)) {
        const protocol::Delta& change = arrays_.assign(**delta, replica_);
        const protocol::ApplyResult result = replica_.apply(change);
        INCISE_CHECK(result, result.text);
        const protocol::ApplyResult carried = fields_.apply(change);
        INCISE_CHECK(carried, carried.text);
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
  fields_.load(std::move(fields));
  if (initial.mirror) {
    replica_ = initial.mirror->volume();
    surface_ = initial.mirror->surface();
    surface_epoch_ = epoch_;
    return;
  }
  surface_.set_origins(initial.origins);
  const std::string problem = load_initial(initial, replica_);
  INCISE_CHECK(problem.empty(), problem);
}

void SnapshotKeeper::encode_fields(Snapshot& snapshot) const {
  const std::vector<protocol::Field>& all = fields_.all();
  for (std::uint32_t place = 0; place < all.size(); ++place) {
    std::vector<SharedFrame>& frames = snapshot.fields.emplace_back();
    protocol::FieldWriter writer(all[place], place, protocol::kChunkElements);
    while (writer.next()) {
      frames.push_back(make_frame(writer.message()));
      snapshot.bytes += frames.back()->tcp().size();
    }
  }
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
  } else if (box) {
    snapshot->part = std::make_shared<BoxPart>(BoxPart{*box, protocol::VolumePart()});
    auto& part = std::get<protocol::VolumePart>(snapshot->part->held);
    part.load_part(replica_, *box);
    encode_all(protocol::VolumePartWriter(part, *box, kCause), replica_.state_hash());
  } else {
    encode_all(protocol::SnapshotWriter(replica_, kCause));
    if (with_fields) encode_fields(*snapshot);
  }
  if (!box) last = snapshot;
  return snapshot;
}

}  // namespace incise::stream
