#include "core/pipeline/made_with.h"

#include <fmt/format.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <type_traits>

#include "core/base/crc32c.h"
#include "core/base/file.h"
#include "core/session/session_rig.h"
#include "core/session/view_writer.h"

namespace omnihdr {
namespace {

class Digest {
 public:
  void AddText(std::string_view text) {
    Add(text.size());  // so that two texts are not one longer
    crc_ = Crc32c(std::as_bytes(std::span(text)), crc_);
  }
  template <typename T>
  void Add(const T& value) {
    if constexpr (std::is_enum_v<T>) {
      Add(static_cast<std::int64_t>(value));
    } else {
      static_assert(std::is_arithmetic_v<T>);
      crc_ = Crc32c(std::as_bytes(std::span(&value, 1)), crc_);
    }
  }
  template <typename T, std::size_t N>
  void Add(const std::array<T, N>& values) {
    for (const T& value : values) Add(value);
  }
  template <typename... Values>
  void AddAll(const Values&... values) {
    (Add(values), ...);
  }
  std::string Text() const { return fmt::format("{:08x}", crc_); }

 private:
  std::uint32_t crc_ = 0;
};

// Structured bindings: a new member of an options struct does not compile here until it is added.
void AddOptions(const PipelineOptions& options, Digest& digest) {
  const auto& [mode, output_width, orientation, preview_quality, preview, exr_type, chromaticities,
               nan, mask_file, value_low, value_high, noise, white_luminance, weights,
               white_balance, refine_exposure, refine_limit, demosaic, stereo_width, labels,
               max_parallax_deg, neighbours, cost, search, fusion, filter, fill, sky,
               min_baseline_ratio, keyframes, heading_sigma_deg, consistency_sigma,
               merge_neighbours, merge_weights, consistency, occlusion, movers, mover_masks] =
      options;
  digest.AddAll(mode, output_width, orientation, preview_quality, exr_type, chromaticities, nan,
                value_low, value_high, white_luminance, weights, white_balance, refine_exposure,
                refine_limit, demosaic, stereo_width, labels, max_parallax_deg, neighbours, cost,
                search, fusion, filter, fill, sky, min_baseline_ratio, keyframes, heading_sigma_deg,
                consistency_sigma, merge_neighbours, merge_weights, consistency, occlusion, movers);
  // Which folder: its pictures may come with the frames.
  digest.AddText(mover_masks);
  const auto& [read, gain, prnu] = noise;
  digest.AddAll(read, gain, prnu);
  const auto& [tone_operator, shape, key, exposure_stops, white_percentile, sharpening, threshold,
               bias, contrast_decades, sigma_space, sigma_range] = preview;
  digest.AddAll(tone_operator, shape, key, exposure_stops, white_percentile, sharpening, threshold,
                bias, contrast_decades, sigma_space, sigma_range);
  digest.Add(mask_file.empty());  // what is in it counts, not how it is called
}

}  // namespace

Result<std::string> MadeWith(const PipelineOptions& options, const std::filesystem::path& session) {
  Digest digest;
  AddOptions(options, digest);
  if (!options.mask_file.empty()) {
    OMNIHDR_ASSIGN(const std::string mask, ReadTextFile(options.mask_file));
    digest.AddText(mask);
  }
  std::error_code error;
  if (std::filesystem::exists(session / "rig.toml", error)) {
    OMNIHDR_ASSIGN(const std::vector<SessionFile> files, ReadRigFiles(session));
    for (const SessionFile& file : files) {
      digest.AddText(file.name);
      digest.AddText(file.content);
    }
  }
  return digest.Text();
}

std::string OtherwiseMade(const std::filesystem::path& views_directory,
                          const std::string& made_with) {
  const Result<std::vector<PositionId>> complete = CompleteViews(views_directory);
  if (!complete || complete->empty()) return "";
  for (const PositionId position : {complete->front(), complete->back()}) {
    const Result<ViewRecord> record = ReadViewRecord(views_directory, position);
    if (!record || record->made_with.empty() || record->made_with == made_with) continue;
    return fmt::format(
        "{}: made with other options, another mask or another rig than now (made_with {}, now {}); "
        "complete views are kept as they are",
        (views_directory / ViewDirectoryName(position)).string(), record->made_with, made_with);
  }
  return "";
}

}  // namespace omnihdr
