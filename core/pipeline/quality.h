#pragma once

#include <string>

#include "core/base/result.h"
#include "core/pipeline/options.h"

namespace omnihdr {

// What happens when positions come faster than views can be made.
enum class Overload {
  kBacklog,  // they wait on disk, and every view is made in full
  kDegrade,  // views are made with less work, step by step, until the pipeline keeps up
};
std::string_view ToString(Overload value);

// [pipeline]
struct OverloadOptions {
  Overload overload = Overload::kBacklog;
  // Waiting positions, beside the one in work, at which the quality level is raised.
  int backlog_limit = 8;
  Status Validate() const;  // kConfig error naming the option and its range
};

// Quality levels: 0 is full, each further one costs less work on the disparity, which is most of a
// view's; poses, exposures, merge and the size of the pictures stay what they are. Relative to the
// options configured (never below what they may be at least):
//
//   level  stereo.labels  stereo.width  stereo.neighbours  cells  CPU   rmse   bad1
//   0      x 1            x 1           as configured      1      1     .0462  16.9
//   1      x 2/3          x 1           as configured      2/3    .78   .0463  16.3
//   2      x 2/3          x 3/4         as configured      3/8    .51   .0465  15.9
//   3      x 2/3          x 3/4         1                  3/8    .46   .0478  23.1
//   4      x 1/2          x 1/2         1                  1/8    .28   .0487  27.6
//
// cells: pixels times labels matched, level 3 and 4 against half the positions. CPU (of a whole
// view, files included), rmse of log10 luminance (own frames alone .0889) and bad1 (% of the sphere
// off by more than a pixel of parallax) are means of six views of the simulated hall, seed 1, 1024
// wide, 0.3 m apart, on a machine shared with other work: one scene, one seed.
inline constexpr int kMaxQualityLevel = 4;

// The options that views of a level are made with; those given at level 0. Requires a level in
// [0, kMaxQualityLevel].
PipelineOptions AtQuality(const PipelineOptions& options, int level);
// For view.json and for people: "full", "labels x 2/3", ...
std::string_view DescribeQuality(int level);

// Which level the next view is made at, from how many positions wait.
// Law: the level goes up by one when the backlog has reached the limit and has not fallen since the
// last change, and down by one when it is at most half the limit; a change is given kSettle
// positions to show its effect before the next one. With Overload::kBacklog it is always 0.
class QualityGovernor {
 public:
  static constexpr int kSettle = 3;
  explicit QualityGovernor(const OverloadOptions& options) : options_(options) {}
  // Once for each position taken: how many others wait. Returns the level from now on.
  int Next(int backlog);
  int level() const { return level_; }
  // Nothing more comes that has to be kept up with: in full again.
  void Reset() { *this = QualityGovernor(options_); }

 private:
  OverloadOptions options_;
  int level_ = 0;
  int since_change_ = kSettle;
  int backlog_at_change_ = 0;
};

}  // namespace omnihdr
