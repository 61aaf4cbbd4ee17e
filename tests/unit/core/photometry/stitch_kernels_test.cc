#include "core/photometry/stitch_kernels.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <random>
#include <vector>

#include "core/photometry/measurement.h"
#include "core/photometry/stitch_table.h"

namespace omnihdr::stitch_kernels_test {
namespace {

constexpr int kCount = 53;

// Samples of several sensors: most clean, some clipped or dark in some channels, some in all.
struct Samples {
  std::vector<float> rgba;
  std::vector<std::uint8_t> flags;
  std::vector<std::uint32_t> packed;
  int sensors = 0;

  Samples(int sensors_, std::uint32_t seed) : sensors(sensors_) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> value(0.01F, 5.0F);
    std::uniform_int_distribution<std::uint32_t> share(1, kFullShare);
    std::uniform_int_distribution<int> bits(0, 63);
    std::uniform_int_distribution<int> kind(0, 5);
    for (int i = 0; i < sensors * kCount; ++i) {
      for (int c = 0; c < 4; ++c) rgba.push_back(value(random));
      const int k = i % kCount > 16 && i % kCount < 36 ? 0 : kind(random);  // a clean stretch
      flags.push_back(static_cast<std::uint8_t>(k < 4 ? 0 : k == 4 ? bits(random) : kSaturatedAny));
      packed.push_back(share(random) << 16U | (random() & 0xFFFFU));
    }
  }

  struct Out {
    std::vector<float> rgba = std::vector<float>(4 * kCount);
    std::vector<std::uint8_t> flags = std::vector<std::uint8_t>(kCount);
  };

  // Columns [begin, end) in one call.
  void Blend(int begin, int end, Out* out) const {
    const auto count = static_cast<std::size_t>(end - begin);
    std::vector<float> part_rgba;
    std::vector<std::uint8_t> part_flags;
    std::array<const std::uint32_t*, 4> part_packed{};
    for (int k = 0; k < sensors; ++k) {
      const auto first = static_cast<std::size_t>(k * kCount + begin);
      part_rgba.insert(part_rgba.end(), &rgba[4 * first], &rgba[4 * first] + 4 * count);
      part_flags.insert(part_flags.end(), &flags[first], &flags[first] + count);
      part_packed[static_cast<std::size_t>(k)] = &packed[first];
    }
    BlendSamples(part_rgba.data(), part_flags.data(), part_packed.data(), sensors,
                 static_cast<int>(count), &out->rgba[static_cast<std::size_t>(4 * begin)],
                 &out->flags[static_cast<std::size_t>(begin)]);
  }
};

TEST(BlendSamples, AreTheWeightedMeanOfWhatMeasuresElseTheLargestBound) {
  for (const int sensors : {2, 3, 4}) {
    const Samples samples(sensors, static_cast<std::uint32_t>(sensors));
    Samples::Out out;
    samples.Blend(0, kCount, &out);
    int bounds = 0;
    int lost = 0;
    for (int x = 0; x < kCount; ++x) {
      const auto at = [&](int k) { return static_cast<std::size_t>(k * kCount + x); };
      // Far below what a clipped sample of no smaller share proves.
      const auto is_lost = [&](int k) {
        if ((samples.flags[at(k)] & kSaturatedAny) != 0) return false;
        for (int j = 0; j < sensors; ++j) {
          if (ShareOf(samples.packed[at(j)]) < ShareOf(samples.packed[at(k)])) continue;
          for (std::size_t c = 0; c < 3; ++c) {
            if ((samples.flags[at(j)] & (kSaturatedR << c)) != 0 &&
                samples.rgba[4 * at(k) + c] < 0.5F * samples.rgba[4 * at(j) + c]) {
              return true;
            }
          }
        }
        return false;
      };
      bool some_clean = false;
      for (int k = 0; k < sensors; ++k) {
        if (is_lost(k)) {
          ++lost;
          continue;
        }
        some_clean = some_clean || (samples.flags[at(k)] & kSaturatedAny) == 0;
      }
      std::uint8_t want_flags = 0;
      std::array<double, 3> want{};
      for (int c = 0; c < 3; ++c) {
        double sum = 0.0;
        double shares = 0.0;
        double bound = 0.0;
        for (int k = 0; k < sensors; ++k) {
          if (is_lost(k)) continue;
          const std::uint8_t f = samples.flags[at(k)];
          const double value = samples.rgba[4 * at(k) + static_cast<std::size_t>(c)];
          if ((f & (some_clean ? int{kSaturatedAny} : kSaturatedR << c)) != 0) {
            bound = std::max(bound, value);
            continue;
          }
          sum += ShareOf(samples.packed[at(k)]) * value;
          shares += ShareOf(samples.packed[at(k)]);
          want_flags = static_cast<std::uint8_t>(want_flags | (f & (kDarkR << c)));
        }
        want[static_cast<std::size_t>(c)] = shares > 0.0 ? sum / shares : bound;
        if (shares == 0.0) want_flags = static_cast<std::uint8_t>(want_flags | kSaturatedR << c);
      }
      if ((want_flags & kSaturatedAny) == kSaturatedAny) {
        want.fill(std::min({want[0], want[1], want[2]}));
        ++bounds;
      }
      const auto i = static_cast<std::size_t>(x);
      EXPECT_EQ(out.flags[i], want_flags) << x;
      for (std::size_t c = 0; c < 3; ++c) {
        EXPECT_NEAR(out.rgba[4 * i + c], want[c], 1e-5 * want[c]) << x << " " << c;
      }
      EXPECT_EQ(out.rgba[4 * i + 3], want_flags == 0 ? 1.0F : 0.0F) << x;
    }
    if (sensors == 2) {
      EXPECT_GT(bounds, 0);
      EXPECT_GT(lost, 0);
    }
  }
}

TEST(BlendSamples, DoNotDependOnHowTheRowIsCut) {
  const Samples samples(3, 9);
  Samples::Out whole;
  samples.Blend(0, kCount, &whole);
  for (const int step : {1, 2, 5, 16, 31}) {
    Samples::Out cut;
    for (int x = 0; x < kCount; x += step) samples.Blend(x, std::min(x + step, kCount), &cut);
    EXPECT_EQ(std::memcmp(cut.rgba.data(), whole.rgba.data(), 4 * cut.rgba.size()), 0) << step;
    EXPECT_EQ(cut.flags, whole.flags) << step;
  }
}

}  // namespace
}  // namespace omnihdr::stitch_kernels_test
