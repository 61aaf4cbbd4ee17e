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

struct SoakResult {
  std::vector<Sample> samples;
  std::vector<Latency> latencies;  // one for each of equal parts of the day
  std::vector<FrameRecord> journal;
  std::uint64_t unlisted = 0;  // triggers that are counted and have no line
  double interval_s = 0.0;     // between triggers
};

// One latency for each of `parts` equal parts of the day, by what the frames say of the middle of
// their exposure. The journal's times are those of the fast clock.
std::vector<Latency> LatenciesOf(const std::vector<FrameRecord>& journal, HostTime start,
                                 double hours, double speed, int parts);

// What is wrong, in words: something that grows from the second quarter of the day to the last, a
// trigger without its line, a loss without its reason. Empty when nothing is.
std::vector<std::string> Judge(const SoakResult& result);

// Memory, descriptors and threads, and latency over the day; lost frames as dots. PNG or SVG.
Status Draw(const SoakResult& result, const std::filesystem::path& file);

}  // namespace omnihdr::soak
