#include "drivers/v4l2/recording.h"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "core/base/file.h"
#include "drivers/v4l2/kernel_call.h"
#include "drivers/v4l2/v4l2_camera.h"

namespace omnihdr::v4l2 {
namespace {

using Kind = KernelCall::Kind;
using recording::RecordedCalls;
using recording::RecordingFile;
using recording::RecordingOptions;
using std::chrono::milliseconds;

constexpr std::uint32_t kMostControls = 64;
// What a recording may have mapped at once, whatever it says.
constexpr std::size_t kMostMapped = Stream::kMaxBuffers * (std::size_t{1} << 26);
// Somebody who plays a recording gives the next trigger as soon as the one before is answered, and
// fetches its picture.
constexpr Nanoseconds kTriggerPatience = std::chrono::seconds(2);
constexpr Nanoseconds kReceivePatience = milliseconds(500);

// The bytes of an ioctl's argument, without the pointer that it may hold.
std::vector<std::byte> ArgumentBytes(std::uint32_t request, const void* argument) {
  std::vector<std::byte> bytes(_IOC_SIZE(request));
  std::memcpy(bytes.data(), argument, bytes.size());
  if (HasControls(request)) {
    v4l2_ext_controls group;
    std::memcpy(&group, bytes.data(), sizeof group);
    group.controls = nullptr;
    std::memcpy(bytes.data(), &group, sizeof group);
  }
  return bytes;
}

// The array that it points at.
std::span<std::byte> ControlBytes(std::uint32_t request, void* argument) {
  if (!HasControls(request)) return {};
  auto& group = *static_cast<v4l2_ext_controls*>(argument);
  return std::as_writable_bytes(std::span(group.controls, std::min(group.count, kMostControls)));
}

KernelCall AskedIoctl(std::uint32_t device, unsigned long request, void* argument) {
  KernelCall call;
  call.kind = Kind::kIoctl;
  call.device = device;
  call.request = static_cast<std::uint32_t>(request);
  call.argument = ArgumentBytes(call.request, argument);
  const std::span<const std::byte> controls = ControlBytes(call.request, argument);
  call.controls.assign(controls.begin(), controls.end());
  return call;
}

KernelCall AskedMap(std::uint32_t device, std::size_t length, std::int64_t offset) {
  KernelCall call;
  call.kind = Kind::kMap;
  call.device = device;
  call.length = length;
  call.offset = offset;
  return call;
}

// Which mapped buffer has which number: what VIDIOC_QUERYBUF told, and what was mapped there.
class Buffers {
 public:
  void Told(const KernelCall& call) {
    if (call.request != VIDIOC_QUERYBUF || call.result < 0) return;
    v4l2_buffer buffer{};
    std::memcpy(&buffer, call.argument_after.data(),
                std::min(sizeof buffer, call.argument_after.size()));
    if (offsets_.size() < Stream::kMaxBuffers) offsets_[buffer.index] = buffer.m.offset;
  }
  void Mapped(std::int64_t offset, std::span<std::byte> bytes) { mapped_[offset] = bytes; }
  void Unmapped(const std::byte* data) {
    std::erase_if(mapped_, [data](const auto& each) { return each.second.data() == data; });
    if (mapped_.empty()) offsets_.clear();
  }
  // Empty when there is none.
  std::span<std::byte> Of(const v4l2_buffer& buffer) const {
    const auto offset = offsets_.find(buffer.index);
    if (offset == offsets_.end()) return {};
    const auto found = mapped_.find(offset->second);
    return found == mapped_.end() ? std::span<std::byte>() : found->second;
  }
  std::size_t bytes() const {
    std::size_t sum = 0;
    for (const auto& [offset, bytes] : mapped_) sum += bytes.size();
    return sum;
  }

 private:
  std::map<std::uint32_t, std::int64_t> offsets_;
  std::map<std::int64_t, std::span<std::byte>> mapped_;
};

// ---- recording

class RecordingDevice final : public V4l2Device {
 public:
  RecordingDevice(std::unique_ptr<V4l2Device> device, std::uint32_t number, const Clock& clock,
                  std::shared_ptr<RecordingFile> file)
      : device_(std::move(device)), number_(number), clock_(clock), file_(std::move(file)) {}

