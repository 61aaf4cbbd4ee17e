#include "core/stereo/merge_row.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/base/simd.h"

namespace omnihdr {
namespace {

// Whether a source sees each point, see SightOf.
OMNIHDR_SIMD_CLONES
void FindSights(const float* __restrict nearest, const int* __restrict column,
                const int* __restrict row, const float* __restrict disparity,
                const float* __restrict distance, int count, int grid_width, float tolerance,
                std::uint8_t* __restrict sight) {
  constexpr auto kUnknown = static_cast<int>(Sight::kUnknown);
  constexpr auto kHidden = static_cast<int>(Sight::kHidden);
  constexpr auto kVisible = static_cast<int>(Sight::kVisible);
  for (int i = 0; i < count; ++i) {
    const float expected = disparity[i] / distance[i];
    const float found = nearest[row[i] * grid_width + column[i]];
    int s = found > expected * (1.0F + tolerance) + 0.003F ? kHidden : kVisible;
    s = disparity[i] >= 0.0F ? s : kUnknown;
    s = distance[i] >= 1e-4F ? s : kUnknown;
    sight[i] = static_cast<std::uint8_t>(s);
  }
}

// Radiance to the reference's, and its variance: noise, what a wrong place makes, a constant part.
OMNIHDR_SIMD_CLONES
void ScaleAndVary(const float* __restrict factor, const float* __restrict contrast,
                  const float* __restrict misregistration, int count, float floor,
                  float per_radiance, float relative, float* __restrict radiance,
                  float* __restrict variance) {
  for (int i = 0; i < count; ++i) {
    const float raw = radiance[i] > 0.0F ? radiance[i] : 0.0F;
    const float e = radiance[i] * factor[i];
    const float misplaced = factor[i] * contrast[i] * misregistration[i];
    radiance[i] = e;
    variance[i] = (floor + per_radiance * raw) * factor[i] * factor[i] + misplaced * misplaced +
                  relative * e * e;
  }
}

OMNIHDR_SIMD_CLONES
void StartMean(const float* __restrict radiance, int count, float floor, float per_radiance,
               float* __restrict sum, float* __restrict weight) {
  for (int i = 0; i < count; ++i) {
    const float e = radiance[i] > 0.0F ? radiance[i] : 0.0F;
    const float w = 1.0F / (floor + per_radiance * e);
    weight[i] = w;
    sum[i] = w * radiance[i];
  }
}

OMNIHDR_SIMD_CLONES
void AddDisagreement(const float* __restrict theirs, const float* __restrict variance,
                     const float* __restrict mine, int count, float floor, float per_radiance,
                     float relative_tolerance, float* __restrict chi) {
  for (int i = 0; i < count; ++i) {
    const float gap = theirs[i] - mine[i];
    const float here = floor + per_radiance * (theirs[i] > 0.0F ? theirs[i] : 0.0F);
    const float tolerance = relative_tolerance * mine[i];
    chi[i] += gap * gap / (variance[i] + here + tolerance * tolerance);
  }
}

// Trust by agreement; none in what is not seen or not measured.
OMNIHDR_SIMD_CLONES
void TrustPlain(const float* __restrict chi, const float* __restrict block_trust,
                const std::uint8_t* __restrict flags, const std::uint8_t* __restrict sight,
                int count, float chi_scale, float* __restrict trust) {
  constexpr auto kVisible = static_cast<std::uint8_t>(Sight::kVisible);
  for (int i = 0; i < count; ++i) {
    const float r = chi[i] * chi_scale;
    const int counts = static_cast<int>(sight[i] == kVisible) &
                       static_cast<int>((flags[i] & (kMasked | kMover | kSaturatedAny)) == 0);
    trust[i] = counts != 0 ? block_trust[i] / (1.0F + r * r) : 0.0F;
  }
}

// Who would have a say where the own view says little, how far apart they are, and whether any of
// them measured a channel above the noise.
OMNIHDR_SIMD_CLONES
void CountVoters(const float* __restrict green, const float* __restrict trust,
                 const std::uint8_t* __restrict flags, const std::uint8_t* __restrict sight,
                 int count, float* __restrict voters, float* __restrict least,
                 float* __restrict most, std::uint8_t* __restrict lit) {
  constexpr auto kVisible = static_cast<std::uint8_t>(Sight::kVisible);
  for (int i = 0; i < count; ++i) {
    const int counts = static_cast<int>(sight[i] == kVisible) &
                       static_cast<int>((flags[i] & (kMasked | kMover | kSaturatedAny)) == 0);
    const int votes = counts & static_cast<int>(trust[i] > kLeastTrust);
    voters[i] += votes != 0 ? 1.0F : 0.0F;
    least[i] = (votes & static_cast<int>(green[i] < least[i])) != 0 ? green[i] : least[i];
    most[i] = (votes & static_cast<int>(green[i] > most[i])) != 0 ? green[i] : most[i];
    const int bright = counts & static_cast<int>((flags[i] & kDarkAny) != kDarkAny);
    lit[i] = static_cast<std::uint8_t>(lit[i] | static_cast<std::uint8_t>(bright));
  }
}

OMNIHDR_SIMD_CLONES
void DropOutside(const float* __restrict green, const std::uint8_t* __restrict flags,
                 const float* __restrict least, const float* __restrict most, int count,
                 float* __restrict trust) {
  for (int i = 0; i < count; ++i) {
    const int outside =
        static_cast<int>(green[i] < least[i]) | static_cast<int>(green[i] > most[i]);
    const int drops = outside & static_cast<int>((flags[i] & kSaturatedAny) == 0);
    trust[i] = drops != 0 ? 0.0F : trust[i];
  }
}

OMNIHDR_SIMD_CLONES
void AddWeighted(const float* __restrict radiance, const float* __restrict variance,
                 const float* __restrict trust, int count, float* __restrict sum,
                 float* __restrict weight, float* __restrict weights) {
  for (int i = 0; i < count; ++i) {
    const float w = trust[i] / variance[i];
    weights[i] = w;
    weight[i] += w;
    // What is not seen may hold anything.
    sum[i] += w > 0.0F ? w * radiance[i] : 0.0F;
  }
}

}  // namespace

namespace {

OMNIHDR_SIMD_CLONES
void LookUp(const float* __restrict map, const float* __restrict map_confidence, int width,
            int height, const float* __restrict px, const float* __restrict py, int count,
            float* __restrict disparity, float* __restrict confidence) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  for (int i = 0; i < count; ++i) {
    const float fx = px[i] - 0.5F;
    const float fy = py[i] - 0.5F;
    const float left = std::floor(fx);
    const float top = std::floor(fy);
    const float ax = fx - left;
    const float ay = fy - top;
    int x0 = static_cast<int>(left);
    int x1 = x0 + 1;
    x0 = x0 < 0 ? x0 + width : x0;
    x1 = x1 >= width ? x1 - width : x1;
    const int y = static_cast<int>(top);
    const int last = height - 1;
    const int y0 = y < 0 ? 0 : (y < last ? y : last);
    const int y1 = y + 1 < last ? y + 1 : last;
    const int i00 = y0 * width + x0;
    const int i10 = y0 * width + x1;
    const int i01 = y1 * width + x0;
    const int i11 = y1 * width + x1;
    const float d00 = map[i00];
    const float d10 = map[i10];
    const float d01 = map[i01];
    const float d11 = map[i11];
    const auto weigh = [](float d, float w) {
      const float least = w > 1e-3F ? w : 1e-3F;
      return d >= 0.0F ? least : 0.0F;
    };
    const float w00 = weigh(d00, (1.0F - ax) * (1.0F - ay));
    const float w10 = weigh(d10, ax * (1.0F - ay));
    const float w01 = weigh(d01, (1.0F - ax) * ay);
    const float w11 = weigh(d11, ax * ay);
    float most = w00;
    float centre = d00;
    int heaviest = i00;
    const auto compare = [&](float w, float d, int index) {
      const bool more = w > most;
      most = more ? w : most;
      centre = more ? d : centre;
      heaviest = more ? index : heaviest;
    };
    compare(w10, d10, i10);
    compare(w01, d01, i01);
    compare(w11, d11, i11);
    const float near = 0.05F * centre + 0.002F;
    float sum = 0.0F;
    float weights = 0.0F;
    const auto add = [&](float w, float d) {
      const float counted = std::fabs(d - centre) <= near ? w : 0.0F;  // never, of NaN
      sum += counted > 0.0F ? counted * d : 0.0F;
      weights += counted;
    };
    add(w00, d00);
    add(w10, d10);
    add(w01, d01);
    add(w11, d11);
    const float c = map_confidence[heaviest];
    disparity[i] = weights > 0.0F ? sum / weights : kNan;
    confidence[i] = weights > 0.0F ? c : 0.0F;
  }
}

}  // namespace

