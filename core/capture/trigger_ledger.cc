#include "core/capture/trigger_ledger.h"

#include <fmt/format.h>

#include <algorithm>
#include <numeric>
#include <utility>

namespace omnihdr {

std::uint64_t OutcomeCounts::total() const {
  return std::accumulate(by_status.begin(), by_status.end(), std::uint64_t{0});
}

void TriggerLedger::Open(const ExposureRequest& request, HostTime deadline, bool reserved_buffer) {
  Entry entry;
  entry.outcome.request = request;
  entry.outcome.reserved_buffer = reserved_buffer;
  entry.deadline = deadline;
  entries_.push_back(std::move(entry));
}

void TriggerLedger::OpenFailed(const ExposureRequest& request, FrameStatus status,
                               std::string detail) {
  Entry entry;
  entry.outcome.request = request;
  entry.outcome.status = status;
  entry.outcome.detail = std::move(detail);
  entry.ended = true;
  entries_.push_back(std::move(entry));
}

void TriggerLedger::Await(TriggerId trigger, HostTime deadline, bool reserved_buffer) {
  Entry* entry = Find(trigger);
  if (entry == nullptr || entry->ended) return;
  entry->deadline = deadline;
  entry->outcome.reserved_buffer = reserved_buffer;
}

TriggerLedger::Entry* TriggerLedger::Find(TriggerId trigger) {
  const auto found = std::find_if(entries_.begin(), entries_.end(), [&](const Entry& entry) {
    return entry.outcome.request.trigger == trigger;
  });
  return found == entries_.end() ? nullptr : &*found;
}

const ExposureRequest* TriggerLedger::FindOpen(TriggerId trigger) const {
  const auto found = std::find_if(entries_.begin(), entries_.end(), [&](const Entry& entry) {
    return entry.outcome.request.trigger == trigger && !entry.ended;
  });
  return found == entries_.end() ? nullptr : &found->outcome.request;
}

TriggerLedger::Match TriggerLedger::Resolve(TriggerId trigger, FrameStatus status,
                                            std::string detail, std::optional<CameraFrame> frame) {
  Entry* entry = Find(trigger);
  if (entry == nullptr || entry->ended) return Match::kUnknown;
  entry->outcome.status = status;
  entry->outcome.detail = std::move(detail);
  entry->outcome.frame = std::move(frame);
  entry->ended = true;
  return Match::kMatched;
}

void TriggerLedger::Expire(HostTime now) {
  for (Entry& entry : entries_) {
    if (entry.ended || entry.deadline > now) continue;
    const Nanoseconds waited = entry.deadline - entry.outcome.request.trigger_time;
    entry.outcome.status = FrameStatus::kCameraTimeout;
    entry.outcome.detail =
        fmt::format("no frame within {} ms of the trigger", waited.count() / 1'000'000);
    entry.ended = true;
  }
}

void TriggerLedger::FailOpen(FrameStatus status, const std::string& detail) {
  for (Entry& entry : entries_) {
    if (entry.ended) continue;
    entry.outcome.status = status;
    entry.outcome.detail = detail;
    entry.ended = true;
  }
}

std::optional<TriggerOutcome> TriggerLedger::Pop() {
  if (entries_.empty() || !entries_.front().ended) return std::nullopt;
  TriggerOutcome outcome = std::move(entries_.front().outcome);
  entries_.pop_front();
  return outcome;
}

std::size_t TriggerLedger::open() const {
  return static_cast<std::size_t>(std::count_if(entries_.begin(), entries_.end(),
                                                [](const Entry& entry) { return !entry.ended; }));
}

std::optional<HostTime> TriggerLedger::NextDeadline() const {
  std::optional<HostTime> next;
  for (const Entry& entry : entries_) {
    if (!entry.ended && (!next || entry.deadline < *next)) next = entry.deadline;
  }
  return next;
}

}  // namespace omnihdr
