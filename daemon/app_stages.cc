#include "daemon/app.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <thread>
#include <utility>

#include "core/base/background.h"
#include "core/session/session_reader.h"
#include "daemon/survey_volume.h"

// The daemon's threads beside the main loop: camera, recorder, pipeline.
namespace omnihdr {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr auto kViewsFirstRetry = seconds(1);
constexpr auto kViewsLongestRetry = seconds(30);

// What is different between the camera of the session and the one found; empty when frames of both
// can be in one journal.
std::string Difference(const CameraDescription& session, const CameraDescription& camera) {
  if (session.layout != camera.layout || session.width != camera.width ||
      session.height != camera.height || session.bits != camera.bits ||
      session.projection != camera.projection || session.bayer != camera.bayer ||
      std::abs(session.z_min - camera.z_min) > 1e-6 ||
      std::abs(session.z_max - camera.z_max) > 1e-6) {
    return fmt::format(
        "the session has frames of {}x{} ({}, {} bits), the camera delivers {}x{} "
        "({}, {} bits) or another projection",
        session.width, session.height, ToString(session.layout), session.bits, camera.width,
        camera.height, ToString(camera.layout), camera.bits);
  }
  if (session.model != camera.model || session.serial != camera.serial) {
    return fmt::format("the session was begun with camera {} {}, found {} {}", session.model,
                       session.serial, camera.model, camera.serial);
  }
  return {};
}

// What the journal's times are by, beside what the camera has for session.json.
std::string WithClock(const std::string& extra_json, const UtcQuality& utc) {
  nlohmann::json extra = nlohmann::json::parse(extra_json, nullptr, false);
  if (!extra.is_object()) extra = nlohmann::json::object();
  extra["clock"] = {{"stamps", "CLOCK_MONOTONIC"},
                    {"trigger_ns", "the event, as its source stamped it"},
                    {"timestamp_ns", "middle of the exposure"},
                    {"utc_ns", "CLOCK_REALTIME of trigger_ns"},
                    {"time_scale", "UTC"}};
  if (utc.tai_offset_s) extra["clock"]["tai_offset_s"] = *utc.tai_offset_s;
  return extra.dump();
}

// The rig file of a camera whose frames are those of a head's sensors; empty for all others.
std::string HeadOf(const CameraInfo& info) {
  if (info.description.layout != Layout::kRig) return {};
  for (const SessionFile& file : info.files) {
    if (file.name == "rig.toml") return file.content;
  }
  return {};
}

void Rest(std::stop_token stop, Nanoseconds time) {
  std::mutex mutex;
  std::condition_variable_any never;
  std::unique_lock lock(mutex);
  never.wait_for(lock, stop, time, [] { return false; });
}

}  // namespace

// ---- camera thread

Status App::RunCamera(std::stop_token stop, Stage& self) {
  const LogContext stage({.stage = "camera"});
  while (!stop.stop_requested()) {
    MeterIfDue(stop, self);
    const Nanoseconds rest = runner_->Turn();
    self.Progress();
    if (rest > Nanoseconds(0)) Rest(stop, std::min<Nanoseconds>(rest, seconds(1)));
  }
  runner_->Close();
  return {};
}

