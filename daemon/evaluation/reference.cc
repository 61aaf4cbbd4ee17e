#include "daemon/evaluation/reference.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <system_error>

#include "core/photometry/tonemap.h"
#include "daemon/evaluation/photographs.h"
#include "daemon/evaluation/simulation_truth.h"

namespace omnihdr {

bool MeasurableRange::Has(const float* rgb) const {
  return std::isfinite(rgb[0]) && *std::max_element(rgb, rgb + 3) <= high && Luminance(rgb) >= low;
}

Result<std::unique_ptr<Reference>> OpenReference(const std::filesystem::path& session,
                                                 const SessionContents& contents,
                                                 const std::filesystem::path& photographs) {
  if (!photographs.empty()) return OpenPhotographs(photographs, contents.info.camera);
  const auto extra = nlohmann::json::parse(contents.info.extra_json, nullptr, false);
  if (extra.is_object() && extra.contains("simulation")) {
    return OpenSimulationTruth(contents.info.extra_json, (session / "session.json").string());
  }
  std::error_code error;
  if (std::filesystem::exists(session / "reference" / "how.json", error)) {
    return OpenPhotographs(session / "reference", contents.info.camera);
  }
  return std::unique_ptr<Reference>();
}

}  // namespace omnihdr
