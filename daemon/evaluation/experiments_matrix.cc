#include "daemon/evaluation/experiments_matrix.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "core/photometry/exposure_refine.h"
#include "core/photometry/exposure_report.h"
#include "core/pipeline/rig_masks.h"

namespace omnihdr::experiments {
namespace {

constexpr double kSameExposure = 0.02;   // relative difference of two labels of one exposure
constexpr double kOtherStep = 0.3;       // share of a step by which another one may stand for it
constexpr double kNothingUnder = 0.005;  // percent that is "zero" in two decimals

bool IsSameExposure(const FrameRecord& frame, double seconds) {
  return std::abs(frame.exposure.EffectiveSeconds() / seconds - 1.0) < kSameExposure;
}

}  // namespace

Result<std::unique_ptr<DataMatrix>> DataMatrix::Open(const std::filesystem::path& session,
                                                     const PipelineOptions& options) {
  std::unique_ptr<DataMatrix> matrix(new DataMatrix());
  matrix->session_ = session;
  OMNIHDR_ASSIGN(matrix->contents_, ReadSession(session));
  const SessionInfo& info = matrix->contents_.info;
  if (info.camera.layout == Layout::kPerspective) {
    return Fail(
        ErrorKind::kData,
        "{}: layout: \"perspective\", expected \"panorama\" or \"rig\": experiments compare "
        "panoramas",
        (session / "session.json").string());
  }
  OMNIHDR_TRY(matrix->Arrange());
  Image<std::uint8_t> mask;
  if (!options.mask_file.empty()) {
    OMNIHDR_ASSIGN(mask, ReadMask(options.mask_file));
  }
  OMNIHDR_ASSIGN(
      FrameMeasurer measurer,
      FrameMeasurer::Open(session, info, mask.view(), options.mask_file, options.white_balance));
  matrix->output_width_ = options.output_width != 0
                              ? options.output_width
                              : std::min(measurer.projection().width() / 2 * 2, 8192);
  matrix->measurer_.emplace(std::move(measurer));
  OMNIHDR_ASSIGN(matrix->reference_, OpenReference(session, matrix->contents_, {}));
  OMNIHDR_TRY(matrix->FindMiddle());
  return matrix;
}

Status DataMatrix::Arrange() {
  std::map<PositionId, std::vector<const FrameRecord*>> places;
  for (const FrameRecord& frame : contents_.journal.frames) {
    if (frame.status == FrameStatus::kOk) places[frame.position].push_back(&frame);
  }
  if (places.size() < 3) {
    return Fail(ErrorKind::kData, "{}: {} positions with frames, expected 3 or more",
                (session_ / "frames.jsonl").string(), places.size());
  }
  std::vector<double> common;
  for (const FrameRecord* frame : places.begin()->second) {
    common.push_back(frame->exposure.EffectiveSeconds());
  }
  std::sort(common.begin(), common.end());
  common.erase(
      std::unique(common.begin(), common.end(),
                  [](double a, double b) { return std::abs(b / a - 1.0) < kSameExposure; }),
      common.end());
  std::size_t most = 0;
  for (const auto& [position, frames] : places) {
    most = std::max(most, frames.size());
    std::erase_if(common, [&frames = frames](double seconds) {
      return std::none_of(frames.begin(), frames.end(), [seconds](const FrameRecord* frame) {
        return IsSameExposure(*frame, seconds);
      });
    });
  }
  if (common.size() < 3) {
    return Fail(ErrorKind::kData,
                "{}: {} exposures at most at one position and {} that every position has, expected "
                "3 or more: a data matrix, as simulate --frames-per-position writes one",
                (session_ / "frames.jsonl").string(), most, common.size());
  }
  for (const auto& [position, frames] : places) {
    std::vector<FrameRecord>& row = frames_.emplace_back();
    for (const double seconds : common) {
      row.push_back(**std::find_if(frames.begin(), frames.end(), [&](const FrameRecord* frame) {
        return IsSameExposure(*frame, seconds);
      }));
    }
  }
  return {};
}

Status DataMatrix::FindMiddle() {
  int last = exposures() - 1;
  for (int exposure = 2; exposure < exposures(); ++exposure) {
    OMNIHDR_ASSIGN(const DecodedImage image, Frame(positions() / 2, exposure));
    if (CountExposure(image, info().camera.bits, frame_mask()).UnderPercent() < kNothingUnder) {
      last = exposure;
      break;
    }
  }
  middle_ = last / 2;
  return {};
}

double DataMatrix::Seconds(int exposure) const {
  return frames_.front()[static_cast<std::size_t>(exposure)].exposure.EffectiveSeconds();
}

double DataMatrix::StopsFromMiddle(int exposure) const {
  return std::log2(Seconds(exposure) / Seconds(middle_));
}

int DataMatrix::NearestTo(double stops) const {
  int nearest = 0;
  for (int exposure = 1; exposure < exposures(); ++exposure) {
    if (std::abs(StopsFromMiddle(exposure) - stops) < std::abs(StopsFromMiddle(nearest) - stops)) {
      nearest = exposure;
    }
  }
  return nearest;
}

std::optional<int> DataMatrix::AtStops(double stops) const {
  const int nearest = NearestTo(stops);
  if (std::abs(StopsFromMiddle(nearest) - stops) > kOtherStep * std::abs(stops)) {
    return std::nullopt;
  }
  return nearest;
}

const FrameRecord& DataMatrix::frame(int position, int exposure) const {
  return frames_[static_cast<std::size_t>(position)][static_cast<std::size_t>(exposure)];
}

Result<DecodedImage> DataMatrix::Frame(int position, int exposure) const {
  const std::filesystem::path path = session_ / frame(position, exposure).file;
  OMNIHDR_ASSIGN(DecodedImage image, ReadImage(path));
  const CameraDescription& camera = info().camera;
  if (image.width() != camera.width || image.height() != camera.height) {
    return Fail(ErrorKind::kData, "{}: {}x{}, expected {}x{} as session.json says", path.string(),
                image.width(), image.height(), camera.width, camera.height);
  }
  return image;
}

Result<Measurement> DataMatrix::Measure(int position, std::span<const int> exposures,
                                        const PipelineOptions& options) {
  std::vector<DecodedImage> images;
  for (const int exposure : exposures) {
    OMNIHDR_ASSIGN(DecodedImage image, Frame(position, exposure));
    images.push_back(std::move(image));
  }
  std::vector<ExposedFrame> exposed;
  for (std::size_t k = 0; k < images.size(); ++k) {
    exposed.push_back({&images[k], frame(position, exposures[k]).exposure});
  }
  if (options.refine_exposure && exposed.size() > 1) {
    RefineOptions refine;
    refine.limit = options.refine_limit;
    refine.value_low = options.value_low;
    refine.value_high = options.value_high;
    refine.noise = options.noise;
    const Result<std::vector<RefinedExposure>> refined =
        RefineExposures(exposed, info().response, info().camera.bits, frame_mask(), refine);
    for (std::size_t k = 0; refined && k < exposed.size(); ++k) {
      ExposureTime& time = exposed[k].exposure.time;
      time = ExposureTime::Seconds(time.seconds() * (*refined)[k].scale);
    }
  }
  MeasureOptions measure;
  measure.value_low = options.value_low;
  measure.value_high = options.value_high;
  measure.noise = options.noise;
  measure.weights = options.weights;
  measure.white_balance = options.white_balance;
  measure.demosaic = options.demosaic;
  return measurer_->Measure(exposed, measure);
}

Result<std::optional<Pose>> DataMatrix::TruePose(int position) const {
  if (!reference_) return std::optional<Pose>();
  return reference_->TruePose(frame(position, 0));
}

}  // namespace omnihdr::experiments
