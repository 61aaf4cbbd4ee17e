#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "core/base/clock.h"
#include "core/session/session.h"

namespace omnihdr::gnss {

// What a report of gpsd says of position and motion.
struct Report {
  std::optional<GnssFix> fix;       // nothing: the receiver has none
  std::optional<double> track_deg;  // course over ground, clockwise from true north
  std::optional<double> speed_m_s;
};

// gpsd's reports, one JSON object a line. Not thread-safe.
class ReportParser {
 public:
  // The text of one line. Nothing when it says nothing of position (satellites, devices, ...), or
  // is not understood, which errors() counts.
  std::optional<Report> Parse(std::string_view line, HostTime now);
  std::uint64_t errors() const { return errors_; }
  // gpsd has greeted: it is one.
  bool greeted() const { return greeted_; }

 private:
  std::optional<HostTime> last_pps_;
  std::uint64_t errors_ = 0;
  bool greeted_ = false;
};

// Cuts a stream into lines of at most kMaxLine bytes; longer ones are left out and counted.
class LineCutter {
 public:
  static constexpr std::size_t kMaxLine = 16384;
  void Add(std::string_view bytes);
  std::optional<std::string> Next();
  std::uint64_t too_long() const { return too_long_; }

 private:
  std::string waiting_;
  bool skipping_ = false;
  std::uint64_t too_long_ = 0;
};

}  // namespace omnihdr::gnss
