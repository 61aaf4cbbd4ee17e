#include "drivers/gpio/edge_filter.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace omnihdr::gpio {
namespace {

constexpr std::size_t kTrainLength = 16;
// Beyond that a gap says nothing about a buffer of 16.
constexpr double kMostMissing = 10000.0;

}  // namespace

Edge EdgeFilter::RequestFor(const EdgeFilterOptions& options) {
  return options.debounce > Nanoseconds(0) ? Edge::kBoth : options.edge;
}

EdgeFilter::EdgeFilter(const EdgeFilterOptions& options, bool kernel_debounces)
    : options_(options), filters_(!kernel_debounces && options.debounce > Nanoseconds(0)) {}

bool EdgeFilter::Wanted(bool rising) const {
  return options_.edge == Edge::kBoth || rising == (options_.edge == Edge::kRising);
}

std::optional<EdgeFilter::Counted> EdgeFilter::Take(const EdgeEvent& event) {
  // Of both edges that were asked for, every second one counts.
  const bool halved = filters_ && options_.edge != Edge::kBoth;
  lost_ += halved ? (event.lost_before + 1) / 2 : event.lost_before;
  const bool doubt_ends_here = std::exchange(doubtful_, doubtful_ || event.buffer_was_full);
  bool counts = Wanted(event.rising);
  if (filters_) {
    const bool at_rest = !last_time_ || event.time - *last_time_ >= options_.debounce;
    if (!at_rest) {
      ++bounces_;
      counts = false;
    } else if (last_time_ && event.rising == last_rising_ && event.lost_before == 0 &&
               Wanted(!event.rising)) {
      // The edge between two equal ones never came. Where both count, or that one does, it is lost.
      ++lost_;
    }
    last_time_ = event.time;
    last_rising_ = event.rising;
  }
  if (!counts) return std::nullopt;
  Counted counted;
  counted.time = event.time;
  counted.lost_before = std::exchange(lost_, 0);
  counted.doubtful = doubt_ends_here;
  doubtful_ = event.buffer_was_full;
  return counted;
}

void PulseTrain::Add(HostTime time) {
  recent_.push_back(time);
  if (recent_.size() > kTrainLength) recent_.pop_front();
}

std::uint64_t PulseTrain::MissingBefore(HostTime time) const {
  if (recent_.size() < kTrainLength / 2) return 0;
  std::vector<std::int64_t> gaps;
  for (std::size_t i = 1; i < recent_.size(); ++i) {
    gaps.push_back((recent_[i] - recent_[i - 1]).count());
  }
  const auto middle = gaps.begin() + static_cast<std::ptrdiff_t>(gaps.size() / 2);
  std::nth_element(gaps.begin(), middle, gaps.end());
  if (*middle <= 0) return 0;
  const double pulses =
      static_cast<double>((time - recent_.back()).count()) / static_cast<double>(*middle);
  if (!(pulses < kMostMissing)) return 0;
  return static_cast<std::uint64_t>(std::max(std::llround(pulses) - 1, 0LL));
}

}  // namespace omnihdr::gpio
