#include "core/capture/edge_pairing.h"

#include <algorithm>
#include <chrono>

namespace omnihdr {

void EdgePairing::AddEdge(TriggerId trigger, HostTime earliest, HostTime latest) {
  edges_.push_back({trigger, earliest, latest});
  if (edges_.size() > kMostEdges) edges_.pop_front();
}

std::optional<EdgePairing::Match> EdgePairing::Take(HostTime start, Nanoseconds error) {
  const auto off = [start](const Edge& edge) {
    if (start < edge.earliest) return start - edge.earliest;
    if (start > edge.latest) return start - edge.latest;
    return Nanoseconds(0);
  };
  const auto near = [&](const Edge& edge) {
    return std::chrono::abs(off(edge)) <= tolerance_ + error;
  };
  auto nearest = edges_.end();
  for (auto edge = edges_.begin(); edge != edges_.end(); ++edge) {
    if (edge->earliest != edge->latest || !near(*edge)) continue;
    if (nearest == edges_.end() || std::chrono::abs(off(*edge)) < std::chrono::abs(off(*nearest))) {
      nearest = edge;
    }
  }
  if (nearest == edges_.end()) nearest = std::find_if(edges_.begin(), edges_.end(), near);
  if (nearest == edges_.end()) return std::nullopt;
  Match match;
  match.trigger = nearest->trigger;
  match.off = off(*nearest);
  for (auto edge = edges_.begin(); edge != nearest; ++edge) match.passed.push_back(edge->trigger);
  edges_.erase(edges_.begin(), nearest + 1);
  return match;
}

}  // namespace omnihdr
