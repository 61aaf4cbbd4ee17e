#include "core/stereo/mover_region.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/stereo/stereo_view.h"

namespace omnihdr {
namespace {
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr int kWitnesses = 2;
constexpr float kLeastArea = 0.002F;     // steradians
constexpr float kLeastSureness = 0.35F;  // share of a pixel's surroundings that witnesses agree on
constexpr int kSmooth = 6;               // of a pixel's 8 neighbours at its distance: a surface
constexpr float kWide = 0.8F;            // of a surface pixel's surroundings, to be surface as well
constexpr int kRimPixels = 5;            // of a row whose median is the rim's disparity
constexpr int kWidest = 96;              // pixels of a row between two rims
constexpr float kAlike = 0.15F;          // relative: nearly equal radiance
constexpr float kSpread = 0.2F;          // relative: at which views do not agree at all
// What counts for a guess beside the views that agree on it.
constexpr float kBetweenRims = 0.5F;
constexpr float kLikeOneRim = 0.25F;
// Radii of a pixel's surroundings, as shares of the picture's width.
constexpr int kAroundShare = 160;
constexpr int kWideShare = 128;
constexpr int kRounds = 16;
constexpr int kGrowth = 1;  // pixels

bool AreNear(float a, float b) { return std::abs(a - b) <= 0.1F * std::max(a, b) + 0.004F; }

int Wrapped(int x, int width) { return x < 0 ? x + width : (x >= width ? x - width : x); }

int RadiusOf(int width, int share) { return std::max(2, width / share); }

// Means over squares of 2·radius + 1, rows closed round the globe.
Image<float> BoxMean(const Image<float>& values, int radius) {
  const int width = values.width();
  const int height = values.height();
  Image<float> across(width, height);
  Image<float> out(width, height);
  const int side = 2 * radius + 1;
  const float share = 1.0F / static_cast<float>(side * side);
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      const float* row = values.row(y);
      for (int x = 0; x < width; ++x) {
        float sum = 0.0F;
        for (int k = -radius; k <= radius; ++k) sum += row[Wrapped(x + k, width)];
        across.at(x, y) = sum;
      }
    }
  });
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int k = -radius; k <= radius; ++k) {
        const float* row = across.row(std::clamp(y + k, 0, height - 1));
        for (int x = 0; x < width; ++x) out.at(x, y) += row[x];
      }
      for (int x = 0; x < width; ++x) out.at(x, y) *= share;
    }
  });
  return out;
}

// Clears connected areas (by sides) of which less than `least` steradians is in `evidence`.
void ClearSmall(float least, const Image<std::uint8_t>& evidence, Image<std::uint8_t>* mask) {
  const int width = mask->width();
  const int height = mask->height();
  std::vector<float> pixel_area;
  for (int y = 0; y < height; ++y) {
    const double top = std::cos(std::numbers::pi * y / height);
    const double bottom = std::cos(std::numbers::pi * (y + 1) / height);
    pixel_area.push_back(static_cast<float>((top - bottom) * 2.0 * std::numbers::pi / width));
  }
  constexpr std::uint8_t kVisited = 2;
  std::vector<std::array<int, 2>> members;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (mask->at(x, y) != 1) continue;
      members.assign(1, {x, y});
      mask->at(x, y) = kVisited;
      float area = 0.0F;
      for (std::size_t k = 0; k < members.size(); ++k) {
        const auto [mx, my] = members[k];
        if (evidence.at(mx, my) != 0) area += pixel_area[static_cast<std::size_t>(my)];
        const auto visit = [&](int nx, int ny) {
          nx = Wrapped(nx, width);
          if (ny < 0 || ny >= height || mask->at(nx, ny) != 1) return;
          mask->at(nx, ny) = kVisited;
          members.push_back({nx, ny});
        };
        visit(mx - 1, my);
        visit(mx + 1, my);
        visit(mx, my - 1);
        visit(mx, my + 1);
      }
      if (area >= least) continue;
      for (const auto& [mx, my] : members) mask->at(mx, my) = 0;
    }
  }
}

// Everything the pixels of one search share.
class Search {
 public:
  explicit Search(const MoverSearch& s)
      : s_(s),
        map_grid_(s.map.disparity.width(), s.map.disparity.height()),
        own_(Halved(s.own)),
        own_sampler_(own_) {
    others_.reserve(s.sources.size());
    for (const SourceLookup& source : s.sources) others_.push_back(Halved(*source.measurement));
    for (const Measurement& other : others_) samplers_.emplace_back(other);
  }

