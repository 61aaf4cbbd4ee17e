#include "core/pipeline/session_processor.h"

#include <algorithm>
#include <chrono>
#include <deque>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "core/base/file.h"
#include "core/base/profile.h"
#include "core/image/image_io.h"
#include "core/photometry/exposure_refine.h"
#include "core/pipeline/frame_measurer.h"
#include "core/pipeline/made_with.h"
#include "core/pipeline/mover_masks.h"
#include "core/pipeline/position_set.h"
#include "core/pipeline/read_frame.h"
#include "core/pipeline/rig_masks.h"
#include "core/pipeline/view_files.h"
#include "core/pipeline/view_pipeline.h"
#include "core/session/session_reader.h"
#include "core/session/view_writer.h"

namespace omnihdr {
namespace {

using FramesByPosition = std::map<std::int64_t, std::vector<FrameRecord>>;

// An upgrade goes on from a saved state rather than through so many positions: more than a restored
// pipeline and its poses' window need again.
constexpr std::ptrdiff_t kWorthSkipping = 3 * ViewPipeline::kWarmUpPositions;
constexpr std::size_t kMaxKeyframeBytes = std::size_t{1} << 20;

double SecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// Of frames merged at one position, the one that stands for it: the exposure in the middle.
const FrameRecord& ReferenceOf(const std::vector<const FrameRecord*>& frames) {
  std::vector<const FrameRecord*> sorted = frames;
  std::stable_sort(sorted.begin(), sorted.end(), [](const FrameRecord* a, const FrameRecord* b) {
    return a->exposure.EffectiveSeconds() < b->exposure.EffectiveSeconds();
  });
  return *sorted[sorted.size() / 2];
}

struct LoadedPosition {
  PositionId position{};
  Measurement measurement;
  std::vector<FrameId> frames;
  FrameRecord reference;
  std::vector<std::string> notes;  // about exposure labels, for view.json's warnings
};

class SessionProcessorImpl final : public SessionProcessor {
 public:
  SessionProcessorImpl(std::filesystem::path session, std::filesystem::path output,
                       const PipelineOptions& options, ProcessorCallbacks callbacks,
                       const ProcessorOptions& how, SessionInfo info)
      : session_(std::move(session)),
        output_(std::move(output)),
        views_(output_ / "views"),
        options_(options),
        callbacks_(std::move(callbacks)),
        how_(how),
        governor_(how.overload),
        info_(std::move(info)),
        follower_(session_) {
    if (callbacks_.durable_bytes) follower_.ReadUpTo(callbacks_.durable_bytes);
  }

  Status Prepare() {
    const CameraDescription& camera = info_.camera;
    if (camera.layout == Layout::kPerspective && options_.mode == ProcessMode::kSpatiotemporal) {
      return Fail(ErrorKind::kData,
                  "{}: camera.layout: \"perspective\" can only be processed in mode temporal",
                  (session_ / "session.json").string());
    }
    if (camera.layout == Layout::kRig && options_.weights == MergeWeights::kHat) {
      return Fail(
          ErrorKind::kConfig,
          "photometry.weights: \"hat\", expected \"inverse-variance\" for the raw frames of "
          "a rig ({})",
          (session_ / "session.json").string());
    }
    is_temporal_ = options_.mode == ProcessMode::kTemporal ||
                   (options_.mode == ProcessMode::kAuto && camera.layout == Layout::kPerspective);
    Image<std::uint8_t> mask;
    if (!options_.mask_file.empty()) {
      OMNIHDR_ASSIGN(mask, ReadMask(options_.mask_file));
    }
    OMNIHDR_ASSIGN(FrameMeasurer measurer,
                   FrameMeasurer::Open(session_, info_, mask.view(), options_.mask_file,
                                       options_.white_balance));
    measurer_.emplace(std::move(measurer));
    std::error_code error;
    std::filesystem::create_directories(views_, error);
    if (error) {
      return Fail(ErrorKind::kCannotCreate, "{}: {}", views_.string(), error.message());
    }
    OMNIHDR_TRY(RemoveTemporaryViews(views_));
    OMNIHDR_ASSIGN(const auto complete, CompleteViewLevels(views_));
    for (const auto& [position, level] : complete) {
      complete_.Insert(Value(position));
      if (level > 0) reduced_.Insert(Value(position));
    }
    OMNIHDR_ASSIGN(made_with_, MadeWith(options_, session_));
    if (how_.upgrade) {
      OMNIHDR_TRY(CheckUpgradable());
    } else if (const std::string otherwise = OtherwiseMade(views_, made_with_);
               !otherwise.empty()) {
      Warn(otherwise);
    }
    if (!is_temporal_) {
      OMNIHDR_ASSIGN(pipeline_, ViewPipeline::Create(options_));
    }
    return {};
  }

