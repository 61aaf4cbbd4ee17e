#include "tests/support/rig_session.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <string>

#include "core/image/image_io.h"
#include "core/session/journal.h"
#include "core/session/rig_file.h"
#include "core/session/session_reader.h"
#include "tests/support/ring.h"

namespace omnihdr::testing {
namespace {

RadianceAlong SeenFrom(const Room& room, const Pose& world_from_camera) {
  return [&room, world_from_camera](const Eigen::Vector3d& from, const Eigen::Vector3d& ray) {
    return Eigen::Vector3d(
        room.Look(world_from_camera.WorldFromCamera(from), world_from_camera.rotation * ray)
            .radiance.cast<double>());
  };
}

}  // namespace

SessionInfo RigInfo(const Rig& rig) {
  SessionInfo info;
  info.created = "2026-01-01T00:00:00Z";
  info.camera.model = "ring";
  info.camera.layout = Layout::kRig;
  info.camera.width = rig.sensors.front().lens.width();
  info.camera.height = StackedRows(rig).value().back();
  info.camera.bayer = ToString(rig.sensors.front().bayer);
  info.files = {{"rig.toml", FormatRig(rig)}};
  return info;
}

void WriteRigSession(const std::filesystem::path& directory, const Rig& rig, const Room& room,
                     const std::vector<Pose>& poses, const std::vector<double>& exposures_s,
                     int frames_per_position) {
  SessionInfo info = RigInfo(rig);
  BracketDescription bracket;
  for (const double s : exposures_s) bracket.exposures.push_back(ExposureTime::Seconds(s));
  bracket.frames_per_position = frames_per_position;
  info.bracket = bracket;
  SessionWriter writer = SessionWriter::Create(directory, info).value();
  std::uint64_t number = 0;
  for (std::size_t p = 0; p < poses.size(); ++p) {
    for (int k = 0; k < frames_per_position; ++k) {
      const double seconds = exposures_s[number % exposures_s.size()];
      const DecodedImage image = ShootRig(rig, SeenFrom(room, poses[p]), seconds, 8, 0.5, number);
      FrameRecord record;
      record.frame = FrameId{number};
      record.position = PositionId{static_cast<std::int64_t>(p)};
      record.file = "raw/" + std::to_string(number) + ".png";
      record.exposure = {ExposureTime::Seconds(seconds), GainDb{}};
      record.trigger_time = HostTime::FromNanoseconds(static_cast<std::int64_t>(number) * 1000);
      record.odometer_m = 0.2 * static_cast<double>(p);
      record.pose = poses[p];
      ASSERT_TRUE(writer.Append(
          record, EncodePng(std::get<Image<std::uint8_t>>(image.pixels).view()).value()));
      ++number;
    }
  }
}

}  // namespace omnihdr::testing