void LookUpDisparity(const DisparityMap& map, const PointRow& points, float* disparity,
                     float* confidence) {
  LookUp(map.disparity.data(), map.confidence.data(), map.disparity.width(), map.disparity.height(),
         points.x.data(), points.y.data(), static_cast<int>(points.x.size()), disparity,
         confidence);
}

void SampleSource(const SourceLookup& source, const RowSampler& sampler, int y, int width,
                  int block, const float* disparity, float occlusion_tolerance,
                  const MergeErrors& errors, SourceRow* row) {
  const auto count = static_cast<std::size_t>(width);
  const Measurement& m = *source.measurement;
  sampler.Sample(row->seen.image.x.data(), row->seen.image.y.data(), count, &row->sampled);
  row->sight.resize(count);
  if (source.nearest.empty()) {
    std::fill(row->sight.begin(), row->sight.end(), Sight::kVisible);
  } else {
    static_assert(sizeof(Sight) == 1);
    FindSights(source.nearest.data(), row->seen.grid_column.data(), row->seen.grid_row.data(),
               disparity, row->seen.distance.data(), width, source.nearest.width(),
               occlusion_tolerance, reinterpret_cast<std::uint8_t*>(row->sight.data()));
  }
  row->trust.resize(count);
  const float* blocks = source.block_trust.row(y / block);
  for (int x = 0; x < width; x += block) {
    std::fill_n(row->trust.begin() + x, std::min(block, width - x), blocks[x / block]);
  }
  row->weight.resize(count);
  std::vector<float>& factor = row->weight;  // until the weights are known
  source.agreement.FactorsOfRow(
      (static_cast<float>(y) + 0.5F) * AgreementField::kHeight / (0.5F * static_cast<float>(width)),
      static_cast<float>(AgreementField::kWidth) / static_cast<float>(width), width, factor.data());
  const float relative = errors.model_error * errors.model_error + source.agreement.excess();
  for (std::size_t c = 0; c < 3; ++c) {
    row->variance[c].resize(count);
    ScaleAndVary(factor.data(), row->sampled.contrast.data(), errors.misregistration, width,
                 m.variance_floor[c], m.variance_per_radiance[c], relative,
                 row->sampled.radiance[c].data(), row->variance[c].data());
  }
}

