#include "drivers/gnss/gpsd_reports.h"

#include <fmt/format.h>
#include <gps.h>

#include <cmath>
#include <ctime>
#include <utility>
#include <vector>

namespace omnihdr::gnss {
namespace {

// gpsd's "status" by number: the names differ from version to version of its header.
int GgaQuality(int status) {
  switch (status) {
    case 2:
      return 2;  // differential
    case 3:
      return 4;  // RTK fixed
    case 4:
      return 5;  // RTK float
    case 5:
    case 6:
      return 6;  // dead reckoning
    case 7:
      return 7;  // surveyed in
    case 8:
      return 8;  // simulated
    case 9:
      return 3;  // precise positioning service
    default:
      return 1;  // gpsd leaves out what is not remarkable
  }
}

std::string Iso(const timespec& time) {
  std::tm utc{};
  if (gmtime_r(&time.tv_sec, &utc) == nullptr) return {};
  return fmt::format("{:04}-{:02}-{:02}T{:02}:{:02}:{:02}.{:03}Z", utc.tm_year + 1900,
                     utc.tm_mon + 1, utc.tm_mday, utc.tm_hour, utc.tm_min, utc.tm_sec,
                     time.tv_nsec / 1'000'000);
}

std::optional<double> NotNegative(double value) {
  if (std::isfinite(value) && value >= 0.0 && value <= 1e9) return value;
  return std::nullopt;
}

}  // namespace

ReportParser::ReportParser() : data_(std::make_unique<gps_data_t>()) {}
ReportParser::~ReportParser() = default;

std::optional<Report> ReportParser::Parse(std::string_view line, HostTime now) {
  if (line.empty()) return std::nullopt;
  // libgps looks for these itself, too; what is none of them needs no look.
  const auto is = [line](std::string_view name) {
    return line.starts_with("{\"class\":\"" + std::string(name) + "\"");
  };
  if (is("PPS")) {
    last_pps_ = now;
    return std::nullopt;
  }
  if (is("VERSION")) greeted_ = true;
  if (!is("TPV")) {
    if (!line.starts_with("{\"class\":\"")) ++errors_;
    return std::nullopt;
  }
  // What the line before said and this one does not is not to stay.
  *data_ = gps_data_t{};
  gps_clear_fix(&data_->fix);
  std::vector<char> text(line.begin(), line.end());
  text.push_back('\0');
  if (gps_unpack(text.data(), data_.get()) != 0 || (data_->set & MODE_SET) == 0) {
    ++errors_;
    return std::nullopt;
  }
  const gps_fix_t& from = data_->fix;
  Report report;
  if (std::isfinite(from.track)) report.track_deg = from.track;
  if (std::isfinite(from.speed)) report.speed_m_s = from.speed;
  const bool placed =
      from.mode >= MODE_2D && std::abs(from.latitude) <= 90.0 && std::abs(from.longitude) <= 360.0;
  if (!placed) return report;
  GnssFix fix;
  fix.lat_deg = from.latitude;
  fix.lon_deg = from.longitude;
  const double height = std::isfinite(from.altMSL) ? from.altMSL : from.altHAE;
  if (from.mode >= MODE_3D && std::abs(height) < 1e7) {
    fix.alt_m = height;
    fix.dimensions = 3;
  } else {
    fix.dimensions = 2;
  }
  fix.fix = GgaQuality(from.status);
  if (from.time.tv_sec > 0) {
    fix.time = Iso(from.time);
    const bool pulses = last_pps_ && now - *last_pps_ < std::chrono::seconds(3);
    fix.time_source = pulses ? "gnss+pps" : "gnss";
    fix.time_error_s = NotNegative(from.ept);
  }
  fix.error_m = NotNegative(from.eph);
  if (!fix.error_m && std::isfinite(from.epx) && std::isfinite(from.epy)) {
    fix.error_m = NotNegative(std::hypot(from.epx, from.epy));
  }
  report.fix = std::move(fix);
  return report;
}

void LineCutter::Add(std::string_view bytes) { waiting_ += bytes; }

std::optional<std::string> LineCutter::Next() {
  while (true) {
    const std::size_t end = waiting_.find('\n');
    if (end == std::string::npos) {
      if (waiting_.size() <= kMaxLine) return std::nullopt;
      if (!std::exchange(skipping_, true)) ++too_long_;
      waiting_.clear();
      return std::nullopt;
    }
    std::string line = waiting_.substr(0, end);
    waiting_.erase(0, end + 1);
    if (std::exchange(skipping_, false)) continue;  // the rest of one that was too long
    if (line.size() > kMaxLine) {
      ++too_long_;
      continue;
    }
    if (line.ends_with('\r')) line.pop_back();
    return line;
  }
}

}  // namespace omnihdr::gnss