Status App::OnCameraOpened(const CameraInfo& info) {
  const auto fault = [this](Error error) {
    state_.Update([&](CaptureConditions& c) { c.fault = error.message; });
    return tl::unexpected<Error>(std::move(error));
  };
  ExposureLimits limits;
  limits.shortest = info.shortest;
  limits.longest = info.longest;
  limits.quantum_s = info.exposure_quantum_s;
  // A reload of the bracket waits until the camera's limits are known and its plan is in force.
  std::lock_guard plan_lock(plan_mutex_);
  BracketConfig bracket;
  {
    std::lock_guard lock(mutex_);
    bracket = config_.bracket;
  }
  limits.pixel_rad = PixelAngle(info.description, info.files);
  Result<BracketPlan> plan = BracketPlan::Make(WantedBracket(bracket), limits);
  if (!plan) return fault(plan.error());
  for (const std::string& change : plan->changes()) spdlog::warn("bracket: {}", change);
  if (bracket.max_blur_px > 0.0 && limits.pixel_rad <= 0.0) {
    spdlog::warn("bracket: max_blur_px: how large a pixel is cannot be told: not checked");
  }
  exposure_limits_ = limits;
  metered_camera_ = info;

  SessionInfo session_info;
  session_info.camera = info.description;
  session_info.response = info.response;
  session_info.extra_json = WithClock(info.extra_json, utc_.Quality());
  session_info.files = info.files;
  // Nobody asks a recorded frame for an exposure.
  if (info.proof != ExposureProof::kFile) session_info.bracket = DescribePlan(*plan);
  {
    std::lock_guard lock(mutex_);
    camera_session_ = session_info;
  }

  std::shared_ptr<Session> session = this->session();
  if (session) {
    if (const std::string difference = Difference(session->info.camera, info.description);
        !difference.empty()) {
      return fault(Error{ErrorKind::kUnavailable,
                         fmt::format("session {}: {}", session->directory.string(), difference)});
    }
  } else {
    session_info.created = IsoUtc(clock_.NowUtc());
    // The volume may have gone since the start.
    if (const Status volume = CheckSurveyVolume(choice_.directory, config_.MayLieOnRoot());
        !volume) {
      return fault(volume.error());
    }
    Result<SessionWriter> writer = SessionWriter::Create(choice_.directory, session_info);
    if (!writer) return fault(writer.error());
    session = std::make_shared<Session>(std::move(*writer));
    session->directory = choice_.directory;
    session->info = std::move(session_info);
    session->extent.since = clock_.Now();
    SetLogSession(choice_.directory.string());
    spdlog::info("session {}: begun", choice_.directory.string());
    hub_.Publish(
        {{"event", "session"}, {"what", "begun"}, {"directory", session->directory.string()}});
    {
      std::lock_guard lock(mutex_);
      session_ = session;
    }
    PostOrLog([this] { StartSessionStages(); });
  }
  {
    std::lock_guard lock(mutex_);
    camera_model_ = info.description.model;
    camera_serial_ = info.description.serial;
    camera_abilities_ = {info.shortest.seconds(), info.longest.seconds(),
                         info.exposure_latency_frames,
                         static_cast<double>(info.min_trigger_interval.count()) * 1e-9, info.proof};
    bracket_changes_ = plan->changes();
  }
  orientation_->Begin(config_.camera.check_orientation ? HeadOf(info) : "");
  if (orientation_->state().what != ToString(OrientationVerdict::kContradicted)) {
    state_.Update([](CaptureConditions& c) { c.orientation.clear(); });
  }
  ExposureTolerance tolerance;
  tolerance.relative = config_.camera.exposure_tolerance;
  tolerance.quantum_s = info.exposure_quantum_s;
  controller_->SetCamera(std::move(*plan), info.description, tolerance);
  TellPlan();
  return {};
}

void App::OnCameraAway(const Error& error) {
  metering_ = false;
  controller_->OnCameraLost(error.message);
  const bool was_ready = state_.conditions().camera_ready;
  const std::string before = state_.conditions().waiting;
  state_.Update([&](CaptureConditions& c) {
    c.camera_ready = false;
    c.waiting = error.message;
  });
  const LogContext about({.error = "camera-away"});
  if (was_ready || before != error.message) spdlog::warn("camera: {}", error.message);
}

// ---- recorder thread

Status App::RunRecorder(std::stop_token stop, Stage& self) {
  const LogContext stage({.stage = "recorder"});
  SeriesStore store(*this);
  std::optional<HostTime> give_up;
  while (true) {
    const Recorder::Turn turn = recorder_.Step(store, milliseconds(100));
    self.Progress();
    WatchStorage();
    const bool last = stop.stop_requested() && turn == Recorder::Turn::kIdle;
    Status synced = SyncIfDue(last);
    if (stop.stop_requested()) {
      if (last) return synced;
      if (!give_up) give_up = clock_.Now() + seconds(10);
      if (turn == Recorder::Turn::kFailed && clock_.Now() > *give_up) {
        return Fail(ErrorKind::kIo, "{} triggers could not be journaled", recorder_.waiting());
      }
    }
    if (turn == Recorder::Turn::kFailed) std::this_thread::sleep_for(milliseconds(200));
  }
}

