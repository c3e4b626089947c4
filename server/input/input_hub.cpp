#include "server/input/input_hub.hpp"

#include <algorithm>

#include "server/base/clock.hpp"

namespace incise::input {

// ------------------------------------------------------------------------------------------------
// SourceHandle

SourceHandle& SourceHandle::operator=(SourceHandle&& other) noexcept {
  std::swap(hub_, other.hub_);
  std::swap(number_, other.number_);
  std::swap(owner_, other.owner_);
  return *this;
}

SourceHandle::~SourceHandle() {
  if (!hub_) return;
  InputHub::Slot& slot = *hub_->slots_[number_];
  slot.closed_ns.store(monotonic_ns(), std::memory_order_relaxed);
  slot.state.store(InputHub::State::kClosing, std::memory_order_release);
}

std::size_t SourceHandle::push(std::span<const TimedPose> poses) {
  if (hub_->closed_.load(std::memory_order_acquire)) return 0;
  SpscQueue<InputEvent>& queue = hub_->slots_[number_]->queue;
  std::size_t taken = 0;
  for (const TimedPose& pose : poses) {
    if (!queue.push(InputEvent{InputEvent::Kind::kPose, pose, {}, 0})) break;
    ++taken;
  }
  return taken;
}

bool SourceHandle::end_stroke(std::int64_t arrival_ns) {
  if (hub_->closed_.load(std::memory_order_acquire)) return false;
  return hub_->slots_[number_]->queue.push(InputEvent{InputEvent::Kind::kEndStroke, {{}, arrival_ns}, {}, 0});
}

SourceCounts SourceHandle::counts() const {
  const InputHub::Slot& slot = *hub_->slots_[number_];
  SourceCounts counts;
  for (std::size_t i = 0; i < counts.verdicts.size(); ++i) {
    const std::uint64_t told = slot.told[i].load(std::memory_order_acquire),
                        before = slot.before[i].load(std::memory_order_relaxed);
    counts.verdicts[i] = told > before ? told - before : 0;
    counts.drained += counts.verdicts[i];
  }
  const std::uint64_t accepted =
      counts.count(core::PoseVerdict::kAccepted) + counts.count(core::PoseVerdict::kNewStroke);
  counts.last_source_ns = accepted > 0 ? slot.last_source_ns.load(std::memory_order_relaxed) : 0;
  // Read after the others: a pose counts as recorded before it is told of, so none seems to be lost.
  if (slot.recorded_owner.load(std::memory_order_acquire) == owner_) {
    counts.recorded = std::min(slot.recorded.load(std::memory_order_acquire), accepted);
    counts.recorded_source_ns = slot.recorded_source_ns.load(std::memory_order_relaxed);
  }
  return counts;
}

// ------------------------------------------------------------------------------------------------ InputHub

InputHub::InputHub(const core::Blade& blade, std::vector<Declared> declared, std::size_t queue_capacity)
    : blade_(blade), declared_(std::move(declared)) {
  for (std::size_t i = 0; i < slots_.size(); ++i) {
    slots_[i] = std::make_unique<Slot>(queue_capacity);
    if (i < declared_.size()) slots_[i]->name = declared_[i].name;
  }
}

InputHub::~InputHub() = default;

std::optional<SourceHandle> InputHub::open_source(std::string_view name,
                                                  const std::optional<core::Blade>& own_blade) {
  const std::scoped_lock lock(mutex_);
  if (closed_.load(std::memory_order_acquire)) return std::nullopt;
  const auto free = [&](std::size_t i) {
    return slots_[i]->state.load(std::memory_order_acquire) == State::kFree;
  };
  std::optional<std::uint32_t> number;
  for (std::uint32_t i = 0; i < slots_.size(); ++i) {
    if (slots_[i]->name == name && (i < declared_.size() || !free(i))) {
      if (!free(i)) return std::nullopt;
      number = i;
      break;
    }
    if (!number && i >= declared_.size() && free(i)) number = i;
  }
  if (!number) return std::nullopt;
  Slot& slot = *slots_[*number];
  slot.name = name;
  // The loop gave the slot free after it had counted the last one.
  for (std::size_t i = 0; i < slot.before.size(); ++i)
    slot.before[i].store(slot.counted[i].load(std::memory_order_relaxed), std::memory_order_relaxed);
  // The slot is free: its queue is empty, and the loop does not look at it before the state says kOpen.
  const core::Blade& blade = own_blade                    ? *own_blade
                             : *number < declared_.size() ? declared_[*number].blade
                                                          : blade_;
  slot.queue.push(InputEvent{InputEvent::Kind::kOpened, {{}, monotonic_ns()}, blade, ++slot.owners});
  slot.state.store(State::kOpen, std::memory_order_release);
  return SourceHandle(this, *number, slot.owners);
}

bool InputHub::is_open(std::string_view name) const {
  const std::scoped_lock lock(mutex_);
  for (const auto& slot : slots_) {
    if (slot->name == name && slot->state.load(std::memory_order_acquire) != State::kFree) return true;
  }
  return false;
}

void InputHub::count(std::uint32_t source, core::PoseVerdict verdict) {
  // One writer: a load and a store, not a locked addition.
  auto& counter = slots_[source]->counted[static_cast<std::size_t>(verdict)];
  counter.store(counter.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
}

void InputHub::tell(std::uint32_t source, core::PoseVerdict verdict, std::int64_t source_ns) {
  Slot& slot = *slots_[source];
  if (core::accepted(verdict)) slot.last_source_ns.store(source_ns, std::memory_order_relaxed);
  slot.told[static_cast<std::size_t>(verdict)].fetch_add(1, std::memory_order_release);
}

void InputHub::tell_recorded(std::uint32_t source, std::uint32_t owner, std::int64_t source_ns) {
  Slot& slot = *slots_[source];
  if (slot.recorded_owner.load(std::memory_order_relaxed) != owner) {
    slot.recorded.store(0, std::memory_order_relaxed);
    slot.recorded_owner.store(owner, std::memory_order_release);
  }
  slot.recorded_source_ns.store(source_ns, std::memory_order_relaxed);
  slot.recorded.fetch_add(1, std::memory_order_release);
}

std::size_t InputHub::waiting() const {
  std::size_t waiting = 0;
  for (const auto& slot : slots_) waiting += slot->queue.size();
  return waiting;
}

std::uint32_t InputHub::open_sources() const {
  std::uint32_t open = 0;
  for (const auto& slot : slots_) open += slot->state.load(std::memory_order_acquire) == State::kOpen;
  return open;
}

std::string InputHub::name_of(std::uint32_t source) const {
  const std::scoped_lock lock(mutex_);
  return slots_[source]->name;
}

}  // namespace incise::input