  int Open(const std::string& path) override {
    KernelCall call;
    call.kind = Kind::kOpen;
    call.device = number_;
    call.path = path;
    call.result = device_->Open(path);
    return Write(call);
  }
  void Close() override { device_->Close(); }
  int Ioctl(unsigned long request, void* argument) override {
    KernelCall call = AskedIoctl(number_, request, argument);
    call.result = device_->Ioctl(request, argument);
    call.argument_after = ArgumentBytes(call.request, argument);
    call.controls_after = call.controls;
    // As many as were asked for, whatever the count says now.
    const std::span<const std::byte> controls = ControlBytes(call.request, argument);
    std::copy_n(controls.begin(), std::min(controls.size(), call.controls_after.size()),
                call.controls_after.begin());
    buffers_.Told(call);
    if (call.request == VIDIOC_DQBUF && call.result >= 0) {
      const auto& buffer = *static_cast<const v4l2_buffer*>(argument);
      const std::span<const std::byte> bytes = buffers_.Of(buffer);
      call.frame.assign(bytes.begin(),
                        bytes.begin() + static_cast<std::ptrdiff_t>(
                                            std::min(bytes.size(), std::size_t{buffer.bytesused})));
    }
    return Write(call);
  }
  Mapping Map(std::size_t length, std::int64_t offset) override {
    KernelCall call = AskedMap(number_, length, offset);
    const Mapping mapping = device_->Map(length, offset);
    call.result = mapping.data != nullptr ? 0 : std::min(mapping.error, -1);
    if (mapping.data != nullptr) buffers_.Mapped(offset, {mapping.data, length});
    Write(call);
    return mapping;
  }
  void Unmap(std::byte* data, std::size_t length) override {
    buffers_.Unmapped(data);
    device_->Unmap(data, length);
  }
  int WaitForFrame(Nanoseconds timeout) override {
    KernelCall call;
    call.kind = Kind::kWait;
    call.device = number_;
    call.result = device_->WaitForFrame(timeout);
    return Write(call);
  }

  std::optional<Nanoseconds> TriggerPatience() override { return device_->TriggerPatience(); }
  HostTime TookTrigger(const Exposure& exposure, HostTime time) override {
    KernelCall call;
    call.kind = Kind::kTrigger;
    call.device = number_;
    call.exposure = exposure;
    call.trigger_time = device_->TookTrigger(exposure, time);
    Write(call);
    return call.trigger_time;
  }
  std::optional<Exposure> TookHint(std::optional<Exposure> hint) override {
    hint = device_->TookHint(hint);
    if (!hint) return hint;
    KernelCall call;
    call.kind = Kind::kPrepare;
    call.device = number_;
    call.exposure = *hint;
    Write(call);
    return hint;
  }

 private:
  int Write(KernelCall& call) {
    call.at = clock_.Now();
    file_->Write(EncodeCall(call));
    return call.result;
  }

  const std::unique_ptr<V4l2Device> device_;
  const std::uint32_t number_;
  const Clock& clock_;
  const std::shared_ptr<RecordingFile> file_;
  Buffers buffers_;
};

class RecordingSystem final : public V4l2System {
 public:
  RecordingSystem(std::unique_ptr<V4l2System> system, std::shared_ptr<RecordingFile> file)
      : system_(std::move(system)), file_(std::move(file)) {}
  std::vector<V4l2Node> List() override {
    KernelCall call;
    call.nodes = system_->List();
    call.at = clock().Now();
    file_->Write(EncodeCall(call));
    return call.nodes;
  }
  std::unique_ptr<V4l2Device> MakeDevice() override {
    return std::make_unique<RecordingDevice>(system_->MakeDevice(), devices_++, clock(), file_);
  }
  const Clock& clock() const override { return system_->clock(); }

 private:
  const std::unique_ptr<V4l2System> system_;
  const std::shared_ptr<RecordingFile> file_;
  std::uint32_t devices_ = 0;
};

// ---- replaying

// The calls of a recording, one after the other, and its time, which goes on with them.
class PlayedCalls final : public Clock {
 public:
  explicit PlayedCalls(RecordedCalls calls) : calls_(std::move(calls)) { Load(); }

  HostTime Now() const override { return HostTime::FromNanoseconds(now_ns_); }
  UtcTime NowUtc() const override { return SystemClock().NowUtc(); }

