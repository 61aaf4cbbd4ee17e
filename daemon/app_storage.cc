#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "daemon/app.h"
#include "daemon/retention.h"
#include "daemon/session_rotation.h"
#include "daemon/survey_volume.h"

// What the daemon has to do with the volume that it writes to: free space, durability, the series
// of session directories, retention.
namespace omnihdr {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr auto kStorageInterval = seconds(1);
constexpr auto kRotationRetry = seconds(10);
constexpr auto kRetentionInterval = seconds(60);
// The recorder looks whether a sync is due at least so often.
constexpr auto kRecorderWait = milliseconds(100);

}  // namespace

// ---- recorder thread

Status App::SeriesStore::Append(const FrameRecord& record, std::span<const std::byte> file_bytes) {
  app_.RotateIfDue(record);
  const std::shared_ptr<Session> session = app_.session();
  const std::uint64_t before = lines();
  const std::int64_t position_before = session->store.writer().last_position();
  session->store.SetDurability(app_.durability().first);
  Status appended = session->store.Append(record, file_bytes);
  if (lines() > before) {
    if (appended) session->extent.bytes += file_bytes.size();
    if (Value(record.position) != position_before) ++session->extent.positions;
  }
  if (app_.unsynced_.exchange(session->store.unsynced()) == 0) {
    app_.unsynced_since_ = app_.clock_.Now();
  }
  return appended;
}

std::uint64_t App::SeriesStore::lines() const {
  const std::shared_ptr<Session> session = app_.session();
  return std::max(session->first_frame, session->store.lines());
}

std::pair<Durability, Nanoseconds> App::durability() const {
  std::lock_guard lock(mutex_);
  return {config_.recorder.durability,
          Nanoseconds(std::llround(config_.recorder.sync_interval_s * 1e9))};
}

Status App::SyncIfDue(bool at_once) {
  if (unsynced_ == 0) return {};
  const auto [mode, interval] = this->durability();
  const bool due = at_once || mode == Durability::kFrame ||
                   clock_.Now() - unsynced_since_ >= interval - Nanoseconds(kRecorderWait);
  if (!due) return {};
  Status synced = session()->store.Sync();
  unsynced_ = session()->store.unsynced();
  if (!synced) {
    ++storage_errors_;
    if (const auto count = storage_log_.Pass(clock_.Now())) {
      spdlog::error("storage: sync: {} ({} times)", synced.error().message, *count);
    }
    // Not before the interval is over once more.
    unsynced_since_ = clock_.Now();
  }
  SetStorageProblem(StorageProblem::kSync, synced ? "" : synced.error().message);
  return synced;
}

void App::SetStorageProblem(StorageProblem which, const std::string& problem) {
  storage_problems_[static_cast<std::size_t>(which)] = problem;
  std::string all;
  for (const std::string& one : storage_problems_) {
    if (one.empty()) continue;
    all += (all.empty() ? "" : "; ") + one;
  }
  state_.Update([&](CaptureConditions& c) { c.storage = all; });
}

void App::WatchStorage() {
  const HostTime now = clock_.Now();
  if (now - storage_watched_ < kStorageInterval) return;
  storage_watched_ = now;
  ReadStorage(session()->directory);
}

void App::ReadStorage(const std::filesystem::path& directory) {
  // The call may take as long as a disk does: no lock is held meanwhile.
  const Result<VolumeSpace> space = ReadVolume(directory);
  StorageReport before;
  StorageReport report;
  {
    std::lock_guard lock(mutex_);
    if (space) {
      storage_guard_.Add(clock_.Now(), space->free_bytes, space->total_bytes);
    } else {
      storage_guard_.Unreadable(space.error().message);
    }
    before = std::exchange(storage_report_, storage_guard_.Judge(config_.storage.limits));
    report = storage_report_;
  }
  const auto tell = [](const std::string& old_text, const std::string& text, const char* end) {
    if (old_text.empty() == text.empty()) return;
    if (text.empty()) {
      spdlog::info("storage: {}", end);
    } else {
      const LogContext about({.error = "storage"});
      spdlog::error("storage: {}", text);
    }
  };
  tell(before.stop, report.stop, "pictures are stored again");
  tell(before.error, report.error, "can be read again");
  if (before.warning.empty() && !report.warning.empty()) {
    spdlog::warn("storage: {}", report.warning);
  }
  SetStorageProblem(StorageProblem::kLimit, report.stop);
  state_.Update([&](CaptureConditions& c) {
    c.storage_low = !report.error.empty()     ? fmt::format("storage: {}", report.error)
                    : !report.warning.empty() ? fmt::format("storage: {}", report.warning)
                                              : "";
  });
}

