#include "core/session/pose_notes.h"

namespace omnihdr {

std::string_view ToString(ScaleSource source) {
  switch (source) {
    case ScaleSource::kOdometer:
      return "odometer";
    case ScaleSource::kGnss:
      return "gnss";
    case ScaleSource::kGiven:
      return "given";
    case ScaleSource::kNone:
      break;
  }
  return "none";
}

std::optional<ScaleSource> ScaleSourceFromString(std::string_view name) {
  for (const ScaleSource source :
       {ScaleSource::kNone, ScaleSource::kOdometer, ScaleSource::kGnss, ScaleSource::kGiven}) {
    if (name == ToString(source)) return source;
  }
  return std::nullopt;
}

}  // namespace omnihdr
