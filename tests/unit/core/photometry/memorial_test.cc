#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "core/image/image_io.h"
#include "core/photometry/measure.h"
#include "core/photometry/response_calibration.h"

namespace omnihdr::memorial_test {
namespace {

const std::filesystem::path kMemorial =
    std::filesystem::path(OMNIHDR_SOURCE_DIR) / ".." / "shared" / "data" / "memorial";

// Debevec and Malik's bracket of a church: sixteen scans of film, one stop apart. Film is not
// linear; a log-linear response over the usable range is what a person would write down first, and
// its slope is fitted here from the pictures themselves, as a median over pixels and pairs of
// frames.
class Memorial : public ::testing::Test {
 protected:
  void SetUp() override {
    std::ifstream times(kMemorial / "shutter_times.txt");
    if (!times) {
      GTEST_SKIP() << "SKIPPED: no recorded bracket at " << kMemorial.lexically_normal();
    }
    std::vector<std::filesystem::path> files;
    for (const auto& entry : std::filesystem::directory_iterator(kMemorial)) {
      if (entry.path().extension() == ".png") files.push_back(entry.path());
    }
    std::sort(files.begin(), files.end());
    for (const std::filesystem::path& file : files) {
      std::string time;  // "32" or "1/1024"
      ASSERT_TRUE(times >> time) << "fewer times than pictures";
      const std::size_t slash = time.find('/');
      const double seconds =
          slash == std::string::npos ? std::stod(time) : 1.0 / std::stod(time.substr(slash + 1));
      Result<DecodedImage> image = ReadImage(file);
      ASSERT_TRUE(image) << image.error().message;
      images_.push_back(std::move(*image));
      seconds_.push_back(seconds);
    }
    ASSERT_EQ(images_.size(), 16U);
  }

  const Image<std::uint8_t>& Picture(std::size_t k) const {
    return std::get<Image<std::uint8_t>>(images_[k].pixels);
  }

  // d(ln exposure)/d(value) of a channel: between frames a stop apart, the median change of value.
  double FitSlope(int channel) const {
    std::vector<double> changes;
    for (std::size_t k = 0; k + 1 < images_.size(); ++k) {
      const Image<std::uint8_t>& brighter = Picture(k);
      const Image<std::uint8_t>& darker = Picture(k + 1);
      for (int y = kBorder; y < brighter.height() - kBorder; y += 7) {
        for (int x = kBorder; x < brighter.width() - kBorder; x += 7) {
          const int a = brighter.at(x, y, channel);
          const int b = darker.at(x, y, channel);
          if (a > 220 || b < 40) continue;
          changes.push_back(a - b);
        }
      }
    }
    std::nth_element(changes.begin(),
                     changes.begin() + static_cast<std::ptrdiff_t>(changes.size() / 2),
                     changes.end());
    return std::log(2.0) / changes[changes.size() / 2];
  }

