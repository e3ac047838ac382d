// Values by cell in order of arrival, found by looking through a few, by hashing beyond. A row of
// the Hessian holds the half dozen neighbours of a cell at the end, nearly all cells at the start.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace radiant {

template <class Value>
class CellRow {
 public:
  // The value of `cell`, made anew where there is none.
  Value& operator[](int cell) {
    if (slots_.empty()) {
      for (auto& [key, value] : entries_)
        if (key == cell) return value;
      append(cell, Value{});
      return entries_.back().second;
    }
    std::size_t slot = first_slot(cell);
    for (; slots_[slot] >= 0; slot = (slot + 1) & (slots_.size() - 1))
      if (entries_[static_cast<std::size_t>(slots_[slot])].first == cell) return entries_[static_cast<std::size_t>(slots_[slot])].second;
    append(cell, Value{});
    return entries_.back().second;
  }

  // A cell that the row does not hold yet.
  void append(int cell, Value value) {
    entries_.emplace_back(cell, std::move(value));
    if (entries_.size() > kFew && 2 * entries_.size() > slots_.size()) {
      slots_.assign(4 * entries_.capacity(), -1);
      while (slots_.size() & (slots_.size() - 1)) slots_.push_back(-1);
      for (std::size_t i = 0; i < entries_.size(); ++i) enter(i);
    } else if (!slots_.empty()) {
      enter(entries_.size() - 1);
    }
  }

  std::size_t size() const { return entries_.size(); }
  auto begin() { return entries_.begin(); }
  auto end() { return entries_.end(); }
  auto begin() const { return entries_.begin(); }
  auto end() const { return entries_.end(); }

 private:
  static constexpr std::size_t kFew = 12;

  std::size_t first_slot(int cell) const { return (static_cast<std::uint32_t>(cell) * 2654435769u >> 7) & (slots_.size() - 1); }
  void enter(std::size_t entry) {
    std::size_t slot = first_slot(entries_[entry].first);
    while (slots_[slot] >= 0) slot = (slot + 1) & (slots_.size() - 1);
    slots_[slot] = static_cast<std::int32_t>(entry);
  }

  std::vector<std::pair<int, Value>> entries_;
  std::vector<std::int32_t> slots_;  // (a power of two,) into `entries_`, -1 where free
};

}  // namespace radiant
