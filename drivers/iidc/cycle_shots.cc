#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <utility>

#include "drivers/iidc/iidc_camera.h"
#include "drivers/iidc/registers.h"
#include "drivers/iidc/trigger_mode.h"

// The camera's own exposure cycle: loading it, learning where it stands, and pictures taken with
// it, one a trigger or a series of them.
namespace omnihdr::iidc {
namespace {

using std::chrono::milliseconds;

// All the way round, and one more.
constexpr int kPicturesOfATry = kCycleSteps + 1;
constexpr int kMostPicturesOfATry = 2 * kPicturesOfATry;
constexpr int kSeriesOfATry = 2;
// Thrown away before a step is due: to know where the cycle stands, and once round.
constexpr int kMostThrownAway = 2 * kCycleSteps;
// Of the newest eight frames, so many contradictions end the use of the cycle.
constexpr unsigned kRecentFrames = 0xFF;
constexpr int kMostSurprises = 3;
constexpr std::size_t kMostNotes = 8;
constexpr Nanoseconds kSlice = milliseconds(50);
// A counter that has gone on by more says something else than that frames were lost.
constexpr std::uint32_t kMostLost = 1000;

Nanoseconds FromSeconds(double seconds) {
  return Nanoseconds(static_cast<std::int64_t>(std::llround(seconds * 1e9)));
}

}  // namespace

void IidcCamera::Plan(const ExposurePlan& plan) {
  std::lock_guard lock(mutex_);
  plan_ = plan;
  plan_is_new_ = true;
  last_note_.clear();
}

std::optional<std::string> IidcCamera::TakeNote() {
  std::lock_guard lock(mutex_);
  if (notes_.empty()) return std::nullopt;
  std::string note = std::move(notes_.front());
  notes_.pop_front();
  return note;
}

void IidcCamera::AddNote(std::string note) {
  std::lock_guard lock(mutex_);
  if (note == last_note_) return;
  last_note_ = note;
  notes_.push_back(std::move(note));
  if (notes_.size() > kMostNotes) notes_.pop_front();
}

bool IidcCamera::FollowPlanAgain() {
  if (!cycle_suspended_) return false;
  cycle_suspended_ = false;
  AskForPlan();
  return true;
}

void IidcCamera::AskForPlan() {
  std::lock_guard lock(mutex_);
  plan_is_new_ = plan_.has_value();
}

bool IidcCamera::PlanIsNew() const {
  std::lock_guard lock(mutex_);
  return plan_is_new_ && camera_->cycle;
}

bool IidcCamera::IsPlanned(const Exposure& exposure) const {
  std::lock_guard lock(mutex_);
  return plan_ &&
         std::find(plan_->order.begin(), plan_->order.end(), exposure) != plan_->order.end();
}

Status IidcCamera::FollowPlan(const std::stop_token& stop) {
  ExposurePlan plan;
  {
    std::lock_guard lock(mutex_);
    if (!plan_is_new_ || !plan_) return {};
    plan_is_new_ = false;
    plan = *plan_;
  }
  if (!camera_->cycle) return {};
  cycle_suspended_ = false;
  std::string why;
  Result<bool> loaded = false;
  if (Status ended = EndCycle(); !ended) {
    loaded = Forward(std::move(ended).error());
  } else {
    loaded = LoadCycle(plan, stop, why);
  }
  if (loaded && *loaded) {
    AddNote(cycle_->pictures > 0
                ? fmt::format("the camera's own exposure cycle is used: a trigger takes a series "
                              "of {} pictures (trigger mode {})",
                              cycle_->pictures, kSeriesMode)
                : std::string("the camera's own exposure cycle is used"));
    return {};
  }
  if (!loaded) {
    if (loaded.error().kind == ErrorKind::kUnavailable) return Forward(std::move(loaded).error());
    why = loaded.error().message;
  }
  if (!why.empty()) {
    AddNote(fmt::format(
        "the camera's own exposure cycle is not used: {}: exposures are written one by one", why));
  }
  return EndCycle();
}

Status IidcCamera::EndCycle() {
  cycle_.reset();
  series_.reset();
  if (!cycle_touched_) return {};
  in_force_.reset();
  OMNIHDR_TRY(SwitchExposureCycleOff(*camera_->registers).Context("end the exposure cycle"));
  OMNIHDR_TRY(SetUpTrigger());
  cycle_touched_ = false;
  return {};
}

Status IidcCamera::SetUpTrigger() {
  if (options_.wired || options_.release) {
    return SetUpWiredTrigger(*camera_->registers, options_.trigger_mode, options_.trigger_input,
                             options_.trigger_active_low);
  }
  return SetUpSoftwareTrigger(*camera_->registers, options_.trigger_mode);
}

Status IidcCamera::EndCycleIfSurprised() {
  if (!cycle_ || std::popcount(cycle_->recent & kRecentFrames) < kMostSurprises) return {};
  AddNote(fmt::format(
      "the camera's own exposure cycle is not used any more: {} of the newest 8 frames had "
      "another of its steps than was due: exposures are written one by one",
      kMostSurprises));
  return EndCycle();
}

const IidcCamera::InForce* IidcCamera::StepOf(const Exposure& exposure) const {
  const auto found = std::find_if(cycle_->steps.begin(), cycle_->steps.end(),
                                  [&](const InForce& step) { return step.asked == exposure; });
  return found == cycle_->steps.end() ? nullptr : &*found;
}

const IidcCamera::InForce* IidcCamera::FoundStep(const CycleMark& mark) const {
  return mark.found ? &cycle_->steps[static_cast<std::size_t>(*mark.found)] : nullptr;
}

Result<bool> IidcCamera::LoadCycle(const ExposurePlan& plan, const std::stop_token& stop,
                                   std::string& why) {
  const std::optional<CycleLayout> layout = LayOutCycle(plan.order, why);
  if (!layout) return false;
  if (options_.wired && !layout->exact) {
    why = fmt::format(
        "a bracket of {} pictures leaves one of the cycle's {} steps over, and no pulse of the "
        "wire can be left out for it",
        plan.order.size(), kCycleSteps);
    return false;
  }
  std::array<InForce, kCycleSteps> steps;
  std::array<CycleWords, kCycleSteps> words;
  for (std::size_t i = 0; i < kCycleSteps; ++i) {
    const auto before =
        std::find_if(steps.begin(), steps.begin() + static_cast<std::ptrdiff_t>(i),
                     [&](const InForce& step) { return step.asked == layout->steps[i]; });
    if (before != steps.begin() + static_cast<std::ptrdiff_t>(i)) {
      steps[i] = *before;
    } else {
      OMNIHDR_TRY(SetExposure(layout->steps[i]).Context("set the exposure"));
      steps[i] = *in_force_;
      steps[i].settled = true;
    }
    words[i] = {steps[i].shutter_raw, steps[i].gain_raw};
  }
  for (std::size_t i = 0; i < kCycleSteps; ++i) {
    bool shared = shutters_.ambiguous(words[i].shutter) || gains_.ambiguous(words[i].gain);
    for (std::size_t k = 0; k < i; ++k) {
      shared = shared || (words[k] == words[i] && steps[k].asked != steps[i].asked);
    }
    if (!shared) continue;
    why = fmt::format("its registers hold {:.9g} s and another exposure by the same value {:#x}",
                      steps[i].asked.time.seconds(), words[i].shutter);
    return false;
  }
  cycle_touched_ = true;
  OMNIHDR_TRY(LoadExposureCycle(*camera_->registers, words, camera_->gain_range.has_value())
                  .Context("load the exposure cycle"));
  cycle_.emplace(CycleInForce{steps, CyclePhase(words)});
  // The patience with its pictures follows from the longest.
  in_force_ = *std::max_element(steps.begin(), steps.end(), [](const InForce& a, const InForce& b) {
    return a.measured.time < b.measured.time;
  });
  if (plan.burst && camera_->series && !options_.wired) {
    const int pictures = layout->exact ? static_cast<int>(plan.order.size()) : kCycleSteps;
    OMNIHDR_ASSIGN(const bool whole, TrySeries(pictures, stop));
    if (whole) {
      cycle_->pictures = pictures;
      return true;
    }
    OMNIHDR_TRY(SetUpTrigger());
  }
  return TrySteps(stop, why);
}

Result<bool> IidcCamera::TrySteps(const std::stop_token& stop, std::string& why) {
  std::string seen;
  bool one_by_one = true;
  int came = 0;
  cycle_->phase.Forget();
  for (int i = 0; i < kMostPicturesOfATry && came < kPicturesOfATry; ++i) {
    if (stop.stop_requested()) return false;
    CyclePhase::Seen verdict{};
    OMNIHDR_ASSIGN(const std::optional<CycleMark> mark, ThrowAwayAPicture(stop, &verdict));
    if (!mark) continue;
    ++came;
    seen += mark->found ? fmt::format(" {}", *mark->found + 1) : std::string(" none");
    one_by_one = one_by_one && verdict != CyclePhase::Seen::kContradiction &&
                 verdict != CyclePhase::Seen::kForeign;
  }
  if (came < kPicturesOfATry) {
    why = fmt::format("{} of {} pictures came", came, kMostPicturesOfATry);
    return false;
  }
  if (one_by_one && cycle_->phase.next()) return true;
  why = fmt::format("pictures one after the other had the steps{}", seen);
  return false;
}

Result<bool> IidcCamera::TrySeries(int pictures, const std::stop_token& stop) {
  OMNIHDR_TRY(SetUpSoftwareTrigger(*camera_->registers, kSeriesMode, pictures));
  cycle_->pictures = pictures;
  bool whole = true;
  for (int i = 0; i < kSeriesOfATry && whole && !stop.stop_requested(); ++i) {
    OMNIHDR_TRY(BeginSeries(clock_.Now(), stop));
    while (!series_->over(clock_.Now()) && !stop.stop_requested()) OMNIHDR_TRY(ReadSeries(kSlice));
    whole = static_cast<int>(series_->held.size()) == pictures &&
            std::all_of(series_->held.begin(), series_->held.end(), [](const SeriesFrame& frame) {
              return frame.mark.found && (!frame.mark.due || frame.mark.due == frame.mark.found);
            });
    for (const InForce& step : cycle_->steps) {
      whole = whole && std::any_of(series_->held.begin(), series_->held.end(),
                                   [&](const SeriesFrame& frame) {
                                     return FoundStep(frame.mark)->asked == step.asked;
                                   });
    }
  }
  if (series_) {
    std::lock_guard lock(mutex_);
    counts_.cycle_discarded += series_->held.size();
  }
  series_.reset();
  cycle_->pictures = 0;
  return whole;
}

std::optional<CycleWords> IidcCamera::WordsOf(const EmbeddedInfo& info) const {
  if (!info.shutter || (camera_->gain_range && !info.gain)) return std::nullopt;
  return CycleWords{*info.shutter & 0xFFF, camera_->gain_range ? *info.gain & 0xFFF : 0};
}

IidcCamera::CycleMark IidcCamera::MarkFrame(const RawFrame& raw, CyclePhase::Seen* seen) {
  const std::optional<FrameFacts> facts = ReadFacts(raw.bytes, camera_->picture);
  const std::optional<CycleWords> words =
      facts ? WordsOf(facts->info) : std::optional<CycleWords>();
  CycleMark mark;
  mark.due = cycle_->phase.next();
  if (words) mark.found = cycle_->phase.Find(*words);
  const CyclePhase::Seen verdict = cycle_->phase.Saw(words);
  // Of steps with the same words the one that was due.
  if (verdict == CyclePhase::Seen::kExpected) mark.found = mark.due;
  cycle_->recent = cycle_->recent << 1 | (verdict == CyclePhase::Seen::kContradiction ? 1U : 0U);
  if (verdict == CyclePhase::Seen::kContradiction) {
    std::lock_guard lock(mutex_);
    ++counts_.cycle_contradictions;
  }
  if (seen != nullptr) *seen = verdict;
  return mark;
}

Result<std::optional<IidcCamera::CycleMark>> IidcCamera::ThrowAwayAPicture(
    const std::stop_token& stop, CyclePhase::Seen* seen) {
  OMNIHDR_ASSIGN(const Sent sent, SendTrigger());
  unreleased_ = sent.unreleased;
  if (!unreleased_.empty()) return Fail(ErrorKind::kTemporary, "{}", unreleased_);
  OMNIHDR_ASSIGN(const std::optional<RawFrame> raw, WaitForFrame(sent, stop));
  if (!raw) {
    cycle_->phase.Forget();
    return std::optional<CycleMark>();
  }
  ++discarded_;
  {
    std::lock_guard lock(mutex_);
    ++counts_.cycle_discarded;
  }
  return std::optional<CycleMark>(MarkFrame(*raw, seen));
}

Result<bool> IidcCamera::Align(const Exposure& exposure, const std::stop_token& stop) {
  for (int i = 0; i < kMostThrownAway && !stop.stop_requested(); ++i) {
    const std::optional<int> next = cycle_->phase.next();
    if (next && cycle_->steps[static_cast<std::size_t>(*next)].asked == exposure) return true;
    OMNIHDR_TRY(ThrowAwayAPicture(stop, nullptr));
  }
  if (stop.stop_requested()) return false;
  AddNote(fmt::format(
      "the camera's own exposure cycle is not used any more: {} pictures did not bring it to the "
      "step of {:.9g} s: exposures are written one by one",
      kMostThrownAway, exposure.time.seconds()));
  OMNIHDR_TRY(EndCycle());
  return false;
}

Result<std::optional<CameraFrame>> IidcCamera::TakeStep(const ExposureRequest& request,
                                                        const std::stop_token& stop) {
  if (const std::optional<int> due = cycle_->phase.next()) {
    in_force_ = cycle_->steps[static_cast<std::size_t>(*due)];
  }
  OMNIHDR_ASSIGN(const Sent sent, SendTrigger());
  if (!sent.unreleased.empty()) return NotReleased(request, sent);
  OMNIHDR_ASSIGN(std::optional<RawFrame> raw, WaitForFrame(sent, stop));
  if (!raw) {
    cycle_->phase.Forget();
    return std::optional<CameraFrame>();
  }
  const CycleMark mark = MarkFrame(*raw);
  CameraFrame frame = MakeFrame(request, sent, std::move(*raw), &mark);
  {
    std::lock_guard lock(mutex_);
    ++counts_.cycled;
  }
  OMNIHDR_TRY(EndCycleIfSurprised());
  if (!assembler_->in_step()) OMNIHDR_TRY(RestartStream().Context("begin the stream anew"));
  return std::optional<CameraFrame>(std::move(frame));
}

Status IidcCamera::BeginSeries(HostTime asked_at, const std::stop_token& stop) {
  // The camera is busy with the one before: what is left over of it is counted.
  while (series_ && !series_->over(clock_.Now()) && !stop.stop_requested()) {
    OMNIHDR_TRY(ReadSeries(kSlice));
  }
  if (series_) {
    std::lock_guard lock(mutex_);
    counts_.cycle_discarded += series_->held.size();
  }
  series_.reset();
  in_force_ = *std::max_element(
      cycle_->steps.begin(), cycle_->steps.end(),
      [](const InForce& a, const InForce& b) { return a.measured.time < b.measured.time; });
  cycle_->phase.Forget();
  OMNIHDR_ASSIGN(const Sent sent, SendTrigger());
  Series series;
  series.asked_at = asked_at;
  series.sent = sent;
  series.pictures = cycle_->pictures;
  series.until = sent.after + FromSeconds(in_force_->measured.time.seconds()) +
                 FromSeconds(options_.frame_timeout_s);
  series_ = std::move(series);
  return {};
}

Status IidcCamera::ReadSeries(Nanoseconds timeout) {
  Result<StreamChunk> chunk = camera_->link->ReadStream(timeout);
  if (!chunk) {
    if (chunk.error().kind == ErrorKind::kTemporary) return {};
    return Forward(Error{ErrorKind::kUnavailable, std::move(chunk).error().message});
  }
  std::vector<RawFrame> frames = assembler_->Add(*chunk);
  camera_->link->Recycle(std::move(*chunk));
  for (RawFrame& raw : frames) {
    if (IsStray(raw, series_->sent) || series_->came >= series_->pictures) {
      std::lock_guard lock(mutex_);
      ++counts_.strays;
      continue;
    }
    const Nanoseconds longest = FromSeconds(in_force_->measured.time.seconds());
    const std::optional<FrameFacts> facts = ReadFacts(raw.bytes, camera_->picture);
    std::uint32_t lost = 0;
    if (facts && facts->info.counter) {
      if (last_counter_) lost = *facts->info.counter - *last_counter_ - 1 - discarded_;
      if (lost > kMostLost) lost = 0;
      last_counter_ = facts->info.counter;
      counter_at_last_ = counter_;
      discarded_ = 0;
    }
    // A step is left out with each.
    if (lost > 0) cycle_->phase.Forget();
    series_->gap += lost;
    SeriesFrame frame;
    frame.mark = MarkFrame(raw);
    frame.sent = series_->sent;
    if (series_->came > 0 || lost > 0) {
      // Begun by itself, no sooner than the trigger.
      const HostTime begun = std::max(series_->sent.before, raw.arrived - longest);
      frame.sent = {begun, begun, false, {}};
    }
    series_->until = raw.arrived + longest + FromSeconds(options_.frame_timeout_s);
    series_->came += 1 + static_cast<int>(lost);
    frame.raw = std::move(raw);
    series_->held.push_back(std::move(frame));
  }
  if (!assembler_->in_step()) {
    series_->came = series_->pictures;
    OMNIHDR_TRY(RestartStream().Context("begin the stream anew"));
  }
  return {};
}

std::optional<IidcCamera::SeriesFrame> IidcCamera::Claim(const std::optional<Exposure>& exposure) {
  auto& held = series_->held;
  const auto found = std::find_if(held.begin(), held.end(), [&](const SeriesFrame& frame) {
    const InForce* step = FoundStep(frame.mark);
    return exposure ? step != nullptr && step->asked == *exposure : step == nullptr;
  });
  if (found == held.end()) return std::nullopt;
  SeriesFrame frame = std::move(*found);
  held.erase(found);
  return frame;
}

Result<std::optional<CameraFrame>> IidcCamera::TakeFromSeries(const ExposureRequest& request,
                                                              const std::stop_token& stop) {
  // A step that is asked for again needs another series.
  const bool again = series_ && std::find(series_->answered.begin(), series_->answered.end(),
                                          request.trigger) != series_->answered.end();
  if (!series_ || again || series_->asked_at != request.trigger_time) {
    OMNIHDR_TRY(BeginSeries(request.trigger_time, stop));
  }
  series_->answered.push_back(request.trigger);
  std::optional<SeriesFrame> taken = Claim(request.exposure);
  while (!taken && !series_->over(clock_.Now())) {
    if (stop.stop_requested()) return std::optional<CameraFrame>();
    OMNIHDR_TRY(ReadSeries(kSlice));
    taken = Claim(request.exposure);
  }
  // One that proves nothing is told as such, in the place of the step that is missing.
  if (!taken) taken = Claim(std::nullopt);
  if (!taken) {
    std::lock_guard lock(mutex_);
    ++counts_.lost;
    return std::optional<CameraFrame>(Handover::Missed(
        request,
        fmt::format("none of the {} pictures of the camera's series had this exposure",
                    series_->pictures),
        counter_));
  }
  counter_ += 1 + std::exchange(series_->gap, 0);
  counter_at_last_ = counter_;
  CameraFrame frame =
      MakeFrame(request, taken->sent, std::move(taken->raw), &taken->mark, counter_);
  {
    std::lock_guard lock(mutex_);
    ++counts_.cycled;
  }
  return std::optional<CameraFrame>(std::move(frame));
}

}  // namespace omnihdr::iidc
