#pragma once

#include <cstddef>
#include <cstdint>
#include <map>

namespace omnihdr {

// A set of positions that takes memory by its gaps, not by its members: runs of neighbouring
// positions are kept as their two ends. Positions that are settled without being members (nothing
// will ever come of them) close the gaps, so that a session that goes on for days takes a few runs.
// Not thread-safe.
class PositionSet {
 public:
  void Insert(std::int64_t position);
  // Not a member, and never asked to be one: it lies within a run from now on. Nothing for a
  // member.
  void Settle(std::int64_t position);
  void Erase(std::int64_t position);
  // Members and settled positions.
  bool Covers(std::int64_t position) const;
  std::size_t size() const { return size_; }  // members
  std::size_t runs() const { return runs_.size(); }

  // Every position covered, ascending; `visit` must not change the set. Stops when it answers
  // false.
  template <typename Visit>
  void ForEach(const Visit& visit) const {
    for (const auto& [first, last] : runs_) {
      for (std::int64_t position = first; position <= last; ++position) {
        if (!visit(position)) return;
      }
    }
  }

 private:
  bool Cover(std::int64_t position);

  std::map<std::int64_t, std::int64_t> runs_;  // first to last, apart from each other
  std::size_t size_ = 0;
};

}  // namespace omnihdr
