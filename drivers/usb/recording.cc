#include "drivers/usb/recording.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <mutex>
#include <thread>
#include <utility>

#include "core/base/file.h"
#include "drivers/usb/recording_format.h"

namespace omnihdr::usb {
namespace {

using Kind = RecordedCall::Kind;

template <typename T>
std::optional<Error> ErrorOf(const Result<T>& result) {
  if (result) return std::nullopt;
  return result.error();
}

// ---- recording

using recording::RecordingFile;

void Write(RecordingFile& file, const RecordedCall& call) { file.Write(EncodeCall(call)); }

class RecordingStream final : public BulkStream {
 public:
  RecordingStream(std::unique_ptr<BulkStream> stream, std::shared_ptr<RecordingFile> file)
      : stream_(std::move(stream)), file_(std::move(file)) {}
  Result<BulkChunk> Next(Nanoseconds timeout) override {
    Result<BulkChunk> chunk = stream_->Next(timeout);
    if (chunk || chunk.error().kind != ErrorKind::kTemporary) {
      RecordedCall call;
      call.kind = Kind::kChunk;
      call.error = ErrorOf(chunk);
      if (chunk) call.chunk = *chunk;
      Write(*file_, call);
    }
    return chunk;
  }
  void Recycle(BulkChunk chunk) override { stream_->Recycle(std::move(chunk)); }
  void Stop(Nanoseconds quiet, Nanoseconds limit) override {
    RecordedCall call;
    call.kind = Kind::kStopStream;
    Write(*file_, call);
    stream_->Stop(quiet, limit);
  }

 private:
  const std::unique_ptr<BulkStream> stream_;
  const std::shared_ptr<RecordingFile> file_;
};

class RecordingDevice final : public Device {
 public:
  RecordingDevice(std::unique_ptr<Device> device, std::shared_ptr<RecordingFile> file)
      : device_(std::move(device)), file_(std::move(file)) {}
  const DeviceInfo& info() const override { return device_->info(); }
  Status VendorIn(const ControlSetup& setup, std::span<std::byte> data,
                  Nanoseconds timeout) override {
    Status status = device_->VendorIn(setup, data, timeout);
    RecordedCall call;
    call.kind = Kind::kIn;
    call.setup = setup;
    call.number = static_cast<std::uint32_t>(data.size());
    call.error = ErrorOf(status);
    if (status) call.received.assign(data.begin(), data.end());
    Write(*file_, call);
    return status;
  }
  Status VendorOut(const ControlSetup& setup, std::span<const std::byte> data,
                   Nanoseconds timeout) override {
    Status status = device_->VendorOut(setup, data, timeout);
    RecordedCall call;
    call.kind = Kind::kOut;
    call.setup = setup;
    call.sent.assign(data.begin(), data.end());
    call.error = ErrorOf(status);
    Write(*file_, call);
    return status;
  }
  Result<int> PacketBytes(std::uint8_t endpoint) override {
    Result<int> bytes = device_->PacketBytes(endpoint);
    RecordedCall call;
    call.kind = Kind::kPacketBytes;
    call.number = endpoint;
    call.error = ErrorOf(bytes);
    call.result = static_cast<std::uint32_t>(bytes.value_or(0));
    Write(*file_, call);
    return bytes;
  }
  Result<std::unique_ptr<BulkStream>> StartStream(const BulkStreamOptions& options) override {
    Result<std::unique_ptr<BulkStream>> stream = device_->StartStream(options);
    RecordedCall call;
    call.kind = Kind::kStartStream;
    call.number = options.endpoint;
    call.error = ErrorOf(stream);
    Write(*file_, call);
    if (!stream) return stream;
    return std::unique_ptr<BulkStream>(
        std::make_unique<RecordingStream>(std::move(*stream), file_));
  }

