#include "drivers/gnss/gpsd_reports.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>

namespace omnihdr::gnss {
namespace {

using Json = nlohmann::json;

// From gpsd's "status".
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

// A finite number of a report; nothing when there is none of that name or it is something else.
std::optional<double> Number(const Json& report, const char* name) {
  const auto found = report.find(name);
  if (found == report.end() || !found->is_number()) return std::nullopt;
  const double value = found->get<double>();
  if (!std::isfinite(value)) return std::nullopt;
  return value;
}

std::optional<double> NotNegative(std::optional<double> value) {
  if (value && *value >= 0.0 && *value <= 1e9) return value;
  return std::nullopt;
}

// "2026-01-01T12:00:13.250Z" with any number of decimals; empty when it is not like that.
std::string Time(const Json& report) {
  const auto found = report.find("time");
  if (found == report.end() || !found->is_string()) return {};
  const auto& text = found->get_ref<const std::string&>();
  const std::string_view pattern = "dddd-dd-ddTdd:dd:dd";
  if (text.size() <= pattern.size() || text.size() > 32 || text.back() != 'Z') return {};
  const auto digit = [](char c) { return c >= '0' && c <= '9'; };
  for (std::size_t i = 0; i < pattern.size(); ++i) {
    if (pattern[i] == 'd' ? !digit(text[i]) : text[i] != pattern[i]) return {};
  }
  const std::string_view decimals =
      std::string_view(text).substr(pattern.size(), text.size() - pattern.size() - 1);
  const bool fits = decimals.empty() || (decimals[0] == '.' && decimals.size() > 1 &&
                                         std::all_of(decimals.begin() + 1, decimals.end(), digit));
  return fits ? text : std::string();
}

}  // namespace

std::optional<Report> ReportParser::Parse(std::string_view line, HostTime now) {
  if (line.empty()) return std::nullopt;
  const Json json = Json::parse(line, nullptr, false);
  const auto name = json.is_object() ? json.find("class") : json.end();
  if (!json.is_object() || name == json.end() || !name->is_string()) {
    ++errors_;
    return std::nullopt;
  }
  const auto& kind = name->get_ref<const std::string&>();
  if (kind == "PPS") last_pps_ = now;
  if (kind == "VERSION") greeted_ = true;
  if (kind != "TPV") return std::nullopt;
  const std::optional<double> mode = Number(json, "mode");
  if (!mode) {
    ++errors_;
    return std::nullopt;
  }
  Report report;
  report.track_deg = Number(json, "track");
  report.speed_m_s = Number(json, "speed");
  const std::optional<double> lat = Number(json, "lat");
  const std::optional<double> lon = Number(json, "lon");
  if (*mode < 2.0 || !lat || !lon || std::abs(*lat) > 90.0 || std::abs(*lon) > 360.0) {
    return report;
  }
  GnssFix fix;
  fix.lat_deg = *lat;
  fix.lon_deg = *lon;
  std::optional<double> height = Number(json, "altMSL");
  // "alt" is what gpsd said before it told the two apart.
  for (const char* other : {"altHAE", "alt"}) {
    if (!height) height = Number(json, other);
  }
  fix.dimensions = 2;
  if (*mode >= 3.0 && height && std::abs(*height) < 1e7) {
    fix.alt_m = *height;
    fix.dimensions = 3;
  }
  const double status = std::clamp(Number(json, "status").value_or(0.0), 0.0, 100.0);
  fix.fix = GgaQuality(static_cast<int>(status));
  fix.time = Time(json);
  if (!fix.time.empty()) {
    const bool pulses = last_pps_ && now - *last_pps_ < std::chrono::seconds(3);
    fix.time_source = pulses ? "gnss+pps" : "gnss";
    fix.time_error_s = NotNegative(Number(json, "ept"));
  }
  fix.error_m = NotNegative(Number(json, "eph"));
  const std::optional<double> east = Number(json, "epx");
  const std::optional<double> north = Number(json, "epy");
  if (!fix.error_m && east && north) fix.error_m = NotNegative(std::hypot(*east, *north));
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
