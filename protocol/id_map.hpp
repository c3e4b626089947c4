#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <utility>
#include <vector>

namespace incise::protocol {

// Up to 64 elements by index: which there are, and these one after another.
template <class T>
struct Sparse64 {
  std::uint64_t present = 0;
  std::vector<T> elements;

  static std::uint64_t bit(unsigned i) { return std::uint64_t{1} << i; }
  std::size_t place(unsigned i) const {
    return static_cast<std::size_t>(std::popcount(present & (bit(i) - 1)));
  }
  const T* find(unsigned i) const { return present & bit(i) ? &elements[place(i)] : nullptr; }
  // Makes it where there is none.
  T& at(unsigned i) {
    const std::size_t k = place(i);
    if (!(present & bit(i))) {
      elements.insert(elements.begin() + static_cast<std::ptrdiff_t>(k), T{});
      present |= bit(i);
    }
    return elements[k];
  }
  void erase(unsigned i) {
    elements.erase(elements.begin() + static_cast<std::ptrdiff_t>(place(i)));
    present &= ~bit(i);
  }
};

// Values by id, in the order of the ids. For ids that are assigned in ascending order, some of them in use, such as a surface's
// vertices and half-faces. Looking one up takes three steps, whatever the size; a value takes its own bytes and, with few
// neighbours, up to a hundred more. The whole takes 32 bytes for each 4,096 ids up to the largest.
template <class T>
class IdMap {
 public:
  // Over ids and values, ascending.
  class Iterator {
   public:
    Iterator() = default;
    std::pair<std::uint32_t, const T&> operator*() const {
      return {static_cast<std::uint32_t>(id_), *value_};
    }
    Iterator& operator++() {
      ++id_;
      advance();
      return *this;
    }
    bool operator==(const Iterator& other) const { return id_ == other.id_; }

   private:
    friend IdMap;
    Iterator(const IdMap* map, std::uint64_t id) : map_(map), id_(id) { advance(); }
    // To the first element that is not before id_.
    void advance() {
      const auto& blocks = map_->blocks_;
      while (id_ >> 12 < blocks.size()) {
        const Block& block = blocks[id_ >> 12];
        const std::uint64_t pages = block.present >> (id_ >> 6 & 63);
        if (pages == 0) {
          id_ = ((id_ >> 12) + 1) << 12;
          continue;
        }
        if (const int passed = std::countr_zero(pages); passed > 0)
          id_ = ((id_ >> 6) + static_cast<unsigned>(passed)) << 6;
        const Page& page = *block.find(id_ >> 6 & 63);
        const std::uint64_t values = page.present >> (id_ & 63);
        if (values == 0) {
          id_ = ((id_ >> 6) + 1) << 6;
          continue;
        }
        id_ += static_cast<unsigned>(std::countr_zero(values));
        value_ = page.find(id_ & 63);
        return;
      }
      id_ = kEnd;
    }
    static constexpr std::uint64_t kEnd = std::uint64_t{1} << 32;
    const IdMap* map_ = nullptr;
    std::uint64_t id_ = kEnd;
    const T* value_ = nullptr;
  };

  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  Iterator begin() const { return Iterator(this, 0); }
  Iterator end() const { return Iterator(this, Iterator::kEnd); }

  // Null if the id is not there. Pointers and references are valid until the next element is added or removed.
  const T* find(std::uint32_t id) const {
    if (id >> 12 >= blocks_.size()) return nullptr;
    const Page* page = blocks_[id >> 12].find(id >> 6 & 63);
    return page == nullptr ? nullptr : page->find(id & 63);
  }
  bool contains(std::uint32_t id) const { return find(id) != nullptr; }
  // Throws std::out_of_range if the id is not there.
  const T& at(std::uint32_t id) const {
    const T* found = find(id);
    if (found == nullptr) throw std::out_of_range("IdMap: no such id");
    return *found;
  }
  // Adds the id if it is not there.
  T& operator[](std::uint32_t id) {
    if (id >> 12 >= blocks_.size()) blocks_.resize((id >> 12) + std::size_t{1});
    Page& page = blocks_[id >> 12].at(id >> 6 & 63);
    const std::size_t before = page.elements.size();
    T& value = page.at(id & 63);
    size_ += page.elements.size() - before;
    return value;
  }
  void erase(std::uint32_t id) {
    if (!contains(id)) return;
    Block& block = blocks_[id >> 12];
    Page& page = block.at(id >> 6 & 63);
    page.erase(id & 63);
    if (page.present == 0) block.erase(id >> 6 & 63);
    --size_;
  }
  friend bool operator==(const IdMap& a, const IdMap& b) {
    if (a.size_ != b.size_) return false;
    for (auto i = a.begin(), j = b.begin(); i != a.end(); ++i, ++j) {
      if (i != j || !((*i).second == (*j).second)) return false;
    }
    return true;
  }

 private:
  using Page = Sparse64<T>;
  using Block = Sparse64<Page>;
  std::vector<Block> blocks_;
  std::size_t size_ = 0;
};

}  // namespace incise::protocol
