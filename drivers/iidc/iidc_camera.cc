#include "drivers/iidc/iidc_camera.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "drivers/firewire/recording.h"
#include "drivers/iidc/firewire_link.h"
#include "drivers/iidc/registers.h"
#include "drivers/iidc/trigger_mode.h"
#include "drivers/iidc/usb_link.h"
#include "drivers/usb/libusb_bus.h"
#include "drivers/usb/recording.h"

namespace omnihdr::iidc {
namespace {

using std::chrono::milliseconds;

constexpr int kMaxFailures = 3;
constexpr Nanoseconds kIdleLook = milliseconds(50);
constexpr Nanoseconds kSlice = milliseconds(50);
// The exposure begins no later than this after the trigger's write has been answered.
constexpr Nanoseconds kLongestStart = milliseconds(2);
// How much earlier than its trigger a frame may seem and still be its own: the fit of the camera's
// clock is off by what the first exposures were later than that. A picture of before was waited
// for, and is older by its reading out at least.
constexpr Nanoseconds kStraySlack = milliseconds(10);
// Beyond the spacing of its pulses, which a wire waits for.
constexpr Nanoseconds kReleaseMargin = milliseconds(100);
constexpr std::size_t kMostEdges = 64;
// Chunks thrown away at once while nobody waits for a frame.
constexpr int kMaxStrayChunks = 1000;

Nanoseconds FromSeconds(double seconds) {
  return Nanoseconds(static_cast<std::int64_t>(std::llround(seconds * 1e9)));
}

}  // namespace

IidcCamera::IidcCamera(IidcCameraOptions options, std::unique_ptr<LinkFinder> finder,
                       RegisterTimeouts timeouts)
    : options_(std::move(options)), finder_(std::move(finder)), timeouts_(timeouts) {}

IidcCamera::~IidcCamera() { Close(); }

Result<CameraInfo> IidcCamera::Open() {
  if (handover_.IsOpen()) return camera_->info;
  Close();
  Result<ReadyCamera> ready = OpenAndSetUp(*finder_, options_, timeouts_).Context("IIDC camera");
  if (!ready) return Forward(std::move(ready).error());
  camera_ = std::move(*ready);
  assembler_.emplace(camera_->format.frame_bytes, camera_->format.marked_ends);
  camera_clock_.Reset();
  jumps_before_ = camera_clock_.jumps();
  shutters_ = {};
  gains_ = {};
  in_force_.reset();
  cycle_touched_ = false;
  last_counter_.reset();
  counter_ = 0;
  discarded_ = 0;
  failures_ = 0;
  HandoverLimits limits;
  limits.shortest = camera_->info.shortest;
  limits.longest = camera_->info.longest;
  if (camera_->gain_range) {
    limits.least_gain_db = camera_->gain_range->minimum;
    limits.most_gain_db = camera_->gain_range->maximum;
  } else {
    limits.gain_note = "the camera has no gain";
  }
  handover_.Open(std::move(limits));
  return camera_->info;
}

void IidcCamera::Close() {
  Stop();
  handover_.Close();
  camera_.reset();
}

Status IidcCamera::Start() {
  OMNIHDR_ASSIGN(const bool may_start, handover_.MayStart());
  if (!may_start) return {};
  assembler_->Reset();
  cycle_.reset();
  series_.reset();
  cycle_suspended_ = false;
  AskForPlan();
  const auto begin = [this]() -> Status {
    OMNIHDR_TRY(StartLink());
    OMNIHDR_TRY(camera_->registers->WriteChecked(kIsoEnable, Bit(31), Bit(31), "ISO_EN"));
    return {};
  };
  if (Status begun = begin(); !begun) {
    camera_->link->StopStream();
    return Forward(std::move(begun).error(), "IIDC camera: start");
  }
  handover_.Start("iidc-camera", [this](std::stop_token stop, Stage& stage) {
    return options_.wired ? RunWired(std::move(stop), stage) : RunShots(std::move(stop), stage);
  });
  return {};
}

void IidcCamera::Stop() {
  handover_.Stop([this](bool gone) {
    // The ring goes on taking data until the camera has stopped sending. Whether it listened shows
    // when it is opened again.
    if (!gone) {
      static_cast<void>(EndCycle());
      static_cast<void>(camera_->registers->Write(kIsoEnable, 0, "ISO_EN"));
    }
    camera_->link->StopStream();
  });
}

Status IidcCamera::Trigger(const ExposureRequest& request) {
  if (!options_.wired) return handover_.Trigger(request);
  OMNIHDR_TRY(handover_.CheckRunning("edge: "));
  std::lock_guard lock(mutex_);
  edges_.push_back(request.trigger_time);
  if (edges_.size() > kMostEdges) edges_.pop_front();
  return {};
}

Result<CameraFrame> IidcCamera::Receive(Nanoseconds timeout) { return handover_.Receive(timeout); }

void IidcCamera::Prepare(const Exposure& next) { handover_.Prepare(next); }

IidcCamera::Counts IidcCamera::counts() const {
  std::lock_guard lock(mutex_);
  return counts_;
}

std::vector<CameraCounter> IidcCamera::Counters() const {
  const Counts now = counts();
  return {{"torn_frames", now.torn},
          {"stray_frames", now.strays},
          {"lost_triggers", now.lost},
          {"cycle_frames", now.cycled},
          {"cycle_discarded", now.cycle_discarded},
          {"cycle_contradictions", now.cycle_contradictions}};
}

Status IidcCamera::RunShots(std::stop_token stop, Stage& stage) {
  while (!stop.stop_requested()) {
    stage.Progress();
    if (Status planned = FollowPlan(stop);
        !planned && planned.error().kind == ErrorKind::kUnavailable) {
      handover_.GoAway(planned.error().message);
      return {};
    }
    const std::optional<ExposureRequest> request = handover_.Take(kIdleLook, stop);
    if (!request) {
      if (const std::optional<Exposure> next = handover_.TakeHint()) {
        // What fails here is done again, and told, when the trigger comes.
        static_cast<void>(GetReady(*next, stop));
        continue;
      }
      // Nobody waits for anything: what comes now belongs to nobody, and a lost camera shows.
      if (Status idle = Idle(); !idle) {
        handover_.GoAway(idle.error().message);
        return {};
      }
      continue;
    }
    Result<std::optional<CameraFrame>> taken = TakePicture(*request, stop);
    if (taken) {
      failures_ = 0;
      if (*taken) {
        handover_.Finish(std::move(**taken));
        continue;
      }
      ++counter_;  // unless the camera's own counter knows better
      {
        std::lock_guard lock(mutex_);
        ++counts_.lost;
      }
      handover_.Done();
    } else if (taken.error().kind == ErrorKind::kUnavailable || ++failures_ >= kMaxFailures) {
      handover_.GoAway(taken.error().message);
      return {};
    } else {
      handover_.Finish(Handover::Missed(*request, taken.error().message, counter_));
    }
  }
  return {};
}

Status IidcCamera::GetReady(const Exposure& next, const std::stop_token& stop) {
  if (cycle_ && StepOf(next) != nullptr) {
    if (cycle_->pictures == 0) OMNIHDR_TRY(Align(next, stop));
    return {};
  }
  if (cycle_ || (IsPlanned(next) && FollowPlanAgain())) return {};
  // Eight register accesses less between the next trigger and its exposure.
  if (!in_force_ || in_force_->asked != next) OMNIHDR_TRY(SetExposure(next));
  return {};
}

Status IidcCamera::Idle() {
  if (series_ && !series_->over(clock_.Now())) return ReadSeries(Nanoseconds(0));
  return DropStrays();
}

Result<std::optional<CameraFrame>> IidcCamera::TakePicture(const ExposureRequest& request,
                                                           std::stop_token stop) {
  OMNIHDR_TRY(FollowPlan(stop));
  if (cycle_ && StepOf(request.exposure) != nullptr) {
    if (cycle_->pictures > 0) return TakeFromSeries(request, stop);
    unreleased_.clear();
    const Result<bool> due = Align(request.exposure, stop);
    if (!due) {
      if (unreleased_.empty()) return Forward(due.error());
      return std::optional<CameraFrame>(Handover::Missed(request, unreleased_, counter_));
    }
    if (*due) return TakeStep(request, stop);
  } else if (cycle_) {
    cycle_suspended_ = true;
  }
  OMNIHDR_TRY(EndCycle());
  if (!in_force_ || in_force_->asked != request.exposure) {
    OMNIHDR_TRY(SetExposure(request.exposure).Context("set the exposure"));
  }
  int settle = options_.settle_frames;
  if (settle < 0) settle = camera_->model ? camera_->model->settle_frames : 0;
  for (int i = 0; !in_force_->settled && i < settle && !stop.stop_requested(); ++i) {
    OMNIHDR_ASSIGN(const Sent sent, SendTrigger());
    if (!sent.unreleased.empty()) return NotReleased(request, sent);
    OMNIHDR_ASSIGN(const std::optional<RawFrame> thrown_away, WaitForFrame(sent, stop));
    if (thrown_away) ++discarded_;
  }
  in_force_->settled = true;
  OMNIHDR_ASSIGN(const Sent sent, SendTrigger());
  if (!sent.unreleased.empty()) return NotReleased(request, sent);
  OMNIHDR_ASSIGN(std::optional<RawFrame> raw, WaitForFrame(sent, stop));
  if (!raw) return std::optional<CameraFrame>();
  CameraFrame frame = MakeFrame(request, sent, std::move(*raw));
  if (!assembler_->in_step()) OMNIHDR_TRY(RestartStream().Context("begin the stream anew"));
  return std::optional<CameraFrame>(std::move(frame));
}

Status IidcCamera::SetExposure(const Exposure& exposure) {
  in_force_.reset();
  InForce next;
  next.asked = exposure;
  OMNIHDR_ASSIGN(const Feature::Set shutter,
                 camera_->shutter->SetAbsolute(exposure.time.seconds()));
  shutters_.Learn(shutter.raw, shutter.value);
  next.measured.time = ExposureTime::Seconds(shutter.value);
  next.shutter_raw = shutter.raw;
  if (camera_->gain_range) {
    OMNIHDR_ASSIGN(const Feature::Set gain, camera_->gain->SetAbsolute(exposure.gain.value));
    gains_.Learn(gain.raw, gain.value);
    next.measured.gain = GainDb{gain.value};
    next.gain_raw = gain.raw;
  }
  in_force_ = next;
  return {};
}

Result<IidcCamera::Sent> IidcCamera::SendTrigger() {
  if (camera_->tells_ready) OMNIHDR_TRY(WaitForTriggerReady(*camera_->registers));
  OMNIHDR_TRY(DropStrays());
  assembler_->Reset();
  if (options_.release) return PulseWire();
  Sent sent;
  sent.before = clock_.Now();
  Status status = SendSoftwareTrigger(*camera_->registers);
  sent.after = clock_.Now();
  sent.confirmed = status.has_value();
  // Without an answer it may still have worked: the frame will tell.
  if (!status && status.error().kind != ErrorKind::kTemporary) {
    return Forward(std::move(status).error());
  }
  return sent;
}

IidcCamera::Sent IidcCamera::PulseWire() {
  Sent sent;
  const Result<CameraRelease::Moment> released =
      options_.release->Release(options_.release->spacing() + kReleaseMargin);
  if (released) {
    sent.before = released->before;
    sent.after = released->after;
    sent.confirmed = true;
  } else {
    sent.unreleased = released.error().message;
  }
  return sent;
}

std::optional<CameraFrame> IidcCamera::NotReleased(const ExposureRequest& request,
                                                   const Sent& sent) {
  return Handover::Missed(request, sent.unreleased, counter_);
}

Result<std::optional<RawFrame>> IidcCamera::WaitForFrame(const Sent& sent, std::stop_token stop) {
  const Nanoseconds exposure = FromSeconds(in_force_->measured.time.seconds());
  const HostTime deadline = sent.after + exposure + FromSeconds(options_.frame_timeout_s);
  bool stray_seen = false;
  while (!stop.stop_requested()) {
    const Nanoseconds left = deadline - clock_.Now();
    if (left <= Nanoseconds(0)) break;
    Result<StreamChunk> chunk = camera_->link->ReadStream(std::min(left, kSlice));
    if (!chunk) {
      if (chunk.error().kind == ErrorKind::kTemporary) continue;
      return Forward(Error{ErrorKind::kUnavailable, std::move(chunk).error().message});
    }
    std::vector<RawFrame> frames = assembler_->Add(*chunk);
    camera_->link->Recycle(std::move(*chunk));
    for (RawFrame& frame : frames) {
      if (!IsStray(frame, sent)) return std::optional<RawFrame>(std::move(frame));
      stray_seen = true;
      std::lock_guard lock(mutex_);
      ++counts_.strays;
    }
  }
  // Frames that always seem too old mean that the camera's clock is not what it was.
  if (stray_seen) camera_clock_.Reset();
  if (!assembler_->in_step()) OMNIHDR_TRY(RestartStream().Context("begin the stream anew"));
  return std::optional<RawFrame>();
}

bool IidcCamera::IsStray(const RawFrame& frame, const Sent& sent) {
  // A recording has its own order of triggers and frames, and none of this host's times.
  if (!camera_->link->live()) return false;
  const std::optional<FrameFacts> facts = ReadFacts(frame.bytes, camera_->picture);
  if (!facts || !facts->info.cycle_time) return false;
  const std::optional<std::int64_t> cycle_ns = CycleTimeNanoseconds(*facts->info.cycle_time);
  if (!cycle_ns) return false;
  CameraClock clock = camera_clock_;  // a frame that is thrown away leaves no trace
  const CameraTime taken = clock.Unwrap(*cycle_ns, frame.arrived);
  const std::optional<HostTime> at = clock.ToHost(taken);
  return at && *at + clock.uncertainty(taken) + kStraySlack < sent.before;
}

Status IidcCamera::DropStrays() {
  for (int i = 0; i < kMaxStrayChunks; ++i) {
    Result<StreamChunk> chunk = camera_->link->ReadStream(Nanoseconds(0));
    if (!chunk) {
      if (chunk.error().kind == ErrorKind::kTemporary) return {};
      return Forward(Error{ErrorKind::kUnavailable, std::move(chunk).error().message});
    }
    const std::size_t frames = assembler_->Add(*chunk).size();
    camera_->link->Recycle(std::move(*chunk));
    std::lock_guard lock(mutex_);
    counts_.strays += frames;
  }
  return Fail(ErrorKind::kProtocol, "the camera sends without being triggered");
}

Status IidcCamera::StartLink() {
  OMNIHDR_TRY(camera_->link->PrepareStream(*camera_->registers, camera_->format.packet_bytes));
  return camera_->link->StartStream(camera_->format.frame_bytes);
}

Status IidcCamera::RestartStream() {
  OMNIHDR_TRY(camera_->registers->WriteChecked(kIsoEnable, 0, Bit(31), "ISO_EN"));
  camera_->link->StopStream();
  assembler_->Reset();
  OMNIHDR_TRY(StartLink());
  OMNIHDR_TRY(camera_->registers->WriteChecked(kIsoEnable, Bit(31), Bit(31), "ISO_EN"));
  return {};
}

void IidcCamera::Prove(const EmbeddedInfo& info, CameraFrame& frame) const {
  Exposure measured = in_force_->measured;
  frame.proof = info.shutter ? ExposureProof::kEmbedded : ExposureProof::kReadback;
  if (cycle_ && (!info.shutter || (camera_->gain_range && !info.gain))) {
    // Nobody knows which of its steps the camera has taken.
    frame.proof = ExposureProof::kNone;
    return;
  }
  // What an embedded word says; nothing when that is not known.
  const auto meaning = [this, &frame](std::uint32_t word, const ExposureTable& table,
                                      std::uint32_t raw_in_force,
                                      double value_in_force) -> std::optional<double> {
    const std::uint32_t raw = word & 0xFFF;
    if (table.ambiguous(raw) && raw == raw_in_force && !cycle_) {
      // Several settings have this register value: it proves less than what was read back.
      frame.proof = ExposureProof::kReadback;
      return value_in_force;
    }
    return table.Find(raw);
  };
  const auto unproven = [&frame](const char* what, std::uint32_t word) {
    frame.proof = ExposureProof::kNone;
    if (frame.detail.empty()) {
      frame.detail = fmt::format("the frame's {} word {:#x} stands for nothing that was set", what,
                                 word & 0xFFF);
    }
  };
  if (info.shutter) {
    const std::optional<double> seconds =
        meaning(*info.shutter, shutters_, in_force_->shutter_raw, measured.time.seconds());
    if (!seconds) return unproven("shutter", *info.shutter);
    measured.time = ExposureTime::Seconds(*seconds);
  }
  if (info.gain && camera_->gain_range) {
    const std::optional<double> gain =
        meaning(*info.gain, gains_, in_force_->gain_raw, measured.gain.value);
    if (!gain) return unproven("gain", *info.gain);
    measured.gain = GainDb{*gain};
  }
  frame.measured_exposure = measured;
}

std::uint64_t IidcCamera::Count(std::optional<std::uint32_t> embedded) {
  if (embedded && last_counter_) {
    // The difference wraps with the camera's 32 bits.
    counter_ = counter_at_last_ + (*embedded - *last_counter_ - discarded_);
  } else {
    ++counter_;
  }
  if (embedded) {
    last_counter_ = embedded;
    counter_at_last_ = counter_;
    discarded_ = 0;
  }
  return counter_;
}

CameraFrame IidcCamera::MakeFrame(const ExposureRequest& request, const Sent& sent, RawFrame raw,
                                  const CycleMark* mark, std::optional<std::uint64_t> counter) {
  CameraFrame frame;
  frame.trigger = request.trigger;
  if (raw.torn) {
    frame.status = FrameStatus::kCorrupt;
    frame.detail = raw.detail;
    std::lock_guard lock(mutex_);
    ++counts_.torn;
  }
  const std::optional<FrameFacts> facts = ReadFacts(raw.bytes, camera_->picture);
  const EmbeddedInfo info = facts ? facts->info : EmbeddedInfo{};
  if (facts && !facts->one_exposure) {
    if (frame.detail.empty()) frame.detail = "the sensors had different exposures";
  } else if (facts || camera_->info.proof == ExposureProof::kReadback) {
    Prove(info, frame);
  }

  frame.camera_counter = counter ? *counter : Count(info.counter);

  const Nanoseconds exposure =
      FromSeconds(frame.measured_exposure.value_or(in_force_->measured).time.seconds());
  HostTime start = sent.before + (sent.after - sent.before) / 2;
  if (info.cycle_time) {
    if (const auto cycle_ns = CycleTimeNanoseconds(*info.cycle_time)) {
      const CameraTime taken = camera_clock_.Unwrap(*cycle_ns, raw.arrived);
      if (sent.confirmed) camera_clock_.Add(taken, sent.before, sent.after + kLongestStart);
      frame.camera_time = taken + exposure / 2;
      if (const std::optional<HostTime> fitted = camera_clock_.ToHost(taken)) {
        start = *fitted;
        frame.mid_exposure_error = camera_clock_.uncertainty(taken);
      }
    }
  }
  frame.mid_exposure =
      std::clamp(start + exposure / 2, sent.before, std::max(sent.before, raw.arrived));
  frame.clock_jumps = camera_clock_.jumps() - jumps_before_;
  frame.cycled = mark != nullptr;
  frame.settings_readback_json = Readback(mark);
  const PictureLayout& layout = camera_->picture;
  Result<Pixels> picture = ReadPicture(std::move(raw.bytes), layout);
  if (!picture) {
    if (frame.status == FrameStatus::kOk) frame.detail = picture.error().message;
    frame.status = FrameStatus::kCorrupt;
    picture = layout.deep ? Pixels(Image<std::uint16_t>(layout.width, layout.height))
                          : Pixels(Image<std::uint8_t>(layout.width, layout.height));
  }
  frame.pixels = std::move(*picture);
  return frame;
}

std::string IidcCamera::Readback(const CycleMark* mark) const {
  // Of the cycle's settings, those that the frame had: the one that was due is no fact.
  const auto number = [](const std::optional<int>& step) {
    return step ? fmt::format("{}", *step + 1) : std::string("null");
  };
  std::string cycle;
  const InForce* settings = &*in_force_;
  if (mark != nullptr) {
    cycle = fmt::format(R"("cycle_step":{},"cycle_step_due":{})", number(mark->found),
                        number(mark->due));
    settings = FoundStep(*mark);
    if (settings == nullptr) return fmt::format("{{{}}}", cycle);
    cycle += ',';
  }
  return fmt::format(R"({{{}"exposure_s":{:.9g},"gain_db":{:.9g},"shutter_raw":{},"gain_raw":{}}})",
                     cycle, settings->measured.time.seconds(), settings->measured.gain.value,
                     settings->shutter_raw, settings->gain_raw);
}

std::unique_ptr<LinkFinder> MakeFinder(const IidcCameraOptions& options) {
  if (options.bus == CameraBus::kFirewire) {
    std::shared_ptr<firewire::Bus> bus = firewire::MakeSystemBus();
    if (!options.usb_recording.empty()) {
      bus = firewire::MakeRecordingBus(std::move(bus), {.file = options.usb_recording});
    }
    return MakeFirewireFinder(std::move(bus));
  }
  std::shared_ptr<usb::Bus> bus = usb::MakeLibusbBus();
  if (!options.usb_recording.empty()) {
    bus = usb::MakeRecordingBus(std::move(bus), {.file = options.usb_recording});
  }
  return MakeUsbFinder(std::move(bus));
}

std::unique_ptr<Camera> MakeIidcCamera(IidcCameraOptions options) {
  std::unique_ptr<LinkFinder> finder = MakeFinder(options);
  return std::make_unique<IidcCamera>(std::move(options), std::move(finder));
}

}  // namespace omnihdr::iidc
