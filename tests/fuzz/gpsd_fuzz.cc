#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "drivers/gnss/gpsd_reports.h"

// Laws: whatever a gpsd sends, a fix that comes out has a place in the world and finite numbers.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace omnihdr;  // NOLINT(google-build-using-namespace)
  gnss::LineCutter lines;
  gnss::ReportParser parser;
  std::int64_t now = 0;
  for (std::size_t at = 0; at < size; at += 4096) {
    const std::size_t piece = size - at < 4096 ? size - at : 4096;
    lines.Add(std::string_view(reinterpret_cast<const char*>(data) + at, piece));
    while (const auto line = lines.Next()) {
      const auto report = parser.Parse(*line, HostTime::FromNanoseconds(now += 1'000'000'000));
      if (!report || !report->fix) continue;
      const GnssFix& fix = *report->fix;
      if (!(std::abs(fix.lat_deg) <= 90.0) || !(std::abs(fix.lon_deg) <= 360.0)) std::abort();
      if (!(std::abs(fix.alt_m) < 1e7) || fix.fix < 1 || fix.fix > 8) std::abort();
      for (const auto& number : {fix.error_m, fix.time_error_s}) {
        if (number && !(*number >= 0.0 && *number <= 1e9)) std::abort();
      }
    }
  }
  return 0;
}