  // The recorded answer to a request. An error is what a device would say that has gone, or does
  // not understand; Why tells more.
  std::optional<KernelCall> Answer(const KernelCall& asked, int& error) {
    if (asked.kind == Kind::kIoctl && asked.request == VIDIOC_DQBUF) WaitForReceive();
    std::lock_guard lock(mutex_);
    // A stream that is stopped sooner than the recorded one leaves frames behind.
    if (asked.kind == Kind::kIoctl && asked.request == VIDIOC_STREAMOFF) SkipFrames();
    if (!why_.empty() || !next_) {
      if (why_.empty()) why_ = "the recording has ended";
      error = -ENODEV;
      return std::nullopt;
    }
    if (!next_->AsksTheSame(asked)) {
      why_ = fmt::format("recorded was \"{}\", asked is \"{}\"", next_->Request(), asked.Request());
      error = -EPROTO;
      return std::nullopt;
    }
    return Take();
  }
  // What waiting for a frame gave; nothing comes before a request that is due.
  int Wait(std::uint32_t device, Nanoseconds timeout) {
    WaitForReceive();
    {
      std::lock_guard lock(mutex_);
      if (!why_.empty() || !next_) {
        if (why_.empty()) why_ = "the recording has ended";
        return -ENODEV;
      }
      if (next_->kind == Kind::kWait && next_->device == device) return Take().result;
      now_ns_ += std::max<std::int64_t>(timeout.count(), 0);
    }
    std::this_thread::sleep_for(std::min<Nanoseconds>(timeout, milliseconds(1)));
    return 0;
  }
  bool IsDue(Kind kind, std::uint32_t device) const {
    std::lock_guard lock(mutex_);
    return next_ && next_->kind == kind && next_->device == device;
  }
  // Of a hint that is due.
  Exposure TakeHint() {
    std::lock_guard lock(mutex_);
    return Take().exposure;
  }
  std::string Why() const {
    std::lock_guard lock(mutex_);
    return why_;
  }
  // The picture of a trigger has been fetched.
  void Received() { ++received_; }

 private:
  // A camera that goes takes the pictures along that nobody has fetched, and a recording is played
  // faster than they were then.
  void WaitForReceive() {
    const SystemClock clock;
    const HostTime deadline = clock.Now() + kReceivePatience;
    while (received_ < taken_ && clock.Now() < deadline) {
      {
        std::lock_guard lock(mutex_);
        const bool goes = !next_ || (next_->result < 0 && next_->result != -EAGAIN &&
                                     (next_->kind == Kind::kWait || next_->kind == Kind::kIoctl));
        if (!goes) return;
      }
      std::this_thread::sleep_for(milliseconds(1));
    }
  }
  KernelCall Take() {
    KernelCall taken = std::move(*next_);
    now_ns_ = taken.at.ns();
    if (taken.kind == Kind::kTrigger) ++taken_;
    Load();
    return taken;
  }
  void SkipFrames() {
    while (next_ && (next_->kind == Kind::kWait || next_->kind == Kind::kPrepare ||
                     (next_->kind == Kind::kIoctl &&
                      (next_->request == VIDIOC_DQBUF || next_->request == VIDIOC_QBUF)))) {
      Load();
    }
  }
  // What is no call ends the recording.
  void Load() {
    next_.reset();
    if (const auto call = calls_.Next()) next_ = DecodeCall(*call);
  }

  mutable std::mutex mutex_;
  RecordedCalls calls_;
  std::optional<KernelCall> next_;
  std::string why_;  // nothing goes on
  std::atomic<std::int64_t> now_ns_ = 0;
  std::atomic<std::uint64_t> taken_ = 0;     // triggers
  std::atomic<std::uint64_t> received_ = 0;  // of their pictures
};

class ReplayingDevice final : public V4l2Device {
 public:
  ReplayingDevice(std::uint32_t number, std::shared_ptr<PlayedCalls> calls)
      : number_(number), calls_(std::move(calls)) {}