  // What a pixel of the own view shows by its own map.
  struct Look {
    float disparity = kNan;
    bool is_marked = false;
    bool is_open = false;     // the own view says something that others could contradict
    bool is_surface = false;  // all other views but one see there what the own view sees
  };
  Look At(int x, int y) const {
    const Eigen::Vector3f ray = RayOf(x, y);
    Look look;
    MergeSamples samples;
    samples[0] = OwnSample(ray);
    look.disparity = MapAt(s_.map.disparity, ray);
    look.is_marked = (samples[0].flags & kMover) != 0;
    // What the own view does not see is nobody's to judge; dark, it can contradict nobody.
    look.is_open =
        (samples[0].flags & kMasked) == 0 && (!samples[0].usable || IsTelling(samples[0]));
    if (!(look.disparity >= 0.0F) || !look.is_open) return look;
    const std::size_t count = SamplesAt(ray, look.disparity, &samples);
    int with_mine = 0;
    int seen = 0;
    for (std::size_t k = 1; k < count; ++k) {
      if ((samples[k].flags & (kMasked | kMover)) != 0) continue;
      const bool both_clipped = (samples[k].flags & samples[0].flags & kSaturatedAny) != 0;
      if (!both_clipped && !IsTelling(samples[k])) continue;
      ++seen;
      with_mine += both_clipped || MayShowTheSame(samples[0], samples[k]) ? 1 : 0;
    }
    // Of one view in four it may be hidden; fewer than two contradict nothing.
    look.is_surface = seen < kWitnesses || with_mine >= std::max(kWitnesses, seen - 1);
    return look;
  }

  // What all views see of the surface that most of them agree on along the ray of a pixel.
  struct Meeting {
    float disparity = kNan;  // of that surface; NaN: none could be tried
    // Bit k: view k - 0 the own, k the k-th source from 1 on - says something there; and whom it
    // sides with, itself included.
    std::uint8_t telling = 0;
    std::array<std::uint8_t, kMaxMergeViews> sides{};
  };
  Meeting MeetAt(int x, int y, float d) const {
    const Eigen::Vector3f ray = RayOf(x, y);
    MergeSamples samples;
    samples[0] = OwnSample(ray);
    const std::size_t count = SamplesAt(ray, d, &samples);
    Meeting meeting = SidesOf(samples, count);
    meeting.disparity = d;
    return meeting;
  }
  // How well the other views agree with each other at a disparity, the own one's aside: the views
  // of the largest set that sides with each other, less how far apart they are.
  float AgreementAt(int x, int y, float d) const {
    if (!(d >= 0.0F)) return 0.0F;
    const Eigen::Vector3f ray = RayOf(x, y);
    MergeSamples samples;
    const std::size_t count = SamplesAt(ray, d, &samples);
    const MergeMajority majority = FindMajority(samples, count);
    if (majority.telling < kWitnesses) return 0.0F;
    const float centre = samples[majority.winner].radiance[1];
    float spread = 0.0F;
    for (std::size_t k = 1; k < count; ++k) {
      if (majority.member[k]) spread += std::abs(samples[k].radiance[1] - centre);
    }
    spread /= std::max(centre, 1e-9F) * static_cast<float>(majority.views);
    return static_cast<float>(majority.telling) * std::max(0.0F, 1.0F - spread / kSpread);
  }

  // Whether other views' maps put something at a pixel that would hide what its own map has there.
  bool IsSeenThrough(int x, int y, const Look& look) const {
    for (std::size_t n = 0; n < s_.sources.size(); ++n) {
      const float d = BehindBy(n, x, y);
      if (d > look.disparity && !AreNear(d, look.disparity)) return true;
    }
    return false;
  }

  // How far another view's map puts what is seen at a pixel; NaN = it does not say.
  float BehindBy(std::size_t source, int x, int y) const {
    const Image<float>& behind = s_.sources[source].behind;
    return behind.empty() ? kNan : MapAt(behind, RayOf(x, y));
  }

