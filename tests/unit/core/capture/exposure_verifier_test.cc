#include "core/capture/exposure_verifier.h"

#include <gtest/gtest.h>

#include <limits>

namespace omnihdr::exposure_verifier_test {
namespace {

Exposure At(double seconds, double gain_db = 0.0) {
  return {ExposureTime::Seconds(seconds), GainDb{gain_db}};
}

TEST(ExposureVerifier, WithinToleranceTheMeasuredExposureIsTheOneJournaled) {
  const auto check = VerifyExposure(At(0.01), At(0.0101), ExposureProof::kEmbedded, {});
  EXPECT_EQ(check.verdict, ExposureVerdict::kOk);
  EXPECT_TRUE(check.usable);
  EXPECT_DOUBLE_EQ(check.exposure.time.seconds(), 0.0101);
  EXPECT_TRUE(check.detail.empty());
}

TEST(ExposureVerifier, OneQuantumIsAlwaysAllowed) {
  ExposureTolerance tolerance;
  tolerance.quantum_s = 0.0001;
  EXPECT_TRUE(VerifyExposure(At(0.001), At(0.0011), ExposureProof::kReadback, tolerance).usable);
  EXPECT_FALSE(VerifyExposure(At(0.001), At(0.0013), ExposureProof::kReadback, tolerance).usable);
}

TEST(ExposureVerifier, AnotherExposureIsAMismatchAndSaysBoth) {
  const auto check = VerifyExposure(At(0.01), At(0.02), ExposureProof::kReadback, {});
  EXPECT_EQ(check.verdict, ExposureVerdict::kMismatch);
  EXPECT_FALSE(check.usable);
  EXPECT_EQ(check.detail, "asked for 0.01 s at 0 dB, the frame had 0.02 s at 0 dB");
  EXPECT_DOUBLE_EQ(check.exposure.time.seconds(), 0.02);
}

TEST(ExposureVerifier, AnotherGainIsAMismatch) {
  EXPECT_EQ(VerifyExposure(At(0.01), At(0.01, 6.0), ExposureProof::kEmbedded, {}).verdict,
            ExposureVerdict::kMismatch);
}

TEST(ExposureVerifier, WithoutProofAFrameIsRefusedUnlessAllowed) {
  for (const std::optional<Exposure>& measured : {std::optional<Exposure>(), {At(0.01)}}) {
    const auto refused = VerifyExposure(At(0.01), measured, ExposureProof::kNone, {});
    EXPECT_EQ(refused.verdict, ExposureVerdict::kUnproven);
    EXPECT_FALSE(refused.usable);
    EXPECT_FALSE(refused.detail.empty());
  }
  ExposureTolerance lax;
  lax.accept_unproven = true;
  const auto check = VerifyExposure(At(0.01), std::nullopt, ExposureProof::kNone, lax);
  EXPECT_TRUE(check.usable);
  EXPECT_DOUBLE_EQ(check.exposure.time.seconds(), 0.01);
}

TEST(ExposureVerifier, ARecordedFrameKeepsTheExposureItWasRecordedWith) {
  const auto check = VerifyExposure(At(0.01), At(0.0333), ExposureProof::kFile, {});
  EXPECT_EQ(check.verdict, ExposureVerdict::kOk);
  EXPECT_DOUBLE_EQ(check.exposure.time.seconds(), 0.0333);
}

TEST(ExposureVerifier, ANonsenseReadingNeverPasses) {
  for (const double bad : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN()}) {
    for (const ExposureProof proof : {ExposureProof::kEmbedded, ExposureProof::kFile}) {
      const auto check = VerifyExposure(At(0.01), At(bad), proof, {});
      EXPECT_EQ(check.verdict, ExposureVerdict::kMismatch) << bad;
      EXPECT_FALSE(check.usable);
      EXPECT_TRUE(check.exposure.IsValid());
    }
  }
}

}  // namespace
}  // namespace omnihdr::exposure_verifier_test
