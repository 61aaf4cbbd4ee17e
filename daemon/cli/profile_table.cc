#include "daemon/cli/profile_table.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>

namespace omnihdr {
namespace {

// What the parts leave of the whole.
Profile::Part Elsewhere(const Profile::Report& report) {
  Profile::Part rest{.name = "elsewhere", .wall_s = report.wall_s, .cpu_s = report.cpu_s};
  for (const Profile::Part& part : report.parts) {
    if (part.is_task) continue;
    rest.wall_s -= part.wall_s;
    rest.cpu_s -= part.cpu_s;
  }
  rest.wall_s = std::max(rest.wall_s, 0.0);
  rest.cpu_s = std::max(rest.cpu_s, 0.0);
  return rest;
}

}  // namespace

std::string ProfileTable(const Profile::Report& report, int views) {
  const double per_view_ms = 1e3 / views;
  std::string text = fmt::format("{:<26} {:>9} {:>9} {:>7} {:>10}\n", "part (mean per view)",
                                 "wall ms", "CPU ms", "share", "calls/view");
  const auto line = [&](std::string_view name, const Profile::Part& part, bool is_whole) {
    const std::string calls =
        part.calls > 0 ? fmt::format("{:.2f}", static_cast<double>(part.calls) / views) : "";
    const std::string share =
        part.is_task || report.wall_s <= 0.0
            ? ""
            : fmt::format("{:.1f} %", 100.0 * (is_whole ? 1.0 : part.wall_s / report.wall_s));
    fmt::format_to(std::back_inserter(text), "{:<26} {:>9.2f} {:>9.2f} {:>7} {:>10}\n", name,
                   part.wall_s * per_view_ms, part.cpu_s * per_view_ms, share, calls);
  };
  for (const Profile::Part& part : report.parts) {
    line(part.is_task ? fmt::format("  of it {}", part.name) : std::string(part.name), part, false);
  }
  line("elsewhere", Elsewhere(report), false);
  line("all", {.name = "all", .wall_s = report.wall_s, .cpu_s = report.cpu_s}, true);
  return text;
}

nlohmann::json ProfileJson(const Profile::Report& report, int views) {
  const double per_view_ms = 1e3 / views;
  nlohmann::json parts = nlohmann::json::array();
  const auto add = [&](const Profile::Part& part) {
    parts.push_back({{"part", part.name},
                     {"wall_ms", part.wall_s * per_view_ms},
                     {"cpu_ms", part.cpu_s * per_view_ms},
                     {"calls", part.calls},
                     {"beside_others", part.is_task}});
  };
  for (const Profile::Part& part : report.parts) add(part);
  add(Elsewhere(report));
  return {{"views", views},
          {"wall_ms", report.wall_s * per_view_ms},
          {"cpu_ms", report.cpu_s * per_view_ms},
          {"parts", parts}};
}

}  // namespace omnihdr
