#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "core/photometry/measure.h"
#include "tests/property/generators.h"

namespace omnihdr {
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
}  // namespace omnihdr
