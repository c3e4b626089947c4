#pragma once

#include <string>
#include <vector>

namespace incise::loop {

// What a real-time thread may ask of the system. Each function returns a line for people: what was granted, or what was
// not, why, and what to set. None fails: without the grants the loop runs, only with more jitter.

// SCHED_FIFO with this priority (1 to 99) for the calling thread.
std::string request_priority(int priority);
// Keeps the calling thread on one processor.
std::string request_cpu(int cpu);
// Keeps the whole process in memory, each page from its first use.
std::string request_locked_memory();

}  // namespace incise::loop
