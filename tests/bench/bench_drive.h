#pragma once

#include <cstdlib>
#include <filesystem>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/photometry/measure.h"
#include "core/session/journal.h"
#include "core/session/session_reader.h"
#include "tests/support/small_session.h"

namespace omnihdr {

// Places driven along there and back without end, each with its exposure: what the benchmarks of
// whole positions look at. The same pixels for ours and for the peers.
struct BenchDrive {
  testing::SessionPlan plan;
  SessionInfo info;
  std::vector<std::vector<std::byte>> files;  // a PNG a place
  std::vector<DecodedImage> images;           // the same, decoded
  std::vector<Measurement> measurements;

  // A furnished room, three exposures in turn. `files_only`: neither pictures nor measurements are
  // kept.
  BenchDrive(int width, int places, double step_m, bool files_only = false) {
    plan.projection = Projection::Equirectangular(width, width / 2);
    plan.room.detail_m = 0.2;
    plan.room.balls = {{{2.5, 1.6, 0.0}, 0.6, 1.0F},
                       {{1.0, -1.6, -0.5}, 0.5, 1.5F},
                       {{4.0, -1.2, 0.3}, 0.4, 0.7F}};
    plan.poses = testing::GentleBend(places, step_m);
    plan.exposures_s = {0.25, 1.0, 4.0};
    plan.with_odometer = false;
    info = testing::InfoOf(plan);
    files = testing::RenderFrames(plan);
    if (files_only) return;
    for (std::size_t k = 0; k < files.size(); ++k) {
      Result<DecodedImage> image = DecodeImage(files[k], "frame");
      if (!image) std::abort();
      images.push_back(std::move(*image));
    }
    for (std::size_t k = 0; k < files.size(); ++k) {
      const std::vector<ExposedFrame> frames = {{&images[k], {Exposure(k), GainDb{}}}};
      Result<Measurement> m =
          Measure(frames, plan.projection, *Response::Linear(), 8, {}, MeasureOptions{});
      if (!m) std::abort();
      measurements.push_back(std::move(*m));
    }
  }

  // A recorded session of panoramas, one frame a position: files only. `plan` has made-up poses.
  explicit BenchDrive(const std::filesystem::path& session) {
    const Result<SessionContents> contents = ReadSession(session);
    if (!contents) Refuse(contents.error().message);
    info = contents->info;
    info.files.clear();
    if (info.camera.layout != Layout::kPanorama || info.camera.width != 2048 ||
        info.camera.height != 1024) {
      Refuse("a session of panoramas of 2048 x 1024 is needed");
    }
    plan.exposures_s.clear();
    for (const FrameRecord& record : contents->journal.frames) {
      if (record.status != FrameStatus::kOk) continue;
      Result<std::vector<std::byte>> file = ReadFile(session / record.file);
      if (!file) Refuse(file.error().message);
      files.push_back(std::move(*file));
      plan.exposures_s.push_back(record.exposure.time.seconds());
    }
    if (files.size() < 4) Refuse("at least four frames are needed");
    plan.poses = testing::GentleBend(static_cast<int>(files.size()), 0.25);
  }

  ExposureTime Exposure(std::size_t place) const {
    return ExposureTime::Seconds(plan.exposures_s[place % plan.exposures_s.size()]);
  }
  // Where the drive is at its position number `position`.
  std::size_t Place(std::size_t position) const {
    const std::size_t last = files.size() - 1;
    const std::size_t k = position % (2 * last);
    return k <= last ? k : 2 * last - k;
  }
  // Adds the drive's next position to a session.
  void Append(SessionWriter& writer) const {
    const std::size_t position = writer.next_frame();
    const std::size_t place = Place(position);
    FrameRecord record;
    record.frame = FrameId{position};
    record.position = PositionId{static_cast<std::int64_t>(position)};
    record.file = fmt::format("raw/{:06}.png", position);
    record.exposure.time = Exposure(place);
    if (!writer.Append(record, files[place])) std::abort();
  }

 private:
  [[noreturn]] static void Refuse(const std::string& what) {
    fmt::print(stderr, "benchmark: {}\n", what);
    std::exit(65);
  }
};

// The drive that whole positions are measured on: lat-long 2048×1024.
inline const BenchDrive& LargeDrive() {
  static const BenchDrive drive(2048, 7, 0.25);
  return drive;
}

// A walk that a camera recorded, lat-long 2048×1024, when OMNIHDR_BENCH_SESSION names a session.
inline const char* RecordedWalkPath() { return std::getenv("OMNIHDR_BENCH_SESSION"); }
inline const BenchDrive& RecordedWalk() {
  static const BenchDrive drive{std::filesystem::path(RecordedWalkPath())};
  return drive;
}

}  // namespace omnihdr
