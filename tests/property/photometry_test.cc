#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "core/photometry/measure.h"
#include "tests/property/generators.h"

namespace omnihdr::photometry_test {
namespace {

using testing::Between;

// A bracket of random pictures: what the frames show need not even fit together.
struct Bracket {
  std::vector<DecodedImage> images;
  std::vector<Exposure> exposures;
};

Bracket AnyBracket(int width, int height) {
  Bracket bracket;
  const int count = *rc::gen::inRange(1, 6);
  for (int k = 0; k < count; ++k) {
    const auto values = *rc::gen::container<std::vector<std::uint8_t>>(
        static_cast<std::size_t>(3 * width * height), rc::gen::arbitrary<std::uint8_t>());
    Image<std::uint8_t> image(width, height, 3);
    std::copy(values.begin(), values.end(), image.data());
    bracket.images.push_back({std::move(image)});
    bracket.exposures.push_back(
        {ExposureTime::Seconds(std::pow(10.0, *Between(-5.0, 2.0))), GainDb{*Between(-6.0, 24.0)}});
  }
  return bracket;
}

Measurement MeasureIn(const Bracket& bracket, const std::vector<std::size_t>& order) {
  std::vector<ExposedFrame> frames;
  for (const std::size_t k : order) frames.push_back({&bracket.images[k], bracket.exposures[k]});
  Result<Measurement> m = Measure(
      frames, Projection::Equirectangular(bracket.images[0].width(), bracket.images[0].height()),
      *Response::Linear(), 8, {}, {});
  RC_ASSERT(m.has_value());
  return std::move(*m);
}

RC_GTEST_PROP(MeasureLaw, TheOrderOfFramesDoesNotMatter, ()) {
  const Bracket bracket = AnyBracket(5, 3);
  std::vector<std::size_t> order(bracket.images.size());
  std::iota(order.begin(), order.end(), 0U);
  const Measurement a = MeasureIn(bracket, order);
  for (std::size_t k = order.size(); k > 1; --k) {
    std::swap(order[k - 1], order[*rc::gen::inRange<std::size_t>(0, k)]);
  }
  const Measurement b = MeasureIn(bracket, order);
  for (std::size_t k = 0; k < a.radiance.size(); ++k) {
    const float x = a.radiance.data()[k];
    const float y = b.radiance.data()[k];
    RC_ASSERT(std::abs(x - y) <= 2e-6F * std::max(std::abs(x), std::abs(y)));
  }
  RC_ASSERT(std::ranges::equal(a.flags.values(), b.flags.values()));
  RC_ASSERT(a.saturation == b.saturation);
  RC_ASSERT(a.noise_floor == b.noise_floor);
}

RC_GTEST_PROP(MeasureLaw, RadianceIsFiniteAndNeverNegativeWhateverTheFramesShow, ()) {
  const Bracket bracket = AnyBracket(5, 3);
  std::vector<std::size_t> order(bracket.images.size());
  std::iota(order.begin(), order.end(), 0U);
  const Measurement m = MeasureIn(bracket, order);
  for (const float v : m.radiance.values()) {
    RC_ASSERT(std::isfinite(v));
    RC_ASSERT(v >= 0.0F);
  }
}

RC_GTEST_PROP(MeasureLaw, TheMergeLiesBetweenTheFramesThatMeasured, ()) {
  const Bracket bracket = AnyBracket(4, 2);
  std::vector<std::size_t> order(bracket.images.size());
  std::iota(order.begin(), order.end(), 0U);
  const Measurement m = MeasureIn(bracket, order);
  for (int x = 0; x < 4; ++x) {
    if (m.flags.at(x, 0) != 0) continue;
    for (int c = 0; c < 3; ++c) {
      double low = 1e300;
      double high = 0.0;
      for (std::size_t k = 0; k < order.size(); ++k) {
        const double e = std::get<Image<std::uint8_t>>(bracket.images[k].pixels).at(x, 0, c) /
                         128.0 / bracket.exposures[k].EffectiveSeconds();
        low = std::min(low, e);
        high = std::max(high, e);
      }
      RC_ASSERT(m.radiance.at(x, 0, c) >= low * (1.0 - 1e-5));
      RC_ASSERT(m.radiance.at(x, 0, c) <= high * (1.0 + 1e-5));
    }
  }
}

RC_GTEST_PROP(MeasureLaw, TwiceTheTimeIsHalfTheRadiance, ()) {
  Bracket bracket = AnyBracket(4, 2);
  std::vector<std::size_t> order(bracket.images.size());
  std::iota(order.begin(), order.end(), 0U);
  const Measurement a = MeasureIn(bracket, order);
  for (Exposure& e : bracket.exposures) e.time = ExposureTime::Seconds(2.0 * e.time.seconds());
  const Measurement b = MeasureIn(bracket, order);
  for (int x = 0; x < 4; ++x) {
    for (int c = 0; c < 3; ++c) {
      const float e = a.radiance.at(x, 1, c);
      RC_ASSERT(std::abs(2.0F * b.radiance.at(x, 1, c) - e) <= 1e-5F * e);
    }
  }
}

// All-black, all-white and half-and-half pictures are where averages of nothing hide.
RC_GTEST_PROP(MeasureLaw, ExtremesAreFiniteAndNeverNegativeWithAnyWeights, ()) {
  Bracket bracket = AnyBracket(5, 2);
  for (DecodedImage& image : bracket.images) {
    auto& pixels = std::get<Image<std::uint8_t>>(image.pixels);
    for (std::uint8_t& z : pixels.values()) {
      z = *rc::gen::element<std::uint8_t>(0, 1, 9, 10, 245, 246, 255);
    }
  }
  std::vector<ExposedFrame> frames;
  for (std::size_t k = 0; k < bracket.images.size(); ++k) {
    frames.push_back({&bracket.images[k], bracket.exposures[k]});
  }
  MeasureOptions options;
  options.weights = *rc::gen::element(MergeWeights::kInverseVariance, MergeWeights::kHat);
  options.value_low = *rc::gen::element(0.0, 10.0);
  options.value_high = *rc::gen::element(245.0, 255.0);
  const Result<Measurement> m =
      Measure(frames, Projection::Equirectangular(5, 2), *Response::Linear(), 8, {}, options);
  RC_ASSERT(m.has_value());
  for (const float v : m->radiance.values()) RC_ASSERT(std::isfinite(v) && v >= 0.0F);
}

RC_GTEST_PROP(MeasureLaw, MoreLightNeverReadsAsLess, ()) {
  // A ramp of light without noise in any bracket: from pixel to pixel the merge rises, but for the
  // rounding of the frames it is made of.
  constexpr int kWidth = 400;
  std::vector<double> seconds;
  std::vector<DecodedImage> images;
  const int count = *rc::gen::inRange(1, 5);
  double t = std::pow(10.0, *Between(-3.0, -1.0));
  for (int k = 0; k < count; ++k) {
    seconds.push_back(t);
    t *= std::exp2(*Between(0.3, 4.0));
    Image<std::uint8_t> image(kWidth, 1, 3);
    for (int x = 0; x < kWidth; ++x) {
      const double e = 0.05 * std::exp2(14.0 * x / kWidth);
      const auto z = static_cast<std::uint8_t>(
          std::clamp(std::floor(128.0 * e * seconds.back() + 0.5), 0.0, 255.0));
      for (int c = 0; c < 3; ++c) image.at(x, 0, c) = z;
    }
    images.push_back({std::move(image)});
  }
  std::vector<ExposedFrame> frames;
  for (std::size_t k = 0; k < images.size(); ++k) {
    frames.push_back({&images[k], {ExposureTime::Seconds(seconds[k]), GainDb{}}});
  }
  MeasureOptions options;
  options.weights = *rc::gen::element(MergeWeights::kInverseVariance, MergeWeights::kHat);
  const Result<Measurement> m =
      Measure(frames, Projection::Equirectangular(kWidth, 1), *Response::Linear(), 8, {}, options);
  RC_ASSERT(m.has_value());
  for (int x = 1; x < kWidth; ++x) {
    if ((m->flags.at(x, 0) | m->flags.at(x - 1, 0)) != 0) continue;
    // Half a value at the least usable one, 10, on either side.
    RC_ASSERT(m->radiance.at(x, 0, 1) >= m->radiance.at(x - 1, 0, 1) * (1.0F - 0.1F));
  }
  const auto mean = [&](int from) {
    double sum = 0.0;
    for (int x = from; x < from + 20; ++x) sum += m->radiance.at(x, 0, 1);
    return sum;
  };
  for (int x = 20; x + 20 <= kWidth; ++x) {
    const auto clean = [&](int from) {
      for (int k = from; k < from + 20; ++k) {
        if (m->flags.at(k, 0) != 0) return false;
      }
      return true;
    };
    if (clean(x) && clean(x - 20)) RC_ASSERT(mean(x) > mean(x - 20));
  }
}

RC_GTEST_PROP(ResponseLaw, LinearValuesComeBack, ()) {
  const Response r = *Response::Linear(*Between(0.0, 100.0));
  const double value = *Between(r.black(), 255.0);
  const double back = r.ValueFromExposure(1, r.ExposureFromValue(1, value));
  RC_ASSERT(std::abs(back - value) < 1e-9);
}

RC_GTEST_PROP(ResponseLaw, ExposuresOfATableComeBack, ()) {
  std::array<std::vector<double>, 3> table;
  for (std::vector<double>& row : table) {
    double ln = *Between(-9.0, 0.0);
    for (int z = 0; z < 256; ++z) row.push_back(ln += *Between(0.001, 0.08));
  }
  const Response r = *Response::Table(table);
  const int c = *rc::gen::inRange(0, 3);
  const double value = *Between(0.0, 255.0);
  RC_ASSERT(std::abs(r.ValueFromExposure(c, r.ExposureFromValue(c, value)) - value) < 1e-6);
}

}  // namespace
}  // namespace omnihdr::photometry_test