 private:
  const std::unique_ptr<Device> device_;
  const std::shared_ptr<RecordingFile> file_;
};

class RecordingBus final : public Bus {
 public:
  RecordingBus(std::shared_ptr<Bus> bus, const RecordingOptions& options)
      : bus_(std::move(bus)), file_(std::make_shared<RecordingFile>(options, kRecordingMagic)) {}
  Result<std::vector<DeviceInfo>> List() override {
    OMNIHDR_TRY(file_->Begin().Context("USB recording"));
    Result<std::vector<DeviceInfo>> devices = bus_->List();
    RecordedCall call;
    call.kind = Kind::kList;
    call.error = ErrorOf(devices);
    if (devices) call.devices = *devices;
    Write(*file_, call);
    return devices;
  }
  Result<std::unique_ptr<Device>> Open(const DeviceInfo& device) override {
    Result<std::unique_ptr<Device>> opened = bus_->Open(device);
    RecordedCall call;
    call.kind = Kind::kOpen;
    call.device = device;
    call.error = ErrorOf(opened);
    Write(*file_, call);
    if (!opened) return opened;
    return std::unique_ptr<Device>(std::make_unique<RecordingDevice>(std::move(*opened), file_));
  }

 private:
  const std::shared_ptr<Bus> bus_;
  const std::shared_ptr<RecordingFile> file_;
};

// ---- replaying

// The calls of a recording, one after the other; chunks lie among them where they came.
class Recording {
 public:
  explicit Recording(recording::RecordedCalls calls) : calls_(std::move(calls)) {}
  static Result<std::shared_ptr<Recording>> Read(std::vector<std::byte> bytes) {
    OMNIHDR_ASSIGN(auto calls, recording::RecordedCalls::Read(std::move(bytes), kRecordingMagic,
                                                              "USB requests"));
    auto recording = std::make_shared<Recording>(std::move(calls));
    recording->Load();
    return recording;
  }

  // Requires a request, not a chunk.
  Result<RecordedCall> Answer(const RecordedCall& asked) {
    std::lock_guard lock(mutex_);
    // Chunks that nobody waited for: the stream was stopped, or not read on.
    while (next_ && next_->kind == Kind::kChunk) Load();
    if (!next_) return Fail(ErrorKind::kUnavailable, "the recording has ended");
    if (next_->kind != asked.kind || next_->Request() != asked.Request()) {
      return Fail(ErrorKind::kProtocol, "recorded was \"{}\", asked is \"{}\"", next_->Request(),
                  asked.Request());
    }
    RecordedCall answer = std::move(*next_);
    Load();
    if (answer.error) return Forward(*answer.error);
    return answer;
  }
  // The chunk that is due; nothing when a request comes first.
  Result<std::optional<BulkChunk>> Chunk() {
    std::lock_guard lock(mutex_);
    if (!next_) return Fail(ErrorKind::kUnavailable, "the recording has ended");
    if (next_->kind != Kind::kChunk) return std::optional<BulkChunk>();
    RecordedCall answer = std::move(*next_);
    Load();
    if (answer.error) return Forward(*answer.error);
    answer.chunk.arrived = SystemClock().Now();
    return std::optional<BulkChunk>(std::move(answer.chunk));
  }

 private:
  // What is no call ends the recording.
  void Load() {
    next_.reset();
    if (const auto call = calls_.Next()) next_ = DecodeCall(*call);
  }

  std::mutex mutex_;
  recording::RecordedCalls calls_;
  std::optional<RecordedCall> next_;
};

class ReplayingStream final : public BulkStream {
 public:
  explicit ReplayingStream(std::shared_ptr<Recording> recording)
      : recording_(std::move(recording)) {}
  Result<BulkChunk> Next(Nanoseconds timeout) override {
    if (stopped_) return Fail(ErrorKind::kUnavailable, "stream: stopped");
    OMNIHDR_ASSIGN(std::optional<BulkChunk> chunk, recording_->Chunk());
    if (chunk) return std::move(*chunk);
    // Requests are made by the thread that waits here: nothing comes in the meantime.
    std::this_thread::sleep_for(std::min<Nanoseconds>(timeout, std::chrono::milliseconds(1)));
    return Fail(ErrorKind::kTemporary, "stream: nothing recorded before the next request");
  }
  void Recycle(BulkChunk) override {}
  void Stop(Nanoseconds, Nanoseconds) override {
    if (std::exchange(stopped_, true)) return;
    RecordedCall asked;
    asked.kind = Kind::kStopStream;
    // A recording that went on differently says so at the next request.
    static_cast<void>(recording_->Answer(asked));
  }