 private:
  Eigen::Vector3f RayOf(int x, int y) const { return s_.world_from_grid * s_.grid.Ray(x, y); }
  float MapAt(const Image<float>& map, const Eigen::Vector3f& ray) const {
    int x = 0;
    int y = 0;
    map_grid_.Pixel(ray, &x, &y);
    // A view that was matched before its neighbours were there has a map of half the size.
    return map.at(x * map.width() / s_.map.disparity.width(),
                  y * map.height() / s_.map.disparity.height());
  }
  static Meeting SidesOf(const MergeSamples& samples, std::size_t count) {
    Meeting meeting;
    for (std::size_t k = 0; k < count; ++k) {
      const bool is_clipped = (samples[k].flags & kSaturatedAny) != 0;
      const bool is_there = (samples[k].flags & (kMasked | kMover)) == 0;
      if (!is_there || !(IsTelling(samples[k]) || (k == 0 && is_clipped))) continue;
      meeting.telling = static_cast<std::uint8_t>(meeting.telling | (1U << k));
    }
    for (std::size_t k = 0; k < count; ++k) {
      if (((meeting.telling >> k) & 1U) == 0) continue;
      for (std::size_t j = 0; j < count; ++j) {
        if (((meeting.telling >> j) & 1U) == 0) continue;
        const bool same = j == k || (k < j ? MayShowTheSame(samples[k], samples[j], kAlike)
                                           : MayShowTheSame(samples[j], samples[k], kAlike));
        if (same) meeting.sides[k] = static_cast<std::uint8_t>(meeting.sides[k] | (1U << j));
      }
    }
    return meeting;
  }
  // As coarse as the search, with a quarter of the noise's variance.
  static Measurement Halved(const Measurement& m) {
    Measurement half = HalveMeasurement(m);
    for (float& variance : half.variance_floor) variance *= 0.25F;
    for (float& variance : half.variance_per_radiance) variance *= 0.25F;
    return half;
  }
  MergeSample OwnSample(const Eigen::Vector3f& ray) const {
    return MakeMergeSample(own_, own_sampler_.Sample(s_.own_from_world * ray));
  }
  // Samples of the other views, source k's at k + 1; how many there are with the own.
  std::size_t SamplesAt(const Eigen::Vector3f& ray, float d, MergeSamples* samples) const {
    std::size_t count = 1;
    for (std::size_t n = 0; n < others_.size(); ++n) {
      const SourceLookup& source = s_.sources[n];
      const Eigen::Vector3f towards = source.camera_from_world * (ray - d * source.offset);
      float x = 0.0F;
      float y = 0.0F;
      samplers_[n].PixelFromRay(towards.x(), towards.y(), towards.z(), &x, &y);
      MergeSample sample = MakeMergeSample(others_[n], samplers_[n].SampleAt(x, y));
      if ((sample.flags & kMover) != 0) sample.usable = false;
      const float contrast = LocalContrast(others_[n], x, y) * s_.misalignment_px;
      for (float& variance : sample.variance) variance += contrast * contrast;
      (*samples)[count++] = sample;
    }
    return count;
  }

