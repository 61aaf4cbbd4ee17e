#include <cmath>
#include <nlohmann/json.hpp>

#include "daemon/evaluation/evaluation.h"

namespace omnihdr {
namespace {

using Json = nlohmann::ordered_json;

Json Number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }
Json Number(const std::optional<double>& value) { return value ? Number(*value) : Json(nullptr); }

// A table cell of fixed width: "-" where the number is not known.
std::string Cell(const std::optional<double>& value, int width, int decimals) {
  if (!value || std::isnan(*value)) return fmt::format("{:>{}}", "-", width);
  return fmt::format("{:>{}.{}f}", *value, width, decimals);
}

Json RadianceJson(const RadianceScore& score) {
  return {{"log10_rmse", Number(score.errors.log10_rmse)},
          {"log10_p95", Number(score.errors.log10_p95)},
          {"log10_rmse_unscaled", Number(score.errors.log10_rmse_unscaled)},
          {"scale", Number(score.errors.scale)},
          {"ssim", Number(score.ssim)},
          {"psnr_mu", Number(score.psnr_mu)}};
}

std::optional<double> Percent(std::optional<double> share) {
  if (share) *share *= 100.0;
  return share;
}

}  // namespace

std::string FormatScoreTable(const SessionScore& score) {
  std::string out;
  const bool judged = score.mean.has_value();
  if (judged) {
    out += fmt::format(
        "against: {}. log10 RMSE of luminance, view beside the position's own frame alone\n",
        score.reference);
    out +=
        "position  exposure s  frames    view     own  change  v.p95  o.p95  v.SSIM  o.SSIM  "
        "covered"
        "  disp bad1  disp rel  rot deg  trans %\n";
  } else {
    out += "position  exposure s  frames   valid\n";
  }
  for (const PositionScore& p : score.positions) {
    out += fmt::format("{:>8}  {:>10.6f}", Value(p.position), p.exposure.time.seconds());
    if (!p.complete) {
      out += fmt::format("  no view{}\n", p.status == FrameStatus::kOk
                                              ? ""
                                              : fmt::format(": frame is {}", ToString(p.status)));
      continue;
    }
    out += fmt::format("  {:>6}", p.frames);
    if (judged) {
      const auto view = p.view ? std::optional(p.view->errors.log10_rmse) : std::nullopt;
      const auto own = p.own_frame ? std::optional(p.own_frame->errors.log10_rmse) : std::nullopt;
      const auto change = view ? std::optional(100.0 * (*view / *own - 1.0)) : std::nullopt;
      const auto of = [](const std::optional<RadianceScore>& s, double RadianceErrors::*member) {
        return s ? std::optional(s->errors.*member) : std::nullopt;
      };
      out += Cell(view, 8, 4) + Cell(own, 8, 4) + Cell(change, 7, 1) + "%" +
             Cell(of(p.view, &RadianceErrors::log10_p95), 7, 3) +
             Cell(of(p.own_frame, &RadianceErrors::log10_p95), 7, 3) +
             Cell(p.view ? std::optional(p.view->ssim) : std::nullopt, 8, 3) +
             Cell(p.own_frame ? std::optional(p.own_frame->ssim) : std::nullopt, 8, 3) +
             Cell(100.0 * p.covered, 8, 1) + "%" +
             Cell(Percent(p.disparity ? std::optional(p.disparity->bad1) : std::nullopt), 10, 1) +
             Cell(Percent(p.disparity ? std::optional(p.disparity->median_relative) : std::nullopt),
                  10, 2) +
             Cell(p.pose ? std::optional(p.pose->rotation_deg) : std::nullopt, 9, 3) +
             Cell(p.pose ? std::optional(p.pose->translation_percent) : std::nullopt, 9, 2);
    } else {
      out += Cell(100.0 * p.valid_fraction, 7, 1) + "%";
    }
    out += "\n";
    for (const std::string& warning : p.warnings) out += fmt::format("          {}\n", warning);
  }
  if (judged) {
    const SessionScore::Mean& m = *score.mean;
    out += fmt::format("{:>28}", "mean (poses: largest)") + Cell(m.view_rmse, 8, 4) +
           Cell(m.own_rmse, 8, 4) + Cell(-100.0 * score.improvement(), 7, 1) + "%" +
           Cell(m.view_p95, 7, 3) + Cell(m.own_p95, 7, 3) + Cell(m.view_ssim, 8, 3) +
           Cell(m.own_ssim, 8, 3) + Cell(100.0 * m.covered, 8, 1) + "%" +
           Cell(Percent(m.disparity_bad1), 10, 1) + Cell(Percent(m.disparity_relative), 10, 2) +
           Cell(m.rotation_deg, 9, 3) + Cell(m.translation_percent, 9, 2) + "\n";
  }
  out +=
      fmt::format("{} of {} positions have their view\n", score.complete, score.positions.size());
  return out;
}

std::string FormatScoreJson(const SessionScore& score) {
  Json positions = Json::array();
  for (const PositionScore& p : score.positions) {
    Json item = {{"position", Value(p.position)},
                 {"exposure_s", p.exposure.time.seconds()},
                 {"status", ToString(p.status)},
                 {"complete", p.complete},
                 {"frames", p.frames},
                 {"chain", p.chain},
                 {"valid_fraction", Number(p.valid_fraction)},
                 {"warnings", p.warnings}};
    if (p.view) {
      item["view"] = RadianceJson(*p.view);
      item["own_frame"] = RadianceJson(*p.own_frame);
      item["covered"] = Number(p.covered);
    }
    if (p.disparity) {
      item["disparity"] = {{"bad1", Number(p.disparity->bad1)},
                           {"bad1_of_known", Number(p.disparity->bad1_of_known)},
                           {"unknown", Number(p.disparity->unknown)},
                           {"median_relative", Number(p.disparity->median_relative)}};
    }
    if (p.pose) {
      item["pose"] = {{"rotation_deg", Number(p.pose->rotation_deg)},
                      {"translation_percent", Number(p.pose->translation_percent)}};
    }
    positions.push_back(std::move(item));
  }
  Json json = {{"reference", score.reference.empty() ? Json(nullptr) : Json(score.reference)},
               {"complete", score.complete},
               {"positions", std::move(positions)}};
  if (score.mean) {
    const SessionScore::Mean& m = *score.mean;
    json["mean"] = {{"positions", m.positions},
                    {"view_log10_rmse", Number(m.view_rmse)},
                    {"own_log10_rmse", Number(m.own_rmse)},
                    {"improvement", Number(score.improvement())},
                    {"view_log10_p95", Number(m.view_p95)},
                    {"own_log10_p95", Number(m.own_p95)},
                    {"view_ssim", Number(m.view_ssim)},
                    {"own_ssim", Number(m.own_ssim)},
                    {"view_psnr_mu", Number(m.view_psnr_mu)},
                    {"own_psnr_mu", Number(m.own_psnr_mu)},
                    {"covered", Number(m.covered)},
                    {"disparity_bad1", Number(m.disparity_bad1)},
                    {"disparity_median_relative", Number(m.disparity_relative)},
                    {"largest_rotation_deg", Number(m.rotation_deg)},
                    {"largest_translation_percent", Number(m.translation_percent)}};
  }
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace omnihdr
