#include "daemon/evaluation/comparison.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>

#include "core/quality/picture_metrics.h"
#include "core/sphere/projection.h"
#include "daemon/evaluation/false_colour.h"
#include "daemon/evaluation/picture_files.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

bool AreIdentical(const Image<float>& a, const Image<float>& b) {
  return std::equal(a.values().begin(), a.values().end(), b.values().begin(),
                    [](float x, float y) { return x == y || (std::isnan(x) && std::isnan(y)); });
}

// Share of the area whose pixels are finite in both.
double KnownShare(const Image<float>& a, const Image<float>& b, const ComparisonArea& area) {
  double known = 0.0;
  double total = 0.0;
  for (int y = 0; y < a.height(); ++y) {
    for (int x = 0; x < a.width(); ++x) {
      if (!area.Has(x, y)) continue;
      total += area.Weight(y);
      const auto is_finite = [x, y](const Image<float>& image) {
        const float* p = image.pixel(x, y);
        return std::isfinite(p[0]) && std::isfinite(p[1]) && std::isfinite(p[2]);
      };
      if (is_finite(a) && is_finite(b)) known += area.Weight(y);
    }
  }
  return total > 0.0 ? known / total : 0.0;
}

Image<float> LumaOf(const Image<float>& codes) {
  Image<float> luma(codes.width(), codes.height(), 1);
  for (int y = 0; y < codes.height(); ++y) {
    for (int x = 0; x < codes.width(); ++x) {
      const float* p = codes.pixel(x, y);
      // In double, so that equal channels give exactly their value.
      luma.at(x, y) =
          static_cast<float>(0.299 * static_cast<double>(p[0]) + 0.587 * static_cast<double>(p[1]) +
                             0.114 * static_cast<double>(p[2]));
    }
  }
  return luma;
}

void CompareCodes(const Image<float>& tested, const Image<float>& reference, double peak,
                  const ComparisonArea& area, Comparison* result) {
  result->psnr_db = Psnr(tested, reference, peak, area);
  const Image<float> tested_luma = LumaOf(tested);
  const Image<float> reference_luma = LumaOf(reference);
  result->ssim = Ssim(tested_luma, reference_luma, peak, area, result->on_sphere);
  result->difference = tested_luma.Clone();
  for (std::size_t i = 0; i < reference_luma.size(); ++i) {
    result->difference.data()[i] =
        (tested_luma.data()[i] - reference_luma.data()[i]) / static_cast<float>(peak);
  }
}

void CompareMaps(Image<float> tested, const Image<float>& reference, const ComparisonArea& area,
                 ScaleFit fit, Comparison* result) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  result->radiance = CompareRadiance(tested, reference, area, fit);
  const double scale = result->radiance.scale;
  if (!std::isfinite(scale)) {
    result->psnr_db = result->psnr_mu_db = result->ssim = result->white = kNaN;
    result->difference = LogError(tested, reference);
    return;
  }
  for (float& value : tested.values()) value *= static_cast<float>(scale);
  const Image<float> luminance = LuminanceOf(reference);
  const ReinhardParameters parameters = ReinhardParametersOf(luminance, area);
  result->white = parameters.white * parameters.log_average / 0.18;
  result->psnr_db = Psnr(tested, reference, result->white, area);
  result->psnr_mu_db = PsnrMu(tested, reference, result->white, area);
  result->ssim = Ssim(ReinhardDisplay(LuminanceOf(tested), parameters),
                      ReinhardDisplay(luminance, parameters), 1.0, area, result->on_sphere);
  result->difference = LogError(tested, reference);
}

// The disparity beside a view's radiance, or nothing.
Result<std::optional<Image<float>>> DisparityOfView(const fs::path& view) {
  const fs::path file = view / "disparity.exr";
  std::error_code error;
  if (!fs::is_directory(view, error) || !fs::exists(file, error)) {
    return std::optional<Image<float>>();
  }
  OMNIHDR_ASSIGN(ExrImage exr, ReadExr(file));
  const auto found = exr.channels.find("disparity");
  if (found == exr.channels.end()) {
    return Fail(ErrorKind::kData, "{}: no channel \"disparity\"", file.string());
  }
  return std::optional(std::move(found->second));
}

std::string Decibel(double value) {
  if (std::isnan(value)) return "-";
  return std::isinf(value) ? "infinite (equal)" : fmt::format("{:.3f} dB", value);
}

std::string Plain(double value, int decimals) {
  return std::isfinite(value) ? fmt::format("{:.{}f}", value, decimals) : "-";
}

}  // namespace

