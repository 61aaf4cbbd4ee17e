#include "core/session/view_check.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <optional>
#include <system_error>
#include <utility>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/session/limits.h"
#include "core/session/view_writer.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxKeyframeBytes = std::size_t{1} << 20;
constexpr std::size_t kMaxNamedFrames = 5;  // in one message
constexpr std::array<std::string_view, 5> kViewFiles = {
    "view.json", "radiance.exr", "disparity.exr", "preview.jpg", "keyframe.bin"};

class ViewChecker {
 public:
  ViewChecker(const fs::path& directory, PositionId position, std::string name,
              const FrameIndex& frames, bool quick)
      : directory_(directory),
        position_(position),
        name_(std::move(name)),
        frames_(frames),
        quick_(quick) {}

  std::vector<SessionFinding> Run() && {
    const Result<ViewRecord> record = ReadRecord();
    if (!record) {
      // Then nobody takes it for a view, whatever else is in it.
      Damage("view-incomplete", "view.json", record.error().message);
      return std::move(findings_);
    }
    CheckRecord(*record);
    CheckRadiance();
    CheckDisparity(*record);
    CheckPreview();
    CheckOtherFiles();
    return std::move(findings_);
  }

 private:
  void Add(FindingKind kind, std::string code, const std::string& file, std::string message) {
    const std::string path = (directory_ / file).string();
    findings_.push_back({kind, std::move(code), file.empty() ? name_ : name_ + "/" + file, 0,
                         WithoutName(std::move(message), path)});
  }
  void Damage(std::string code, const std::string& file, std::string message) {
    Add(FindingKind::kDamage, std::move(code), file, std::move(message));
  }

  Result<ViewRecord> ReadRecord() const {
    OMNIHDR_ASSIGN(const std::string text,
                   ReadTextFile(directory_ / "view.json", session_limits::kMaxViewBytes));
    return ParseViewRecord(text, (directory_ / "view.json").string());
  }

  void CheckRecord(const ViewRecord& record) {
    if (record.position != position_) {
      Damage("view-incomplete", "view.json",
             fmt::format("position: {}, expected {} as the directory's name",
                         Value(record.position), Value(position_)));
    }
    if (record.mode != "spatiotemporal" && record.mode != "temporal") {
      Damage("view-values", "view.json",
             fmt::format("mode: \"{}\", expected \"spatiotemporal\" or \"temporal\"", record.mode));
    }
    if (record.valid_fraction < 0.0 || record.valid_fraction > 1.0 + 1e-9) {
      Damage("view-values", "view.json",
             fmt::format("radiance.valid_fraction: {}, expected a number in [0, 1]",
                         record.valid_fraction));
    }
    CheckFrames(record);
  }

  void CheckFrames(const ViewRecord& record) {
    std::vector<std::uint64_t> unknown;
    for (const std::uint64_t frame : record.frames) {
      const FrameIndex::Entry* entry = frames_.Find(frame);
      if (entry == nullptr || !entry->has_pixels) unknown.push_back(frame);
    }
    if (!unknown.empty()) {
      const std::size_t shown = std::min(unknown.size(), kMaxNamedFrames);
      Damage("view-journal", "view.json",
             fmt::format("frames: made from frame {}{}, expected frames that frames.jsonl has with "
                         "status \"ok\"",
                         fmt::join(unknown.begin(),
                                   unknown.begin() + static_cast<std::ptrdiff_t>(shown), ", "),
                         unknown.size() > shown ? ", ..." : ""));
    }
    const FrameIndex::Entry* own = frames_.Find(record.reference);
    if (own == nullptr || !own->has_pixels) {
      Damage("view-journal", "view.json",
             fmt::format("reference: frame {}, expected a frame that frames.jsonl has with status "
                         "\"ok\"",
                         record.reference));
    } else if (own->position != Value(position_)) {
      Damage("view-journal", "view.json",
             fmt::format("reference: frame {} of position {}, expected a frame of position {}",
                         record.reference, own->position, Value(position_)));
    }
  }