  Result<Progress> Step() override {
    OMNIHDR_TRY(WriteWaiting());
    OMNIHDR_TRY(ReadJournal());
    const std::optional<std::int64_t> position = NextReady();
    if (!position) return Progress::kNothingNew;
    OMNIHDR_TRY(ProcessPosition(*position));
    return Progress::kWorked;
  }

  Status Finish() override {
    at_end_ = true;
    for (;;) {
      OMNIHDR_ASSIGN(const Progress progress, Step());
      if (progress == Progress::kNothingNew) break;
    }
    if (const std::optional<std::string> torn = follower_.TornTail()) Warn(*torn);
    if (governor_.level() > 0 && callbacks_.quality_changed) callbacks_.quality_changed(0, 0);
    governor_.Reset();
    if (pipeline_ != nullptr) {
      for (FinishedView& view : pipeline_->Finish(WantView())) Enqueue(std::move(view), 0.0);
      references_.clear();
    }
    return WriteWaiting();
  }

  Counts counts() const override {
    Counts c = counts_;
    c.views_complete = static_cast<int>(complete_.size());
    c.views_reduced = static_cast<int>(reduced_.size());
    c.backlog = static_cast<int>(pending_.size());
    c.quality_level = governor_.level();
    return c;
  }

 private:
  struct Waiting {
    FinishedView view;
    std::optional<TemporalView> temporal;
    ViewContext context;
    ViewDone done;
  };

  void Warn(const std::string& message) const {
    if (callbacks_.warning) callbacks_.warning(message);
  }

  bool IsWanted(std::int64_t position) const {
    return how_.upgrade ? reduced_.Covers(position) : !complete_.Covers(position);
  }
  ViewPipeline::WantView WantView() const {
    return [this](PositionId position) { return IsWanted(Value(position)); };
  }

  // Views made with something else are not brought to full quality but become others.
  Status CheckUpgradable() const {
    Status upgradable;
    reduced_.ForEach([&](std::int64_t position) {
      const Result<ViewRecord> record = ReadViewRecord(views_, PositionId{position});
      if (!record) {
        upgradable = Forward(record.error());
      } else if (record->made_with != made_with_) {
        upgradable = Fail(
            ErrorKind::kConfig,
            "{}: made with other options, another mask or another rig than now (made_with "
            "\"{}\", now \"{}\"): upgrade with the configuration it was made with",
            (views_ / ViewDirectoryName(record->position)).string(), record->made_with, made_with_);
      }
      return upgradable.has_value();
    });
    return upgradable;
  }

  // The level for the view that the next push finishes.
  int NextQualityLevel() {
    if (how_.overload.overload == Overload::kBacklog) return 0;
    int waiting = -1;  // beside the one that is taken now
    for (const auto& [position, frames] : pending_) {
      if (!complete_.Covers(position)) ++waiting;
    }
    waiting = std::max(waiting, 0);
    const int before = governor_.level();
    const int level = governor_.Next(waiting);
    if (level != before && callbacks_.quality_changed) callbacks_.quality_changed(level, waiting);
    return level;
  }

