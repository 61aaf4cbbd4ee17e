#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/session/pose_notes.h"
#include "core/session/session.h"

namespace omnihdr {

// What view.json says.
struct ViewRecord {
  PositionId position{};
  Pose pose;                  // world_from_camera
  bool metric_scale = false;  // scale: "metric" or "relative"
  // Additive keys: where the metres come from, and what satellite fixes say of the unit.
  ScaleSource scale_source = ScaleSource::kNone;
  std::optional<GnssScale> gnss_scale;
  int chain = 0;             // positions of different chains have no common world; additive key
  std::string chain_reason;  // why a new chain began here, empty when it did not
  // Additive keys: of the pose, and beside it.
  std::optional<PoseSigma> sigma;
  std::string dead_reckoned;  // why heading and odometer had to give the pose, empty else
  std::optional<Relocalisation> relocalised;
  std::optional<LoopClosure> loop;
  // camera_from_output of the written panoramas.
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
  std::vector<std::uint64_t> frames;  // journal numbers of the frames that contributed
  std::uint64_t reference = 0;        // the view's own frame
  std::string mode;                   // "spatiotemporal" or "temporal"
  double radiance_min = 0.0;
  double radiance_max = 0.0;
  double valid_fraction = 0.0;
  std::vector<std::string> warnings;
  // How much work its disparity got (core/pipeline/quality.h): 0 = full; and in words. Additive
  // keys; a record without them is of level 0.
  int quality_level = 0;
  std::string quality;
  std::string made_with;  // what it was made with beside the frames (additive key); "" = not told
  // JSON object as text: what the pipeline needs to continue after this view (additive key
  // "resume").
  std::string resume_json;
};
std::string FormatViewRecord(const ViewRecord& record);
Result<ViewRecord> ParseViewRecord(std::string_view text, const std::string& name);

// Complete view directories appear by rename: `fill` writes every file of the view into the
// temporary directory it is given; then everything is synced and renamed to VIEWS/000003. On any
// failure the temporary directory is removed and no half view is visible. An existing view is
// replaced only when `replace` is set.
Status WriteView(const std::filesystem::path& views_directory, PositionId position, bool replace,
                 const std::function<Status(const std::filesystem::path& directory)>& fill);

std::string ViewDirectoryName(PositionId position);  // "000003"
// Positions with a complete view (a directory with a readable view.json), ascending.
Result<std::vector<PositionId>> CompleteViews(const std::filesystem::path& views_directory);
// The same with each view's quality level.
Result<std::map<PositionId, int>> CompleteViewLevels(const std::filesystem::path& views_directory);
Result<ViewRecord> ReadViewRecord(const std::filesystem::path& views_directory,
                                  PositionId position);
// Removes what an interrupted writer left behind; returns how many.
Result<int> RemoveTemporaryViews(const std::filesystem::path& views_directory);

}  // namespace omnihdr