  // Whether the file is there and, unless `quick_`, can be read on.
  bool IsThere(const std::string& file) {
    std::error_code error;
    const auto status = fs::status(directory_ / file, error);
    if (!fs::exists(status)) {
      Damage("view-unreadable", file, "missing");
      return false;
    }
    if (!fs::is_regular_file(status) || fs::file_size(directory_ / file, error) == 0) {
      Damage("view-unreadable", file, "0 bytes or no file, expected a file with content");
      return false;
    }
    return !quick_;
  }

  // Reads an EXR file with at least the channels named.
  std::optional<ExrImage> ReadChannels(const std::string& file,
                                       const std::vector<std::string>& expected) {
    if (!IsThere(file)) return std::nullopt;
    Result<ExrImage> image = ReadExr(directory_ / file);
    if (!image) {
      Damage("view-unreadable", file, image.error().message);
      return std::nullopt;
    }
    std::vector<std::string> missing;
    for (const std::string& channel : expected) {
      if (!image->channels.contains(channel)) missing.push_back(channel);
    }
    if (!missing.empty()) {
      Damage("view-channels", file,
             fmt::format("no channel {}, expected {}", fmt::join(missing, ", "),
                         fmt::join(expected, ", ")));
      return std::nullopt;
    }
    const auto told = image->attributes.strings.find("omnihdrPosition");
    if (told != image->attributes.strings.end() &&
        told->second != fmt::format("{}", Value(position_))) {
      Damage("view-mismatch", file,
             fmt::format("omnihdrPosition: {}, expected {}", told->second, Value(position_)));
    }
    if (width_ == 0) {
      width_ = image->width;
      height_ = image->height;
    } else {
      CheckSize(file, image->width, image->height);
    }
    return std::move(*image);
  }

  void CheckSize(const std::string& file, int width, int height) {
    if (width_ == 0 || (width == width_ && height == height_)) return;
    Damage("view-size", file,
           fmt::format("{}x{}, expected {}x{} as radiance.exr", width, height, width_, height_));
  }

  void CheckRadiance() {
    const std::string file = "radiance.exr";
    const std::optional<ExrImage> image = ReadChannels(file, {"R", "G", "B", "origin"});
    if (!image) return;
    const Image<float>& origin = image->channels.at("origin");
    std::size_t wrong_origin = 0;
    std::size_t wrong_value = 0;
    for (int y = 0; y < image->height; ++y) {
      for (int x = 0; x < image->width; ++x) {
        const float o = origin.at(x, y);
        if (!(o == 0.0F || o == 1.0F || o == 2.0F || o == 3.0F)) ++wrong_origin;
        for (const char* channel : {"R", "G", "B"}) {
          const float value = image->channels.at(channel).at(x, y);
          // output.nan may have put NaN wherever nothing was measured.
          const bool may_be_nan = std::isnan(value) && o != 1.0F;
          if (!may_be_nan && !(value >= 0.0F && std::isfinite(value))) ++wrong_value;
        }
      }
    }
    if (wrong_origin > 0) {
      Damage("view-values", file,
             fmt::format("{} pixels with an unknown origin, expected 0, 1, 2 or 3", wrong_origin));
    }
    if (wrong_value > 0) {
      Damage("view-values", file,
             fmt::format("{} negative or infinite values, expected finite radiance of at least 0",
                         wrong_value));
    }
  }

  void CheckDisparity(const ViewRecord& record) {
    const std::string file = "disparity.exr";
    std::error_code error;
    // A merge of exposures of one place has none.
    if (record.mode == "temporal" && !fs::exists(directory_ / file, error)) return;
    const std::optional<ExrImage> image = ReadChannels(file, {"disparity", "confidence"});
    if (!image) return;
    std::size_t wrong = 0;
    for (const float value : image->channels.at("disparity").values()) {
      wrong += std::isinf(value) ? 1 : 0;
    }
    if (wrong > 0) {
      Damage("view-values", file,
             fmt::format("{} infinite disparities, expected numbers, or NaN where it is unknown",
                         wrong));
    }
    wrong = 0;
    for (const float value : image->channels.at("confidence").values()) {
      wrong += value >= 0.0F && value <= 1.0F ? 0 : 1;
    }
    if (wrong > 0) {
      Damage("view-values", file,
             fmt::format("{} confidences out of range, expected numbers in [0, 1]", wrong));
    }
  }

