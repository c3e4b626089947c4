#include "server/input/hid/hid_device.hpp"

#include <spdlog/spdlog.h>
#include <sys/prctl.h>

#include <algorithm>
#include <cmath>
#include <ctime>

#include "server/base/clock.hpp"

namespace incise::input {
namespace {

constexpr int kReadTimeout_ms = 50;  // the longest that ending the thread may take

void sleep_until(std::int64_t ns) {
  const timespec time{ns / 1'000'000'000, ns % 1'000'000'000};
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &time, nullptr);
}

}  // namespace

// ------------------------------------------------------------------------------------------------ opening

std::unique_ptr<HidDevice> HidDevice::open(Setup setup, const std::vector<HidInterface>& all,
                                           const Surroundings& surroundings, std::string& error) {
  std::unique_ptr<HidDevice> device(new HidDevice(std::move(setup), surroundings));
  if (!device->open_handles(all, error) || !device->open_sources(error)) return nullptr;
  if (device->setup_.profile.force) {
    device->slot_ = &surroundings.forces[device->sources_.front().number()];
    device->slot_->device_came(device->setup_.profile.force->max_newtons,
                               device->setup_.profile.force->max_newton_metres);
    device->writer_ = std::jthread([d = device.get()](const std::stop_token& stop) { d->write_loop(stop); });
  }
  device->reader_ = std::jthread([d = device.get()](const std::stop_token& stop) { d->read_loop(stop); });
  return device;
}

HidDevice::HidDevice(Setup setup, const Surroundings& surroundings)
    : setup_(std::move(setup)), surroundings_(surroundings), decoder_(setup_.profile, setup_.placement) {}

HidDevice::~HidDevice() {
  if (writer_.joinable()) {
    writer_.request_stop();
    writer_.join();
  }
  if (reader_.joinable()) {
    reader_.request_stop();
    reader_.join();
  }
  if (slot_ && !lost()) slot_->device_lost();
  if (!lost() && writing_) {
    std::string error;
    send_all(setup_.profile.stop, setup_.interface, *writing_, list_hid_interfaces(), error);
  }
}

bool HidDevice::open_sources(std::string& error) {
  for (const std::string& name : sources()) {
    auto source = surroundings_.sources.open(name);
    if (!source) {
      error = "no blade is free: \"" + name + "\" is in use, or all " + std::to_string(core::kMaxSources) +
              " are";
      sources_.clear();
      return false;
    }
    sources_.push_back(std::move(*source));
  }
  return true;
}

bool HidDevice::open_handles(const std::vector<HidInterface>& all, std::string& error) {
  reading_ = HidHandle::open(setup_.interface.path, error);
  if (reading_) writing_ = HidHandle::open(setup_.interface.path, error);
  if (!reading_ || !writing_) return false;
  return send_all(setup_.profile.start, setup_.interface, *writing_, all, error);
}

std::vector<std::string> HidDevice::sources() const {
  std::vector<std::string> names;
  for (const ToolProfile& tool : setup_.profile.tools) {
    names.push_back(tool.name.empty() ? setup_.name : setup_.name + "." + tool.name);
  }
  return names;
}

DeviceFigures HidDevice::figures() const {
  const std::scoped_lock lock(mutex_);
  DeviceFigures figures = shared_;
  figures.forces_written = forces_written_.load(std::memory_order_relaxed);
  figures.forces_failed = forces_failed_.load(std::memory_order_relaxed);
  const auto us = [&](double q) { return 1e-3 * static_cast<double>(pose_to_report_.quantile_ns(q)); };
  figures.pose_to_report = {us(0.5), us(0.99), us(0.999), us(1)};
  return figures;
}

// ------------------------------------------------------------------------------------------------ reading

void HidDevice::read_loop(const std::stop_token& stop) {
  surroundings_.on_thread();
  std::vector<std::uint8_t> report(kMaxReportBytes);
  while (!stop.stop_requested()) {
    int bytes = reading_->read(report, kReadTimeout_ms);
    for (; bytes > 0 && !stop.stop_requested(); bytes = reading_->read(report, 0)) {
      handle_report(std::span(report).first(static_cast<std::size_t>(bytes)), stop);
    }
    publish_figures();
    if (bytes < 0) {
      lose();
      return;
    }
  }
}

void HidDevice::handle_report(std::span<const std::uint8_t> report, const std::stop_token& stop) {
  const std::int64_t arrival_ns = monotonic_ns();
  for (const PoseDecoder::Sample& sample : decoder_.decode(report, arrival_ns))
    enqueue(sample, arrival_ns, stop);
}