  Status ReadJournal() {
    const ProfileScope profile("journal");
    OMNIHDR_ASSIGN(std::vector<FrameRecord> records, follower_.ReadNew());
    const std::vector<std::string>& warnings = follower_.warnings();
    for (; warnings_told_ < warnings.size(); ++warnings_told_) Warn(warnings[warnings_told_]);
    for (FrameRecord& record : records) {
      const std::int64_t position = Value(record.position);
      // By the order of lines alone, so that it does not matter when they are read.
      if (position < newest_ || (last_taken_ && position <= *last_taken_)) {
        Warn(fmt::format("frame {}: position {} came after position {}: not used",
                         Value(record.frame), position, newest_));
        continue;
      }
      if (position > newest_) {
        newest_ = position;
        frames_at_newest_ = 0;
      }
      if (IsFull(frames_at_newest_)) {
        Warn(
            fmt::format("frame {}: position {} has its {} frame(s) already, as session.json's "
                        "bracket.frames_per_position says: not used",
                        Value(record.frame), position, frames_at_newest_));
        continue;
      }
      ++frames_at_newest_;
      pending_[position].push_back(std::move(record));
    }
    return {};
  }

  // Whether a position with so many frames has all it will get. In temporal mode a position has
  // more than one frame by nature: it is closed by the next position unless their number is given.
  bool IsFull(std::size_t frames) const {
    const int expected = info_.bracket ? info_.bracket->frames_per_position : 1;
    return static_cast<int>(frames) >= expected && (!is_temporal_ || expected > 1);
  }

  // The lowest position of which nothing more is to come.
  std::optional<std::int64_t> NextReady() const {
    if (pending_.empty()) return std::nullopt;
    const auto& [position, frames] = *pending_.begin();
    if (at_end_ || pending_.size() > 1 || IsFull(frames.size())) return position;
    return std::nullopt;
  }

  Status ProcessPosition(std::int64_t position) {
    if (is_temporal_) {
      if (IsWanted(position)) OMNIHDR_TRY(ProcessTemporal(position));
      Take(position);
      complete_.Settle(position);
      return {};
    }
    if (!started_) {
      OMNIHDR_TRY(Start());
    } else if (how_.upgrade) {
      SkipUnwanted();
    }
    if (!pending_.contains(position)) return {};  // skipped: already done
    const int quality_level = NextQualityLevel();
    std::optional<LoadedPosition> loaded = Load(pending_.at(position), true);
    Take(position);
    if (!loaded) {
      complete_.Settle(position);
      return {};
    }
    ViewContext context = ContextOf(loaded->reference);
    context.notes = loaded->notes;
    references_[position] = context;
    PositionInput input;
    input.position = PositionId{position};
    input.measurement = std::move(loaded->measurement);
    input.frames = std::move(loaded->frames);
    input.reference = loaded->reference.frame;
    input.odometer_m = loaded->reference.odometer_m;
    input.prior = loaded->reference.pose;
    input.heading_deg = loaded->reference.heading_deg;
    input.gnss = ClueFromFix(loaded->reference.gnss);
    input.optics = measurer_->optics();
    std::optional<FinishedView> finished =
        pipeline_->Push(std::move(input), WantView(), quality_level);
    if (finished) {
      Enqueue(std::move(*finished), pipeline_->last_pose_s());
      return WriteWaiting();
    }
    return {};
  }

  void Take(std::int64_t position) {
    pending_.erase(position);
    last_taken_ = position;
  }

  // The first time there is work: where to begin. Positions whose views are complete are only gone
  // through as far as the first missing view depends on them.
  Status Start() {
    started_ = true;
    const std::vector<std::int64_t> positions = UsablePositions();
    const auto missing = std::find_if(positions.begin(), positions.end(),
                                      [this](std::int64_t p) { return IsWanted(p); });
    if (missing == positions.begin()) return {};
    for (const std::int64_t p : positions) {
      if (complete_.Covers(p) && !IsWanted(p)) Tell(p);
    }
    if (missing == positions.end() && (at_end_ || how_.upgrade)) {
      pending_.clear();
      return {};
    }
    ContinueBefore(positions, missing - positions.begin());
    return {};
  }

