#include "core/capture/motion_track.h"

#include <algorithm>
#include <cmath>

namespace omnihdr {
namespace {

constexpr Nanoseconds kSpeedWindow = std::chrono::milliseconds(500);

double Seconds(Nanoseconds time) { return static_cast<double>(time.count()) * 1e-9; }

}  // namespace

void MotionTrack::Add(HostTime time, double metres, std::optional<double> speed_m_s) {
  if (!readings_.empty() && time <= readings_.back().time) return;
  readings_.push_back({time, metres});
  if (readings_.size() > std::max<std::size_t>(options_.capacity, 2)) readings_.pop_front();
  UpdateSpeed(speed_m_s);
}

void MotionTrack::Clear() {
  readings_.clear();
  speed_m_s_ = 0.0;
}

void MotionTrack::UpdateSpeed(std::optional<double> told) {
  if (told) {
    speed_m_s_ = *told;
    return;
  }
  const Reading& newest = readings_.back();
  // The last reading at or before the window's beginning, or the oldest.
  const auto first =
      std::upper_bound(readings_.begin(), readings_.end(), newest.time - kSpeedWindow,
                       [](HostTime time, const Reading& reading) { return time < reading.time; });
  const Reading& from = first == readings_.begin() ? *first : *std::prev(first);
  speed_m_s_ = from.time < newest.time
                   ? (newest.metres - from.metres) / Seconds(newest.time - from.time)
                   : 0.0;
}

std::optional<HostTime> MotionTrack::newest() const {
  if (readings_.empty()) return std::nullopt;
  return readings_.back().time;
}

std::optional<double> MotionTrack::At(HostTime time) const {
  if (readings_.empty() || time < readings_.front().time) return std::nullopt;
  const Reading& newest = readings_.back();
  if (time >= newest.time) {
    if (time - newest.time >= options_.valid) return std::nullopt;
    if (!options_.extrapolate) return newest.metres;
    return newest.metres + speed_m_s_ * Seconds(std::min(time - newest.time, options_.ahead));
  }
  const auto after =
      std::upper_bound(readings_.begin(), readings_.end(), time,
                       [](HostTime at, const Reading& reading) { return at < reading.time; });
  const Reading& a = *std::prev(after);
  const Reading& b = *after;
  const double part = Seconds(time - a.time) / Seconds(b.time - a.time);
  return a.metres + part * (b.metres - a.metres);
}

std::optional<HostTime> MotionTrack::TimeAt(double metres) const {
  if (readings_.empty()) return std::nullopt;
  const Reading& newest = readings_.back();
  if (newest.metres >= metres) {
    // Mostly asked about what has just been passed: from the end.
    for (auto b = readings_.rbegin(); std::next(b) != readings_.rend(); ++b) {
      const Reading& a = *std::next(b);
      if (a.metres >= metres) continue;
      const double part = (metres - a.metres) / (b->metres - a.metres);
      return a.time + Nanoseconds(static_cast<Nanoseconds::rep>(
                          std::llround(part * static_cast<double>((b->time - a.time).count()))));
    }
    return readings_.front().time;
  }
  if (!options_.extrapolate || !(speed_m_s_ > 0.0)) return std::nullopt;
  const double seconds = (metres - newest.metres) / speed_m_s_;
  const double most = Seconds(std::min(options_.valid, options_.ahead));
  if (!(seconds * 1e9 < 9e17) || seconds >= most) return std::nullopt;
  return newest.time + Nanoseconds(static_cast<Nanoseconds::rep>(std::ceil(seconds * 1e9)));
}

}  // namespace omnihdr
