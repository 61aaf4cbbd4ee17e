#include "drivers/v4l2/rig_camera.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>
#include <type_traits>
#include <utility>
#include <variant>

#include "core/photometry/mosaic.h"
#include "core/session/rig_file.h"
#include "core/session/session_rig.h"
#include "drivers/v4l2/kernel_device.h"
#include "drivers/v4l2/recording.h"

namespace omnihdr::v4l2 {
namespace {

using Json = nlohmann::json;
using std::chrono::milliseconds;

constexpr Nanoseconds kIdleLook = milliseconds(20);
constexpr Nanoseconds kBusyLook = milliseconds(2);
// Of frame_timeout_s: an incomplete set comes before its trigger counts as lost.
constexpr double kPatience = 0.75;

Nanoseconds FromSeconds(double seconds) {
  return Nanoseconds(static_cast<std::int64_t>(std::llround(seconds * 1e9)));
}

// How much a proof of this driver is worth: read-back without a measured latency says least.
int Worth(ExposureProof proof) {
  if (proof == ExposureProof::kNone) return 0;
  return proof == ExposureProof::kReadback ? 1 : 2;
}

// How far an exposure is from the one asked for, in stops.
double Distance(const Exposure& exposure, const Exposure& asked) {
  return std::abs(std::log2(exposure.EffectiveSeconds() / asked.EffectiveSeconds()));
}

// The rows of one sensor into the stack; false when the picture is not of that kind.
template <typename T>
bool Place(const CameraFrame& frame, int row, Image<T>& stack) {
  const auto* picture = std::get_if<Image<T>>(&frame.pixels);
  if (picture == nullptr || picture->width() != stack.width() ||
      picture->channels() != stack.channels() || row + picture->height() > stack.height()) {
    return false;
  }
  for (int y = 0; y < picture->height(); ++y) {
    std::copy_n(picture->row(y), picture->width() * picture->channels(), stack.row(row + y));
  }
  return true;
}

}  // namespace

V4l2RigCamera::V4l2RigCamera(V4l2CameraOptions options, MakeSystem make_system, Nanoseconds retry)
    : options_(std::move(options)), make_system_(std::move(make_system)), retry_(retry) {}

V4l2RigCamera::~V4l2RigCamera() { Close(); }

Result<CameraInfo> V4l2RigCamera::Open() {
  if (handover_.IsOpen()) return info_;
  Close();
  std::vector<CameraInfo> infos;
  const auto open = [&]() -> Status {
    OMNIHDR_TRY(options_.Validate());
    OMNIHDR_ASSIGN(info_.files, ReadRigFilesOf(options_.rig_file));
    OMNIHDR_ASSIGN(const Rig rig, ParseRig(info_.files.front().content, options_.rig_file));
    OMNIHDR_ASSIGN(rows_, StackedRows(rig).Context(options_.rig_file));
    if (rig.sensors.size() != options_.devices.size()) {
      return Fail(ErrorKind::kConfig, "devices: {}: expected {}, one for each sensor of {}",
                  options_.devices.size(), rig.sensors.size(), options_.rig_file);
    }
    names_.clear();
    for (const RigSensor& sensor : rig.sensors) names_.push_back(sensor.name);
    OMNIHDR_TRY(OpenMembers(infos));
    return Combine(infos);
  };
  if (Status opened = open(); !opened) {
    ForgetMembers();
    return Forward(std::move(opened).error(), "V4L2 rig");
  }
  for (std::size_t i = 0; i < members_.size(); ++i) {
    CameraInfo expected = infos[i];
    expected.shortest = info_.shortest;
    expected.longest = info_.longest;
    members_[i]->Expect(expected);
  }
  counter_ = 0;
  last_counters_.assign(members_.size(), std::nullopt);
  return info_;
}

// Side by side: each measures its latency for seconds.
Status V4l2RigCamera::OpenMembers(std::vector<CameraInfo>& infos) {
  std::vector<std::unique_ptr<RigMember>> members;
  for (std::size_t i = 0; i < options_.devices.size(); ++i) {
    V4l2CameraOptions options = options_;
    options.device = options_.devices[i];
    options.devices.clear();
    options.sensor = static_cast<int>(i);
    members.push_back(std::make_unique<RigMember>(
        i, fmt::format("sensor {} \"{}\" ({})", i, names_[i], options.device), options,
        make_system_(i), retry_, inbox_));
  }
  {
    std::lock_guard lock(members_mutex_);
    members_ = std::move(members);
  }
  std::vector<Result<CameraInfo>> opened(members_.size(), CameraInfo{});
  {
    std::vector<std::unique_ptr<Stage>> openers;
    for (std::size_t i = 0; i < members_.size(); ++i) {
      openers.push_back(std::make_unique<Stage>(fmt::format("v4l2-open-{}", i),
                                                [&, i](const std::stop_token&, Stage&) -> Status {
                                                  opened[i] = members_[i]->Open();
                                                  return {};
                                                }));
    }
    for (const auto& opener : openers) OMNIHDR_TRY(opener->Join());
  }
  std::optional<Error> failure;
  for (Result<CameraInfo>& each : opened) {
    if (each) {
      infos.push_back(std::move(*each));
    } else if (!failure) {
      failure = std::move(each).error();
    } else {
      failure->message += "; " + each.error().message;
      // Looking again later does not help against a wrong configuration.
      if (each.error().kind == ErrorKind::kConfig) failure->kind = ErrorKind::kConfig;
    }
  }
  if (failure) return Forward(std::move(*failure));
  for (std::size_t i = 0; i < members_.size(); ++i) {
    for (std::size_t k = 0; k < i; ++k) {
      if (members_[i]->node() != members_[k]->node()) continue;
      return Fail(ErrorKind::kConfig, "devices[{}], devices[{}]: \"{}\", \"{}\": both are {}", k, i,
                  options_.devices[k], options_.devices[i], members_[i]->node());
    }
  }
  return {};
}

Status V4l2RigCamera::Combine(const std::vector<CameraInfo>& infos) {
  const CameraDescription& first = infos.front().description;
  CameraInfo info;
  info.files = std::move(info_.files);
  info.description = first;
  info.description.model = fmt::format("{} x {}", infos.size(), first.model);
  info.description.serial.clear();
  info.description.height = rows_.back();
  info.shortest = infos.front().shortest;
  info.longest = infos.front().longest;
  info.proof = infos.front().proof;
  Json members = Json::array();
  for (std::size_t i = 0; i < infos.size(); ++i) {
    const CameraInfo& each = infos[i];
    if (each.description.bits != first.bits || each.description.bayer != first.bayer) {
      return Fail(
          ErrorKind::kConfig,
          "{}: {} bits, \"{}\": expected {} bits, \"{}\" as sensor 0 has (camera.v4l2.format)",
          members_[i]->name(), each.description.bits, each.description.bayer, first.bits,
          first.bayer);
    }
    info.description.serial += (i == 0 ? "" : "+") + each.description.serial;
    info.shortest = std::max(info.shortest, each.shortest);
    info.longest = std::min(info.longest, each.longest);
    info.exposure_quantum_s = std::max(info.exposure_quantum_s, each.exposure_quantum_s);
    info.exposure_latency_frames =
        std::max(info.exposure_latency_frames, each.exposure_latency_frames);
    if (Worth(each.proof) < Worth(info.proof)) info.proof = each.proof;
    Json member = {{"device", options_.devices[i]}, {"node", members_[i]->node()}};
    const Json extra = Json::parse(each.extra_json, nullptr, false);
    if (extra.is_object() && extra.contains("v4l2")) member.update(extra["v4l2"]);
    members.push_back(std::move(member));
  }
  if (!(info.shortest < info.longest)) {
    return Fail(ErrorKind::kConfig, "exposures {} to {} s: expected a range that all cameras share",
                info.shortest.seconds(), info.longest.seconds());
  }
  info.extra_json = Json{{"v4l2_rig", members}}.dump();
  info_ = std::move(info);
  HandoverLimits limits = members_.front()->limits();
  for (const auto& member : members_) {
    const HandoverLimits each = member->limits();
    limits.least_gain_db = std::max(limits.least_gain_db, each.least_gain_db);
    limits.most_gain_db = std::min(limits.most_gain_db, each.most_gain_db);
  }
  limits.shortest = info_.shortest;
  limits.longest = info_.longest;
  handover_.Open(std::move(limits));
  return {};
}

void V4l2RigCamera::Close() {
  Stop();
  handover_.Close();
  ForgetMembers();
}

void V4l2RigCamera::ForgetMembers() {
  std::vector<std::unique_ptr<RigMember>> gone;
  std::lock_guard lock(members_mutex_);
  gone.swap(members_);
}

Status V4l2RigCamera::Start() {
  OMNIHDR_ASSIGN(const bool may_start, handover_.MayStart());
  if (!may_start) return {};
  for (const auto& member : members_) {
    if (Status started = member->Start(); !started) {
      for (const auto& each : members_) each->Stop();
      return Forward(std::move(started).error(), "V4L2 rig: start");
    }
  }
  inbox_.Clear();
  sets_.clear();
  handover_.Start("v4l2-rig",
                  [this](const std::stop_token& stop, Stage& stage) { return Run(stop, stage); });
  return {};
}

void V4l2RigCamera::Stop() {
  handover_.Stop([this](bool) {
    for (const auto& member : members_) member->Stop();
  });
}

Status V4l2RigCamera::Trigger(const ExposureRequest& request) { return handover_.Trigger(request); }

void V4l2RigCamera::Prepare(const Exposure& next) {
  std::lock_guard lock(members_mutex_);
  for (const auto& member : members_) member->Prepare(next);
}

Result<CameraFrame> V4l2RigCamera::Receive(Nanoseconds timeout) {
  return handover_.Receive(timeout);
}

V4l2RigCamera::Counts V4l2RigCamera::counts() const {
  std::lock_guard lock(mutex_);
  return counts_;
}

std::vector<CameraCounter> V4l2RigCamera::Counters() const {
  const Counts now = counts();
  std::vector<CameraCounter> counters{{"incomplete_sets", now.incomplete},
                                      {"late_member_frames", now.late_frames},
                                      {"member_departures", now.departures},
                                      {"member_returns", now.returns}};
  std::lock_guard lock(members_mutex_);
  for (std::size_t i = 0; i < members_.size(); ++i) {
    const std::vector<CameraCounter> own = members_[i]->Counters();
    if (i == 0) {
      counters.insert(counters.end(), own.begin(), own.end());
      continue;
    }
    const std::size_t first = counters.size() - own.size();
    for (std::size_t k = 0; k < own.size(); ++k) counters[first + k].value += own[k].value;
  }
  return counters;
}

Status V4l2RigCamera::Run(const std::stop_token& stop, Stage& stage) {
  while (!stop.stop_requested()) {
    stage.Progress();
    if (const auto request = handover_.Take(sets_.empty() ? kIdleLook : Nanoseconds(0), stop)) {
      Begin(*request);
    }
    CommandMembers();
    Collect(sets_.empty() ? Nanoseconds(0) : kBusyLook);
    FindLost();
    // Sets that are whole are delivered even when the last camera has just gone.
    DeliverFinished();
    if (std::string why = AllAway(); !why.empty()) {
      handover_.GoAway(std::move(why));
      return {};
    }
  }
  return {};
}

void V4l2RigCamera::Begin(const ExposureRequest& request) {
  Set set;
  set.request = request;
  set.deadline = clock_.Now() + FromSeconds(request.exposure.time.seconds() +
                                            kPatience * options_.frame_timeout_s);
  set.slots.resize(members_.size());
  sets_.push_back(std::move(set));
}

void V4l2RigCamera::CommandMembers() {
  for (std::size_t i = 0; i < members_.size(); ++i) {
    for (Set& set : sets_) {
      Slot& slot = set.slots[i];
      if (slot.state != Slot::State::kToCommand) continue;
      // Asked before it is commanded: one that leaves in between is found by the difference.
      slot.life = members_[i]->state().life;
      const Status commanded = members_[i]->Trigger(set.request);
      if (commanded) {
        slot.state = Slot::State::kCommanded;
        continue;
      }
      slot.why = commanded.error().message;
      // A later trigger does not overtake this one.
      if (commanded.error().kind == ErrorKind::kTemporary) break;
      slot.state = Slot::State::kMissing;
    }
  }
}

void V4l2RigCamera::Collect(Nanoseconds timeout) {
  for (RigInbox::Arrival& arrival : inbox_.TakeAll(timeout)) {
    const auto set = std::find_if(sets_.begin(), sets_.end(), [&](const Set& each) {
      return each.request.trigger == arrival.frame.trigger;
    });
    if (set == sets_.end() || set->slots[arrival.member].state != Slot::State::kCommanded) {
      std::lock_guard lock(mutex_);
      ++counts_.late_frames;
      continue;
    }
    Slot& slot = set->slots[arrival.member];
    if (arrival.frame.status == FrameStatus::kMissedTrigger) {
      slot.state = Slot::State::kMissing;
      slot.why = std::move(arrival.frame.detail);
    } else {
      slot.state = Slot::State::kHere;
      slot.frame = std::move(arrival.frame);
    }
  }
}

// What was asked of a camera before it left will not come.
void V4l2RigCamera::FindLost() {
  std::size_t away = 0;
  std::uint64_t departures = 0;
  std::uint64_t returns = 0;
  for (std::size_t i = 0; i < members_.size(); ++i) {
    const RigMember::State state = members_[i]->state();
    away += state.present ? 0 : 1;
    departures += state.departures;
    returns += state.returns;
    for (Set& set : sets_) {
      Slot& slot = set.slots[i];
      if (slot.state != Slot::State::kCommanded || slot.life == state.life) continue;
      slot.state = Slot::State::kMissing;
      slot.why = state.present ? "it left and came back" : state.why;
    }
  }
  std::lock_guard lock(mutex_);
  counts_.away = away;
  counts_.departures = departures;
  counts_.returns = returns;
}

void V4l2RigCamera::DeliverFinished() {
  while (!sets_.empty()) {
    Set& set = sets_.front();
    const bool waits = std::any_of(set.slots.begin(), set.slots.end(), [](const Slot& slot) {
      return slot.state == Slot::State::kCommanded || slot.state == Slot::State::kToCommand;
    });
    if (waits && clock_.Now() < set.deadline) return;
    for (Slot& slot : set.slots) {
      if (slot.state == Slot::State::kHere || slot.state == Slot::State::kMissing) continue;
      if (slot.why.empty()) slot.why = "no picture in time";
      slot.state = Slot::State::kMissing;
    }
    handover_.Finish(MakeFrame(set));
    sets_.pop_front();
  }
}

std::uint64_t V4l2RigCamera::Count(const Set& set) {
  std::uint64_t step = 1;
  for (std::size_t i = 0; i < set.slots.size(); ++i) {
    if (set.slots[i].state != Slot::State::kHere) continue;
    const std::uint64_t now = set.slots[i].frame.camera_counter;
    std::optional<std::uint64_t>& last = last_counters_[i];
    // A camera that came back counts from the beginning.
    if (last && now > *last) step = std::max(step, now - *last);
    last = now;
  }
  counter_ += step;
  return counter_;
}

CameraFrame V4l2RigCamera::MakeFrame(Set& set) {
  std::vector<std::string> faults;
  std::vector<const CameraFrame*> here;
  Json settings = Json::array();
  for (std::size_t i = 0; i < set.slots.size(); ++i) {
    const Slot& slot = set.slots[i];
    const std::string which = fmt::format("sensor {} \"{}\"", i, names_[i]);
    if (slot.state != Slot::State::kHere) {
      faults.push_back(fmt::format("{} missing: {}", which, slot.why));
      settings.push_back(nullptr);
      continue;
    }
    const CameraFrame& frame = slot.frame;
    here.push_back(&frame);
    if (frame.status != FrameStatus::kOk) {
      faults.push_back(fmt::format("{}: {}", which, frame.detail));
    } else if (!frame.detail.empty()) {
      faults.push_back(fmt::format("{} unproved: {}", which, frame.detail));
    }
    Json setting = Json::parse(frame.settings_readback_json, nullptr, false);
    if (!setting.is_object()) setting = Json::object();
    setting["proof"] = ToString(frame.proof);
    settings.push_back(std::move(setting));
  }
  const bool complete =
      std::all_of(here.begin(), here.end(),
                  [](const CameraFrame* frame) { return frame->status == FrameStatus::kOk; }) &&
      here.size() == set.slots.size();
  const std::string detail = fmt::format("{}", fmt::join(faults, "; "));
  const std::uint64_t counter = Count(set);
  if (!complete) {
    std::lock_guard lock(mutex_);
    ++counts_.incomplete;
  }
  if (here.empty()) return Handover::Missed(set.request, detail, counter);

  CameraFrame made;
  made.trigger = set.request.trigger;
  made.status = complete ? FrameStatus::kOk : FrameStatus::kCorrupt;
  made.partial = !complete;
  made.detail = complete ? detail : "incomplete: " + detail;
  made.camera_counter = counter;
  made.proof = here.front()->proof;
  made.measured_exposure = here.front()->measured_exposure;
  HostTime first = here.front()->mid_exposure;
  HostTime last = first;
  for (const CameraFrame* frame : here) {
    first = std::min(first, frame->mid_exposure);
    last = std::max(last, frame->mid_exposure);
    if (Worth(frame->proof) < Worth(made.proof)) made.proof = frame->proof;
    if (!made.measured_exposure || !frame->measured_exposure) {
      made.measured_exposure.reset();
    } else if (Distance(*frame->measured_exposure, set.request.exposure) >
               Distance(*made.measured_exposure, set.request.exposure)) {
      made.measured_exposure = frame->measured_exposure;
    }
  }
  made.mid_exposure = first + (last - first) / 2;
  made.settings_readback_json = Json{
      {"sensors", settings},
      {"skew_s", static_cast<double>((last - first).count()) *
                     1e-9}}.dump();
  const auto stack = [&](auto image) {
    for (std::size_t i = 0; i < set.slots.size(); ++i) {
      if (set.slots[i].state != Slot::State::kHere || Place(set.slots[i].frame, rows_[i], image)) {
        continue;
      }
      made.status = FrameStatus::kCorrupt;
      made.partial = true;
      made.detail += fmt::format("; sensor {} \"{}\": a picture of another kind", i, names_[i]);
    }
    made.pixels = std::move(image);
  };
  const int channels =
      std::visit([](const auto& image) { return image.channels(); }, here.front()->pixels);
  if (info_.description.bits > 8) {
    stack(Image<std::uint16_t>(info_.description.width, rows_.back(), channels));
  } else {
    stack(Image<std::uint8_t>(info_.description.width, rows_.back(), channels));
  }
  return made;
}

std::string V4l2RigCamera::AllAway() const {
  std::string why;
  for (const auto& member : members_) {
    const RigMember::State state = member->state();
    if (state.present) return {};
    why += fmt::format("{}{}: {}", why.empty() ? "" : "; ", member->name(), state.why);
  }
  return why;
}

Result<std::unique_ptr<Camera>> MakeKernelV4l2Camera(V4l2CameraOptions options) {
  if (!options.devices.empty()) {
    V4l2RigCamera::MakeSystem make = [](std::size_t) { return MakeKernelSystem(); };
    if (!options.recording.empty()) {
      OMNIHDR_ASSIGN(make, MakeRecordingSystems(std::move(make), options.devices.size(),
                                                {.file = options.recording}));
    }
    return std::unique_ptr<Camera>(
        std::make_unique<V4l2RigCamera>(std::move(options), std::move(make)));
  }
  std::unique_ptr<V4l2System> system = MakeKernelSystem();
  if (!options.recording.empty()) {
    OMNIHDR_ASSIGN(system, MakeRecordingSystem(std::move(system), {.file = options.recording}));
  }
  return std::unique_ptr<Camera>(
      std::make_unique<V4l2Camera>(std::move(options), std::move(system)));
}

}  // namespace omnihdr::v4l2