  // Of those pending, the positions whose frames claim pixels.
  std::vector<std::int64_t> UsablePositions() const {
    std::vector<std::int64_t> positions;
    for (const auto& [position, frames] : pending_) {
      const bool usable = std::any_of(frames.begin(), frames.end(), [](const FrameRecord& f) {
        return f.status == FrameStatus::kOk;
      });
      if (usable) positions.push_back(position);
    }
    return positions;
  }

  // An upgrade between two of its views: what lies far before the next one is not gone through.
  void SkipUnwanted() {
    for (const auto& [position, context] : references_) {
      if (IsWanted(position)) return;  // still inside the pipeline
    }
    const std::vector<std::int64_t> positions = UsablePositions();
    const auto missing = std::find_if(positions.begin(), positions.end(),
                                      [this](std::int64_t p) { return IsWanted(p); });
    const bool none = missing == positions.end();
    if (!none && missing - positions.begin() < kWorthSkipping) return;
    Result<std::unique_ptr<ViewPipeline>> fresh = ViewPipeline::Create(options_);
    if (!fresh) return;
    std::swap(pipeline_, *fresh);
    if (none) {
      pending_.clear();
    } else if (!ContinueBefore(positions, missing - positions.begin())) {
      std::swap(pipeline_, *fresh);
      return;
    }
    references_.clear();
  }

  // Puts the pipeline, fresh, into a saved state from which everything the view of
  // positions[missing_index] depends on is made again. False, and a fresh pipeline, when there is
  // none.
  bool ContinueBefore(const std::vector<std::int64_t>& positions, std::ptrdiff_t missing_index) {
    // The latest state from which everything the missing view depends on is made again.
    const std::ptrdiff_t latest = missing_index - 1 - ViewPipeline::kWarmUpPositions;
    for (std::ptrdiff_t k = latest; k >= 0; --k) {
      const std::int64_t candidate = positions[static_cast<std::size_t>(k)];
      Result<ViewRecord> record = ReadViewRecord(views_, PositionId{candidate});
      if (!record || record->resume_json.empty()) continue;
      if (record->made_with != made_with_) continue;  // its state is not the one to be had now
      const nlohmann::json state = nlohmann::json::parse(record->resume_json, nullptr, false);
      if (!state.is_object() || !state.contains("after") || !state["after"].is_number_integer()) {
        continue;
      }
      const auto after = state["after"].get<std::int64_t>();
      const auto after_it = std::find(positions.begin(), positions.end(), after);
      if (after_it == positions.end() || after_it - positions.begin() > latest) continue;
      if (!RestoreAt(record->resume_json)) break;  // state of another version: from the beginning
      pending_.erase(pending_.begin(), pending_.upper_bound(after));
      last_taken_ = after;
      return true;
    }
    return false;
  }

  bool RestoreAt(const std::string& resume_json) {
    Status restored = pipeline_->Restore(resume_json);
    if (restored) {
      for (const PositionId position : pipeline_->RestorePositions()) {
        const auto it = pending_.find(Value(position));
        std::optional<LoadedPosition> loaded;
        if (it != pending_.end()) loaded = Load(it->second, false);
        if (!loaded) {
          restored = Fail(ErrorKind::kData, "position {}: its frames are gone", Value(position));
          break;
        }
        pipeline_->Rewarm(position, loaded->measurement);
      }
    }
    if (restored) restored = RestoreKeyframes();
    if (restored) return true;
    Warn(fmt::format("cannot continue from a saved state ({}): starting from the first position",
                     restored.error().message));
    Result<std::unique_ptr<ViewPipeline>> fresh = ViewPipeline::Create(options_);
    if (fresh) pipeline_ = std::move(*fresh);
    return false;
  }

  std::filesystem::path KeyframePath(PositionId position) const {
    return views_ / ViewDirectoryName(position) / kKeyframeFile;
  }