void HidDevice::enqueue(const PoseDecoder::Sample& sample, std::int64_t arrival_ns,
                        const std::stop_token& stop) {
  const std::size_t tool = sample.tool;
  const auto pushed = [&] {
    if (sample.valid) {
      const TimedPose pose{sample.pose, arrival_ns};
      return sources_[tool].enqueue(std::span(&pose, 1)) == 1;
    }
    return !in_sight_[tool] || sources_[tool].end_stroke(arrival_ns);
  };
  // A full queue: the loop is far behind. The reports wait in the system's queue, and what does not fit there shows in
  // the device's counter.
  while (!pushed() && !stop.stop_requested()) {
    sleep_until(monotonic_ns() + 1'000'000);
    ++full_queue_ms_;
  }
  in_sight_[tool] = sample.valid;
}

void HidDevice::lose() {
  // At once: end the strokes, and tell the loop that nobody feels its forces.
  if (slot_) slot_->device_lost();
  for (PoseSource& source : sources_) source.end_stroke(monotonic_ns());
  lost_.store(true, std::memory_order_release);
  surroundings_.on_loss();
}

void HidDevice::publish_figures() {
  const std::unique_lock lock(mutex_, std::try_to_lock);
  if (!lock) return;
  shared_.reports = decoder_.counts();
  shared_.drift_ppm = decoder_.drift_ppm();
  shared_.full_queue_ms = full_queue_ms_;
}

// ------------------------------------------------------------------------------------------------ forces

void HidDevice::write_loop(const std::stop_token& stop) {
  surroundings_.on_thread();
  const ForceProfile& profile = *setup_.profile.force;
  const auto period_ns = static_cast<std::int64_t>(1e9 / profile.rate_hz);
  ForceReport report(profile, decoder_);
  haptics::ForceCommand newest;
  const auto write = [&](std::span<const std::uint8_t> bytes) {
    if (lost()) return;
    if (writing_->write(bytes)) {
      forces_written_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    forces_failed_.fetch_add(1, std::memory_order_relaxed);
    report.failed();
    if (!lost()) slot_->write_failed();
  };
  // Lets this thread's sleeps end on time; by default Linux adds up to 50 us.
  prctl(PR_SET_TIMERSLACK, 1000UL, 0UL, 0UL, 0UL);
  std::int64_t last_ns = 0, pose_ns = 0;
  while (!stop.stop_requested() && !lost()) {
    const bool fresh = slot_->read(newest);
    const std::int64_t now_ns = monotonic_ns();
    // A device hears something at its rate even where the loop has missed a frame: it may let go when it hears nothing;
    // and an old force comes to 0.
    if (fresh || now_ns - last_ns >= period_ns * 5 / 4) {
      write(report.make(newest, now_ns));
      if (newest.pose_ns != pose_ns) pose_to_report_.record(monotonic_ns() - newest.pose_ns);
      pose_ns = newest.pose_ns;
      last_ns = now_ns;
      sleep_until(now_ns + period_ns * 4 / 5);  // then look often: this falls into step with the loop
    } else {
      sleep_until(now_ns + std::min<std::int64_t>(period_ns / 20, 1'000'000));
    }
  }
  write(report.zero());
}

ForceReport::ForceReport(const ForceProfile& profile, const PoseDecoder& axes)
    : profile_(profile),
      axes_(axes),
      bytes_(profile.bytes),
      guard_(profile.max_newtons, profile.max_newton_metres) {}

std::span<const std::uint8_t> ForceReport::zero() noexcept {
  return make({}, 0);
}

std::span<const std::uint8_t> ForceReport::make(const haptics::ForceCommand& newest,
                                                std::int64_t now_ns) noexcept {
  const core::Vec3 force = guard_.pass(newest, now_ns);
  const core::Vec3 device = axes_.device_from_world(force);
  const double components[3]{device.x, device.y, device.z};
  for (std::size_t i = 0; i < 3; ++i) {
    if (profile_.components[i]) profile_.components[i]->write(bytes_, components[i]);
  }
  const core::Vec3 turn = axes_.device_torque_from_world(guard_.pass_torque(newest, now_ns));
  const double turns[3]{turn.x, turn.y, turn.z};
  for (std::size_t i = 0; i < 3; ++i) {
    if (profile_.torque[i]) profile_.torque[i]->write(bytes_, turns[i]);
  }
  for (const ReportField& field : profile_.magnitudes) field.write(bytes_, core::length(force));
  return bytes_;
}

}  // namespace incise::input
