#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "protocol/messages.hpp"
#include "server/cluster/feed_publisher.hpp"
#include "server/input/hid/hid_input.hpp"
#include "server/input/network_status.hpp"
#include "server/input/pose_sources.hpp"
#include "server/loop/journal.hpp"
#include "server/loop/loop_stats.hpp"
#include "server/stream/server.hpp"

namespace incise::app {

// What the server reports about itself, from any thread: the loop's statistics as JSON, as Prometheus text and as the
// statistics message. Reads counters only; takes no lock that the loop could wait for.
class Telemetry {
 public:
  // `journal` may be null. All must outlive this.
  Telemetry(const loop::LoopStats& stats, const input::PoseSources& sources, const loop::Journal* journal,
            double rate_hz);
  // Where to ask about devices; call it before the first report.
  void join(std::function<std::vector<input::DeviceStatus>()> devices) { devices_ = std::move(devices); }
  // And about sources on the network.
  void join_network(std::function<std::vector<input::NetworkStatus>()> network) {
    network_ = std::move(network);
  }
  // And about the sessions.
  void join_stream(std::function<stream::StreamCounters()> counters) { stream_ = std::move(counters); }

  // And about what is published on NATS.
  void join_cluster(std::function<cluster::PublisherCounters()> cluster) { cluster_ = std::move(cluster); }

  // One JSON object: state, backlog, histograms (p50, p90, p99, p99.9, max, in microseconds) by stage.
  std::string json() const;
  // Prometheus text format 0.0.4.
  std::string metrics() const;
  protocol::Stats message() const;
  // Where the blades are now.
  std::vector<protocol::BladePose> blades() const;

 private:
  protocol::BladeStats blade_stats(std::uint32_t source, const loop::BladeNow& blade,
                                   const input::PoseSources::Tally& tally) const;

  const loop::LoopStats& stats_;
  const input::PoseSources& sources_;
  const loop::Journal* const journal_;
  const double rate_hz_;
  std::function<std::vector<input::DeviceStatus>()> devices_;
  std::function<std::vector<input::NetworkStatus>()> network_;
  std::function<stream::StreamCounters()> stream_;
  std::function<cluster::PublisherCounters()> cluster_;
};

// What a server's ports and peers did, as in /stats.
nlohmann::ordered_json access_json(const stream::StreamCounters& counters);
nlohmann::ordered_json stream_json(const stream::StreamCounters& counters);

}  // namespace incise::app
