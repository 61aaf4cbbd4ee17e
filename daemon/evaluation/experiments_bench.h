#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <list>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/photometry/exposure_report.h"
#include "core/pipeline/options.h"
#include "core/pipeline/view_pipeline.h"
#include "core/quality/disparity_metrics.h"
#include "daemon/evaluation/experiments_matrix.h"
#include "daemon/evaluation/reference.h"

namespace omnihdr::experiments {

// Which pipeline makes a sequence's views.
enum class Method {
  kOurs,
  kThesis,  // PipelineOptions::Thesis(): the thesis's parts, as far as this program has them
};

// One exposure at each of some positions.
struct Sequence {
  std::vector<int> positions;
  std::vector<int> exposures;  // as many
  bool operator==(const Sequence&) const = default;
};

// Short, medium and long exposure that a sequence repeats; how they follow each other.
struct Steps {
  double nominal = 0.0;  // stops between them, as the thesis names it
  int brief = 0;
  int medium = 0;
  int extended = 0;
  std::array<int, 3> all() const { return {brief, medium, extended}; }
};
enum class Order { kSawTooth, kTriangle };
// S M L S M L …, or S M L M S M L M … (thesis fig. 6.15).
std::vector<int> OrderedExposures(const Steps& steps, Order order, std::size_t count);

// A view against the two things it is held against, on its camera's own grid.
struct ViewScore {
  // Of luminance as Reinhard's operator shows it, against the temporal HDR of the same exposures at
  // the same position, with its parameters for both (thesis 5.1, 6.3): wherever both have a value.
  double ssim = 0.0;
  // Log10 RMSE of luminance against the temporal HDR, after one factor a picture.
  double rmse_temporal = 0.0;
  // Against the truth, after one factor a picture, where the bracket can measure; nothing when the
  // scene is not known.
  std::optional<double> rmse_truth;
  std::optional<double> ssim_truth;
};

// The values asked for last, at most so many. A value stays where it is until that many others have
// been put in or asked for since.
template <typename Key, typename T>
class LastUsed {
 public:
  explicit LastUsed(std::size_t most) : most_(most) {}
  // Null when it is not kept.
  const T* Find(const Key& key) {
    const auto found = std::find_if(kept_.begin(), kept_.end(),
                                    [&key](const auto& each) { return each.first == key; });
    if (found == kept_.end()) return nullptr;
    kept_.splice(kept_.begin(), kept_, found);
    return &kept_.front().second;
  }
  const T* Put(Key key, T value) {
    kept_.emplace_front(std::move(key), std::move(value));
    if (kept_.size() > most_) kept_.pop_back();
    return &kept_.front().second;
  }

 private:
  std::size_t most_;
  std::list<std::pair<Key, T>> kept_;  // the latest first
};

// A data matrix on the bench: draws sequences and brackets from it, and keeps what several
// experiments look at. All pictures are lat-long in the axes of their own camera, so that no pose
// error moves a view against what it is compared with. Pointers it gives stay good while few others
// are asked for (LastUsed). Not thread-safe.
class Bench {
 public:
  // `place`: "indoor", "outdoor", or the session's name.
  Bench(std::unique_ptr<DataMatrix> matrix, const PipelineOptions& options, std::string place)
      : matrix_(std::move(matrix)), options_(options), place_(std::move(place)) {}

  DataMatrix& matrix() { return *matrix_; }
  const DataMatrix& matrix() const { return *matrix_; }
  const std::string& place() const { return place_; }
  PipelineOptions OptionsOf(Method method) const;
  // Hat weights know no mosaics: the thesis's parts cannot take a rig's raw frames.
  bool HasMethod(Method method) const { return method == Method::kOurs || !matrix_->is_rig(); }

  // Exposures around the middle, `stops` apart; an error-free "no" when the matrix has none, with
  // the reason for a report.
  std::optional<Steps> StepsOf(double stops, std::string* why_not) const;

  // The views of a sequence as the pipeline gives them, one a position of it.
  Result<const std::vector<FinishedView>*> Views(const Sequence& sequence, Method method);
  // The bracket of a position merged, and one frame by itself.
  Result<const MergedView*> Temporal(int position, std::span<const int> exposures);
  Result<MergedView> Alone(int position, int exposure);
  // Null when nothing is known of the scene.
  Result<const Reference::Picture*> Truth(int position);

  // `bracket`: the exposures whose temporal HDR is the reference.
  Result<ViewScore> Score(int position, std::span<const int> bracket, const MergedView& view);
  // A map in 1/metre against the truth, one pixel of parallax at `baseline`; nothing without truth.
  Result<std::optional<DisparityErrors>> ScoreDisparity(int position, const Image<float>& disparity,
                                                        double baseline);
  // What of the luminance was measured (not clipped, not dark), where `seen_by` has data.
  static RadianceRange MeasuredRange(const MergedView& view, const MergedView& seen_by);

 private:
  std::unique_ptr<DataMatrix> matrix_;
  PipelineOptions options_;
  std::string place_;
  LastUsed<std::pair<Sequence, Method>, std::vector<FinishedView>> views_{4};
  LastUsed<std::pair<int, std::vector<int>>, MergedView> temporal_{12};
  LastUsed<int, Reference::Picture> truth_{12};
};

}  // namespace omnihdr::experiments