  int Open(const std::string& path) override {
    KernelCall asked;
    asked.kind = Kind::kOpen;
    asked.device = number_;
    asked.path = path;
    int error = 0;
    const std::optional<KernelCall> answer = calls_->Answer(asked, error);
    return answer ? answer->result : error;
  }
  void Close() override {}
  int Ioctl(unsigned long request, void* argument) override {
    int error = 0;
    const auto answer = calls_->Answer(AskedIoctl(number_, request, argument), error);
    if (!answer) return error;
    // The pointer stays the caller's own.
    const std::span<std::byte> controls = ControlBytes(answer->request, argument);
    std::copy_n(answer->controls_after.begin(),
                std::min(controls.size(), answer->controls_after.size()), controls.begin());
    v4l2_ext_control* const own = HasControls(answer->request)
                                      ? static_cast<v4l2_ext_controls*>(argument)->controls
                                      : nullptr;
    std::memcpy(argument, answer->argument_after.data(), answer->argument_after.size());
    if (own != nullptr) static_cast<v4l2_ext_controls*>(argument)->controls = own;
    buffers_.Told(*answer);
    if (answer->request == VIDIOC_DQBUF && answer->result >= 0) {
      const std::span<std::byte> to = buffers_.Of(*static_cast<const v4l2_buffer*>(argument));
      std::copy_n(answer->frame.begin(), std::min(answer->frame.size(), to.size()), to.begin());
    }
    return answer->result;
  }
  Mapping Map(std::size_t length, std::int64_t offset) override {
    int error = 0;
    const auto answer = calls_->Answer(AskedMap(number_, length, offset), error);
    if (!answer) return {nullptr, error};
    if (answer->result < 0) return {nullptr, answer->result};
    if (length == 0 || length > kMostMapped - std::min(kMostMapped, buffers_.bytes())) {
      return {nullptr, -ENOMEM};
    }
    auto* data = static_cast<std::byte*>(std::calloc(length, 1));
    if (data == nullptr) return {nullptr, -ENOMEM};
    buffers_.Mapped(offset, {data, length});
    return {data, 0};
  }
  void Unmap(std::byte* data, std::size_t /*length*/) override {
    buffers_.Unmapped(data);
    std::free(data);
  }
  int WaitForFrame(Nanoseconds timeout) override { return calls_->Wait(number_, timeout); }

  std::optional<Nanoseconds> TriggerPatience() override {
    if (!calls_->IsDue(Kind::kTrigger, number_)) return std::nullopt;
    return kTriggerPatience;
  }
  HostTime TookTrigger(const Exposure& exposure, HostTime time) override {
    KernelCall asked;
    asked.kind = Kind::kTrigger;
    asked.device = number_;
    asked.exposure = exposure;
    int error = 0;
    const auto answer = calls_->Answer(asked, error);
    return answer ? answer->trigger_time : time;
  }
  std::optional<Exposure> TookHint(std::optional<Exposure> /*hint*/) override {
    if (!calls_->IsDue(Kind::kPrepare, number_)) return std::nullopt;
    return calls_->TakeHint();
  }

 private:
  const std::uint32_t number_;
  const std::shared_ptr<PlayedCalls> calls_;
  Buffers buffers_;
};

class ReplayingSystem final : public V4l2System {
 public:
  explicit ReplayingSystem(std::shared_ptr<PlayedCalls> calls) : calls_(std::move(calls)) {}
  std::vector<V4l2Node> List() override {
    int error = 0;
    std::optional<KernelCall> answer = calls_->Answer(KernelCall{}, error);
    return answer ? std::move(answer->nodes) : std::vector<V4l2Node>();
  }
  std::unique_ptr<V4l2Device> MakeDevice() override {
    return std::make_unique<ReplayingDevice>(devices_++, calls_);
  }
  const Clock& clock() const override { return *calls_; }
  std::string why() const override { return calls_->Why(); }

 private:
  const std::shared_ptr<PlayedCalls> calls_;
  std::uint32_t devices_ = 0;
};

// The camera, whose errors also say where it left the recording.
class ReplayedCamera final : public Camera {
 public:
  ReplayedCamera(const V4l2CameraOptions& options, std::shared_ptr<PlayedCalls> calls)
      : calls_(std::move(calls)), camera_(options, std::make_unique<ReplayingSystem>(calls_)) {}
  Result<CameraInfo> Open() override { return Explained(camera_.Open()); }
  void Close() override { camera_.Close(); }
  Status Start() override { return Explained(camera_.Start()); }
  void Stop() override { camera_.Stop(); }
  Status Trigger(const ExposureRequest& request) override {
    return Explained(camera_.Trigger(request));
  }
  void Prepare(const Exposure& /*next*/) override {}
  Result<CameraFrame> Receive(Nanoseconds timeout) override {
    Result<CameraFrame> frame = camera_.Receive(timeout);
    if (frame) calls_->Received();
    if (frame && frame->status == FrameStatus::kMissedTrigger && !calls_->Why().empty()) {
      return Explained<CameraFrame>(Fail(ErrorKind::kProtocol, "{}", frame->detail));
    }
    return Explained(std::move(frame));
  }
  std::vector<CameraCounter> Counters() const override { return camera_.Counters(); }

 private:
  template <typename T>
  Result<T> Explained(Result<T> result) const {
    if (result) return result;
    const std::string why = calls_->Why();
    if (why.empty()) return result;
    Error error = std::move(result).error();
    // Once it has left the recording, nothing comes any more.
    if (error.kind == ErrorKind::kTemporary) error.kind = ErrorKind::kProtocol;
    error.message += ": " + why;
    return Forward(std::move(error));
  }