  static constexpr int kBorder = 80;  // the scans' edges are filled with blue
  std::vector<DecodedImage> images_;
  std::vector<double> seconds_;
};

TEST_F(Memorial, RadianceFollowsTheExposures) {
  std::array<std::array<double, 2>, 3> a_b{};
  for (int c = 0; c < 3; ++c) a_b[static_cast<std::size_t>(c)] = {FitSlope(c), 0.0};
  const Result<Response> response = Response::LogLinear(a_b);
  ASSERT_TRUE(response) << response.error().message;
  std::vector<ExposedFrame> frames;
  for (std::size_t k = 0; k < images_.size(); ++k) {
    frames.push_back({&images_[k], {ExposureTime::Seconds(seconds_[k]), {}}});
  }
  MeasureOptions options;
  options.value_low = 40;
  options.value_high = 220;
  const Projection projection =
      Projection::Equirectangular(images_[0].width(), images_[0].height());
  const Result<Measurement> m = Measure(frames, projection, *response, 8, {}, options);
  ASSERT_TRUE(m) << m.error().message;

  // Every frame's mid-tones, made linear, against the merged radiance times its exposure: no frame
  // stands apart by more than half a stop, though their exposures span fifteen.
  int frames_compared = 0;
  for (std::size_t k = 0; k < images_.size(); ++k) {
    std::vector<double> stops;
    for (int y = kBorder; y < images_[0].height() - kBorder; y += 3) {
      for (int x = kBorder; x < images_[0].width() - kBorder; x += 3) {
        const int z = Picture(k).at(x, y, 1);
        if (z < 60 || z > 200 || m->flags.at(x, y) != 0) continue;
        const double own = response->ExposureFromValue(1, z) / seconds_[k];
        stops.push_back(std::log2(own / m->radiance.at(x, y, 1)));
      }
    }
    if (stops.size() < 200) continue;
    ++frames_compared;
    std::nth_element(stops.begin(), stops.begin() + static_cast<std::ptrdiff_t>(stops.size() / 2),
                     stops.end());
    EXPECT_NEAR(stops[stops.size() / 2], 0.0, 0.5) << "frame of " << seconds_[k] << " s";
  }
  EXPECT_GE(frames_compared, 10);
}

TEST_F(Memorial, ItsResponseExplainsTheExposuresToATenthOfAStop) {
  // The pure blue of the scans' filled edges, grown by the reach of a spot's window.
  Image<std::uint8_t> mask(images_[0].width(), images_[0].height(), 1, 255);
  for (std::size_t k = 0; k < images_.size(); ++k) {
    for (int y = 0; y < mask.height(); ++y) {
      for (int x = 0; x < mask.width(); ++x) {
        const std::uint8_t* p = Picture(k).pixel(x, y);
        if (p[0] != 0 || p[1] != 0 || p[2] != 255) continue;
        for (int dy = -2; dy <= 2; ++dy) {
          for (int dx = -2; dx <= 2; ++dx) {
            mask.at(std::clamp(x + dx, 0, mask.width() - 1),
                    std::clamp(y + dy, 0, mask.height() - 1)) = 0;
          }
        }
      }
    }
  }
  std::vector<ExposedFrame> frames;
  std::vector<std::string> names;
  for (std::size_t k = 0; k < images_.size(); ++k) {
    frames.push_back({&images_[k], {ExposureTime::Seconds(seconds_[k]), {}}});
    names.push_back("scan " + std::to_string(k));
  }
  const Result<ResponseSamples> samples =
      SamplesFromBracket(frames, names, 8, mask.view(), SampleOptions{});
  ASSERT_TRUE(samples) << samples.error().message;
  for (const ResponseMethod method : {ResponseMethod::kDebevec, ResponseMethod::kRobertson}) {
    ResponseCalibrationOptions options;
    options.method = method;
    const Result<ResponseCalibration> calibration = CalibrateResponse(*samples, options);
    ASSERT_TRUE(calibration) << calibration.error().message;
    EXPECT_LT(calibration->residual_stops, 0.105) << ToString(method);
    EXPECT_LT(calibration->all_stops, 0.15) << ToString(method);
    EXPECT_LT(calibration->held_out_stops, 0.15) << ToString(method);
    for (const ResponseCurve& curve : calibration->curves) {
      EXPECT_LT(static_cast<double>(curve.outliers),
                0.03 * static_cast<double>(curve.observations));
      // Smooth: over the measured values, ln g' turns by no more than a quarter from value to
      // value.
      for (int z = curve.measured_low + 1; z < curve.measured_high; ++z) {
        const auto k = static_cast<std::size_t>(z);
        const double before = curve.ln_exposure[k] - curve.ln_exposure[k - 1];
        const double after = curve.ln_exposure[k + 1] - curve.ln_exposure[k];
        ASSERT_GT(before, 0.0) << z;
        ASSERT_LT(std::abs(std::log(after / before)), 0.25) << z;
      }
    }
  }
}

TEST_F(Memorial, TheMergedRangeIsFarMoreThanOneFramesRange) {
  const Result<Response> response =
      Response::LogLinear({{{FitSlope(0), 0.0}, {FitSlope(1), 0.0}, {FitSlope(2), 0.0}}});
  ASSERT_TRUE(response);
  std::vector<ExposedFrame> frames;
  for (std::size_t k = 0; k < images_.size(); ++k) {
    frames.push_back({&images_[k], {ExposureTime::Seconds(seconds_[k]), {}}});
  }
  const Projection projection =
      Projection::Equirectangular(images_[0].width(), images_[0].height());
  const Result<Measurement> m = Measure(frames, projection, *response, 8, {}, {});
  ASSERT_TRUE(m);
  std::vector<float> green;
  int unusable = 0;
  for (int y = kBorder; y < images_[0].height() - kBorder; ++y) {
    for (int x = kBorder; x < images_[0].width() - kBorder; ++x) {
      if (m->radiance.at(x, y, 3) != 1.0F) {
        ++unusable;
      } else {
        green.push_back(m->radiance.at(x, y, 1));
      }
    }
  }
  std::sort(green.begin(), green.end());
  const float low = green[green.size() / 1000];
  const float high = green[green.size() - 1 - green.size() / 1000];
  EXPECT_GT(std::log10(high / low), 3.0);
  EXPECT_LT(unusable, static_cast<int>(green.size() / 20));
}

}  // namespace
}  // namespace omnihdr::memorial_test
