#include "server/input/pose_sources.hpp"

#include <algorithm>

#include "server/base/clock.hpp"

namespace incise::input {

// ------------------------------------------------------------------------------------------------ PoseSource

PoseSource& PoseSource::operator=(PoseSource&& other) noexcept {
  std::swap(sources_, other.sources_);
  std::swap(number_, other.number_);
  std::swap(owner_, other.owner_);
  return *this;
}

PoseSource::~PoseSource() {
  if (!sources_) return;
  PoseSources::Slot& slot = *sources_->slots_[number_];
  slot.closed_ns.store(monotonic_ns(), std::memory_order_relaxed);
  slot.state.store(PoseSources::State::kClosing, std::memory_order_release);
  sources_->doorbell_.ring();
}

std::size_t PoseSource::enqueue(std::span<const TimedPose> poses) {
  if (sources_->closed_.load(std::memory_order_acquire)) return 0;
  SpscQueue<InputEvent>& queue = sources_->slots_[number_]->queue;
  std::size_t taken = 0;
  for (const TimedPose& pose : poses) {
    if (!queue.push(InputEvent{InputEvent::Kind::kPose, pose, {}, 0, nullptr})) break;
    ++taken;
  }
  if (taken > 0) sources_->doorbell_.ring();
  return taken;
}

bool PoseSource::end_stroke(std::int64_t arrival_ns) {
  if (sources_->closed_.load(std::memory_order_acquire)) return false;
  const bool taken = sources_->slots_[number_]->queue.push(
      InputEvent{InputEvent::Kind::kEndStroke, {{}, arrival_ns}, {}, 0, nullptr});
  if (taken) sources_->doorbell_.ring();
  return taken;
}

SourceCounts PoseSource::counts() const {
  const PoseSources::Slot& slot = *sources_->slots_[number_];
  SourceCounts counts;
  for (std::size_t i = 0; i < counts.verdicts.size(); ++i) {
    const std::uint64_t acknowledged = slot.acknowledged[i].load(std::memory_order_acquire),
                        before = slot.before[i].load(std::memory_order_relaxed);
    counts.verdicts[i] = acknowledged > before ? acknowledged - before : 0;
    counts.drained += counts.verdicts[i];
  }
  const std::uint64_t accepted =
      counts.count(core::PoseVerdict::kAccepted) + counts.count(core::PoseVerdict::kNewStroke);
  counts.last_source_ns = accepted > 0 ? slot.last_source_ns.load(std::memory_order_relaxed) : 0;
  // Read last: a pose counts as recorded before it is acknowledged, so none seems lost.
  if (slot.recorded_owner.load(std::memory_order_acquire) == owner_) {
    counts.recorded = std::min(slot.recorded.load(std::memory_order_acquire), accepted);
    counts.recorded_source_ns = slot.recorded_source_ns.load(std::memory_order_relaxed);
  }
  return counts;
}

// ------------------------------------------------------------------------------------------------ PoseSources

PoseSources::PoseSources(const core::Blade& blade, std::vector<Declared> declared, std::size_t queue_capacity)
    : blade_(blade), declared_(std::move(declared)) {
  for (std::size_t i = 0; i < slots_.size(); ++i) {
    slots_[i] = std::make_unique<Slot>(queue_capacity);
    if (i < declared_.size()) slots_[i]->name = declared_[i].name;
  }
}

PoseSources::~PoseSources() = default;

std::optional<PoseSource> PoseSources::open(std::string_view name,
                                            const std::optional<core::Blade>& own_blade) {
  const std::scoped_lock lock(mutex_);
  if (closed_.load(std::memory_order_acquire)) return std::nullopt;
  const auto free = [&](std::size_t i) {
    return slots_[i]->state.load(std::memory_order_acquire) == State::kFree;
  };
  // Who comes back gets the number that it had, and others the one that nobody has missed for longest.
  const auto has_name = [&](const auto& slot) { return slot->name == name; };
  std::optional<std::uint32_t> number;
  for (std::uint32_t i = 0; i < slots_.size(); ++i) {
    if (has_name(slots_[i]) && !free(i)) return std::nullopt;
    const auto idle_since = [&](std::uint32_t slot) {
      return slots_[slot]->closed_ns.load(std::memory_order_relaxed);
    };
    if (i >= declared_.size() && free(i) && (!number || idle_since(i) < idle_since(*number))) number = i;
  }
  const auto its_own = std::ranges::find_if(slots_, has_name);
  if (its_own != slots_.end()) number = static_cast<std::uint32_t>(its_own - slots_.begin());
  if (!number) return std::nullopt;
  Slot& slot = *slots_[*number];
  slot.name = name;
  // The loop freed the slot after it had counted its last pose.
  for (std::size_t i = 0; i < slot.before.size(); ++i)
    slot.before[i].store(slot.counted[i].load(std::memory_order_relaxed), std::memory_order_relaxed);
  // The slot is free: its queue is empty, and the loop does not look at it before the state says kOpen.
  const core::Blade& blade = own_blade                    ? *own_blade
                             : *number < declared_.size() ? declared_[*number].blade
                                                          : blade_;
  slot.queue.push(InputEvent{InputEvent::Kind::kOpened,
                             {{}, monotonic_ns()},
                             blade,
                             ++slot.owners,
                             std::make_shared<const std::string>(name)});
  slot.state.store(State::kOpen, std::memory_order_release);
  return PoseSource(this, *number, slot.owners);
}

bool PoseSources::is_open(std::string_view name) const {
  const std::scoped_lock lock(mutex_);
  for (const auto& slot : slots_) {
    if (slot->name == name && slot->state.load(std::memory_order_acquire) != State::kFree) return true;
  }
  return false;
}

bool PoseSources::is_held(std::string_view name) const {
  const std::scoped_lock lock(mutex_);
  for (const auto& slot : slots_) {
    if (slot->name == name && slot->state.load(std::memory_order_acquire) == State::kOpen) return true;
  }
  return false;
}

void PoseSources::count(std::uint32_t source, core::PoseVerdict verdict) {
  // One writer: a load and a store, not a locked addition.
  auto& counter = slots_[source]->counted[static_cast<std::size_t>(verdict)];
  counter.store(counter.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
}

void PoseSources::acknowledge(std::uint32_t source, core::PoseVerdict verdict, std::int64_t source_ns) {
  Slot& slot = *slots_[source];
  if (core::accepted(verdict)) slot.last_source_ns.store(source_ns, std::memory_order_relaxed);
  slot.acknowledged[static_cast<std::size_t>(verdict)].fetch_add(1, std::memory_order_release);
}

void PoseSources::acknowledge_recorded(std::uint32_t source, std::uint32_t owner, std::int64_t source_ns) {
  Slot& slot = *slots_[source];
  if (slot.recorded_owner.load(std::memory_order_relaxed) != owner) {
    slot.recorded.store(0, std::memory_order_relaxed);
    slot.recorded_owner.store(owner, std::memory_order_release);
  }
  slot.recorded_source_ns.store(source_ns, std::memory_order_relaxed);
  slot.recorded.fetch_add(1, std::memory_order_release);
}

PoseSources::Marks PoseSources::queued() const {
  Marks marks{};
  for (std::size_t i = 0; i < slots_.size(); ++i) marks[i] = slots_[i]->queue.pushed();
  return marks;
}

std::size_t PoseSources::waiting() const {
  std::size_t waiting = 0;
  for (const auto& slot : slots_) waiting += slot->queue.size();
  return waiting;
}

std::uint32_t PoseSources::open_count() const {
  std::uint32_t open = 0;
  for (const auto& slot : slots_) open += slot->state.load(std::memory_order_acquire) == State::kOpen;
  return open;
}

PoseSources::Tally PoseSources::tally(std::uint32_t source) const {
  const std::scoped_lock lock(mutex_);  // so that nobody opens it meanwhile
  const Slot& slot = *slots_[source];
  Tally tally;
  tally.open = slot.state.load(std::memory_order_acquire) == State::kOpen;
  for (std::size_t i = 0; i < slot.before.size(); ++i) {
    const std::uint64_t acknowledged = slot.acknowledged[i].load(std::memory_order_acquire),
                        before = slot.before[i].load(std::memory_order_relaxed);
    if (acknowledged > before) {
      (core::accepted(static_cast<core::PoseVerdict>(i)) ? tally.accepted : tally.rejected) +=
          acknowledged - before;
    }
  }
  return tally;
}

std::string PoseSources::name_of(std::uint32_t source) const {
  const std::scoped_lock lock(mutex_);
  return slots_[source]->name;
}

}  // namespace incise::input