  void CheckPreview() {
    const std::string file = "preview.jpg";
    if (!IsThere(file)) return;
    const Result<DecodedImage> image = ReadImage(directory_ / file);
    if (!image) {
      Damage("view-unreadable", file, image.error().message);
      return;
    }
    CheckSize(file, image->width(), image->height());
  }

  void CheckOtherFiles() {
    std::error_code error;
    std::vector<std::string> others;
    for (fs::directory_iterator it(directory_, error), end; !error && it != end;
         it.increment(error)) {
      const std::string file = it->path().filename().string();
      if (std::find(kViewFiles.begin(), kViewFiles.end(), file) == kViewFiles.end()) {
        others.push_back(file);
      }
      if (file != "keyframe.bin") continue;
      std::error_code ignored;
      const std::uintmax_t bytes = it->file_size(ignored);
      if (ignored || bytes == 0 || bytes > kMaxKeyframeBytes) {
        Damage("view-unreadable", file,
               fmt::format("{} bytes, expected 1 to {}", ignored ? 0 : bytes, kMaxKeyframeBytes));
      }
    }
    std::sort(others.begin(), others.end());
    for (const std::string& other : others) {
      Add(FindingKind::kNote, "view-unknown-file", other, "not one of a view's files");
    }
  }

  const fs::path& directory_;
  const PositionId position_;
  const std::string name_;
  const FrameIndex& frames_;
  const bool quick_;
  int width_ = 0;  // of radiance.exr, or the first that could be read
  int height_ = 0;
  std::vector<SessionFinding> findings_;
};

}  // namespace

FrameIndex::FrameIndex(std::vector<Entry> entries) : entries_(std::move(entries)) {
  std::stable_sort(entries_.begin(), entries_.end(),
                   [](const Entry& a, const Entry& b) { return a.frame < b.frame; });
  for (const Entry& entry : entries_) {
    if (entry.has_pixels) positions_.push_back(entry.position);
  }
  std::sort(positions_.begin(), positions_.end());
  positions_.erase(std::unique(positions_.begin(), positions_.end()), positions_.end());
}

const FrameIndex::Entry* FrameIndex::Find(std::uint64_t frame) const {
  const auto found = std::lower_bound(
      entries_.begin(), entries_.end(), frame,
      [](const Entry& entry, std::uint64_t wanted) { return entry.frame < wanted; });
  return found != entries_.end() && found->frame == frame ? &*found : nullptr;
}

bool FrameIndex::HasUsableFrame(std::int64_t position) const {
  return std::binary_search(positions_.begin(), positions_.end(), position);
}

std::vector<SessionFinding> CheckView(const fs::path& directory, PositionId position,
                                      const std::string& name, const FrameIndex& frames,
                                      bool quick) {
  return ViewChecker(directory, position, name, frames, quick).Run();
}

std::string WithoutName(std::string message, std::string_view name, int* line) {
  if (!message.starts_with(name) || message.size() <= name.size() + 1 ||
      message[name.size()] != ':') {
    return message;
  }
  message.erase(0, name.size() + 1);
  int number = 0;
  const char* const begin = message.data();
  const auto [end, error] = std::from_chars(begin, begin + message.size(), number);
  if (error == std::errc() && end != begin + message.size() && *end == ':') {
    if (line != nullptr) *line = number;
    message.erase(0, static_cast<std::size_t>(end - begin) + 1);
  }
  message.erase(0, message.find_first_not_of(' '));
  return message;
}

}  // namespace omnihdr