 private:
  const std::shared_ptr<Recording> recording_;
  bool stopped_ = false;
};

class ReplayingDevice final : public Device {
 public:
  ReplayingDevice(DeviceInfo info, std::shared_ptr<Recording> recording)
      : info_(std::move(info)), recording_(std::move(recording)) {}
  const DeviceInfo& info() const override { return info_; }
  bool live() const override { return false; }
  Status VendorIn(const ControlSetup& setup, std::span<std::byte> data, Nanoseconds) override {
    RecordedCall asked;
    asked.kind = Kind::kIn;
    asked.setup = setup;
    asked.number = static_cast<std::uint32_t>(data.size());
    OMNIHDR_ASSIGN(const RecordedCall answer, recording_->Answer(asked));
    if (answer.received.size() != data.size()) {
      return Fail(ErrorKind::kProtocol, "{} bytes recorded: expected {}", answer.received.size(),
                  data.size());
    }
    std::copy(answer.received.begin(), answer.received.end(), data.begin());
    return {};
  }
  Status VendorOut(const ControlSetup& setup, std::span<const std::byte> data,
                   Nanoseconds) override {
    RecordedCall asked;
    asked.kind = Kind::kOut;
    asked.setup = setup;
    asked.sent.assign(data.begin(), data.end());
    OMNIHDR_TRY(recording_->Answer(asked));
    return {};
  }
  Result<int> PacketBytes(std::uint8_t endpoint) override {
    RecordedCall asked;
    asked.kind = Kind::kPacketBytes;
    asked.number = endpoint;
    OMNIHDR_ASSIGN(const RecordedCall answer, recording_->Answer(asked));
    if (answer.result < 1 || answer.result > 65536) {
      return Fail(ErrorKind::kProtocol, "packets of {} bytes recorded", answer.result);
    }
    return static_cast<int>(answer.result);
  }
  Result<std::unique_ptr<BulkStream>> StartStream(const BulkStreamOptions& options) override {
    RecordedCall asked;
    asked.kind = Kind::kStartStream;
    asked.number = options.endpoint;
    OMNIHDR_TRY(recording_->Answer(asked));
    return std::unique_ptr<BulkStream>(std::make_unique<ReplayingStream>(recording_));
  }

 private:
  const DeviceInfo info_;
  const std::shared_ptr<Recording> recording_;
};

class ReplayingBus final : public Bus {
 public:
  explicit ReplayingBus(std::shared_ptr<Recording> recording) : recording_(std::move(recording)) {}
  Result<std::vector<DeviceInfo>> List() override {
    OMNIHDR_ASSIGN(RecordedCall answer, recording_->Answer(RecordedCall{}));
    return std::move(answer.devices);
  }
  Result<std::unique_ptr<Device>> Open(const DeviceInfo& device) override {
    RecordedCall asked;
    asked.kind = Kind::kOpen;
    asked.device = device;
    OMNIHDR_TRY(recording_->Answer(asked));
    return std::unique_ptr<Device>(std::make_unique<ReplayingDevice>(device, recording_));
  }

 private:
  const std::shared_ptr<Recording> recording_;
};

}  // namespace

std::unique_ptr<Bus> MakeRecordingBus(std::shared_ptr<Bus> bus, const RecordingOptions& options) {
  return std::make_unique<RecordingBus>(std::move(bus), options);
}

Result<std::unique_ptr<Bus>> MakeReplayingBus(std::vector<std::byte> recording) {
  OMNIHDR_ASSIGN(auto calls, Recording::Read(std::move(recording)));
  return std::unique_ptr<Bus>(std::make_unique<ReplayingBus>(std::move(calls)));
}

Result<std::unique_ptr<Bus>> MakeReplayingBus(const std::filesystem::path& file) {
  OMNIHDR_ASSIGN(std::vector<std::byte> bytes, ReadFile(file));
  return MakeReplayingBus(std::move(bytes)).Context(file.string());
}

}  // namespace omnihdr::usb
