#include "core/stereo/slic.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>
#include <vector>

#include "core/base/parallel_for.h"

namespace omnihdr::slic_test {
namespace {

constexpr int kWidth = 512;
constexpr int kHeight = 256;

Image<std::uint8_t> Noise(int spread) {
  Image<std::uint8_t> picture(kWidth, kHeight, 3);
  std::mt19937 random(11);
  for (std::uint8_t& v : picture.values()) {
    v = static_cast<std::uint8_t>(100 + static_cast<int>(random() % static_cast<unsigned>(spread)));
  }
  return picture;
}

// A bright disc, and one across the seam.
bool InDisc(int x, int y) {
  const int dx = std::min((x - 500 + kWidth) % kWidth, (500 - x + kWidth) % kWidth);
  return (x - 200) * (x - 200) + (y - 120) * (y - 120) < 60 * 60 ||
         dx * dx + (y - 140) * (y - 140) < 50 * 50;
}
Image<std::uint8_t> Discs() {
  Image<std::uint8_t> picture = Noise(12);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (InDisc(x, y)) picture.at(x, y, 0) = static_cast<std::uint8_t>(picture.at(x, y, 0) + 80);
    }
  }
  return picture;
}

// Number of 4-connected pieces per label, columns closing round the globe.
std::vector<int> PiecesOf(const Superpixels& s) {
  std::vector<int> pieces(static_cast<std::size_t>(s.count), 0);
  Image<std::uint8_t> seen(kWidth, kHeight);
  std::vector<std::pair<int, int>> stack;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (seen.at(x, y) != 0) continue;
      const std::int32_t label = s.label.at(x, y);
      ++pieces[static_cast<std::size_t>(label)];
      seen.at(x, y) = 1;
      stack.assign(1, {x, y});
      while (!stack.empty()) {
        const auto [px, py] = stack.back();
        stack.pop_back();
        for (const auto& [nx, ny] :
             {std::pair{(px + 1) % kWidth, py}, std::pair{(px + kWidth - 1) % kWidth, py},
              std::pair{px, std::min(kHeight - 1, py + 1)}, std::pair{px, std::max(0, py - 1)}}) {
          if (seen.at(nx, ny) != 0 || s.label.at(nx, ny) != label) continue;
          seen.at(nx, ny) = 1;
          stack.emplace_back(nx, ny);
        }
      }
    }
  }
  return pieces;
}

TEST(FindSuperpixels, EachIsOneConnectedPieceAndAllAreNumbered) {
  const Superpixels s = FindSuperpixels(Discs(), {});
  for (const std::int32_t label : s.label.values()) {
    ASSERT_GE(label, 0);
    ASSERT_LT(label, s.count);
  }
  for (const int pieces : PiecesOf(s)) ASSERT_EQ(pieces, 1);
}

TEST(FindSuperpixels, ThereAreAboutAsManyAsCells) {
  SlicOptions options;
  options.side_px = 16;
  const Superpixels s = FindSuperpixels(Noise(6), options);
  const int cells = (kWidth / 16) * (kHeight / 16);
  EXPECT_GT(s.count, 0.7 * cells);
  EXPECT_LT(s.count, 1.5 * cells);
}

TEST(FindSuperpixels, NoneIsTiny) {
  const Superpixels s = FindSuperpixels(Discs(), {});
  std::vector<int> size(static_cast<std::size_t>(s.count), 0);
  for (const std::int32_t label : s.label.values()) ++size[static_cast<std::size_t>(label)];
  EXPECT_GE(*std::min_element(size.begin(), size.end()), 24 * 24 / 4);
}

TEST(FindSuperpixels, KeepToOutlines) {
  const Superpixels s = FindSuperpixels(Discs(), {});
  std::vector<int> inside(static_cast<std::size_t>(s.count), 0);
  std::vector<int> all(inside.size(), 0);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const auto label = static_cast<std::size_t>(s.label.at(x, y));
      ++all[label];
      inside[label] += InDisc(x, y) ? 1 : 0;
    }
  }
  // Pixels in the minority of their superpixel have crossed an outline.
  int crossed = 0;
  for (std::size_t k = 0; k < all.size(); ++k) crossed += std::min(inside[k], all[k] - inside[k]);
  EXPECT_LT(crossed, 0.01 * kWidth * kHeight);
}

TEST(FindSuperpixels, TheSeamIsNoBorder) {
  const Superpixels s = FindSuperpixels(Noise(6), {});
  int across = 0;
  for (int y = 0; y < kHeight; ++y) {
    across += s.label.at(0, y) == s.label.at(kWidth - 1, y) ? 1 : 0;
  }
  EXPECT_GT(across, kHeight / 4);
}

TEST(FindSuperpixels, AreTheSameOnOneAndOnTwoWorkers) {
  const Image<std::uint8_t> picture = Discs();
  SetWorkerCount(1);
  const Superpixels one = FindSuperpixels(picture, {});
  SetWorkerCount(2);
  const Superpixels two = FindSuperpixels(picture, {});
  SetWorkerCount(0);
  EXPECT_EQ(one.count, two.count);
  EXPECT_TRUE(std::ranges::equal(one.label.values(), two.label.values()));
}

}  // namespace
}  // namespace omnihdr::slic_test
