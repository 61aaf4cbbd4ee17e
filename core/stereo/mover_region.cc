#include "core/stereo/mover_region.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

#include "core/base/parallel_for.h"

namespace omnihdr {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr int kWitnesses = 2;
constexpr float kLeastArea = 0.004F;  // steradians
constexpr float kLeastFound = 0.6F;   // of an area
constexpr int kGrowth = 2;            // pixels
constexpr int kCrowd = 8;             // of the 25 pixels around one
constexpr int kSmooth = 6;            // of a pixel's 8 neighbours at its distance: a surface
constexpr int kRimPixels = 5;         // of a row whose median is the rim's disparity
constexpr int kReach = 12;            // pixels that a found area spreads
constexpr int kBeside = 2;            // found pixels next to one that spread to it
constexpr int kWidest = 96;           // pixels of a row between two rims

bool AreNear(float a, float b) { return std::abs(a - b) <= 0.1F * std::max(a, b) + 0.004F; }

int Wrapped(int x, int width) { return x < 0 ? x + width : (x >= width ? x - width : x); }

// Pixels with enough of the mask around them: lone ones go, gaps close.
Image<std::uint8_t> Crowded(const Image<std::uint8_t>& mask) {
  Image<std::uint8_t> out(mask.width(), mask.height());
  for (int y = 0; y < mask.height(); ++y) {
    for (int x = 0; x < mask.width(); ++x) {
      int set = 0;
      for (int dy = -2; dy <= 2; ++dy) {
        const int ny = std::clamp(y + dy, 0, mask.height() - 1);
        for (int dx = -2; dx <= 2; ++dx) {
          set += mask.at(Wrapped(x + dx, mask.width()), ny) != 0 ? 1 : 0;
        }
      }
      out.at(x, y) = set >= kCrowd ? 1 : 0;
    }
  }
  return out;
}

// Clears connected areas (by sides) smaller than `least` steradians, and those of which not enough
// was found: of the pixels between the first and the last of each of an area's rows. Half a mover
// taken away is worse than a whole one left.
void ClearDoubtful(float least, const Image<std::uint8_t>& found, Image<std::uint8_t>* mask) {
  const int width = mask->width();
  const int height = mask->height();
  std::vector<float> pixel_area;
  for (int y = 0; y < height; ++y) {
    const double top = std::cos(std::numbers::pi * y / height);
    const double bottom = std::cos(std::numbers::pi * (y + 1) / height);
    pixel_area.push_back(static_cast<float>((top - bottom) * 2.0 * std::numbers::pi / width));
  }
  constexpr std::uint8_t kVisited = 2;
  struct Member {
    int x = 0;  // as walked to: may lie outside the picture
    int y = 0;
  };
  std::vector<Member> members;
  std::vector<std::array<int, 2>> extent;  // of each row
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (mask->at(x, y) != 1) continue;
      members.assign(1, {x, y});
      extent.assign(static_cast<std::size_t>(height), {2 * width, -2 * width});
      mask->at(x, y) = kVisited;
      float area = 0.0F;
      int confirmed = 0;
      for (std::size_t k = 0; k < members.size(); ++k) {
        const Member at = members[k];
        area += pixel_area[static_cast<std::size_t>(at.y)];
        confirmed += found.at(((at.x % width) + width) % width, at.y) != 0 ? 1 : 0;
        auto& [first, last] = extent[static_cast<std::size_t>(at.y)];
        first = std::min(first, at.x);
        last = std::max(last, at.x);
        const auto visit = [&](int nx, int ny) {
          const int column = ((nx % width) + width) % width;
          if (ny < 0 || ny >= height || mask->at(column, ny) != 1) return;
          mask->at(column, ny) = kVisited;
          members.push_back({nx, ny});
        };
        visit(at.x - 1, at.y);
        visit(at.x + 1, at.y);
        visit(at.x, at.y - 1);
        visit(at.x, at.y + 1);
      }
      int filled = 0;
      for (const auto& [first, last] : extent) filled += std::max(0, last - first + 1);
      if (area >= least &&
          static_cast<float>(confirmed) >= kLeastFound * static_cast<float>(filled)) {
        continue;
      }
      for (const Member& at : members) mask->at(((at.x % width) + width) % width, at.y) = 0;
    }
  }
}

