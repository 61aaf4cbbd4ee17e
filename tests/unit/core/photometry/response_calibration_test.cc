#include "core/photometry/response_calibration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>
#include <string>
#include <vector>

namespace omnihdr::response_calibration_test {
namespace {

using ::testing::HasSubstr;

// Pixel value (8-bit units, not rounded) of E·t, 1 being value 128.
using Curve = std::function<double(double)>;
double Linear(double x) { return 128.0 * x; }
double LinearWithBlack(double x) { return 16.0 + 112.0 * x; }
double Gamma(double x) { return 255.0 * std::pow(x * std::pow(128.0 / 255.0, 2.2), 1.0 / 2.2); }
double LogLinear(double x) { return 128.0 + std::log(std::max(x, 1e-9)) / 0.02; }

double Convex(double x) { return 128.0 * std::pow(x, 1.6); }

struct Bracket {
  std::vector<DecodedImage> images;
  std::vector<double> seconds;
  std::vector<std::string> names;
  std::vector<ExposedFrame> frames() const {
    std::vector<ExposedFrame> all;
    for (std::size_t k = 0; k < images.size(); ++k) {
      all.push_back({&images[k], {ExposureTime::Seconds(seconds[k]), {}}});
    }
    return all;
  }
  Result<ResponseSamples> Samples(const SampleOptions& options = {}) const {
    return SamplesFromBracket(frames(), names, 8, {}, options);
  }
  Image<std::uint8_t>& picture(std::size_t k) {
    return std::get<Image<std::uint8_t>>(images[k].pixels);
  }
};

constexpr int kWidth = 160;
constexpr int kHeight = 120;

// Smooth light over two decades, an own pattern a channel, seen through `curve` with noise.
Bracket Take(const Curve& curve, const std::vector<double>& seconds, double noise) {
  Bracket bracket;
  bracket.seconds = seconds;
  std::mt19937 random(7);
  std::normal_distribution<double> normal(0.0, std::max(noise, 1e-12));
  for (std::size_t k = 0; k < seconds.size(); ++k) {
    Image<std::uint8_t> image(kWidth, kHeight, 3);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        for (int c = 0; c < 3; ++c) {
          const double light =
              std::exp(2.3 * std::sin(0.05 * x + c) * std::cos(0.04 * y - 0.5 * c));
          const double value = curve(light * seconds[k]) + normal(random);
          image.at(x, y, c) = static_cast<std::uint8_t>(std::clamp(std::lround(value), 0L, 255L));
        }
      }
    }
    bracket.images.push_back(DecodedImage{std::move(image)});
    bracket.names.push_back("frame" + std::to_string(k));
  }
  return bracket;
}

const std::vector<double> kSevenStops = {0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0};

// Root mean square of g(Z) − g_true(Z) in stops over the values that were measured.
double CurveError(const ResponseCurve& curve, const Curve& truth) {
  double squares = 0.0;
  int count = 0;
  for (int z = curve.measured_low; z <= curve.measured_high; ++z) {
    double low = 1e-6;  // the light of that value, by bisection
    double high = 1e4;
    for (int k = 0; k < 100; ++k) {
      const double middle = std::sqrt(low * high);
      (truth(middle) < z ? low : high) = middle;
    }
    const double error =
        (curve.ln_exposure[static_cast<std::size_t>(z)] - std::log(low)) / std::numbers::ln2;
    squares += error * error;
    ++count;
  }
  return std::sqrt(squares / count);
}

ResponseCalibration Calibrated(const ResponseSamples& samples, ResponseMethod method) {
  ResponseCalibrationOptions options;
  options.method = method;
  Result<ResponseCalibration> calibration = CalibrateResponse(samples, options);
  EXPECT_TRUE(calibration) << (calibration ? "" : calibration.error().message);
  return calibration ? std::move(*calibration) : ResponseCalibration{};
}

class ResponseCalibrationOf : public ::testing::TestWithParam<ResponseMethod> {};

TEST_P(ResponseCalibrationOf, AGammaCurveIsRecoveredFromANoisyBracket) {
  const Result<ResponseSamples> samples = Take(Gamma, kSevenStops, 1.0).Samples();
  ASSERT_TRUE(samples) << samples.error().message;
  const ResponseCalibration calibration = Calibrated(*samples, GetParam());
  for (const ResponseCurve& curve : calibration.curves) {
    EXPECT_LT(CurveError(curve, Gamma), 0.03);
    EXPECT_LT(curve.measured_low, 30);
    EXPECT_GT(curve.measured_high, 230);
    EXPECT_GT(curve.r_squared, 0.999);
    EXPECT_TRUE(std::is_sorted(curve.ln_exposure.begin(), curve.ln_exposure.end()));
  }
  EXPECT_LT(calibration.residual_stops, 0.06);
  EXPECT_LT(calibration.held_out_stops, 1.2 * calibration.all_stops);
}

