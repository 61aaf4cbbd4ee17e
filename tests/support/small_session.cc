#include "tests/support/small_session.h"

#include <cmath>
#include <fstream>
#include <iterator>
#include <stdexcept>

#include "core/base/parallel_for.h"
#include "core/image/image_io.h"

namespace omnihdr::testing {
namespace {

// Support code has nobody to hand an error to.
template <typename T>
T Must(Result<T> result) {
  if (!result) throw std::runtime_error(result.error().message);
  return std::move(*result);
}

}  // namespace

std::vector<Pose> GentleBend(int positions, double step) {
  std::vector<Pose> poses;
  Pose pose;
  for (int k = 0; k < positions; ++k) {
    poses.push_back(pose);
    pose.translation += step * (pose.rotation * Eigen::Vector3d::UnitX());
    pose.rotation = Eigen::AngleAxisd(0.02, Eigen::Vector3d::UnitZ()) * pose.rotation *
                    Eigen::AngleAxisd(0.004 * std::sin(k), Eigen::Vector3d::UnitY());
  }
  return poses;
}

std::vector<std::vector<std::byte>> RenderFrames(const SessionPlan& plan) {
  std::vector<std::vector<std::byte>> frames(plan.poses.size());
  ParallelFor(static_cast<int>(frames.size()), 1, [&](int begin, int end) {
    for (int k = begin; k < end; ++k) {
      const auto index = static_cast<std::size_t>(k);
      const double seconds = plan.exposures_s[index % plan.exposures_s.size()];
      const Truth truth = Render(plan.room, plan.projection, plan.poses[index]);
      const DecodedImage image =
          Expose(truth.radiance, seconds, static_cast<std::uint32_t>(k) + 1, plan.noise);
      frames[index] = Must(EncodePng(std::get<Image<std::uint8_t>>(image.pixels).view()));
    }
  });
  return frames;
}

SessionInfo InfoOf(const SessionPlan& plan) {
  SessionInfo info;
  info.created = "2026-01-01T00:00:00Z";
  info.camera.model = "ray-cast room";
  info.camera.serial = "room-1";
  info.camera.layout = Layout::kPanorama;
  info.camera.width = plan.projection.width();
  info.camera.height = plan.projection.height();
  info.camera.projection = plan.projection.kind();
  info.camera.z_min = plan.projection.z_min();
  info.camera.z_max = plan.projection.z_max();
  if (plan.frames_per_position > 0) {
    BracketDescription& bracket = info.bracket.emplace();
    bracket.frames_per_position = plan.frames_per_position;
    for (const double t : plan.exposures_s) bracket.exposures.push_back(ExposureTime::Seconds(t));
  }
  return info;
}

FrameRecord RecordOf(const SessionPlan& plan, std::size_t position) {
  FrameRecord record;
  record.frame = FrameId{position};
  record.position = PositionId{static_cast<std::int64_t>(position)};
  record.file = fmt::format("raw/{:06}.png", position);
  record.exposure.time =
      ExposureTime::Seconds(plan.exposures_s[position % plan.exposures_s.size()]);
  if (plan.with_odometer && position < plan.poses.size()) {
    double travelled = 0.0;
    for (std::size_t k = 1; k <= position; ++k) {
      travelled += (plan.poses[k].translation - plan.poses[k - 1].translation).norm();
    }
    record.odometer_m = travelled;
  }
  if (plan.with_heading && position < plan.poses.size()) {
    const Eigen::Vector3d forward = plan.poses[position].rotation * Eigen::Vector3d::UnitX();
    record.heading_deg =
        std::fmod(450.0 - std::atan2(forward.y(), forward.x()) * 180.0 / M_PI, 360.0);
  }
  if (plan.with_prior_poses && position < plan.poses.size()) record.pose = plan.poses[position];
  return record;
}

void WriteSession(const std::filesystem::path& directory, const SessionPlan& plan,
                  const std::vector<std::vector<std::byte>>& frames, int count) {
  SessionWriter writer = Must(SessionWriter::Create(directory, InfoOf(plan)));
  const std::size_t end = count < 0 ? frames.size() : static_cast<std::size_t>(count);
  for (std::size_t k = 0; k < end; ++k) {
    const Status status = writer.Append(RecordOf(plan, k), frames[k]);
    if (!status) throw std::runtime_error(status.error().message);
  }
}

std::map<std::string, std::string> ViewBytes(const std::filesystem::path& directory) {
  std::map<std::string, std::string> files;
  const std::filesystem::path views = directory / "views";
  if (!std::filesystem::exists(views)) return files;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(views)) {
    if (!entry.is_regular_file()) continue;
    files[std::filesystem::relative(entry.path(), views).string()] = FileText(entry.path());
  }
  return files;
}

std::string FileText(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error(fmt::format("cannot read {}", path.string()));
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

void WriteText(const std::filesystem::path& path, const std::string& text) {
  std::ofstream file(path, std::ios::binary | std::ios::trunc);
  file << text;
  if (!file.flush()) throw std::runtime_error(fmt::format("cannot write {}", path.string()));
}

}  // namespace omnihdr::testing
