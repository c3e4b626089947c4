#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace incise::core {

// Sorts in portions, so that it can be interrupted: runs of kRun keys are sorted as they fill up, then the least key
// of all is taken from a heap of the runs' first keys. Keys have a total order (operator<). Keeps its memory.
template <class Key>
class RunSorter {
 public:
  static constexpr std::size_t kRun = 256;

  void clear() {
    keys_.clear();
    heap_.clear();
  }
  // Only before seal(). O(1), except that every kRun-th key sorts a run.
  void push(const Key& key) {
    keys_.push_back(key);
    if (keys_.size() % kRun == 0) sort_last_run();
  }
  // After the last push().
  void seal() {
    if (keys_.size() % kRun != 0) sort_last_run();
    std::make_heap(heap_.begin(), heap_.end(), After{keys_});
  }
  bool empty() const { return heap_.empty(); }
  // Removes and returns the least key. O(log runs).
  Key take() {
    Run& run = heap_.front();
    const Key key = keys_[run.next];
    if (heap_.size() == 1) {
      if (++run.next == run.end) heap_.pop_back();
      return key;
    }
    std::pop_heap(heap_.begin(), heap_.end(), After{keys_});
    if (++heap_.back().next == heap_.back().end) {
      heap_.pop_back();
    } else {
      std::push_heap(heap_.begin(), heap_.end(), After{keys_});
    }
    return key;
  }

 private:
  struct Run {
    std::uint32_t next, end;  // into keys_
  };
  struct After {
    const std::vector<Key>& keys;
    bool operator()(const Run& a, const Run& b) const { return keys[b.next] < keys[a.next]; }
  };
  void sort_last_run() {
    const std::size_t begin = (keys_.size() - 1) / kRun * kRun;
    std::sort(keys_.begin() + static_cast<std::ptrdiff_t>(begin), keys_.end());
    heap_.push_back({static_cast<std::uint32_t>(begin), static_cast<std::uint32_t>(keys_.size())});
  }

  std::vector<Key> keys_;
  std::vector<Run> heap_;
};

}  // namespace incise::core