TEST_P(ResponseCalibrationOf, ALinearCameraIsRecoveredToo) {
  const Result<ResponseSamples> samples = Take(Linear, kSevenStops, 0.5).Samples();
  ASSERT_TRUE(samples) << samples.error().message;
  const ResponseCalibration calibration = Calibrated(*samples, GetParam());
  for (const ResponseCurve& curve : calibration.curves) {
    EXPECT_LT(CurveError(curve, Linear), 0.03);
  }
}

INSTANTIATE_TEST_SUITE_P(Methods, ResponseCalibrationOf,
                         ::testing::Values(ResponseMethod::kDebevec, ResponseMethod::kRobertson),
                         [](const auto& method) { return std::string(ToString(method.param)); });

TEST(ResponseCalibration, TheBlackLevelOfALinearCameraIsFoundWithItsUncertainty) {
  const Result<ResponseSamples> samples = Take(LinearWithBlack, kSevenStops, 0.7).Samples();
  ASSERT_TRUE(samples) << samples.error().message;
  const ResponseCalibration calibration = Calibrated(*samples, ResponseMethod::kLinear);
  EXPECT_EQ(calibration.response.model(), ResponseModel::kLinear);
  EXPECT_NEAR(calibration.response.black(), 16.0, 0.15);
}

TEST(ResponseCalibration, ASlopePerChannelIsFoundOfALogLinearCamera) {
  const Result<ResponseSamples> samples =
      Take(LogLinear, {0.0625, 0.125, 0.25, 0.5, 1.0, 2.0}, 1.0).Samples();
  ASSERT_TRUE(samples) << samples.error().message;
  const ResponseCalibration calibration = Calibrated(*samples, ResponseMethod::kLogLinear);
  for (const auto& a_b : calibration.response.loglinear()) {
    EXPECT_NEAR(a_b[0], 0.02, 0.0002);
    EXPECT_NEAR(a_b[1], -128 * a_b[0], 1e-12);
  }
}

TEST(ResponseCalibration, TheUncertaintyIsThatOfRepeatedCalibrations) {
  // The standard error says how far curves from fresh noise lie apart; the spread what one spot's
  // noise does: sigma of the mean of nine pixels over the slope.
  const Result<ResponseSamples> samples = Take(Gamma, kSevenStops, 2.0).Samples();
  ASSERT_TRUE(samples) << samples.error().message;
  const ResponseCurve curve = Calibrated(*samples, ResponseMethod::kDebevec).curves[1];
  const double slope = 2.2 / 100.0;  // d ln E / dZ of Z^2.2 at 100
  EXPECT_NEAR(curve.spread[100], 2.0 / 3.0 * slope, 0.35 * 2.0 / 3.0 * slope);
  EXPECT_LT(curve.standard_error[100], 0.2 * curve.spread[100]);
  EXPECT_GT(curve.standard_error[100], 0.0);
  EXPECT_NEAR(curve.standard_error[128], 0.0, 1e-4);
  EXPECT_GT(curve.standard_error[255], curve.standard_error[200]);
}

TEST(ResponseCalibration, ThingsThatMovedAreRejected) {
  Bracket bracket = Take(Gamma, kSevenStops, 1.0);
  std::mt19937 random(3);
  for (std::size_t k = 0; k < bracket.images.size(); ++k) {
    // Leaves: flat patches of any brightness, elsewhere in every picture.
    for (int n = 0; n < 6; ++n) {
      const int x0 = static_cast<int>(random() % (kWidth - 10));
      const int y0 = static_cast<int>(random() % (kHeight - 10));
      const auto value = static_cast<std::uint8_t>(20 + random() % 210);
      for (int y = y0; y < y0 + 10; ++y) {
        std::fill_n(bracket.picture(k).pixel(x0, y), 30, value);
      }
    }
  }
  const Result<ResponseSamples> samples = bracket.Samples();
  ASSERT_TRUE(samples) << samples.error().message;
  EXPECT_GT(samples->moving, 20U);
  const ResponseCalibration calibration = Calibrated(*samples, ResponseMethod::kDebevec);
  for (const ResponseCurve& curve : calibration.curves) EXPECT_LT(CurveError(curve, Gamma), 0.04);
  EXPECT_LT(calibration.residual_stops, 0.5 * calibration.all_stops);
}

TEST(ResponseCalibration, FogBelowTheFirstLightIsNotTakenForLight) {
  const Curve foggy = [](double x) { return std::max(18.0, Gamma(x)); };
  const Result<ResponseSamples> samples = Take(foggy, kSevenStops, 0.8).Samples();
  ASSERT_TRUE(samples) << samples.error().message;
  for (const double floor : samples->floor) {
    EXPECT_GT(floor, 17.0);
    EXPECT_LT(floor, 32.0);
  }
  const ResponseCalibration calibration = Calibrated(*samples, ResponseMethod::kDebevec);
  for (const ResponseCurve& curve : calibration.curves) EXPECT_LT(CurveError(curve, Gamma), 0.04);
}

