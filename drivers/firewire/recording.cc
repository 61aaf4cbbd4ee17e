#include "drivers/firewire/recording.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <deque>
#include <thread>
#include <utility>

#include "core/base/file.h"
#include "drivers/firewire/recording_format.h"

namespace omnihdr::firewire {
namespace {

using Kind = RecordedCall::Kind;
using recording::RecordedCalls;
using recording::RecordingFile;

template <typename T>
std::optional<Error> ErrorOf(const Result<T>& result) {
  if (result) return std::nullopt;
  return result.error();
}

RecordedCall Asked(Kind kind, std::uint32_t number = 0) {
  RecordedCall call;
  call.kind = kind;
  call.number = number;
  return call;
}

RecordedCall AskedRead(std::uint64_t address, std::size_t quadlets) {
  RecordedCall call = Asked(Kind::kRead, static_cast<std::uint32_t>(quadlets));
  call.address = address;
  return call;
}

RecordedCall AskedWrite(std::uint64_t address, std::uint32_t value) {
  RecordedCall call = Asked(Kind::kWrite, value);
  call.address = address;
  return call;
}

RecordedCall AskedReceive(const IsoOptions& options) {
  RecordedCall call = Asked(Kind::kStartReceive, static_cast<std::uint32_t>(options.channel));
  call.packet_bytes = static_cast<std::uint32_t>(options.packet_bytes);
  return call;
}

// ---- recording

class RecordingNode final : public Node {
 public:
  RecordingNode(std::unique_ptr<Node> node, std::shared_ptr<RecordingFile> file)
      : node_(std::move(node)), file_(std::move(file)) {}
  NodeInfo info() const override { return node_->info(); }
  bool live() const override { return node_->live(); }
  std::string detail() const override { return node_->detail(); }
  Answer Read(std::uint64_t address, std::span<std::uint32_t> quadlets,
              Nanoseconds timeout) override {
    RecordedCall call = AskedRead(address, quadlets.size());
    call.answer = node_->Read(address, quadlets, timeout);
    if (call.answer == Answer::kComplete) call.quadlets.assign(quadlets.begin(), quadlets.end());
    return Write(call);
  }
  Answer Write(std::uint64_t address, std::uint32_t value, Nanoseconds timeout) override {
    RecordedCall call = AskedWrite(address, value);
    call.answer = node_->Write(address, value, timeout);
    return Write(call);
  }
  bool WasReset() override {
    const bool was = node_->WasReset();
    if (was) Write(Asked(Kind::kReset));
    return was;
  }
  Answer Refresh(Nanoseconds timeout) override {
    RecordedCall call = Asked(Kind::kRefresh);
    call.answer = node_->Refresh(timeout);
    call.speed = node_->speed();
    return Write(call);
  }
  int speed() const override { return node_->speed(); }

  Status AllocateChannel(int channel) override {
    return Write(Asked(Kind::kAllocateChannel, static_cast<std::uint32_t>(channel)),
                 node_->AllocateChannel(channel));
  }
  Status AllocateBandwidth(int units) override {
    return Write(Asked(Kind::kAllocateBandwidth, static_cast<std::uint32_t>(units)),
                 node_->AllocateBandwidth(units));
  }
  void ReleaseChannel(int channel) override {
    Write(Asked(Kind::kReleaseChannel, static_cast<std::uint32_t>(channel)));
    node_->ReleaseChannel(channel);
  }
  void ReleaseBandwidth(int units) override {
    Write(Asked(Kind::kReleaseBandwidth, static_cast<std::uint32_t>(units)));
    node_->ReleaseBandwidth(units);
  }

  Status StartReceive(const IsoOptions& options) override {
    return Write(AskedReceive(options), node_->StartReceive(options));
  }
  Result<IsoBatch> Receive(Nanoseconds timeout) override {
    Result<IsoBatch> batch = node_->Receive(timeout);
    if (batch || batch.error().kind != ErrorKind::kTemporary) {
      RecordedCall call = Asked(Kind::kBatch);
      call.error = ErrorOf(batch);
      if (batch) call.batch = *batch;
      Write(call);
    }
    return batch;
  }
  void StopReceive() override {
    Write(Asked(Kind::kStopReceive));
    node_->StopReceive();
  }

 private:
  Answer Write(const RecordedCall& call) {
    file_->Write(EncodeCall(call));
    return call.answer;
  }
  Status Write(RecordedCall call, Status status) {
    call.error = ErrorOf(status);
    Write(call);
    return status;
  }

