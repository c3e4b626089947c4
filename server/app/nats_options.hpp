#pragma once

#include "server/app/config.hpp"
#include "server/cluster/nats_client.hpp"

namespace incise::app {

// The section cluster, as the connection wants it.
cluster::NatsOptions nats_options(const Config& config);

}  // namespace incise::app
