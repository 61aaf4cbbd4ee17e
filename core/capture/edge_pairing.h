#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <vector>

#include "core/base/clock.h"
#include "core/base/units.h"
#include "core/session/session.h"

namespace omnihdr {

// Which edge of a wire started which frame, for a camera that hangs on the same wire as the line
// whose edges are observed, and exposes by itself. Law: an edge starts one frame at most and a
// frame has one edge at most; frames come in the order of their exposures, so an edge before one
// that has been paired gets no frame any more. An edge and a frame belong together when the
// exposure began within the tolerance, and the frame's own error, of the edge; of several such
// edges the nearest. Edges that are only known to lie within a span have what is left: the first
// whose span it is. At most kMostEdges are kept, the oldest are forgotten. Not thread-safe.
class EdgePairing {
 public:
  static constexpr std::size_t kMostEdges = 4096;

  explicit EdgePairing(Nanoseconds tolerance) : tolerance_(tolerance) {}

  // An edge that came from `earliest` to `latest`: the same where its source has stamped it. In
  // order of `latest`.
  void AddEdge(TriggerId trigger, HostTime earliest, HostTime latest);

  struct Match {
    TriggerId trigger{};
    std::vector<TriggerId> passed;  // edges before it that have no frame
    Nanoseconds off{0};             // from the edge to the exposure's begin
  };
  // The edge of a frame whose exposure began at `start`, give or take `error`; nothing when none is
  // near enough. What it answers is taken out.
  std::optional<Match> Take(HostTime start, Nanoseconds error);

  void Clear() { edges_.clear(); }
  std::size_t size() const { return edges_.size(); }

 private:
  struct Edge {
    TriggerId trigger{};
    HostTime earliest;
    HostTime latest;
  };
  const Nanoseconds tolerance_;
  std::deque<Edge> edges_;
};

}  // namespace omnihdr