  const MoverSearch& s_;
  LatLongGrid map_grid_;
  Measurement own_;
  PanoramaSampler own_sampler_;
  std::vector<Measurement> others_;  // of the sources, in order
  std::vector<PanoramaSampler> samplers_;
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

// Which views see the background at every pixel where they do not all agree: bit k as in Meeting.
// Law: of the sets of views that side with each other that one sees the background which is the
// larger, views counting more or less as they see it in the surroundings; from there, round by
// round, a view that something hides hides in one piece.
Image<std::uint8_t> WhoSeesBackground(const Image<Search::Meeting>& meetings, std::size_t views) {
  const int width = meetings.width();
  const int height = meetings.height();
  const int radius = RadiusOf(width, kAroundShare);
  std::vector<Image<float>> sees;  // 1 the background, -1 something else, between where not known
  for (std::size_t k = 0; k < views; ++k) sees.emplace_back(width, height, 1, 1.0F);
  Image<std::uint8_t> chosen(width, height, 1, 0xFF);
  for (int round = 0; round < kRounds; ++round) {
    std::vector<Image<float>> around;
    around.reserve(views);
    for (const Image<float>& of_view : sees) around.push_back(BoxMean(of_view, radius));
    ParallelFor(height, 8, [&](int begin, int end) {
      for (int y = begin; y < end; ++y) {
        for (int x = 0; x < width; ++x) {
          const Search::Meeting& meeting = meetings.at(x, y);
          if (meeting.telling == 0) continue;
          float most = -std::numeric_limits<float>::infinity();
          unsigned best = 0;
          for (std::size_t k = 0; k < views; ++k) {
            if (((meeting.telling >> k) & 1U) == 0) continue;
            float votes = 0.0F;
            for (std::size_t j = 0; j < views; ++j) {
              if (((meeting.sides[k] >> j) & 1U) == 0) continue;
              votes += 1.0F + (round == 0 ? 0.0F : 1.0F) * around[j].at(x, y);
            }
            if (votes <= most) continue;
            most = votes;
            best = meeting.sides[k];
          }
          unsigned who = 0;
          for (std::size_t k = 0; k < views; ++k) {
            const bool tells = ((meeting.telling >> k) & 1U) != 0;
            const float known = ((best >> k) & 1U) != 0 ? 1.0F : -1.0F;
            const float value = tells ? known : around[k].at(x, y);
            sees[k].at(x, y) = value;
            if (value > 0.0F) who |= 1U << k;
          }
          chosen.at(x, y) = static_cast<std::uint8_t>(who);
        }
      }
    });
  }
  return chosen;
}

// One pixel more all round; new ones take the mean disparity of those beside them, and all views
// that show the background there.
void Grow(MoverRegion* region) {
  const int width = region->inside.width();
  const int height = region->inside.height();
  const Image<std::uint8_t> before = region->inside.Clone();
  const Image<float> known = region->disparity.Clone();
  const Image<std::uint8_t> views = region->views.Clone();
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (before.at(x, y) != 0 && known.at(x, y) >= 0.0F && views.at(x, y) != 0) continue;
      float sum = 0.0F;
      int count = 0;
      unsigned beside = 0;
      bool is_next = false;
      for (int dy = -1; dy <= 1; ++dy) {
        const int ny = std::clamp(y + dy, 0, height - 1);
        for (int dx = -1; dx <= 1; ++dx) {
          const int nx = Wrapped(x + dx, width);
          if (before.at(nx, ny) == 0) continue;
          is_next = true;
          beside |= views.at(nx, ny);
          if (!(known.at(nx, ny) >= 0.0F)) continue;
          sum += known.at(nx, ny);
          ++count;
        }
      }
      if (!is_next) continue;
      const bool is_new = before.at(x, y) == 0;
      region->inside.at(x, y) = 1;
      if (count > 0 && (is_new || !(region->disparity.at(x, y) >= 0.0F))) {
        region->disparity.at(x, y) = sum / static_cast<float>(count);
      }
      if (is_new || views.at(x, y) == 0) {
        region->views.at(x, y) = static_cast<std::uint8_t>(beside);
      }
    }
  }
}

// Surfaces that reach far enough to tell of what is behind something beside them.
Image<std::uint8_t> WideSurfaces(const Image<std::uint8_t>& surfaces) {
  const int width = surfaces.width();
  const int height = surfaces.height();
  Image<float> around(width, height);
  std::copy(surfaces.values().begin(), surfaces.values().end(), around.values().begin());
  around = BoxMean(around, RadiusOf(width, kWideShare));
  Image<std::uint8_t> wide(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      wide.at(x, y) = surfaces.at(x, y) != 0 && around.at(x, y) >= kWide ? 1 : 0;
    }
  }
  return wide;
}

// Where pixels are in question, what they show by the own map, and how far the background is there.
struct Background {
  Image<std::uint8_t> open;    // in question
  Image<std::uint8_t> marked;  // by a person
  Image<float> disparity;      // where open; NaN = not known
};