void DistrustOutside(const std::vector<float>& least, const std::vector<float>& most,
                     SourceRow* row) {
  DropOutside(row->sampled.radiance[1].data(), row->sampled.flags.data(), least.data(), most.data(),
              static_cast<int>(least.size()), row->trust.data());
}

void PlainRow::Start(const Measurement& own, const SampledRow& mine) {
  for (std::size_t c = 0; c < 3; ++c) {
    sum_[c].resize(mine.size());
    weight_[c].resize(mine.size());
    StartMean(mine.radiance[c].data(), static_cast<int>(mine.size()), own.variance_floor[c],
              own.variance_per_radiance[c], sum_[c].data(), weight_[c].data());
  }
  own_weight_ = weight_[1];
  has_dark_ = std::any_of(mine.flags.begin(), mine.flags.end(),
                          [](std::uint8_t flags) { return (flags & kDarkAny) != 0; });
  if (!has_dark_) return;
  voters_.assign(mine.size(), 0.0F);
  least_.assign(mine.size(), std::numeric_limits<float>::infinity());
  most_.assign(mine.size(), 0.0F);
  lit_.resize(mine.size());
  for (std::size_t i = 0; i < mine.size(); ++i) {
    lit_[i] = (mine.flags[i] & kDarkAny) != kDarkAny ? 1 : 0;
  }
}

void PlainRow::Add(const Measurement& own, const SampledRow& mine, bool consistency,
                   float half_trust_sigmas, float relative_tolerance, SourceRow* source) {
  const auto count = static_cast<int>(mine.size());
  chi_.assign(mine.size(), 0.0F);
  trust_.resize(mine.size());
  for (std::size_t c = 0; c < 3 && consistency; ++c) {
    AddDisagreement(source->sampled.radiance[c].data(), source->variance[c].data(),
                    mine.radiance[c].data(), count, own.variance_floor[c],
                    own.variance_per_radiance[c], relative_tolerance, chi_.data());
  }
  TrustPlain(chi_.data(), source->trust.data(), source->sampled.flags.data(),
             reinterpret_cast<const std::uint8_t*>(source->sight.data()), count,
             1.0F / (3.0F * half_trust_sigmas * half_trust_sigmas), trust_.data());
  if (has_dark_) {
    CountVoters(source->sampled.radiance[1].data(), trust_.data(), source->sampled.flags.data(),
                reinterpret_cast<const std::uint8_t*>(source->sight.data()), count, voters_.data(),
                least_.data(), most_.data(), lit_.data());
  }
  for (const std::size_t c : {0U, 2U, 1U}) {  // the weights of green stay
    AddWeighted(source->sampled.radiance[c].data(), source->variance[c].data(), trust_.data(),
                count, sum_[c].data(), weight_[c].data(), source->weight.data());
  }
}

}  // namespace omnihdr
