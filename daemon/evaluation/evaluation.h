#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/quality/comparison_area.h"
#include "core/quality/disparity_metrics.h"
#include "core/quality/mover_metrics.h"
#include "core/quality/pose_metrics.h"
#include "core/quality/radiance_metrics.h"
#include "core/quality/reliability.h"
#include "core/quality/seam_metrics.h"
#include "core/session/session.h"
#include "daemon/evaluation/own_frame.h"
#include "daemon/evaluation/plot.h"

namespace omnihdr {

struct EvaluationOptions {
  std::filesystem::path views;        // empty = SESSION/views
  std::filesystem::path photographs;  // empty = SESSION/reference, when there is one
  FrameMaskOptions mask;
};

// One radiance map against the reference.
struct RadianceScore {
  RadianceErrors errors;
  double psnr_mu = 0.0;  // after errors.scale, white = the brightest luminance compared
  double ssim = 0.0;     // of luminance after Reinhard's operator with the reference's parameters
};

// Both W×H×3 panoramas of equal size, NaN = unknown, on the pixels of `area`.
RadianceScore ScoreRadiance(ImageView<const float> tested, ImageView<const float> truth,
                            const ComparisonArea& area);

// What the view shows where something moved: pixels that show it, and pixels whose background it
// hid from another view. A view that keeps movers must show its own frame's instant; where that
// frame was clipped or dark the background is accepted as well. One that removes them must show the
// background; where fewer than two other views saw and could measure it, its own frame's instant is
// accepted too.
struct MoverScore {
  bool removes = false;
  InstanceErrors view;  // off by more than 0.3 in log10 from all that is accepted
  InstanceErrors own_frame;
};

struct PositionScore {
  PositionId position{};
  Exposure exposure;                      // of the reference frame
  FrameStatus status = FrameStatus::kOk;  // of the position's best frame
  bool complete = false;                  // has a view
  int frames = 0;                         // that contributed to the view
  int chain = 0;
  double valid_fraction = 0.0;    // as view.json says
  std::optional<double> seconds;  // the view took, when the session has timings
  std::vector<std::string> warnings;
  // Against the reference, where there is one, all on the same pixels: those known in the
  // reference, seen by the position's own frame and known in the view.
  std::optional<RadianceScore> view;
  std::optional<RadianceScore> own_frame;
  // Share of the pixels known in the reference and seen by the own frame that the view has a value
  // for.
  double covered = 0.0;
  // Stops from the 0.1st to the 99.9th percentile of luminance over those pixels: the view's over
  // the reference's. 1 = the whole range of the scene inside the bracket's was recovered.
  double range_share = 0.0;
  std::optional<DisparityErrors> disparity;
  std::optional<PoseErrors> pose;
  std::optional<MoverScore> movers;  // where any are known
  std::optional<SeamErrors> seams;   // where the view tells the sources of its pixels
};

struct SessionScore {
  std::string reference;  // "" when nothing is known of the scene
  std::vector<PositionScore> positions;
  // Averages over the positions that could be scored.
  struct Mean {
    int positions = 0;
    double view_rmse = 0.0;
    double own_rmse = 0.0;
    double view_p95 = 0.0;
    double own_p95 = 0.0;
    double view_ssim = 0.0;
    double own_ssim = 0.0;
    double view_psnr_mu = 0.0;
    double own_psnr_mu = 0.0;
    double covered = 0.0;
    double range_share = 0.0;
    std::optional<double> movers_off;  // of all positions' mover areas together
    std::optional<double> movers_own_off;
    std::optional<double> seam_noise;
    std::optional<double> seam_log10;
    std::optional<double> disparity_bad1;
    std::optional<double> disparity_relative;
    std::optional<double> rotation_deg;         // largest, not mean
    std::optional<double> translation_percent;  // largest, not mean
  };
  std::optional<Mean> mean;
  // Of the disparity's confidence, over all views whose true disparity is known; may be empty.
  ReliabilityCurve reliability;
  int complete = 0;  // positions with a view
  // How far the views' mean log10 RMSE is below the own frames': 0.25 = a quarter better.
  double improvement() const { return mean ? 1.0 - mean->view_rmse / mean->own_rmse : 0.0; }
};

// Judges the views of a session. `progress` (may be empty) is called after each position. Errors:
// the session or a view cannot be read; layout other than panorama.
Result<SessionScore> EvaluateSession(const std::filesystem::path& session,
                                     const EvaluationOptions& options,
                                     const std::function<void(int done, int of)>& progress);

// "12 -> 15, 34 -> 31, ... (mean gap 2.5)": of each bin that holds anything to speak of what its
// pixels are called and what share of them is right, in percent.
std::string FormatReliability(const ReliabilityCurve& reliability);
// Bins' shares over their confidences, beside the diagonal of a perfect confidence.
Plot ReliabilityPlot(const ReliabilityCurve& reliability);
// For people: a table with a line a position and the means.
std::string FormatScoreTable(const SessionScore& score);
// For programs: one JSON object; unknown numbers are null.
std::string FormatScoreJson(const SessionScore& score);

}  // namespace omnihdr
