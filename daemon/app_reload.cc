#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <utility>

#include "daemon/app.h"

// Reading the configuration again while the daemon runs.
namespace omnihdr {
namespace {

constexpr int kRefusedConfig = 422;

nlohmann::json ToJson(const ConfigChange& change) {
  return {{"key", change.key},
          {"old", change.old_value},
          {"new", change.new_value},
          {"applies", ToString(change.applies)}};
}

}  // namespace

void App::OnHangup() {
  if (phase_ == Phase::kStopping) return;
  if (reload_stage_ && !reload_stage_->finished()) {
    // What the running one has read may be older than this signal.
    reload_again_ = true;
    return;
  }
  // Files are read on a thread of their own: the loop never waits for a disk.
  reload_stage_ = std::make_unique<Stage>("reload", [this](std::stop_token stop, Stage&) -> Status {
    do {
      reload_again_ = false;
      [[maybe_unused]] const ApiReply reply = Reload();  // logged, and kept for the status
    } while (reload_again_ && !stop.stop_requested());
    return {};
  });
}

ApiReply App::Reload() {
  if (stopping_) return ApiReply::Refused(409, "the daemon is stopping");
  const std::unique_lock one(reload_mutex_, std::try_to_lock);
  if (!one) return ApiReply::Refused(503, "the configuration is being read already");
  notifier_.Reloading(clock_.Now());
  Result<DaemonConfig> next = read_config_
                                  ? read_config_()
                                  : Fail(ErrorKind::kUnavailable, "there is no file to read again");
  ApiReply reply = OnLoop([this, next = std::move(next)] { return ApplyConfig(next); });
  if (!stopping_) notifier_.Ready();
  return reply;
}

ApiReply App::RefuseConfig(const Error& error) {
  ++reloads_refused_;
  // Several problems are a line each.
  reload_error_ = error.message;
  for (std::size_t at = 0; (at = reload_error_.find('\n', at)) != std::string::npos;) {
    reload_error_.replace(at, 1, "; ");
  }
  spdlog::error("reload: refused, the configuration in force stays: {}", reload_error_);
  hub_.Publish({{"event", "reload"}, {"applied", false}, {"error", reload_error_}});
  return ApiReply::Refused(error.kind == ErrorKind::kTemporary ? 503 : kRefusedConfig,
                           error.message);
}

// Main loop.
ApiReply App::ApplyConfig(const Result<DaemonConfig>& next) {
  if (!next) return RefuseConfig(next.error());
  const std::vector<ConfigChange> changes = CompareConfig(config_, *next);
  DaemonConfig merged = config_;
  bool bracket = false;
  bool retune = false;
  for (const ConfigChange& change : changes) {
    if (change.applies != Applies::kLive) continue;
    if (const Status adopted = AdoptConfigKey(merged, *next, change.key); !adopted) {
      return RefuseConfig(adopted.error());
    }
    bracket = bracket || change.key.starts_with("bracket.");
    retune = retune || change.key == "trigger.interval_s" || change.key == "trigger.distance_m";
  }
  if (bracket) {
    if (const Status planned = ChangeBracket(merged.bracket); !planned) {
      return RefuseConfig(planned.error());
    }
  }
  if (retune && parts_.retune) {
    if (const Status tuned = parts_.retune(merged.trigger); !tuned) {
      // The one step that an operating system can refuse: the bracket goes back to what it was.
      if (bracket) [[maybe_unused]]
        const Status back = ChangeBracket(config_.bracket);
      return RefuseConfig(tuned.error());
    }
  }
  {
    std::lock_guard lock(mutex_);
    // Member by member: other threads read what never changes without a lock.
    config_.bracket = merged.bracket;
    config_.trigger.interval_s = merged.trigger.interval_s;
    config_.trigger.distance_m = merged.trigger.distance_m;
    config_.trigger.limit = merged.trigger.limit;
    config_.session.rotation = merged.session.rotation;
    config_.recorder.durability = merged.recorder.durability;
    config_.recorder.sync_interval_s = merged.recorder.sync_interval_s;
    config_.storage.limits = merged.storage.limits;
    config_.storage.retention = merged.storage.retention;
    config_.log.level = merged.log.level;
  }
  SetLogLevel(config_.log.level);
  ++reloads_;
  reload_error_.clear();
  restart_needed_.clear();
  nlohmann::json told = nlohmann::json::array();
  for (const ConfigChange& change : changes) {
    told.push_back(ToJson(change));
    if (change.applies == Applies::kRestart) restart_needed_.push_back(change.key);
    spdlog::info("reload: {}: {} -> {}, {}", change.key, change.old_value, change.new_value,
                 ToString(change.applies));
  }
  if (changes.empty()) spdlog::info("reload: nothing has changed");
  if (!restart_needed_.empty()) {
    spdlog::warn("reload: the daemon must be started again for {}",
                 fmt::join(restart_needed_, ", "));
  }
  hub_.Publish({{"event", "reload"}, {"applied", true}, {"changes", told}});
  if (retune && source_running_) OnTriggersReady();
  CheckSeriesEnd();
  return {200, {{"changes", told}, {"restart_needed", restart_needed_}}};
}

Status App::ChangeBracket(const BracketConfig& bracket) {
  const std::unique_lock lock(plan_mutex_, std::try_to_lock);
  if (!lock) return Fail(ErrorKind::kTemporary, "the camera is being opened: try again");
  if (config_.trigger.burst && bracket.order == BracketOrder::kTriangle) {
    return Fail(ErrorKind::kConfig,
                "bracket.order: \"triangle\", expected \"sawtooth\" or \"list\" "
                "as long as trigger.burst is in force");
  }
  OMNIHDR_ASSIGN(
      BracketPlan plan,
      BracketPlan::Make(MakeBracketOptions(bracket, config_.trigger.burst), exposure_limits_));
  {
    std::lock_guard changes_lock(mutex_);
    bracket_changes_ = plan.changes();
    metered_.reset();  // what is asked for now is in force
  }
  OMNIHDR_TRY(controller_->SetPlan(std::move(plan)));
  TellPlan();
  // The next pulse of its wire finds what the camera has been told before.
  if (config_.trigger.wired) PrepareNext();
  return {};
}

}  // namespace omnihdr
