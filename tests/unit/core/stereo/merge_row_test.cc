#include "core/stereo/merge_row.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <vector>

namespace omnihdr::merge_row_test {
namespace {

TEST(AgreementField, FactorsOfARowAreThoseOfItsPoints) {
  std::mt19937 random(7);
  std::uniform_int_distribution<int> cell(0, AgreementField::kWidth * AgreementField::kHeight - 1);
  std::vector<AgreementField::Residual> residuals(20000);
  for (AgreementField::Residual& r : residuals) {
    r.cell = cell(random);
    r.ratio = 1.0F + 0.2F * std::sin(0.01F * static_cast<float>(r.cell));
    r.noise = 1e-4F;
  }
  AgreementField field;
  field.Fit(residuals);
  constexpr int kCount = 500;
  constexpr float kStep = static_cast<float>(AgreementField::kWidth) / kCount;
  std::vector<float> row(kCount);
  for (const float y : {0.1F, 7.3F, 31.5F, 63.9F}) {
    field.FactorsOfRow(y, kStep, kCount, row.data());
    for (int k = 0; k < kCount; ++k) {
      ASSERT_NEAR(row[static_cast<std::size_t>(k)],
                  field.Factor((static_cast<float>(k) + 0.5F) * kStep, y), 1e-5F);
    }
  }
}

TEST(LookUpDisparity, NeverMixesTwoSurfaces) {
  DisparityMap map;
  map.disparity = Image<float>(8, 4, 1, 0.1F);
  map.confidence = Image<float>(8, 4, 1, 0.25F);
  for (int y = 0; y < 4; ++y) {
    map.disparity.at(3, y) = 0.8F;
    map.confidence.at(3, y) = 0.75F;
  }
  PointRow points;
  for (int k = 0; k < 80; ++k) {
    points.x.push_back(0.1F * static_cast<float>(k) + 0.04F);
    points.y.push_back(2.0F);
  }
  std::vector<float> disparity(points.x.size());
  std::vector<float> confidence(points.x.size());
  LookUpDisparity(map, points, disparity.data(), confidence.data());
  for (std::size_t i = 0; i < disparity.size(); ++i) {
    const bool is_near = points.x[i] > 3.0F && points.x[i] < 4.0F;
    EXPECT_FLOAT_EQ(disparity[i], is_near ? 0.8F : 0.1F) << points.x[i];
    EXPECT_FLOAT_EQ(confidence[i], is_near ? 0.75F : 0.25F) << points.x[i];
  }
}

TEST(LookUpDisparity, TakesWhatIsKnownAndGoesOnRoundTheGlobe) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  DisparityMap map;
  map.disparity = Image<float>(8, 4, 1, kNan);
  map.confidence = Image<float>(8, 4, 1, 1.0F);
  map.disparity.at(0, 1) = 0.30F;
  map.disparity.at(7, 1) = 0.31F;
  const PointRow points = {{0.0F, 8.0F, 0.9F, 4.0F}, {1.5F, 1.5F, 1.5F, 1.5F}};
  std::vector<float> disparity(4);
  std::vector<float> confidence(4);
  LookUpDisparity(map, points, disparity.data(), confidence.data());
  EXPECT_NEAR(disparity[0], 0.305F, 1e-5F);
  EXPECT_NEAR(disparity[1], 0.305F, 1e-5F);
  EXPECT_FLOAT_EQ(disparity[2], 0.30F);
  EXPECT_TRUE(std::isnan(disparity[3]));
  EXPECT_EQ(confidence[3], 0.0F);
}

TEST(DistrustOutside, OnlyOfWhatIsMeasured) {
  SourceRow row;
  row.sampled.radiance[1] = {0.5F, 1.0F, 3.0F, 5.0F, 5.0F};
  row.sampled.flags = {0, 0, 0, 0, kSaturatedR};
  row.trust = {0.9F, 0.9F, 0.9F, 0.9F, 0.9F};
  DistrustOutside({0.6F, 0.6F, 0.6F, 0.6F, 0.6F}, {4.0F, 4.0F, 4.0F, 4.0F, 4.0F}, &row);
  EXPECT_EQ(row.trust, (std::vector<float>{0.0F, 0.9F, 0.9F, 0.0F, 0.9F}));
}

}  // namespace
}  // namespace omnihdr::merge_row_test