  const std::unique_ptr<Node> node_;
  const std::shared_ptr<RecordingFile> file_;
};

class RecordingBus final : public Bus {
 public:
  RecordingBus(std::shared_ptr<Bus> bus, const RecordingOptions& options)
      : bus_(std::move(bus)), file_(std::make_shared<RecordingFile>(options, kRecordingMagic)) {}
  Result<std::vector<NodeInfo>> List() override {
    OMNIHDR_TRY(file_->Begin().Context("FireWire recording"));
    Result<std::vector<NodeInfo>> nodes = bus_->List();
    RecordedCall call;
    call.error = ErrorOf(nodes);
    if (nodes) call.nodes = *nodes;
    file_->Write(EncodeCall(call));
    return nodes;
  }
  Result<std::unique_ptr<Node>> Open(const NodeInfo& info) override {
    Result<std::unique_ptr<Node>> opened = bus_->Open(info);
    RecordedCall call = Asked(Kind::kOpen);
    call.node = info;
    call.error = ErrorOf(opened);
    if (opened) call.speed = (*opened)->speed();
    file_->Write(EncodeCall(call));
    if (!opened) return opened;
    return std::unique_ptr<Node>(std::make_unique<RecordingNode>(std::move(*opened), file_));
  }

 private:
  const std::shared_ptr<Bus> bus_;
  const std::shared_ptr<RecordingFile> file_;
};

// ---- replaying

// The calls of a recording that are still to come. One thread, as its nodes.
class Recording {
 public:
  explicit Recording(RecordedCalls calls) : calls_(std::move(calls)) {}

  // The recorded answer to a request.
  Result<RecordedCall> Answer(const RecordedCall& asked) {
    std::size_t at = 0;
    while (Load(at)) {
      if (ahead_[at].IsAccess() != asked.IsAccess()) {
        ++at;
      } else if (ahead_[at].IsEvent()) {
        // Nobody waited for it: the stream was stopped, or not read on.
        ahead_.erase(ahead_.begin() + static_cast<std::ptrdiff_t>(at));
      } else {
        break;
      }
    }
    if (at >= ahead_.size()) return Say(ErrorKind::kUnavailable, "the recording has ended");
    const RecordedCall& next = ahead_[at];
    if (next.kind != asked.kind || next.Request() != asked.Request()) {
      return Say(ErrorKind::kProtocol, fmt::format("recorded was \"{}\", asked is \"{}\"",
                                                   next.Request(), asked.Request()));
    }
    return Take(at);
  }
  // The event that is due, if it is of this kind.
  std::optional<RecordedCall> Event(Kind kind) {
    if (!Load(0) || ahead_.front().kind != kind) return std::nullopt;
    return Take(0);
  }
  bool ended() { return !Load(0); }
  // Why nothing goes on; empty = it does.
  const std::string& why() const { return why_; }

 private:
  RecordedCall Take(std::size_t at) {
    RecordedCall taken = std::move(ahead_[at]);
    ahead_.erase(ahead_.begin() + static_cast<std::ptrdiff_t>(at));
    return taken;
  }
  tl::unexpected<Error> Say(ErrorKind kind, std::string why) {
    why_ = why;
    return Forward(Error{kind, std::move(why)});
  }
  // Whether there is a call so far ahead. What is no call ends the recording.
  bool Load(std::size_t at) {
    while (!ended_ && ahead_.size() <= at) {
      const auto bytes = calls_.Next();
      std::optional<RecordedCall> call;
      if (bytes) call = DecodeCall(*bytes);
      ended_ = !call;
      if (call) ahead_.push_back(std::move(*call));
    }
    return ahead_.size() > at;
  }

  RecordedCalls calls_;
  std::deque<RecordedCall> ahead_;
  bool ended_ = false;
  std::string why_;
};

class ReplayingNode final : public Node {
 public:
  ReplayingNode(const NodeInfo& info, int speed, std::shared_ptr<Recording> recording)
      : info_(info), speed_(speed), recording_(std::move(recording)) {}
  NodeInfo info() const override { return info_; }
  bool live() const override { return false; }
  std::string detail() const override { return recording_->why(); }
  firewire::Answer Read(std::uint64_t address, std::span<std::uint32_t> quadlets,
                        Nanoseconds) override {
    const Result<RecordedCall> answer = recording_->Answer(AskedRead(address, quadlets.size()));
    if (!answer) return AnswerTo(answer.error());
    if (answer->answer != Answer::kComplete) return answer->answer;
    if (answer->quadlets.size() != quadlets.size()) return Answer::kFailed;
    std::copy(answer->quadlets.begin(), answer->quadlets.end(), quadlets.begin());
    return Answer::kComplete;
  }
  firewire::Answer Write(std::uint64_t address, std::uint32_t value, Nanoseconds) override {
    const Result<RecordedCall> answer = recording_->Answer(AskedWrite(address, value));
    return answer ? answer->answer : AnswerTo(answer.error());
  }
  bool WasReset() override { return recording_->Event(Kind::kReset).has_value(); }
  firewire::Answer Refresh(Nanoseconds) override {
    const Result<RecordedCall> answer = recording_->Answer(Asked(Kind::kRefresh));
    if (!answer) return Answer::kGone;
    speed_ = answer->speed;
    return answer->answer;
  }
  int speed() const override { return speed_; }