// One pixel more all round; new ones, and ones without a disparity, take the mean of those beside
// them.
void Grow(MoverRegion* region) {
  const int width = region->inside.width();
  const int height = region->inside.height();
  const Image<std::uint8_t> before = region->inside.Clone();
  const Image<float> known = region->disparity.Clone();
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (before.at(x, y) != 0 && known.at(x, y) >= 0.0F) continue;
      float sum = 0.0F;
      int count = 0;
      for (int dy = -1; dy <= 1; ++dy) {
        const int ny = std::clamp(y + dy, 0, height - 1);
        for (int dx = -1; dx <= 1; ++dx) {
          const int nx = Wrapped(x + dx, width);
          if (before.at(nx, ny) == 0) continue;
          region->inside.at(x, y) = 1;
          if (!(known.at(nx, ny) >= 0.0F)) continue;
          sum += known.at(nx, ny);
          ++count;
        }
      }
      if (count > 0) region->disparity.at(x, y) = sum / static_cast<float>(count);
    }
  }
}

// Everything the pixels of one search share.
class Search {
 public:
  explicit Search(const MoverSearch& s)
      : s_(s), map_grid_(s.map.disparity.width(), s.map.disparity.height()) {}

  struct Look {
    float disparity = kNan;  // the map's
    bool is_marked = false;
    bool is_surface = false;  // all other views but one see there what the own view sees
  };
  Look At(int x, int y) const {
    const Eigen::Vector3f ray = s_.world_from_grid * s_.grid.Ray(x, y);
    Look look;
    MergeSamples samples;
    samples[0] = OwnSample(ray);
    int mx = 0;
    int my = 0;
    map_grid_.Pixel(ray, &mx, &my);
    look.disparity = s_.map.disparity.at(mx, my);
    look.is_marked = (samples[0].flags & kMover) != 0;
    // What the own view does not see is nobody's to judge.
    if ((samples[0].flags & kMasked) != 0) look.is_surface = true;
    // Dark, it can contradict nobody.
    if (samples[0].usable && !IsTelling(samples[0])) look.is_surface = true;
    if (!(look.disparity >= 0.0F) || look.is_surface) return look;
    const std::size_t count = SamplesAt(ray, look.disparity, &samples);
    int with_mine = 0;
    int seen = 0;
    for (std::size_t k = 1; k < count; ++k) {
      const bool both_clipped = (samples[k].flags & samples[0].flags & kSaturatedAny) != 0;
      if (!both_clipped && !IsTelling(samples[k])) continue;
      ++seen;
      with_mine += both_clipped || MayShowTheSame(samples[0], samples[k]) ? 1 : 0;
    }
    // Of one view in four it may be hidden; fewer than two contradict nothing.
    look.is_surface = seen < kWitnesses || with_mine >= std::max(kWitnesses, seen - 1);
    return look;
  }