void App::OnJournaled(const FrameRecord& record) {
  const bool usable = record.status == FrameStatus::kOk;
  const LogContext about({.trigger = std::uint64_t{Value(record.frame)},
                          .position = Value(record.position),
                          .error = usable ? "" : std::string(ToString(record.status))});
  latency_.Durable(TriggerId{Value(record.frame)}, record.position, usable, clock_.Now());
  {
    std::lock_guard lock(mutex_);
    lines_.Add(record.status);
    ++journaled_;
    if (session_) durable_bytes_ = session_->store.writer().durable_bytes();
    views_caught_up_ = false;
    if (record.status == FrameStatus::kOk && Value(record.position) != last_position_with_pixels_) {
      last_position_with_pixels_ = Value(record.position);
      ++positions_with_pixels_;
    }
  }
  journal_grew_.notify_all();
  ShowSoon();
  nlohmann::json event = {{"event", "frame"},
                          {"frame", Value(record.frame)},
                          {"position", Value(record.position)},
                          {"status", ToString(record.status)},
                          {"exposure_s", record.exposure.time.seconds()}};
  if (!record.detail.empty()) event["detail"] = record.detail;
  hub_.Publish(event);
  if (usable) {
    if (const std::shared_ptr<Session> at = session(); at && !record.file.empty()) {
      orientation_->Offer(at->directory / record.file);
    }
    spdlog::debug("trigger {}: {}", Value(record.frame), record.file);
    if (!record.detail.empty()) {
      if (const auto count = drop_log_.Pass(clock_.Now())) {
        spdlog::warn("trigger {}: {} ({} such lines)", Value(record.frame), record.detail, *count);
      }
    }
  } else {
    if (const auto count = drop_log_.Pass(clock_.Now())) {
      spdlog::warn("trigger {}: {}: {}{}", Value(record.frame), ToString(record.status),
                   record.detail, *count > 1 ? fmt::format(" ({} lost)", *count) : "");
    }
  }
  const CaptureController::RecentLosses losses = controller_->recent_losses();
  state_.Update([&](CaptureConditions& c) {
    c.frames_lost = losses.lost == 0
                        ? ""
                        : fmt::format("{} of the last {} triggers gave no frame (last: {})",
                                      losses.lost, losses.of, losses.last_reason);
  });
}

void App::OnOrientation(const OrientationState& found) {
  const bool contradicted = found.what == ToString(OrientationVerdict::kContradicted);
  if (contradicted) {
    const LogContext about({.error = "orientation"});
    spdlog::error("orientation: {}", found.text);
  } else {
    spdlog::info("orientation: {}: {}", found.what, found.text);
  }
  hub_.Publish({{"event", "orientation"}, {"what", found.what}, {"text", found.text}});
  state_.Update([&](CaptureConditions& c) {
    c.orientation = contradicted ? fmt::format("orientation: {}", found.text) : "";
  });
}

// ---- pipeline thread

void App::SetViewsError(const std::string& error) {
  {
    std::lock_guard lock(mutex_);
    if (views_error_ == error) return;
    views_error_ = error;
  }
  if (error.empty()) {
    spdlog::info("views: going on");
  } else {
    const LogContext about({.error = "views-stalled"});
    spdlog::error("views: {}", error);
  }
  state_.Update([&](CaptureConditions& c) {
    c.views_stalled = error.empty() ? "" : fmt::format("views: {}", error);
  });
}

void App::WaitForJournal(std::stop_token stop, Nanoseconds timeout, std::uint64_t known) {
  std::unique_lock lock(mutex_);
  journal_grew_.wait_for(lock, stop, timeout, [&] { return journaled_ != known || finish_views_; });
}

void App::OnViewDone(const ViewDone& view) {
  const LogContext about({.position = Value(view.position)});
  if (!view.already_complete) {
    latency_.ViewDone(view.position, clock_.Now());
    latency_.Took(CaptureLatency::kViewPose, view.pose_s);
    latency_.Took(CaptureLatency::kViewStereo, view.stereo_s);
    latency_.Took(CaptureLatency::kViewMerge, view.merge_s);
    latency_.Took(CaptureLatency::kViewWrite, view.write_s);
    spdlog::info(
        "view {}: done in {:.2f} s (pose {:.2f}, stereo {:.2f}, merge {:.2f}, write {:.2f})",
        Value(view.position), view.pose_s + view.stereo_s + view.merge_s + view.write_s,
        view.pose_s, view.stereo_s, view.merge_s, view.write_s);
    for (const std::string& warning : view.warnings) {
      spdlog::warn("view {}: {}", Value(view.position), warning);
    }
  }
  {
    std::lock_guard lock(mutex_);
    last_view_ = Value(view.position);
  }
  hub_.Publish({{"event", "view"},
                {"position", Value(view.position)},
                {"already_complete", view.already_complete},
                {"quality_level", view.quality_level},
                {"seconds",
                 {{"pose", view.pose_s},
                  {"stereo", view.stereo_s},
                  {"merge", view.merge_s},
                  {"write", view.write_s}}},
                {"warnings", view.warnings}});
}

void App::OnQualityChanged(int level, int backlog) {
  {
    std::lock_guard lock(mutex_);
    if (level > views_.quality_level) {
      spdlog::warn("views: {} positions wait: quality level {} of {} from now on ({})", backlog,
                   level, kMaxQualityLevel, DescribeQuality(level));
    } else {
      spdlog::info("views: {} positions wait: quality level {} of {} from now on ({})", backlog,
                   level, kMaxQualityLevel, DescribeQuality(level));
    }
    views_.quality_level = level;
  }
  hub_.Publish({{"event", "quality"},
                {"level", level},
                {"meaning", DescribeQuality(level)},
                {"waiting", backlog}});
}

