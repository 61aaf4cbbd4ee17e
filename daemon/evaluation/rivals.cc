#include "daemon/evaluation/rivals.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "core/image/image_io.h"
#include "core/pipeline/frame_measurer.h"
#include "core/pipeline/view_files.h"
#include "core/session/session_reader.h"
#include "core/session/view_writer.h"
#include "core/stereo/fuse.h"
#include "core/stereo/view_merge.h"
#include "daemon/evaluation/reference.h"

namespace omnihdr {
namespace {

constexpr int kReach = 2;  // neighbours on each side, as the pipeline has them

// A position with usable frames and where it truly is.
struct Place {
  PositionId position{};
  std::vector<const FrameRecord*> frames;
  Pose pose;
};

Result<std::vector<Place>> PlacesOf(const SessionContents& contents, const Reference& reference) {
  std::map<PositionId, Place> places;
  for (const FrameRecord& frame : contents.journal.frames) {
    if (frame.status != FrameStatus::kOk) continue;
    Place& place = places[frame.position];
    place.position = frame.position;
    place.frames.push_back(&frame);
  }
  std::vector<Place> list;
  for (auto& [position, place] : places) {
    OMNIHDR_ASSIGN(const std::optional<Pose> pose, reference.TruePose(*place.frames.front()));
    if (!pose) {
      return Fail(ErrorKind::kData,
                  "position {}: its true pose is not known: only sessions of a known scene "
                  "(simulated ones) have an oracle",
                  Value(position));
    }
    place.pose = *pose;
    list.push_back(std::move(place));
  }
  return list;
}

Result<Measurement> MeasurePlace(const std::filesystem::path& session, const Place& place,
                                 FrameMeasurer& measurer) {
  std::vector<DecodedImage> images;
  for (const FrameRecord* frame : place.frames) {
    Result<DecodedImage> image = ReadImage(session / frame->file);
    if (!image) return Forward(std::move(image).error(), frame->file);
    images.push_back(std::move(*image));
  }
  std::vector<ExposedFrame> exposed;
  for (std::size_t k = 0; k < images.size(); ++k) {
    exposed.push_back({&images[k], place.frames[k]->exposure});
  }
  MeasureOptions options;
  options.noise.read = 0.0;  // as the pipeline: estimated from the frames
  return measurer.Measure(exposed, options);
}

// The scene's disparity round a place, in the world's axes.
Result<DisparityMap> TrueMap(const Place& place, const Reference& reference, int width) {
  const Projection grid = Projection::Equirectangular(width, width / 2);
  OMNIHDR_ASSIGN(Reference::Picture truth,
                 reference.Render(*place.frames.front(), grid, place.pose.rotation.conjugate()));
  DisparityMap map;
  map.disparity = std::move(truth.disparity);
  map.confidence = Image<float>(width, width / 2, 1, 1.0F);
  return map;
}

// Mean over the views that measured a direction; what none did is the own view's.
MergedView AverageAlongDirections(const std::vector<const MergedView*>& alone) {
  const MergedView& own = *alone.front();
  MergedView mean;
  mean.radiance = own.radiance.Clone();
  mean.origin = own.origin.Clone();
  mean.disparity = own.disparity.Clone();
  mean.confidence = own.confidence.Clone();
  const auto pixels = static_cast<std::size_t>(mean.origin.width()) *
                      static_cast<std::size_t>(mean.origin.height());
  for (std::size_t i = 0; i < pixels; ++i) {
    std::array<double, 3> sum{};
    int count = 0;
    for (const MergedView* view : alone) {
      if (view->origin.data()[i] != static_cast<std::uint8_t>(PixelOrigin::kMeasured)) continue;
      for (std::size_t c = 0; c < 3; ++c) {
        sum[c] += static_cast<double>(view->radiance.data()[3 * i + c]);
      }
      ++count;
    }
    if (count == 0) continue;
    for (std::size_t c = 0; c < 3; ++c) {
      mean.radiance.data()[3 * i + c] = static_cast<float>(sum[c] / count);
    }
    mean.origin.data()[i] = static_cast<std::uint8_t>(PixelOrigin::kMeasured);
  }
  return mean;
}

}  // namespace

std::string_view ToString(Rival rival) {
  return rival == Rival::kOracle ? "oracle" : "unregistered";
}

Status WriteRivalViews(const std::filesystem::path& session, Rival rival,
                       const FrameMaskOptions& mask, int width,
                       const std::filesystem::path& output) {
  OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(session));
  OMNIHDR_ASSIGN(const std::unique_ptr<Reference> reference, OpenReference(session, contents, {}));
  if (!reference) {
    return Fail(ErrorKind::kData, "{}: nothing is known of the scene",
                (session / "session.json").string());
  }
  OMNIHDR_ASSIGN(FrameMeasurer measurer, OpenOwnFrames(session, contents.info, mask));
  OMNIHDR_ASSIGN(const std::vector<Place> places, PlacesOf(contents, *reference));
  if (width == 0) width = std::min(measurer.projection().width() / 2 * 2, 8192);
  const auto count = static_cast<std::ptrdiff_t>(places.size());
  const Eigen::Quaterniond aligned = Eigen::Quaterniond::Identity();
  struct Measured {
    Measurement measurement;
    MergedView alone;  // its own picture by itself (kUnregistered)
  };
  std::map<std::ptrdiff_t, Measured> window;
  for (std::ptrdiff_t k = 0; k < count; ++k) {
    for (std::ptrdiff_t n = std::max<std::ptrdiff_t>(k - kReach, 0);
         n <= std::min(k + kReach, count - 1); ++n) {
      if (window.contains(n)) continue;
      const Place& near = places[static_cast<std::size_t>(n)];
      Measured measured;
      OMNIHDR_ASSIGN(measured.measurement, MeasurePlace(session, near, measurer));
      if (rival == Rival::kUnregistered) {
        measured.alone = MergeViews({&measured.measurement, near.pose, nullptr}, nullptr, {},
                                    aligned, width, MergeOptions{});
      }
      window.emplace(n, std::move(measured));
    }
    window.erase(window.begin(), window.lower_bound(k - kReach));

    const Place& place = places[static_cast<std::size_t>(k)];
    const Measured& here = window.at(k);
    const MergeSource own = {&here.measurement, place.pose, nullptr};
    std::vector<MergeSource> others;
    FinishedView view;
    view.pose.position = place.position;
    view.pose.world_from_camera = place.pose;
    view.pose.metric = true;
    view.camera_from_output = place.pose.rotation.conjugate();
    view.reference = place.frames.front()->frame;
    std::vector<const MergedView*> alone = {&here.alone};
    for (const auto& [n, measured] : window) {
      const Place& other = places[static_cast<std::size_t>(n)];
      for (const FrameRecord* frame : other.frames) view.frames.push_back(frame->frame);
      if (n == k) continue;
      others.push_back({&measured.measurement, other.pose, nullptr});
      alone.push_back(&measured.alone);
    }
    if (rival == Rival::kOracle) {
      OMNIHDR_ASSIGN(const DisparityMap map, TrueMap(place, *reference, width));
      MergeOptions merge;
      merge.refine_exposure = false;
      view.merged = MergeViews(own, &map, others, aligned, width, merge);
    } else {
      view.merged = AverageAlongDirections(alone);
    }
    ViewContext context;
    context.mode = ToString(rival);
    context.reference_exposure_s = place.frames.front()->exposure.time.seconds();
    context.exr_type = ExrPixelType::kFloat;
    OMNIHDR_TRY(WriteView(output / "views", place.position, true,
                          [&](const std::filesystem::path& directory) {
                            return WriteViewFiles(directory, view, context);
                          }));
  }
  return {};
}

}  // namespace omnihdr
