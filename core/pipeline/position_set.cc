#include "core/pipeline/position_set.h"

#include <iterator>

namespace omnihdr {

bool PositionSet::Covers(std::int64_t position) const {
  const auto after = runs_.upper_bound(position);
  return after != runs_.begin() && std::prev(after)->second >= position;
}

bool PositionSet::Cover(std::int64_t position) {
  auto after = runs_.upper_bound(position);
  if (after != runs_.begin()) {
    const auto before = std::prev(after);
    if (before->second >= position) return false;
    if (before->second == position - 1) {
      before->second = position;
      if (after != runs_.end() && after->first == position + 1) {
        before->second = after->second;
        runs_.erase(after);
      }
      return true;
    }
  }
  std::int64_t last = position;
  if (after != runs_.end() && after->first == position + 1) {
    last = after->second;
    after = runs_.erase(after);
  }
  runs_.emplace_hint(after, position, last);
  return true;
}

void PositionSet::Insert(std::int64_t position) {
  if (Cover(position)) ++size_;
}

void PositionSet::Settle(std::int64_t position) { Cover(position); }

void PositionSet::Erase(std::int64_t position) {
  const auto after = runs_.upper_bound(position);
  if (after == runs_.begin()) return;
  const auto run = std::prev(after);
  const auto [first, last] = *run;
  if (last < position) return;
  runs_.erase(run);
  if (first < position) runs_.emplace(first, position - 1);
  if (position < last) runs_.emplace(position + 1, last);
  --size_;
}

}  // namespace omnihdr