Status App::FinishViews(SessionProcessor* processor, const std::filesystem::path& session) {
  if (processor != nullptr) OMNIHDR_TRY(processor->Finish());
  if (SessionEnded(session)) return {};
  std::optional<std::uint64_t> frames;
  {
    std::lock_guard lock(mutex_);
    if (session == session_->directory) frames = journaled_ - session_->first_frame;
  }
  if (!frames) {
    OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(session));
    frames = contents.journal.frames.size() + contents.journal.rejected.size();
  }
  return MarkSessionEnded(session, *frames, clock_.NowUtc());
}

void App::CloseViews(const SessionProcessor* processor) {
  std::lock_guard lock(mutex_);
  if (processor != nullptr) {
    const SessionProcessor::Counts counts = processor->counts();
    views_before_.positions_seen += counts.positions_seen;
    views_before_.views_complete += counts.views_complete;
    views_before_.views_reduced += counts.views_reduced;
  }
  const int quality_level = views_.quality_level;
  views_ = {};
  views_.quality_level = quality_level;
  views_queue_.pop_front();
}

Status App::RunPipeline(std::stop_token stop, Stage& self) {
  const BackgroundThread background;  // capture goes first
  const LogContext stage({.stage = "pipeline"});
  std::unique_ptr<SessionProcessor> processor;
  Nanoseconds retry = kViewsFirstRetry;
  bool ended = false;
  const auto failed = [&](const Error& error) {
    SetViewsError(error.message);
    Rest(stop, retry);
    retry = std::min<Nanoseconds>(retry * 2, kViewsLongestRetry);
  };
  while (!stop.stop_requested()) {
    self.Progress();
    // Read before the step: what is journaled before the session was closed will then have been
    // seen.
    std::filesystem::path session;
    bool closed = false;  // another session is written, this one's journal does not grow
    {
      std::lock_guard lock(mutex_);
      session = views_queue_.front();
      closed = views_queue_.size() > 1;
    }
    if (!processor && parts_.open_pipeline) {
      ProcessorCallbacks callbacks;
      callbacks.view_done = [this](const ViewDone& view) { OnViewDone(view); };
      callbacks.warning = [](const std::string& message) { spdlog::warn("{}", message); };
      callbacks.durable_bytes = [this, session] {
        std::lock_guard lock(mutex_);
        // A session that another one goes on from was synced as a whole.
        const bool written = session_ && session_->directory == session;
        return written ? durable_bytes_ : std::numeric_limits<std::uint64_t>::max();
      };
      callbacks.quality_changed = [this](int level, int backlog) {
        OnQualityChanged(level, backlog);
      };
      auto opened = parts_.open_pipeline(session, std::move(callbacks));
      if (!opened) {
        failed(opened.error());
        continue;
      }
      processor = std::move(*opened);
    }
    // Read before the step: what is journaled before the flag is set will then have been seen.
    bool finish = false;
    std::uint64_t journaled = 0;
    {
      std::lock_guard lock(mutex_);
      finish = finish_views_;
      journaled = journaled_;
    }
    SessionProcessor::Progress progress = SessionProcessor::Progress::kNothingNew;
    if (processor) {
      const Result<SessionProcessor::Progress> step = processor->Step();
      if (!step) {
        failed(step.error());
        continue;
      }
      progress = *step;
    }
    const bool idle = progress == SessionProcessor::Progress::kNothingNew;
    if (idle && (closed || finish) && !ended) {
      if (const Status finished = FinishViews(processor.get(), session); !finished) {
        failed(finished.error());
        continue;
      }
      if (closed) {
        spdlog::info("session {}: all views are finished", session.string());
        CloseViews(processor.get());
        processor.reset();
        continue;
      }
      ended = true;
    }
    SetViewsError("");
    retry = kViewsFirstRetry;
    {
      std::lock_guard lock(mutex_);
      if (processor) views_ = processor->counts();
      views_caught_up_ = idle && journaled == journaled_;
    }
    if (ended && idle && finish) {
      PostOrLog([this] { OnSessionEnded(); });
      // Nothing comes any more: only the stop is waited for.
      while (!stop.stop_requested()) {
        self.Progress();
        Rest(stop, seconds(1));
      }
    }
    if (idle && !finish) WaitForJournal(stop, seconds(1), journaled);
  }
  return {};
}

}  // namespace omnihdr