// How far the background is: between the surfaces left and right of a pixel, like either, where
// the own map has it or where other views' maps have it - where the other views around agree best.
Background GuessBackground(const MoverSearch& s, const Search& search) {
  const int width = s.grid.width();
  const int height = s.grid.height();
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
  const Image<std::uint8_t> wide = WideSurfaces(surfaces);
  Background background{Image<std::uint8_t>(width, height), Image<std::uint8_t>(width, height),
                        Image<float>(width, height, 1, kNan)};
  const std::size_t guesses = 4 + s.sources.size();
  std::vector<Image<float>> guess;
  std::vector<Image<float>> agreement;
  for (std::size_t k = 0; k < guesses; ++k) {
    guess.emplace_back(width, height, 1, kNan);
    agreement.emplace_back(width, height);
  }
  ParallelFor(height, 4, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        const Search::Look& look = looks[index(x, y)];
        if (!look.is_open && !look.is_marked) continue;
        if (surfaces.at(x, y) != 0 && !search.IsSeenThrough(x, y, look)) continue;
        background.open.at(x, y) = 1;
        background.marked.at(x, y) = look.is_marked ? 1 : 0;
        const Rim left = RimOf(looks, wide, x, y, -1);
        const Rim right = RimOf(looks, wide, x, y, 1);
        const float share =
            static_cast<float>(left.distance) / static_cast<float>(left.distance + right.distance);
        guess[0].at(x, y) = left.disparity + share * (right.disparity - left.disparity);
        guess[1].at(x, y) = left.disparity;
        guess[2].at(x, y) = right.disparity;
        guess[3].at(x, y) = look.disparity;
        for (std::size_t n = 0; n < s.sources.size(); ++n) {
          guess[4 + n].at(x, y) = search.BehindBy(n, x, y);
        }
        for (std::size_t k = 0; k < guesses; ++k) {
          agreement[k].at(x, y) = search.AgreementAt(x, y, guess[k].at(x, y));
        }
      }
    }
  });
  for (Image<float>& of_guess : agreement) {
    of_guess = BoxMean(of_guess, RadiusOf(width, kAroundShare));
  }
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (background.open.at(x, y) == 0) continue;
      float best = 0.0F;
      for (std::size_t k = 0; k < guesses; ++k) {
        const float prior = k == 0 ? kBetweenRims : (k < 3 ? kLikeOneRim : 0.0F);
        const float votes = agreement[k].at(x, y) + prior;
        if (!(guess[k].at(x, y) >= 0.0F) || votes <= best) continue;
        best = votes;
        background.disparity.at(x, y) = guess[k].at(x, y);
      }
    }
  }
  return background;
}

}  // namespace

MoverRegion FindMovers(const MoverSearch& s) {
  const int width = s.grid.width();
  const int height = s.grid.height();
  const Search search(s);
  Background background = GuessBackground(s, search);
  Image<Search::Meeting> meetings(width, height);
  ParallelFor(height, 4, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        const float d = background.disparity.at(x, y);
        if (d >= 0.0F) meetings.at(x, y) = search.MeetAt(x, y, d);
      }
    }
  });
  const std::size_t views = std::min(s.sources.size() + 1, kMaxMergeViews);
  const Image<std::uint8_t> who = WhoSeesBackground(meetings, views);
  MoverRegion region;
  region.disparity = std::move(background.disparity);
  region.views = Image<std::uint8_t>(width, height);
  region.inside = Image<std::uint8_t>(width, height);
  Image<std::uint8_t> evidence(width, height);
  Image<float> sure(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const unsigned others = who.at(x, y) & ~1U;
      const bool is_known = region.disparity.at(x, y) >= 0.0F;
      if (!is_known || (who.at(x, y) & 1U) != 0 || others == 0) continue;
      region.inside.at(x, y) = 1;
      region.views.at(x, y) = static_cast<std::uint8_t>(others >> 1U);
      const unsigned telling = others & meetings.at(x, y).telling;
      if (std::popcount(telling) < kWitnesses) continue;
      evidence.at(x, y) = 1;
      sure.at(x, y) = 1.0F;
    }
  }
  sure = BoxMean(sure, RadiusOf(width, kAroundShare));
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (sure.at(x, y) < kLeastSureness) region.inside.at(x, y) = 0;
    }
  }
  ClearSmall(kLeastArea, evidence, &region.inside);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (background.marked.at(x, y) != 0) {
        region.inside.at(x, y) = 1;
        region.views.at(x, y) = 0xFF;
      }
      if (region.inside.at(x, y) != 0) region.inside.at(x, y) = MoverRegion::kCore;
    }
  }
  for (int k = 0; k < kGrowth; ++k) Grow(&region);
  if (std::none_of(region.inside.values().begin(), region.inside.values().end(),
                   [](std::uint8_t v) { return v != 0; })) {
    return {};
  }
  return region;
}

}  // namespace omnihdr