  Status AllocateChannel(int channel) override {
    return Ask(Asked(Kind::kAllocateChannel, static_cast<std::uint32_t>(channel)));
  }
  Status AllocateBandwidth(int units) override {
    return Ask(Asked(Kind::kAllocateBandwidth, static_cast<std::uint32_t>(units)));
  }
  // A recording that went on differently says so at the next request.
  void ReleaseChannel(int channel) override {
    static_cast<void>(Ask(Asked(Kind::kReleaseChannel, static_cast<std::uint32_t>(channel))));
  }
  void ReleaseBandwidth(int units) override {
    static_cast<void>(Ask(Asked(Kind::kReleaseBandwidth, static_cast<std::uint32_t>(units))));
  }

  Status StartReceive(const IsoOptions& options) override { return Ask(AskedReceive(options)); }
  Result<IsoBatch> Receive(Nanoseconds timeout) override {
    if (std::optional<RecordedCall> due = recording_->Event(Kind::kBatch)) {
      if (due->error) return Forward(*due->error);
      due->batch.arrived = SystemClock().Now();
      return std::move(due->batch);
    }
    if (recording_->ended()) {
      return Fail(ErrorKind::kUnavailable, "the recording has ended");
    }
    // Requests are made by the thread that waits here: nothing comes in the meantime.
    std::this_thread::sleep_for(std::min<Nanoseconds>(timeout, std::chrono::milliseconds(1)));
    return Fail(ErrorKind::kTemporary, "nothing recorded before the next request");
  }
  void StopReceive() override { static_cast<void>(Ask(Asked(Kind::kStopReceive))); }

 private:
  static firewire::Answer AnswerTo(const Error& error) {
    return error.kind == ErrorKind::kUnavailable ? Answer::kGone : Answer::kFailed;
  }
  Status Ask(const RecordedCall& asked) {
    OMNIHDR_ASSIGN(const RecordedCall answer, recording_->Answer(asked));
    if (answer.error) return Forward(*answer.error);
    return {};
  }

  const NodeInfo info_;
  int speed_;
  const std::shared_ptr<Recording> recording_;
};

class ReplayingBus final : public Bus {
 public:
  explicit ReplayingBus(std::shared_ptr<Recording> recording) : recording_(std::move(recording)) {}
  Result<std::vector<NodeInfo>> List() override {
    OMNIHDR_ASSIGN(RecordedCall answer, recording_->Answer(RecordedCall{}));
    if (answer.error) return Forward(*answer.error);
    return std::move(answer.nodes);
  }
  Result<std::unique_ptr<Node>> Open(const NodeInfo& info) override {
    RecordedCall asked = Asked(Kind::kOpen);
    asked.node = info;
    OMNIHDR_ASSIGN(const RecordedCall answer, recording_->Answer(asked));
    if (answer.error) return Forward(*answer.error);
    return std::unique_ptr<Node>(std::make_unique<ReplayingNode>(info, answer.speed, recording_));
  }

 private:
  const std::shared_ptr<Recording> recording_;
};

}  // namespace

std::unique_ptr<Bus> MakeRecordingBus(std::shared_ptr<Bus> bus, const RecordingOptions& options) {
  return std::make_unique<RecordingBus>(std::move(bus), options);
}

Result<std::unique_ptr<Bus>> MakeReplayingBus(std::vector<std::byte> recording) {
  OMNIHDR_ASSIGN(auto calls,
                 RecordedCalls::Read(std::move(recording), kRecordingMagic, "FireWire requests"));
  return std::unique_ptr<Bus>(
      std::make_unique<ReplayingBus>(std::make_shared<Recording>(std::move(calls))));
}

Result<std::unique_ptr<Bus>> MakeReplayingBus(const std::filesystem::path& file) {
  OMNIHDR_ASSIGN(std::vector<std::byte> bytes, ReadFile(file));
  return MakeReplayingBus(std::move(bytes)).Context(file.string());
}

}  // namespace omnihdr::firewire