  const std::shared_ptr<PlayedCalls> calls_;
  V4l2Camera camera_;
};

Result<std::shared_ptr<PlayedCalls>> ReadCalls(std::vector<std::byte> recording) {
  OMNIHDR_ASSIGN(RecordedCalls calls,
                 RecordedCalls::Read(std::move(recording), kKernelCallMagic, "V4L2 calls"));
  return std::make_shared<PlayedCalls>(std::move(calls));
}

}  // namespace

Result<std::unique_ptr<V4l2System>> MakeRecordingSystem(std::unique_ptr<V4l2System> system,
                                                        const RecordingOptions& options) {
  auto file = std::make_shared<RecordingFile>(options, kKernelCallMagic);
  OMNIHDR_TRY(file->Begin().Context("V4L2 recording"));
  return std::unique_ptr<V4l2System>(
      std::make_unique<RecordingSystem>(std::move(system), std::move(file)));
}

std::filesystem::path RecordingOfMember(const std::filesystem::path& file, std::size_t member) {
  std::filesystem::path path = file;
  path += fmt::format(".{}", member);
  return path;
}

Result<V4l2RigCamera::MakeSystem> MakeRecordingSystems(V4l2RigCamera::MakeSystem make,
                                                       std::size_t members,
                                                       const RecordingOptions& options) {
  std::vector<std::shared_ptr<RecordingFile>> files;
  for (std::size_t i = 0; i < members; ++i) {
    RecordingOptions own = options;
    own.file = RecordingOfMember(options.file, i);
    files.push_back(std::make_shared<RecordingFile>(std::move(own), kKernelCallMagic));
    OMNIHDR_TRY(files.back()->Begin().Context("V4L2 recording"));
  }
  // A rig that is opened again goes on with its files.
  return V4l2RigCamera::MakeSystem(
      [make = std::move(make), files = std::move(files)](std::size_t member) {
        return std::unique_ptr<V4l2System>(
            std::make_unique<RecordingSystem>(make(member), files.at(member)));
      });
}

Result<std::unique_ptr<V4l2System>> MakeReplayingSystem(std::vector<std::byte> recording) {
  OMNIHDR_ASSIGN(std::shared_ptr<PlayedCalls> calls, ReadCalls(std::move(recording)));
  return std::unique_ptr<V4l2System>(std::make_unique<ReplayingSystem>(std::move(calls)));
}

Result<std::unique_ptr<Camera>> MakeReplayedCamera(const V4l2CameraOptions& options,
                                                   std::vector<std::byte> recording) {
  OMNIHDR_ASSIGN(std::shared_ptr<PlayedCalls> calls, ReadCalls(std::move(recording)));
  return std::unique_ptr<Camera>(std::make_unique<ReplayedCamera>(options, std::move(calls)));
}

Result<std::unique_ptr<Camera>> MakeReplayedRig(const V4l2CameraOptions& options,
                                                std::vector<std::vector<std::byte>> recordings) {
  if (recordings.size() != options.devices.size()) {
    return Fail(ErrorKind::kData, "{} recordings: expected {}, one for each of devices",
                recordings.size(), options.devices.size());
  }
  std::vector<std::shared_ptr<PlayedCalls>> calls;
  for (std::vector<std::byte>& recording : recordings) {
    OMNIHDR_ASSIGN(auto each, ReadCalls(std::move(recording)));
    calls.push_back(std::move(each));
  }
  return std::unique_ptr<Camera>(std::make_unique<V4l2RigCamera>(
      options, [calls = std::move(calls)](std::size_t member) -> std::unique_ptr<V4l2System> {
        return std::make_unique<ReplayingSystem>(calls.at(member));
      }));
}

Result<std::unique_ptr<Camera>> MakeReplayedCamera(const V4l2CameraOptions& options,
                                                   const std::filesystem::path& file) {
  if (!options.devices.empty()) {
    std::vector<std::vector<std::byte>> recordings;
    for (std::size_t i = 0; i < options.devices.size(); ++i) {
      OMNIHDR_ASSIGN(std::vector<std::byte> bytes, ReadFile(RecordingOfMember(file, i)));
      recordings.push_back(std::move(bytes));
    }
    return MakeReplayedRig(options, std::move(recordings)).Context(file.string());
  }
  OMNIHDR_ASSIGN(std::vector<std::byte> bytes, ReadFile(file));
  return MakeReplayedCamera(options, std::move(bytes)).Context(file.string());
}

}  // namespace omnihdr::v4l2