  Status RestoreKeyframes() {
    for (const PositionId position : pipeline_->RestoreKeyframes()) {
      OMNIHDR_ASSIGN(std::string bytes, ReadTextFile(KeyframePath(position), kMaxKeyframeBytes));
      OMNIHDR_TRY(pipeline_->RestoreKeyframe({position, std::move(bytes)})
                      .Context(KeyframePath(position).string()));
    }
    return {};
  }

  // A view that was complete before may lack what its place is recognised by (finished as the last
  // of a session that went on, or made by an older version).
  void CompleteKeyframe(const FinishedView& view) const {
    const std::filesystem::path path = KeyframePath(view.pose.position);
    std::error_code error;
    if (view.keyframe.empty() || std::filesystem::exists(path, error)) return;
    if (const Status written = WriteFileAtomic(path, view.keyframe); !written) {
      Warn(written.error().message);
    }
  }

  // A view that was there before.
  void Tell(std::int64_t position) const {
    if (!callbacks_.view_done) return;
    ViewDone done;
    done.position = PositionId{position};
    done.already_complete = true;
    callbacks_.view_done(done);
  }

  ViewContext ContextOf(const FrameRecord& reference) const {
    ViewContext context;
    context.mode = is_temporal_ ? "temporal" : "spatiotemporal";
    context.reference_exposure_s = reference.exposure.EffectiveSeconds();
    context.camera = info_.camera.model;
    if (!info_.camera.serial.empty()) context.camera += " " + info_.camera.serial;
    context.utc = reference.utc;
    context.gnss = reference.gnss;
    context.preview_quality = options_.preview_quality;
    context.preview = options_.preview;
    context.heading_deg = reference.heading_deg;
    context.exr_type = options_.exr_type;
    context.chromaticities = options_.chromaticities;
    context.white_luminance = options_.white_luminance;
    context.nan = options_.nan;
    context.made_with = made_with_;
    return context;
  }

  // Reads and merges a position's usable frames; nothing when there is none. `count`: report what
  // is wrong and count the position (not when it is read a second time to restore).
  std::optional<LoadedPosition> Load(const std::vector<FrameRecord>& records, bool count) {
    std::vector<DecodedImage> images;
    std::vector<const FrameRecord*> usable;
    for (const FrameRecord& record : records) {
      if (record.status != FrameStatus::kOk) continue;
      Result<DecodedImage> image = ReadFrame(session_, info_.camera, record);
      if (!image) {
        if (count) {
          Warn(fmt::format("frame {}: {}: frame not used", Value(record.frame),
                           image.error().message));
        }
        continue;
      }
      images.push_back(std::move(*image));
      usable.push_back(&record);
    }
    if (usable.empty()) {
      if (count) {
        ++counts_.positions_without_pixels;
        Warn(fmt::format("position {}: no usable frame, no view", Value(records.front().position)));
      }
      return std::nullopt;
    }
    std::vector<ExposedFrame> exposed;
    for (std::size_t k = 0; k < usable.size(); ++k) {
      exposed.push_back({&images[k], usable[k]->exposure});
    }
    MeasureOptions measure;
    measure.value_low = options_.value_low;
    measure.value_high = options_.value_high;
    measure.noise = options_.noise;
    measure.weights = options_.weights;
    measure.white_balance = options_.white_balance;
    measure.demosaic = options_.demosaic;
    const ProfileScope profile("measure");
    std::vector<std::string> notes = RefineLabels(exposed, usable);
    Result<Measurement> measurement = measurer_->Measure(exposed, measure);
    if (!measurement) {
      if (count) {
        ++counts_.positions_without_pixels;
        Warn(fmt::format("position {}: {}: no view", Value(records.front().position),
                         measurement.error().message));
      }
      return std::nullopt;
    }
    // Not into a view: which frames have been seen depends on where a resumed run began, and a
    // view's bytes must not.
    if (const std::optional<std::string> white =
            measurer_->WhiteLevelWarning(options_.value_high)) {
      Warn(*white);
    }
    for (const FrameRecord* record : usable) {
      if (options_.mover_masks.empty()) break;
      const Status marked = MarkMovers(session_ / options_.mover_masks, *record, &*measurement);
      if (!marked && count) {
        Warn(fmt::format("frame {}: {}: its movers are not marked", Value(record->frame),
                         marked.error().message));
      }
    }
    LoadedPosition loaded;
    loaded.position = records.front().position;
    loaded.measurement = std::move(*measurement);
    for (const FrameRecord* record : usable) loaded.frames.push_back(record->frame);
    loaded.reference = ReferenceOf(usable);
    loaded.notes = std::move(notes);
    if (count) ++counts_.positions_seen;
    return loaded;
  }