  // Of the disparities `rims`, and those that other views' maps put there, the one at which most
  // of the others agree, best. NaN: at none two do, or the own view shows the same there.
  float BehindMover(int x, int y, const std::array<float, 3>& rims, bool is_marked) const {
    const Eigen::Vector3f ray = s_.world_from_grid * s_.grid.Ray(x, y);
    MergeSamples samples;
    samples[0] = OwnSample(ray);
    float best = kNan;
    int best_views = 0;
    float best_spread = 0.0F;
    bool is_mine = false;
    const auto try_at = [&](float d) {
      if (!(d >= 0.0F)) return;
      const std::size_t count = SamplesAt(ray, d, &samples);
      const MergeMajority majority = FindMajority(samples, count);
      if (majority.telling < (is_marked ? 1 : kWitnesses)) return;
      const float centre = samples[majority.winner].radiance[1];
      float spread = 0.0F;
      for (std::size_t k = 1; k < count; ++k) {
        if (majority.member[k]) spread += std::abs(samples[k].radiance[1] - centre);
      }
      spread /= std::max(centre, 1e-9F);
      if (majority.telling < best_views ||
          (majority.telling == best_views && spread >= best_spread)) {
        return;
      }
      best = d;
      best_views = majority.telling;
      best_spread = spread;
      is_mine = MayShowTheSame(samples[0], samples[majority.winner]);
    };
    for (const float d : rims) try_at(d);
    int mx = 0;
    int my = 0;
    map_grid_.Pixel(ray, &mx, &my);
    for (const SourceLookup& source : s_.sources) {
      if (source.behind.empty()) continue;
      const float d = source.behind.at(mx, my);
      // Nothing nearer than what lies on both sides is behind.
      if (d <= 1.1F * std::max(rims[0], rims[1]) + 0.004F) try_at(d);
    }
    return is_mine && !is_marked ? kNan : best;
  }

 private:
  MergeSample OwnSample(const Eigen::Vector3f& ray) const {
    return MakeMergeSample(s_.own, s_.own_sampler.Sample(s_.own_from_world * ray));
  }
  // Samples of the other views, from 1 on; how many there are with the own.
  std::size_t SamplesAt(const Eigen::Vector3f& ray, float d, MergeSamples* samples) const {
    std::size_t count = 1;
    for (const SourceLookup& source : s_.sources) {
      const Eigen::Vector3f towards = source.camera_from_world * (ray - d * source.offset);
      float x = 0.0F;
      float y = 0.0F;
      source.sampler->PixelFromRay(towards.x(), towards.y(), towards.z(), &x, &y);
      const RadianceSample raw = source.sampler->SampleAt(x, y);
      if ((raw.flags & (kMasked | kMover)) != 0) continue;
      MergeSample sample = MakeMergeSample(*source.measurement, raw);
      const float contrast = LocalContrast(*source.measurement, x, y) * s_.misalignment_px;
      for (float& variance : sample.variance) variance += contrast * contrast;
      (*samples)[count++] = sample;
    }
    return count;
  }

  const MoverSearch& s_;
  LatLongGrid map_grid_;
};

// Whether a pixel belongs to a surface of the map: the own view is confirmed there, and most
// neighbours are as far away. Where something moved the map is torn: what matched there by chance
// lies now here, now there.
Image<std::uint8_t> Surfaces(const std::vector<Search::Look>& looks, int width, int height) {
  Image<std::uint8_t> surfaces(width, height);
  const auto at = [&](int x, int y) -> const Search::Look& {
    return looks[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                 static_cast<std::size_t>(Wrapped(x, width))];
  };
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const Search::Look& look = at(x, y);
      if (!look.is_surface || look.is_marked) continue;
      int near = 0;
      for (int dy = -1; dy <= 1; ++dy) {
        const int ny = std::clamp(y + dy, 0, height - 1);
        for (int dx = -1; dx <= 1; ++dx) {
          if (dx == 0 && dy == 0) continue;
          near += AreNear(look.disparity, at(x + dx, ny).disparity) ? 1 : 0;
        }
      }
      surfaces.at(x, y) = near >= kSmooth ? 1 : 0;
    }
  }
  return surfaces;
}

// The disparity of a row's surface next to `x` on one side, a median; NaN where there is none.
struct Rim {
  float disparity = kNan;
  int distance = 0;
};
Rim RimOf(const std::vector<Search::Look>& looks, const Image<std::uint8_t>& surfaces, int x, int y,
          int sign) {
  const int width = surfaces.width();
  std::array<float, kRimPixels> values{};
  std::size_t count = 0;
  Rim rim;
  for (int step = 1; step < kWidest && count < values.size(); ++step) {
    const int nx = ((x + sign * step) % width + width) % width;
    if (surfaces.at(nx, y) == 0) continue;
    const float d = looks[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                          static_cast<std::size_t>(nx)]
                        .disparity;
    if (!(d >= 0.0F)) continue;
    if (count == 0) rim.distance = step;
    values[count++] = d;
  }
  if (count < values.size()) return rim;
  std::nth_element(values.begin(), values.begin() + kRimPixels / 2, values.end());
  rim.disparity = values[kRimPixels / 2];
  return rim;
}

}  // namespace

