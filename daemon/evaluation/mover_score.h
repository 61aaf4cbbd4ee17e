#pragma once

#include "core/image/image.h"
#include "daemon/evaluation/evaluation.h"
#include "daemon/evaluation/reference.h"

namespace omnihdr {

struct MoverComparison {
  const Image<float>& view;  // W×H×3, as all pictures here; NaN = unknown
  double view_scale = 1.0;   // that brings it to the truth
  const Image<float>& own_frame;
  double own_scale = 1.0;
  const Image<float>& truth;  // at the view's own instant
  const Reference::Movers& movers;
  MeasurableRange bracket;  // what lies outside it is not compared
  MeasurableRange own;      // of the view's own frame
  bool removes = false;     // see MoverScore
};

// Compares on the pixels of movers.here and in_sight and those next to them, where the own frame
// shows anything.
MoverScore ScoreMovers(const MoverComparison& comparison, const ComparisonArea& sphere);

}  // namespace omnihdr
