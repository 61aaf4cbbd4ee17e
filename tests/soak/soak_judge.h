#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/session/session.h"

namespace omnihdr::soak {

// What was seen of the daemon at a moment of the day.
struct Sample {
  double hour = 0.0;
  double memory_mb = 0.0;  // resident
  double descriptors = 0.0;
  double threads = 0.0;
};

// From a trigger to the begin of its exposure, in milliseconds of the usual clock.
struct Latency {
  double hour = 0.0;
  double median_ms = 0.0;
  double high_ms = 0.0;  // 95 of 100
};

// A trouble that was made: the storage refused, or was slow, from one moment to another.
struct Trouble {
  HostTime from;
  HostTime to;
};

struct SoakResult {
  std::vector<Sample> samples;
  std::vector<Trouble> troubles;
  std::vector<Latency> latencies;  // one for each of equal parts of the day
  std::vector<FrameRecord> journal;
  std::uint64_t unlisted = 0;  // triggers that are counted and have no line
  double interval_s = 0.0;     // between triggers
};

// One latency for each of `parts` equal parts of the day, by what the frames say of the middle of
// their exposure. The journal's times are those of the fast clock.
std::vector<Latency> LatenciesOf(const std::vector<FrameRecord>& journal, HostTime start,
                                 double hours, double speed, int parts);

// Missed triggers by what made them miss.
struct MissCauses {
  int storage = 0;    // no frame buffer was free during a trouble of the storage, or right after it
  int unplugged = 0;  // the camera had been unplugged, or not come yet
  // The camera was busy, a buffer was not free or the main loop late although nothing was made: the
  // fast clock leaves this computer so much less time.
  int slow = 0;
  std::vector<std::string> other;  // the details of those that none of this explains
};
MissCauses CausesOf(const SoakResult& result);

// What is wrong, in words: something that grows from the second quarter of the day to the last, a
// trigger without its line, a loss without its reason or with one that nobody made, more than a
// fifth missed because this computer is too slow for the day's speed. Empty when nothing is.
std::vector<std::string> Judge(const SoakResult& result);

// Memory, descriptors and threads, and latency over the day; lost frames as dots. PNG or SVG.
Status Draw(const SoakResult& result, const std::filesystem::path& file);

}  // namespace omnihdr::soak
