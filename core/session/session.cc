#include "core/session/session.h"

#include <cassert>

namespace omnihdr {

std::string_view ToString(Layout layout) {
  switch (layout) {
    case Layout::kPanorama:
      return "panorama";
    case Layout::kRig:
      return "rig";
    case Layout::kPerspective:
      return "perspective";
  }
  return "?";
}

Projection CameraDescription::PanoramaProjection() const {
  assert(layout == Layout::kPanorama);
  return projection == ProjectionKind::kCylindrical
             ? Projection::Cylindrical(width, height, z_min, z_max)
             : Projection::Equirectangular(width, height);
}

std::string_view ToString(BracketOrder order) {
  switch (order) {
    case BracketOrder::kSawtooth:
      return "sawtooth";
    case BracketOrder::kTriangle:
      return "triangle";
    case BracketOrder::kList:
      return "list";
  }
  return "?";
}

std::string_view ToString(FrameStatus status) {
  switch (status) {
    case FrameStatus::kOk:
      return "ok";
    case FrameStatus::kMissedTrigger:
      return "missed-trigger";
    case FrameStatus::kCameraTimeout:
      return "camera-timeout";
    case FrameStatus::kCorrupt:
      return "corrupt";
    case FrameStatus::kExposureMismatch:
      return "exposure-mismatch";
    case FrameStatus::kDiskFull:
      return "disk-full";
  }
  return "?";
}

std::optional<FrameStatus> FrameStatusFromString(std::string_view name) {
  for (const FrameStatus status :
       {FrameStatus::kOk, FrameStatus::kMissedTrigger, FrameStatus::kCameraTimeout,
        FrameStatus::kCorrupt, FrameStatus::kExposureMismatch, FrameStatus::kDiskFull}) {
    if (name == ToString(status)) return status;
  }
  return std::nullopt;
}

std::string_view ToString(ExposureProof proof) {
  switch (proof) {
    case ExposureProof::kNone:
      return "none";
    case ExposureProof::kEmbedded:
      return "embedded";
    case ExposureProof::kReadback:
      return "readback";
    case ExposureProof::kLatency:
      return "latency";
    case ExposureProof::kFile:
      return "file";
  }
  return "?";
}

std::optional<ExposureProof> ExposureProofFromString(std::string_view name) {
  for (const ExposureProof proof :
       {ExposureProof::kNone, ExposureProof::kEmbedded, ExposureProof::kReadback,
        ExposureProof::kLatency, ExposureProof::kFile}) {
    if (name == ToString(proof)) return proof;
  }
  return std::nullopt;
}

}  // namespace omnihdr
