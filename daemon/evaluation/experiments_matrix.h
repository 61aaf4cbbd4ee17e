#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image_io.h"
#include "core/photometry/measurement.h"
#include "core/pipeline/frame_measurer.h"
#include "core/pipeline/options.h"
#include "core/session/session_reader.h"
#include "daemon/evaluation/reference.h"

namespace omnihdr::experiments {

// A session with the same exposures at every position, as the thesis took them (3.2): a matrix of
// positions × exposures from which a sequence with one exposure a position ("spatiotemporal") and
// the bracket of one position ("temporal") are drawn alike. Positions and exposures are counted
// from 0, exposures from the shortest. Not thread-safe.
class DataMatrix {
 public:
  // Positions without a usable frame are left out, and exposures that not every position has.
  // Errors (kData): fewer than three of either, a perspective camera; what ReadSession,
  // FrameMeasurer and OpenReference say.
  static Result<std::unique_ptr<DataMatrix>> Open(const std::filesystem::path& session,
                                                  const PipelineOptions& options);

  const std::filesystem::path& session() const { return session_; }
  const SessionInfo& info() const { return contents_.info; }
  int positions() const { return static_cast<int>(frames_.size()); }
  int exposures() const { return static_cast<int>(frames_.front().size()); }
  // Time × gain, in seconds at 0 dB.
  double Seconds(int exposure) const;
  // The exposure the others are counted from (the thesis's #7): the middle, by number, of those up
  // to the first that leaves nothing under-exposed (6.2.1), or of all when none does.
  int middle() const { return middle_; }
  double StopsFromMiddle(int exposure) const;
  // The exposure nearest to so many stops from the middle; nothing when it is off by more than 30 %
  // of that, for then it would be another experiment.
  std::optional<int> AtStops(double stops) const;
  // The same, as near as there is.
  int NearestTo(double stops) const;
  const FrameRecord& frame(int position, int exposure) const;

  Result<DecodedImage> Frame(int position, int exposure) const;
  // Frames of one position merged, as processing would: labels tested by their overlap, weights of
  // the options. `options`: photometry of another method.
  Result<Measurement> Measure(int position, std::span<const int> exposures,
                              const PipelineOptions& options);
  // Of the frames, where the camera or the mask shows the scene; empty = everywhere.
  ImageView<const std::uint8_t> frame_mask() const { return measurer_->frame_mask(); }
  // Null when nothing is known of the scene.
  const Reference* reference() const { return reference_.get(); }
  Result<std::optional<Pose>> TruePose(int position) const;
  // Lat-long pictures' width: that of the options, else natural to the frames.
  int output_width() const { return output_width_; }
  bool is_rig() const { return contents_.info.camera.layout == Layout::kRig; }

 private:
  DataMatrix() = default;
  Status Arrange();
  Status FindMiddle();

  std::filesystem::path session_;
  SessionContents contents_;
  std::vector<std::vector<FrameRecord>> frames_;  // by position, by exposure
  std::optional<FrameMeasurer> measurer_;
  std::unique_ptr<Reference> reference_;
  int middle_ = 0;
  int output_width_ = 0;
};

}  // namespace omnihdr::experiments
