#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cmath>
#include <utility>

#include "core/base/file.h"
#include "core/capture/scene_look.h"
#include "core/session/session_reader.h"
#include "daemon/app.h"

// The first look at a scene, and the bracket that it proposes.
namespace omnihdr {

BracketOptions App::WantedBracket(const BracketConfig& bracket) const {
  BracketOptions options = MakeBracketOptions(bracket, config_.trigger.burst);
  std::lock_guard lock(mutex_);
  if (metered_) options.exposures = *metered_;
  return options;
}

BracketDescription App::DescribePlan(const BracketPlan& plan) const {
  BracketDescription description = plan.Description();
  std::lock_guard lock(mutex_);
  description.metered = metered_.has_value();
  return description;
}

// ---- main loop

void App::WantMeter() {
  if (config_.bracket.meter == Metering::kOff || commanded_ > 0) return;
  if (const auto open = session(); open && open->resumed) return;
  meter_due_ = true;
  // From here on no trigger may come between; when the camera comes, it is the same.
  if (state_.conditions().camera_ready) metering_ = true;
}

// ---- camera thread

void App::MeterIfDue(const std::stop_token& stop, Stage& self) {
  if (!meter_due_ || !runner_->running() || !metered_camera_) return;
  metering_ = true;
  // A picture that was commanded before is waited for; it has a deadline of its own.
  if (controller_->open_triggers() > 0) return;
  meter_due_ = false;
  Result<nlohmann::json> report = Meter(stop, self);
  if (!report) {
    spdlog::warn("metering: {}: the bracket stays as it is", report.error().message);
    report = nlohmann::json{{"error", report.error().message}, {"adopted", false}};
  }
  EndMeter(std::move(*report));
}

void App::EndMeter(nlohmann::json report) {
  hub_.Publish({{"event", "metering"}, {"report", report}});
  {
    std::lock_guard lock(mutex_);
    metering_report_ = std::move(report);
  }
  metering_ = false;
  PrepareNext();
  PostOrLog([this] { TakeStanding(); });
}

Result<nlohmann::json> App::Meter(const std::stop_token& stop, Stage& self) {
  SceneLookOptions options;
  options.frame_timeout = Nanoseconds(std::llround(config_.camera.frame_timeout_s * 1e9));
  BracketOptions wanted;
  bool adopt = false;
  {
    std::lock_guard lock(mutex_);
    options.longest_s = config_.bracket.meter_longest_s;
    adopt = config_.bracket.meter == Metering::kAdopt;
    wanted = MakeBracketOptions(config_.bracket, config_.trigger.burst);
  }
  options.gain = wanted.gain;
  if (parts_.positions) {
    options.odometer_m = parts_.positions->OdometerMetres(clock_.Now()).value_or(0.0);
  }
  OMNIHDR_ASSIGN(const SceneLook look, LookAtScene(*parts_.camera, *metered_camera_, options, [&] {
                   self.Progress();
                   return !stop.stop_requested();
                 }));
  const std::optional<BracketProposal> proposal = look.scene.Propose(options.proposal);
  if (!proposal) return Fail(ErrorKind::kData, "no picture");
  std::lock_guard plan_lock(plan_mutex_);
  OMNIHDR_ASSIGN(const AllowedBracket allowed, AllowBracket(*proposal, wanted, exposure_limits_));
  std::string list;
  nlohmann::json report = {{"pictures", look.pictures},
                           {"range_stops", proposal->RangeStops()},
                           {"bright_reached", proposal->bright_reached},
                           {"dark_reached", proposal->dark_reached},
                           {"notes", allowed.notes},
                           {"adopted", false}};
  for (const ExposureTime step : allowed.exposures) {
    report["exposures_s"].push_back(step.seconds());
    fmt::format_to(std::back_inserter(list), "{}{:.6g}", list.empty() ? "" : ", ", step.seconds());
  }
  bool adopted = false;
  if (adopt) {
    OMNIHDR_ASSIGN(adopted, AdoptBracket(allowed.exposures, report));
  }
  spdlog::info("metering: {} pictures, {:.1f} stops: [{}] {}", look.pictures,
               proposal->RangeStops(), list,
               adopted ? "is the bracket of this session" : "would cover them");
  for (const std::string& note : allowed.notes) spdlog::warn("metering: {}", note);
  return report;
}

// With plan_mutex_.
Result<bool> App::AdoptBracket(const std::vector<ExposureTime>& exposures, nlohmann::json& report) {
  if (commanded_ > 0) {
    report["notes"].push_back("not adopted: the session has pictures of another bracket");
    return false;
  }
  const std::shared_ptr<Session> open = session();
  if (!open || open->resumed) return Fail(ErrorKind::kUnavailable, "there is no new session");
  BracketOptions options;
  {
    std::lock_guard lock(mutex_);
    options = MakeBracketOptions(config_.bracket, config_.trigger.burst);
  }
  options.exposures = exposures;
  OMNIHDR_ASSIGN(BracketPlan plan, BracketPlan::Make(options, exposure_limits_));
  report["adopted"] = true;
  SessionInfo info = open->info;
  info.bracket = plan.Description();
  info.bracket->metered = true;
  nlohmann::json extra = nlohmann::json::parse(info.extra_json, nullptr, false);
  if (!extra.is_object()) extra = nlohmann::json::object();
  extra["metering"] = report;
  info.extra_json = extra.dump();
  // No line has an exposure of another bracket: session.json is as if it had been begun with this.
  OMNIHDR_TRY(WriteFileAtomic(open->directory / "session.json", FormatSessionInfo(info)));
  std::vector<std::string> changes = plan.changes();
  OMNIHDR_TRY(controller_->SetPlan(std::move(plan)));
  TellPlan();
  std::lock_guard lock(mutex_);
  open->info = info;
  if (camera_session_) {
    camera_session_->bracket = info.bracket;
    camera_session_->extra_json = info.extra_json;
  }
  metered_ = exposures;
  bracket_changes_ = std::move(changes);
  return true;
}

}  // namespace omnihdr