void App::RotateIfDue(const FrameRecord& record) {
  const HostTime now = clock_.Now();
  const std::shared_ptr<Session> current = session();
  const SessionWriter& writer = current->store.writer();
  // A session has at least one position, and a position lies in one session.
  if (ending_ || writer.next_frame() <= current->first_frame ||
      Value(record.position) == writer.last_position() || now < rotation_retry_) {
    return;
  }
  RotationLimits limits;
  {
    std::lock_guard lock(mutex_);
    limits = config_.session.rotation;
  }
  const std::optional<std::string> why = WhyRotate(limits, current->extent, now);
  if (!why) return;
  const Status begun = BeginNextSession(*current, record.frame, *why);
  if (begun) return;
  rotation_retry_ = now + Nanoseconds(kRotationRetry);
  ++storage_errors_;
  spdlog::error("session: {}, but the next one cannot be begun, this one goes on: {}", *why,
                begun.error().message);
}

Status App::BeginNextSession(Session& current, FrameId first, const std::string& why) {
  SessionInfo info;
  {
    std::lock_guard lock(mutex_);
    // Only a camera that has been open in this run tells what lies beside session.json.
    if (!camera_session_) return {};
    info = *camera_session_;
  }
  OMNIHDR_TRY(CheckSurveyVolume(current.directory, config_.MayLieOnRoot()));
  OMNIHDR_TRY(current.store.Sync());
  OMNIHDR_ASSIGN(const std::filesystem::path directory,
                 NextSessionDirectory(current.directory, clock_.NowUtc()));
  info.created = IsoUtc(clock_.NowUtc());
  info.extra_json = WithContinuation(
      info.extra_json, {current.directory.filename().string(), std::uint64_t{Value(first)}});
  if (info.bracket) info.bracket = DescribePlan(controller_->plan());
  OMNIHDR_ASSIGN(SessionWriter writer, SessionWriter::Create(directory, info));
  auto next = std::make_shared<Session>(std::move(writer));
  next->directory = directory;
  next->info = std::move(info);
  next->first_frame = Value(first);
  next->extent.since = clock_.Now();
  spdlog::info("session {}: ended at frame {} ({}); {} goes on", current.directory.string(),
               Value(first), why, directory.string());
  hub_.Publish({{"event", "session"},
                {"what", "continued"},
                {"directory", directory.string()},
                {"from", current.directory.string()},
                {"reason", why}});
  {
    std::lock_guard lock(mutex_);
    session_ = std::move(next);
    durable_bytes_ = 0;
    views_queue_.push_back(directory);
    ++rotations_;
  }
  SetLogSession(directory.string());
  journal_grew_.notify_all();
  return {};
}

// ---- retention thread

Status App::RunRetention(std::stop_token stop, Stage& self) {
  const LogContext stage({.stage = "retention"});
  while (!stop.stop_requested()) {
    self.Progress();
    ApplyRetention(stop);
    std::mutex mutex;
    std::condition_variable_any never;
    std::unique_lock lock(mutex);
    never.wait_for(lock, stop, kRetentionInterval, [] { return false; });
  }
  return {};
}

void App::ApplyRetention(const std::stop_token& stop) {
  RetentionOptions options;
  std::vector<std::filesystem::path> keep;
  {
    std::lock_guard lock(mutex_);
    options = config_.storage.retention;
    keep.assign(views_queue_.begin(), views_queue_.end());
    keep.push_back(session_ ? session_->directory : choice_.directory);
  }
  if (!options.on()) return;
  const auto plan = PlanRetention(config_.session.directory, options, clock_.NowUtc(), keep);
  if (!plan) {
    if (const auto count = retention_log_.Pass(clock_.Now())) {
      spdlog::error("retention: {} ({} times)", plan.error().message, *count);
    }
    return;
  }
  for (const Deletion& deletion : *plan) {
    if (stop.stop_requested()) return;
    if (const Status deleted = Delete(deletion); !deleted) {
      spdlog::error("retention: {}", deleted.error().message);
      continue;
    }
    ++deleted_;
    spdlog::warn("retention: {} deleted: {}", deletion.path.string(), deletion.why);
    hub_.Publish(
        {{"event", "deleted"}, {"path", deletion.path.string()}, {"reason", deletion.why}});
  }
}

}  // namespace omnihdr