TEST(ResponseCalibration, GreyPicturesGiveThreeEqualCurves) {
  Bracket bracket = Take(Gamma, kSevenStops, 1.0);
  for (DecodedImage& image : bracket.images) {
    const auto& colour = std::get<Image<std::uint8_t>>(image.pixels);
    Image<std::uint8_t> grey(kWidth, kHeight, 1);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) grey.at(x, y) = colour.at(x, y, 1);
    }
    image.pixels = std::move(grey);
  }
  const Result<ResponseSamples> samples = bracket.Samples();
  ASSERT_TRUE(samples) << samples.error().message;
  const ResponseCalibration calibration = Calibrated(*samples, ResponseMethod::kDebevec);
  EXPECT_EQ(calibration.curves[0].ln_exposure, calibration.curves[2].ln_exposure);
}

// Each refusal with its reason.
class ResponseRefuses : public ::testing::Test {
 protected:
  static void Expect(const Result<ResponseSamples>& samples, const std::string& reason) {
    ASSERT_FALSE(samples) << "expected: " << reason;
    EXPECT_EQ(samples.error().kind, ErrorKind::kData);
    EXPECT_THAT(samples.error().message, HasSubstr(reason));
  }
};

TEST_F(ResponseRefuses, OnePicture) {
  Expect(Take(Linear, {1.0}, 0.0).Samples(), "1 picture, expected at least two");
}

TEST_F(ResponseRefuses, EqualExposures) {
  Expect(Take(Linear, {1.0, 1.0, 1.05}, 0.0).Samples(), "are equal");
}

TEST_F(ResponseRefuses, PicturesSaturatedThroughout) {
  Expect(Take(Linear, {100.0, 200.0}, 0.0).Samples(), "saturated throughout");
}

TEST_F(ResponseRefuses, PicturesDarkThroughout) {
  Expect(Take(Linear, {0.0005, 0.001}, 0.0).Samples(), "dark throughout");
}

TEST_F(ResponseRefuses, ValuesThatFallWhileTheExposureGrowsNamingThePictures) {
  Bracket bracket = Take(Gamma, {0.25, 0.5, 1.0, 2.0}, 0.5);
  std::swap(bracket.seconds[1], bracket.seconds[2]);
  Expect(bracket.Samples(), "frame1 at 1 s is not brighter than frame2 at 0.5 s");
}

TEST_F(ResponseRefuses, TooFewSpots) {
  // Each light is usable in one exposure only.
  Expect(Take(Linear, {0.01, 1.0}, 0.0).Samples(), "spots are usable under two exposures");
}

TEST_F(ResponseRefuses, SizesThatDiffer) {
  Bracket bracket = Take(Linear, {1.0, 2.0}, 0.0);
  bracket.images[1].pixels = Image<std::uint8_t>(kWidth, kHeight - 1, 3);
  Expect(bracket.Samples(), "frame1: 160x119 with 3 channels, expected 160x120");
}

TEST_F(ResponseRefuses, AMaskThatLeavesNothingOrHasAnotherSize) {
  const Bracket bracket = Take(Linear, {1.0, 2.0}, 0.0);
  const Image<std::uint8_t> none(kWidth, kHeight);
  Expect(SamplesFromBracket(bracket.frames(), bracket.names, 8, none.view(), {}),
         "the mask leaves no pixel");
  const Image<std::uint8_t> small(kWidth / 2, kHeight);
  Expect(SamplesFromBracket(bracket.frames(), bracket.names, 8, small.view(), {}),
         "mask of 80x120");
}

TEST_F(ResponseRefuses, ATimeThatIsNone) {
  Bracket bracket = Take(Linear, {1.0, 2.0}, 0.0);
  bracket.seconds[0] = std::nan("");
  Expect(bracket.Samples(), "expected a positive finite time");
}

TEST(ResponseCalibration, RefusesRobertsonsMethodOnPairs) {
  const Result<ResponseSamples> samples = Take(Gamma, {0.5, 1.0}, 0.5).Samples();
  ASSERT_TRUE(samples) << samples.error().message;
  ResponseCalibrationOptions options;
  options.method = ResponseMethod::kRobertson;
  const Result<ResponseCalibration> refused = CalibrateResponse(*samples, options);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("robertson needs"));
}

TEST(ResponseCalibration, RefusesALinearFitOfWhatIsNotLinear) {
  const Result<ResponseSamples> samples = Take(Convex, {0.5, 1.0, 2.0}, 0.5).Samples();
  ASSERT_TRUE(samples) << samples.error().message;
  ResponseCalibrationOptions options;
  options.method = ResponseMethod::kLinear;
  const Result<ResponseCalibration> refused = CalibrateResponse(*samples, options);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("not linear"));
}

}  // namespace
}  // namespace omnihdr::response_calibration_test
