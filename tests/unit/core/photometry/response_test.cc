#include "core/photometry/response.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace omnihdr::response_test {
namespace {

std::array<std::vector<double>, 3> GammaTable() {
  std::array<std::vector<double>, 3> table;
  for (std::size_t c = 0; c < 3; ++c) {
    for (int z = 0; z < 256; ++z) {
      table[c].push_back((2.0 + 0.1 * static_cast<double>(c)) * std::log((z + 0.5) / 128.0));
    }
  }
  return table;
}

// One of each model.
std::vector<Response> EveryModel() {
  return {*Response::Linear(), *Response::Linear(16.0),
          *Response::LogLinear({{{0.02, -3.0}, {0.021, -2.9}, {0.019, -3.2}}}),
          *Response::Table(GammaTable())};
}

TEST(Response, GreenValue128IsOne) {
  for (const Response& r : EveryModel()) EXPECT_NEAR(r.ExposureFromValue(1, 128.0), 1.0, 1e-12);
}

TEST(Response, ValueAndExposureAreInverseOfEachOther) {
  for (const Response& r : EveryModel()) {
    for (int c = 0; c < 3; ++c) {
      for (double z = std::max(r.black() + 0.25, 0.25); z < 255.0; z += 0.37) {
        EXPECT_NEAR(r.ValueFromExposure(c, r.ExposureFromValue(c, z)), z, 1e-6)
            << "model " << static_cast<int>(r.model()) << " channel " << c;
      }
    }
  }
}

TEST(Response, RisesWithTheValueAndIsNeverNegative) {
  for (const Response& r : EveryModel()) {
    for (int c = 0; c < 3; ++c) {
      double last = -1.0;
      for (int z = 0; z < 256; ++z) {
        const double e = r.ExposureFromValue(c, z);
        EXPECT_GE(e, 0.0);
        EXPECT_GE(e, last);
        if (z > r.black() + 1.0) {
          EXPECT_GT(e, last);
        }
        last = e;
      }
    }
  }
}

TEST(Response, TheLinearModelIsProportionalAboveBlack) {
  const Response r = *Response::Linear(16.0);
  EXPECT_EQ(r.ExposureFromValue(0, 16.0), 0.0);
  EXPECT_EQ(r.ExposureFromValue(0, 3.0), 0.0);
  EXPECT_NEAR(r.ExposureFromValue(0, 16.0 + 56.0), 0.5, 1e-12);
  EXPECT_NEAR(r.ExposureFromValue(2, 16.0 + 224.0), 2.0, 1e-12);
}

TEST(Response, TheLogLinearModelKeepsTheRatiosBetweenChannels) {
  const Response r = *Response::LogLinear({{{0.02, -3.0}, {0.021, -2.9}, {0.019, -3.2}}});
  EXPECT_NEAR(std::log(r.ExposureFromValue(0, 200.0) / r.ExposureFromValue(1, 60.0)),
              (0.02 * 200.0 - 3.0) - (0.021 * 60.0 - 2.9), 1e-12);
}

TEST(Response, ATableIsInterpolatedInTheLogarithm) {
  const std::array<std::vector<double>, 3> table = GammaTable();
  const Response r = *Response::Table(table);
  EXPECT_NEAR(std::log(r.ExposureFromValue(2, 100.25)),
              0.75 * table[2][100] + 0.25 * table[2][101] - table[1][128], 1e-12);
  EXPECT_EQ(r.ExposureFromValue(2, 300.0), r.ExposureFromValue(2, 255.0));
}

TEST(Response, AFlatPieceOfATableReadsBackAsAFiniteValueWithinIt) {
  std::array<std::vector<double>, 3> table = GammaTable();
  for (std::size_t z = 240; z < 256; ++z) table[0][z] = table[0][240];
  for (std::size_t z = 0; z < 10; ++z) table[0][z] = table[0][9];
  const Response r = *Response::Table(table);
  for (const int z : {0, 5, 9, 10, 239, 240, 250, 255}) {
    const double value = r.ValueFromExposure(0, r.ExposureFromValue(0, z));
    EXPECT_TRUE(std::isfinite(value));
    EXPECT_NEAR(r.ExposureFromValue(0, value), r.ExposureFromValue(0, z), 1e-9);
  }
  EXPECT_EQ(r.ValueFromExposure(0, 0.0), 0.0);
  EXPECT_EQ(r.ValueFromExposure(0, 1e30), 255.0);
}

TEST(Response, TheSlopeIsTheDerivative) {
  for (const Response& r : EveryModel()) {
    for (int c = 0; c < 3; ++c) {
      const double difference =
          (r.ExposureFromValue(c, 130.0) - r.ExposureFromValue(c, 126.0)) / 4.0;
      EXPECT_NEAR(r.Slope(c, 128.0), difference, 0.01 * difference);
    }
  }
}

TEST(Response, TheLookupHoldsEveryValue) {
  for (const Response& r : EveryModel()) {
    const std::array<float, 256> lookup = r.Lookup(1);
    for (std::size_t z = 0; z < 256; ++z) {
      EXPECT_FLOAT_EQ(lookup[z],
                      static_cast<float>(r.ExposureFromValue(1, static_cast<double>(z))));
    }
  }
}

TEST(Response, ABlackLevelOutsideItsRangeIsRefusedWithTheValue) {
  for (const double black : {-1.0, 128.0, 1e9, std::numeric_limits<double>::quiet_NaN(),
                             std::numeric_limits<double>::infinity()}) {
    const Result<Response> r = Response::Linear(black);
    ASSERT_FALSE(r);
    EXPECT_EQ(r.error().kind, ErrorKind::kData);
    EXPECT_NE(r.error().message.find(fmt::format("{}", black)), std::string::npos);
  }
}

TEST(Response, ALogLinearModelThatDoesNotRiseIsRefused) {
  for (const double a : {0.0, -0.02, 11.0, std::numeric_limits<double>::quiet_NaN()}) {
    EXPECT_FALSE(Response::LogLinear({{{0.02, 0.0}, {a, 0.0}, {0.02, 0.0}}}));
  }
  EXPECT_FALSE(Response::LogLinear({{{0.02, 1e9}, {0.02, 0.0}, {0.02, 0.0}}}));
}

TEST(Response, ATableThatFallsOrIsNotWholeIsRefused) {
  std::array<std::vector<double>, 3> table = GammaTable();
  table[2][77] = table[2][76] - 0.001;
  const Result<Response> falling = Response::Table(table);
  ASSERT_FALSE(falling);
  EXPECT_NE(falling.error().message.find("channel 2"), std::string::npos);
  EXPECT_NE(falling.error().message.find("77"), std::string::npos);

  table = GammaTable();
  table[0].pop_back();
  EXPECT_FALSE(Response::Table(table));
  table = GammaTable();
  table[1][3] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(Response::Table(table));
  table = GammaTable();
  table[1][255] = std::numeric_limits<double>::infinity();
  EXPECT_FALSE(Response::Table(table));
  EXPECT_FALSE(Response::Table({}));
}

}  // namespace
}  // namespace omnihdr::response_test