  // Corrects the exposures of a position's frames where their overlap says so; what to tell.
  std::vector<std::string> RefineLabels(std::vector<ExposedFrame>& exposed,
                                        const std::vector<const FrameRecord*>& records) const {
    std::vector<std::string> notes;
    if (!options_.refine_exposure || exposed.size() < 2) return notes;
    RefineOptions refine;
    refine.limit = options_.refine_limit;
    refine.value_low = options_.value_low;
    refine.value_high = options_.value_high;
    refine.noise = options_.noise;
    const Result<std::vector<RefinedExposure>> refined = RefineExposures(
        exposed, info_.response, info_.camera.bits, measurer_->frame_mask(), refine);
    if (!refined) return notes;  // Measure tells what is wrong with them
    std::vector<std::string> names;
    for (const FrameRecord* record : records) {
      names.push_back(fmt::format("frame {}", Value(record->frame)));
    }
    notes = RefinementNotes(*refined, exposed, names, options_.refine_limit);
    for (std::size_t k = 0; k < exposed.size(); ++k) {
      ExposureTime& time = exposed[k].exposure.time;
      time = ExposureTime::Seconds(time.seconds() * (*refined)[k].scale);
    }
    return notes;
  }

  Status ProcessTemporal(std::int64_t position) {
    const auto start = std::chrono::steady_clock::now();
    std::optional<LoadedPosition> loaded = Load(pending_.at(position), true);
    if (!loaded) return {};
    Waiting waiting;
    waiting.context = ContextOf(loaded->reference);
    TemporalView& view = waiting.temporal.emplace();
    view.position = PositionId{position};
    view.frames = loaded->frames;
    view.reference = loaded->reference.frame;
    view.is_latlong = info_.camera.layout != Layout::kPerspective;
    view.warnings = loaded->notes;
    if (loaded->frames.size() == 1) {
      view.warnings.push_back("one exposure at this position: no range gained");
    }
    const ProfileScope profile("merge");
    if (view.is_latlong) {
      const int width = options_.output_width != 0
                            ? options_.output_width
                            : std::min(measurer_->projection().width() / 2 * 2, 8192);
      view.merged = MergeViews({&loaded->measurement, Pose{}, nullptr}, nullptr, {},
                               Eigen::Quaterniond::Identity(), width, MergeOptions{});
    } else {
      view.merged = ViewOfMeasurement(loaded->measurement);
    }
    waiting.done.position = view.position;
    waiting.done.merge_s = SecondsSince(start);
    waiting.done.warnings = view.warnings;
    waiting_.push_back(std::move(waiting));
    return WriteWaiting();
  }

  void Enqueue(FinishedView view, double pose_s) {
    const std::int64_t position = Value(view.pose.position);
    if (view.made) {
      Waiting waiting;
      waiting.context = references_[position];
      waiting.done.position = view.pose.position;
      waiting.done.pose_s = pose_s;
      waiting.done.stereo_s = view.stereo_s;
      waiting.done.merge_s = view.merge_s;
      waiting.done.quality_level = view.quality_level;
      view.warnings.insert(view.warnings.end(), waiting.context.notes.begin(),
                           waiting.context.notes.end());
      waiting.done.warnings = view.warnings;
      waiting.view = std::move(view);
      waiting_.push_back(std::move(waiting));
    } else {
      CompleteKeyframe(view);
    }
    references_.erase(position);
  }