Result<Comparison> ComparePictures(const fs::path& tested, const fs::path& reference,
                                   const ComparisonOptions& options) {
  OMNIHDR_ASSIGN(Picture a, LoadPicture(tested));
  OMNIHDR_ASSIGN(Picture b, LoadPicture(reference));
  const auto kind = [](const Picture& p) {
    return p.is_radiance    ? "radiance (EXR)"
           : p.peak > 255.0 ? "16-bit code values"
                            : "8-bit code values";
  };
  if (a.is_radiance != b.is_radiance || a.peak != b.peak) {
    return Fail(ErrorKind::kData, "{}: {}, expected {} as {}", a.name, kind(a), kind(b), b.name);
  }
  const int width = b.pixels.width();
  const int height = b.pixels.height();
  if (a.pixels.width() != width || a.pixels.height() != height) {
    return Fail(ErrorKind::kData, "{}: {}x{}, expected {}x{} as {}", a.name, a.pixels.width(),
                a.pixels.height(), width, height, b.name);
  }
  Comparison result;
  result.tested = a.name;
  result.reference = b.name;
  result.width = width;
  result.height = height;
  result.is_radiance = a.is_radiance;
  using Area = ComparisonOptions::Area;
  result.on_sphere =
      options.area == Area::kSphere || (options.area == Area::kAuto && b.looks_lat_long());

  Image<std::uint8_t> mask;
  ComparisonArea area;
  if (!options.mask.empty()) {
    OMNIHDR_ASSIGN(mask, LoadMask(options.mask, width, height));
  }
  if (result.on_sphere) {
    area = SphereArea(Projection::Equirectangular(width, height), mask.view());
  } else {
    area.mask = mask.view();
  }
  result.is_identical = options.mask.empty() && AreIdentical(a.pixels, b.pixels);
  result.compared = KnownShare(a.pixels, b.pixels, area);
  if (a.is_radiance) {
    CompareMaps(std::move(a.pixels), b.pixels, area, options.scale, &result);
  } else {
    CompareCodes(a.pixels, b.pixels, a.peak, area, &result);
  }
  if (result.is_radiance) {
    OMNIHDR_ASSIGN(const auto tested_disparity, DisparityOfView(tested));
    OMNIHDR_ASSIGN(const auto reference_disparity, DisparityOfView(reference));
    if (tested_disparity && reference_disparity && tested_disparity->width() == width &&
        reference_disparity->width() == width && tested_disparity->height() == height &&
        reference_disparity->height() == height) {
      constexpr double kAnyBaseline = 1.0;  // what it decides is not reported
      result.disparity =
          CompareDisparity(*tested_disparity, *reference_disparity, kAnyBaseline, area);
    }
  }
  return result;
}

std::string FormatComparisonTable(const Comparison& c) {
  std::string text;
  const auto line = [&text](const char* name, const std::string& value) {
    text += fmt::format("{:<28}{}\n", name, value);
  };
  line("tested", c.tested);
  line("reference", c.reference);
  line("size", fmt::format("{}x{}, {}", c.width, c.height,
                           c.is_radiance ? "linear radiance" : "code values"));
  line("pixels count", c.on_sphere ? "by solid angle (lat-long panorama)" : "all the same");
  line("compared", fmt::format("{:.2f} % of the area", 100.0 * c.compared));
  if (c.is_identical) line("identical", "yes");
  if (c.is_radiance) {
    line("scale", fmt::format("{:.6g}", c.radiance.scale));
    line("log10 RMSE", fmt::format("{}   without the scale {}", Plain(c.radiance.log10_rmse, 5),
                                   Plain(c.radiance.log10_rmse_unscaled, 5)));
    line("|log10 error|",
         fmt::format("median {}   95 % {}   99 % {}   largest {}", Plain(c.radiance.log10_p50, 5),
                     Plain(c.radiance.log10_p95, 5), Plain(c.radiance.log10_p99, 5),
                     Plain(c.radiance.log10_max, 5)));
    line("PSNR, linear", fmt::format("{}   white {:.6g}", Decibel(c.psnr_db), c.white));
    line("PSNR-mu", Decibel(c.psnr_mu_db));
    line("SSIM, tone-mapped", Plain(c.ssim, 6));
  } else {
    line("PSNR", Decibel(c.psnr_db));
    line("SSIM of luma", Plain(c.ssim, 6));
  }
  if (c.disparity) {
    line("disparity", fmt::format("median relative difference {}   unknown {} %",
                                  Plain(c.disparity->median_relative, 5),
                                  Plain(100.0 * c.disparity->unknown, 2)));
  }
  return text;
}

std::string FormatComparisonJson(const Comparison& c) {
  using Json = nlohmann::ordered_json;
  const auto number = [](double v) { return std::isfinite(v) ? Json(v) : Json(nullptr); };
  Json json = {{"tested", c.tested},
               {"reference", c.reference},
               {"width", c.width},
               {"height", c.height},
               {"kind", c.is_radiance ? "radiance" : "codes"},
               {"area", c.on_sphere ? "sphere" : "plane"},
               {"identical", c.is_identical},
               {"compared", number(c.compared)},
               {"psnr_db", number(c.psnr_db)},
               {"ssim", number(c.ssim)}};
  if (c.is_radiance) {
    json["scale"] = number(c.radiance.scale);
    json["white"] = number(c.white);
    json["psnr_mu_db"] = number(c.psnr_mu_db);
    json["log10_rmse"] = number(c.radiance.log10_rmse);
    json["log10_rmse_unscaled"] = number(c.radiance.log10_rmse_unscaled);
    json["log10_p50"] = number(c.radiance.log10_p50);
    json["log10_p95"] = number(c.radiance.log10_p95);
    json["log10_p99"] = number(c.radiance.log10_p99);
    json["log10_max"] = number(c.radiance.log10_max);
  }
  if (c.disparity) {
    json["disparity"] = {{"median_relative", number(c.disparity->median_relative)},
                         {"unknown", number(c.disparity->unknown)}};
  }
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

Image<std::uint8_t> DifferencePicture(const Comparison& c, double full) {
  ScaleBar bar;
  bar.is_signed = true;
  for (const double share : {-1.0, -0.5, 0.0, 0.5, 1.0}) {
    const double value = share * full;
    bar.ticks.push_back({0.5 * (share + 1.0), share == 0.0 ? std::string("equal")
                                              : c.is_radiance
                                                  ? fmt::format("x {:.3g}", std::pow(10.0, value))
                                                  : fmt::format("{:+.3g} %", 100.0 * value)});
  }
  bar.title = c.is_radiance ? "luminance, tested / reference" : "luma, tested - reference";
  return WithScaleBar(DifferenceColours(c.difference, full), bar);
}

}  // namespace omnihdr
