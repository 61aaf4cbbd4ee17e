#include <algorithm>
#include <string>

#include "tests/faults/storage_faults.h"

namespace omnihdr::faults {

std::string_view ToString(Call call) {
  static constexpr std::array<std::string_view, kCalls> kNames = {
      "open",  "write",  "sync",     "sync-directory", "rename",
      "mkdir", "remove", "truncate", "allocate"};
  return kNames[static_cast<std::size_t>(call)];
}

std::string_view ToString(File file) {
  static constexpr std::array<std::string_view, kFiles> kNames = {
      "session.json", "journal",   "pixels",       "ended.json",   "session",
      "raw",          "views",     "view",         "radiance.exr", "disparity.exr",
      "preview.jpg",  "view.json", "keyframe.bin", "other"};
  return kNames[static_cast<std::size_t>(file)];
}

std::string_view ToString(Moment moment) {
  static constexpr std::array<std::string_view, 3> kNames = {"before", "half", "after"};
  return kNames[static_cast<std::size_t>(moment)];
}

File FileOf(std::string_view path) {
  if (path.empty() || path == ".") return File::kSession;
  if (path.ends_with(".tmp") && path.find("/.") == std::string_view::npos) {
    path.remove_suffix(4);  // of a file on its way
  }
  if (path == "frames.jsonl") return File::kJournal;
  if (path == "ended.json") return File::kEnded;
  if (path == "timings.jsonl") return File::kOther;
  if (path == "raw") return File::kRaw;
  if (path == "views") return File::kViews;
  if (path.starts_with("raw/")) return File::kPixels;
  if (path.starts_with("views/")) {
    const std::size_t slash = path.rfind('/');
    if (slash == 5) return File::kView;
    std::string_view name = path.substr(slash + 1);
    if (name.ends_with(".tmp")) name.remove_suffix(4);
    if (name == "radiance.exr") return File::kRadiance;
    if (name == "disparity.exr") return File::kDisparity;
    if (name == "preview.jpg") return File::kPreview;
    if (name == "view.json") return File::kRecord;
    if (name == "keyframe.bin") return File::kKeyframe;
    return File::kOther;
  }
  return path.find('/') == std::string_view::npos ? File::kInfo : File::kOther;
}

}  // namespace omnihdr::faults