  // Writes finished views in order; one that cannot be written stays first in line.
  Status WriteWaiting() {
    while (!waiting_.empty()) {
      Waiting& waiting = waiting_.front();
      const ProfileScope profile("write");
      const auto start = std::chrono::steady_clock::now();
      Status written = WriteView(views_, waiting.done.position, how_.upgrade,
                                 [&waiting](const std::filesystem::path& directory) -> Status {
                                   if (waiting.temporal) {
                                     return WriteTemporalViewFiles(directory, *waiting.temporal,
                                                                   waiting.context);
                                   }
                                   return WriteViewFiles(directory, waiting.view, waiting.context);
                                 });
      if (!written) {
        return Forward(written.error(), fmt::format("view {}", Value(waiting.done.position)));
      }
      waiting.done.write_s = SecondsSince(start);
      complete_.Insert(Value(waiting.done.position));
      if (waiting.done.quality_level > 0) {
        reduced_.Insert(Value(waiting.done.position));
      } else {
        reduced_.Erase(Value(waiting.done.position));
      }
      ++counts_.views_written;
      AppendTiming(waiting.done);
      if (callbacks_.view_done) callbacks_.view_done(waiting.done);
      waiting_.pop_front();
    }
    return {};
  }

  // Timings differ from run to run and views must not: they have a file of their own. Losing a line
  // of it costs nothing.
  void AppendTiming(const ViewDone& done) const {
    const std::string line = fmt::format(
        "{{\"position\": {}, \"seconds\": {{\"pose\": {:.4f}, \"stereo\": {:.4f}, \"merge\": "
        "{:.4f}, "
        "\"write\": {:.4f}}}}}\n",
        Value(done.position), done.pose_s, done.stereo_s, done.merge_s, done.write_s);
    if (std::FILE* file = std::fopen((output_ / "timings.jsonl").c_str(), "ae")) {
      std::fputs(line.c_str(), file);
      std::fclose(file);
    }
  }

  const std::filesystem::path session_;
  const std::filesystem::path output_;
  const std::filesystem::path views_;
  const PipelineOptions options_;
  const ProcessorCallbacks callbacks_;
  const ProcessorOptions how_;
  QualityGovernor governor_;
  const SessionInfo info_;
  JournalFollower follower_;
  bool is_temporal_ = false;
  bool started_ = false;
  bool at_end_ = false;
  std::optional<FrameMeasurer> measurer_;
  std::unique_ptr<ViewPipeline> pipeline_;
  FramesByPosition pending_;
  std::optional<std::int64_t> last_taken_;
  std::int64_t newest_ = -1;  // the highest position in the journal so far
  std::size_t frames_at_newest_ = 0;
  std::map<std::int64_t, ViewContext> references_;  // of positions inside the pipeline
  std::string made_with_;
  PositionSet complete_;  // positions that will never have a view are settled in it
  PositionSet reduced_;   // of those complete, the ones with a quality level above 0
  std::deque<Waiting> waiting_;
  std::size_t warnings_told_ = 0;
  Counts counts_;
};

}  // namespace

Result<std::unique_ptr<SessionProcessor>> SessionProcessor::Open(
    const std::filesystem::path& session, const std::filesystem::path& output,
    const PipelineOptions& options, ProcessorCallbacks callbacks, const ProcessorOptions& how) {
  OMNIHDR_TRY(options.Validate());
  OMNIHDR_TRY(how.overload.Validate());
  const std::filesystem::path info_path = session / "session.json";
  OMNIHDR_ASSIGN(const std::string text, ReadTextFile(info_path));
  OMNIHDR_ASSIGN(SessionInfo info, ParseSessionInfo(text, info_path.string()));
  auto processor =
      std::make_unique<SessionProcessorImpl>(session, output.empty() ? session : output, options,
                                             std::move(callbacks), how, std::move(info));
  OMNIHDR_TRY(processor->Prepare());
  return processor;
}

}  // namespace omnihdr