MoverRegion FindMovers(const MoverSearch& s) {
  const int width = s.grid.width();
  const int height = s.grid.height();
  MoverRegion region;
  region.disparity = Image<float>(width, height, 1, kNan);
  const Search search(s);
  std::vector<Search::Look> looks(static_cast<std::size_t>(width) *
                                  static_cast<std::size_t>(height));
  const auto index = [&](int x, int y) {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
           static_cast<std::size_t>(x);
  };
  ParallelFor(height, 4, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) looks[index(x, y)] = search.At(x, y);
    }
  });
  const Image<std::uint8_t> surfaces = Surfaces(looks, width, height);
  Image<std::uint8_t> found(width, height);
  Image<std::uint8_t> marked(width, height);
  ParallelFor(height, 4, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        if (surfaces.at(x, y) != 0) continue;
        const Rim left = RimOf(looks, surfaces, x, y, -1);
        const Rim right = RimOf(looks, surfaces, x, y, 1);
        if (!(left.disparity >= 0.0F) || !(right.disparity >= 0.0F)) continue;
        const float share =
            static_cast<float>(left.distance) / static_cast<float>(left.distance + right.distance);
        const float between = left.disparity + share * (right.disparity - left.disparity);
        const bool is_marked = looks[index(x, y)].is_marked;
        const float d =
            search.BehindMover(x, y, {left.disparity, right.disparity, between}, is_marked);
        if (is_marked) {
          marked.at(x, y) = 1;
          region.disparity.at(x, y) = d >= 0.0F ? d : between;
        } else if (d >= 0.0F) {
          found.at(x, y) = 1;
          region.disparity.at(x, y) = d;
        }
      }
    }
  });
  region.inside = Crowded(found);
  ClearDoubtful(kLeastArea, found, &region.inside);
  // Chance agreement leaves holes in a mover: close by, what contradicts the others is part of it
  // whatever the map says.
  for (int step = 0; step < kReach; ++step) {
    const Image<std::uint8_t> before = region.inside.Clone();
    const Image<float> known = region.disparity.Clone();
    ParallelFor(height, 4, [&](int begin, int end) {
      for (int y = begin; y < end; ++y) {
        for (int x = 0; x < width; ++x) {
          if (before.at(x, y) != 0) continue;
          float sum = 0.0F;
          int count = 0;
          for (int dy = -1; dy <= 1; ++dy) {
            const int ny = std::clamp(y + dy, 0, height - 1);
            for (int dx = -1; dx <= 1; ++dx) {
              const int nx = Wrapped(x + dx, width);
              if (before.at(nx, ny) == 0 || !(known.at(nx, ny) >= 0.0F)) continue;
              sum += known.at(nx, ny);
              ++count;
            }
          }
          if (count < kBeside) continue;
          const float beside = sum / static_cast<float>(count);
          const float d = search.BehindMover(x, y, {beside, beside, beside}, false);
          if (!(d >= 0.0F)) continue;
          region.inside.at(x, y) = 1;
          region.disparity.at(x, y) = d;
        }
      }
    });
  }
  std::transform(marked.values().begin(), marked.values().end(), region.inside.values().begin(),
                 region.inside.values().begin(),
                 [](std::uint8_t a, std::uint8_t b) -> std::uint8_t { return a | b; });
  for (int k = 0; k < kGrowth; ++k) Grow(&region);
  if (std::none_of(region.inside.values().begin(), region.inside.values().end(),
                   [](std::uint8_t v) { return v != 0; })) {
    return {};
  }
  return region;
}

}  // namespace omnihdr
