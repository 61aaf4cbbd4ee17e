#include "drivers/iidc/firewire_link.h"

#include <fmt/format.h>

#include <algorithm>
#include <deque>
#include <optional>
#include <thread>
#include <utility>

#include "drivers/iidc/registers.h"

namespace omnihdr::iidc {
namespace {

using firewire::Answer;

constexpr std::uint32_t kIsoData = 0x60C;
constexpr std::uint32_t kCycles = 8000;
constexpr int kChannels = 64;
// Room for two frames, and no less than a quarter of a second.
constexpr std::size_t kLeastPackets = 2000;
constexpr std::size_t kMostPackets = 16384;
constexpr int kMaxBatches = 1000;

class FirewireLink final : public Link {
 public:
  FirewireLink(std::unique_ptr<firewire::Node> node, const FirewireLinkOptions& options)
      : node_(std::move(node)), options_(options) {}
  ~FirewireLink() override {
    StopStream();
    Release();
  }
  FirewireLink(const FirewireLink&) = delete;
  FirewireLink& operator=(const FirewireLink&) = delete;

  Result<std::uint32_t> ReadQuadlet(std::uint64_t address, Nanoseconds timeout) override {
    std::uint32_t value = 0;
    OMNIHDR_TRY(ReadBlock(address, {&value, 1}, timeout));
    return value;
  }
  Status ReadBlock(std::uint64_t address, std::span<std::uint32_t> quadlets,
                   Nanoseconds timeout) override {
    return Access(address, timeout,
                  [&](Nanoseconds left) { return node_->Read(address, quadlets, left); });
  }
  Status WriteQuadlet(std::uint64_t address, std::uint32_t value, Nanoseconds timeout) override {
    return Access(address, timeout,
                  [&](Nanoseconds left) { return node_->Write(address, value, left); });
  }

  std::string name() const override {
    const firewire::NodeInfo info = node_->info();
    return fmt::format("firewire {} ({:016x})", info.port, info.guid);
  }
  std::uint16_t product() const override { return 0; }
  bool live() const override { return node_->live(); }
  // The first packet of a frame is marked, and its length is known.
  std::size_t packet_bytes() const override { return 0; }

  Status PrepareStream(const Registers& registers, std::size_t packet_bytes) override {
    Release();
    packet_bytes_ = packet_bytes;
    OMNIHDR_ASSIGN(const std::uint32_t basic, registers.Read(kBasicInquiry, "BASIC_FUNC_INQ"));
    const bool wide = (basic & Bit(23)) != 0;  // 1394b: speeds beyond S400
    const int speed = std::clamp(node_->speed(), 0, wide ? 5 : 2);
    OMNIHDR_TRY(Allocate(speed));
    const auto channel = static_cast<std::uint32_t>(*channel_);
    const auto code = static_cast<std::uint32_t>(speed);
    if (wide) {
      const std::uint32_t value = Bit(15) | channel << 8 | code;
      OMNIHDR_TRY(registers.WriteChecked(kIsoData, value, Bit(15) | 0x3F07, "ISO_DATA"));
    } else {
      const std::uint32_t value = channel << 28 | code << 24;
      OMNIHDR_TRY(registers.WriteChecked(kIsoData, value, 0xF3000000, "ISO_DATA"));
    }
    return {};
  }

  Status StartStream(std::size_t frame_bytes) override {
    if (!channel_) return Fail(ErrorKind::kSoftware, "{}: no channel", name());
    frame_bytes_ = frame_bytes;
    Forget();
    firewire::IsoOptions iso;
    iso.channel = *channel_;
    iso.packet_bytes = packet_bytes_;
    iso.packets = std::clamp(2 * (frame_bytes / std::max<std::size_t>(packet_bytes_, 1) + 1),
                             kLeastPackets, kMostPackets);
    OMNIHDR_TRY(node_->StartReceive(iso).Context(name()));
    streaming_ = true;
    return {};
  }

  Result<StreamChunk> ReadStream(Nanoseconds timeout) override {
    if (!streaming_) return Fail(ErrorKind::kUnavailable, "{}: not streaming", name());
    const HostTime deadline = clock_.Now() + timeout;
    for (int i = 0; i < kMaxBatches; ++i) {
      if (!chunks_.empty()) {
        StreamChunk chunk = std::move(chunks_.front());
        chunks_.pop_front();
        return chunk;
      }
      if (node_->WasReset()) {
        OMNIHDR_TRY(RecoverStream());
      } else if (reset_seen_) {
        OMNIHDR_TRY(TakeAgain());
      }
      const Nanoseconds left = std::max(deadline - clock_.Now(), Nanoseconds(0));
      // A frame that stopped in the middle is told in time.
      Result<firewire::IsoBatch> batch =
          node_->Receive(in_frame_ ? std::min(left, options_.silence) : left);
      if (batch) {
        for (const firewire::IsoPacket& packet : batch->packets) Add(*batch, packet);
        continue;
      }
      if (batch.error().kind != ErrorKind::kTemporary) {
        return Forward(std::move(batch).error(), name());
      }
      if (in_frame_ && clock_.Now() - last_packet_ >= options_.silence) {
        EndFrame(last_packet_);
        continue;
      }
      if (clock_.Now() >= deadline) break;
    }
    return Fail(ErrorKind::kTemporary, "{}: nothing within {} ms", name(),
                timeout.count() / 1'000'000);
  }

  void Recycle(StreamChunk chunk) override {
    if (spare_.capacity() == 0) spare_ = std::move(chunk.bytes);
  }

  void StopStream() override {
    if (!streaming_) return;
    streaming_ = false;
    node_->StopReceive();
    Forget();
  }

 private:
  template <typename Once>
  Status Access(std::uint64_t address, Nanoseconds timeout, Once once) {
    const HostTime deadline = clock_.Now() + timeout;
    Answer answer = Answer::kNoAnswer;
    for (int tries = 0; tries < options_.most_tries; ++tries) {
      const Nanoseconds left = deadline - clock_.Now();
      if (left <= Nanoseconds(0)) break;
      answer = once(left);
      switch (answer) {
        case Answer::kComplete:
          return {};
        case Answer::kReset:
          // Nothing was sent, and the camera may have another number.
          if (node_->Refresh(std::min(left, options_.refresh)) == Answer::kGone) {
            return Fail(ErrorKind::kUnavailable, "{:#014x}: the camera has left the bus", address);
          }
          reset_seen_ = true;
          break;
        case Answer::kBusy:
        case Answer::kConflict:
          std::this_thread::sleep_for(std::min(left, options_.pause));
          break;
        case Answer::kRefused:
          return Fail(ErrorKind::kProtocol, "{:#014x}: refused", address);
        case Answer::kNoAnswer:
          // A write may have been taken: it is not for us to do it twice.
          return Fail(ErrorKind::kTemporary, "{:#014x}: no answer in {} ms", address,
                      timeout.count() / 1'000'000);
        case Answer::kGone:
          return Fail(ErrorKind::kUnavailable, "{:#014x}: the camera has left the bus{}", address,
                      Detail());
        case Answer::kFailed:
          return Fail(ErrorKind::kIo, "{:#014x}: failed{}", address, Detail());
      }
    }
    return Fail(ErrorKind::kTemporary, "{:#014x}: {} for {} ms", address, ToString(answer),
                timeout.count() / 1'000'000);
  }

  std::string Detail() const {
    const std::string detail = node_->detail();
    return detail.empty() ? detail : ": " + detail;
  }

  Status Allocate(int speed) {
    bandwidth_ = BandwidthUnits(packet_bytes_, speed);
    OMNIHDR_TRY(
        node_->AllocateBandwidth(bandwidth_)
            .Context(fmt::format("{}: bandwidth of {} B a packet (camera.iidc.packet_bytes)",
                                 name(), packet_bytes_)));
    Status allocated;
    for (int channel = 0; channel < kChannels; ++channel) {
      // What the short form of ISO_DATA can name comes first.
      allocated = node_->AllocateChannel(channel);
      if (!allocated) continue;
      channel_ = channel;
      return {};
    }
    node_->ReleaseBandwidth(std::exchange(bandwidth_, 0));
    return Forward(std::move(allocated).error(), name());
  }

  void Release() {
    if (channel_) node_->ReleaseChannel(*channel_);
    if (bandwidth_ > 0) node_->ReleaseBandwidth(bandwidth_);
    channel_.reset();
    bandwidth_ = 0;
  }

  // The camera goes on sending on its channel: it is taken again before somebody else does.
  Status RecoverStream() {
    if (node_->Refresh(options_.refresh) == Answer::kGone) {
      return Fail(ErrorKind::kUnavailable, "{}: the camera has left the bus", name());
    }
    return TakeAgain();
  }
  Status TakeAgain() {
    reset_seen_ = false;
    const int channel = *channel_;
    const int bandwidth = bandwidth_;
    channel_.reset();
    bandwidth_ = 0;
    const std::string what = name() + ": after a reset of the bus";
    OMNIHDR_TRY(node_->AllocateBandwidth(bandwidth).Context(what));
    bandwidth_ = bandwidth;
    OMNIHDR_TRY(node_->AllocateChannel(channel).Context(what));
    channel_ = channel;
    return {};
  }

  void Forget() {
    chunks_.clear();
    bytes_.clear();
    fault_.clear();
    in_frame_ = false;
    headless_ = false;
    last_cycle_.reset();
  }

  void Add(const firewire::IsoBatch& batch, const firewire::IsoPacket& packet) {
    if (packet.sync && in_frame_) EndFrame(batch.arrived);
    if (!packet.sync && !in_frame_) {
      if (packet.length == 0) return;
      // What the first packet says of the frame is not there: nothing of it is handed on.
      Blame("the first packets are missing");
      headless_ = true;
    }
    if (in_frame_ && !packet.sync) {
      if (packet.dropped > 0) {
        Blame(fmt::format("{} packets were dropped before cycle {}", packet.dropped, packet.cycle));
      } else if (last_cycle_ && packet.cycle != (*last_cycle_ + 1) % kCycles) {
        Blame(fmt::format("no packet between cycles {} and {}", *last_cycle_, packet.cycle));
      }
    }
    if (!in_frame_) {
      in_frame_ = true;
      bytes_ = std::move(spare_);
      spare_ = {};
      bytes_.clear();
      bytes_.reserve(frame_bytes_);
    }
    last_cycle_ = packet.cycle;
    last_packet_ = batch.arrived;
    if (headless_) return;
    const std::byte* begin = batch.bytes.data() + packet.begin;
    const std::size_t room = frame_bytes_ - bytes_.size();
    bytes_.insert(bytes_.end(), begin, begin + std::min(packet.length, room));
    if (bytes_.size() == frame_bytes_) EndFrame(batch.arrived);
  }

  void Blame(std::string fault) {
    if (fault_.empty()) fault_ = std::move(fault);
  }

  void EndFrame(HostTime arrived) {
    StreamChunk chunk;
    chunk.bytes = std::move(bytes_);
    chunk.arrived = arrived;
    bytes_ = {};
    in_frame_ = false;
    headless_ = false;
    if (!fault_.empty()) {
      // What is not whole, and then its end.
      chunk.error = std::exchange(fault_, {});
      chunks_.push_back(std::move(chunk));
      chunk = {};
      chunk.arrived = arrived;
    }
    chunk.ended_short = true;
    chunks_.push_back(std::move(chunk));
  }

  const SystemClock clock_;
  std::unique_ptr<firewire::Node> node_;
  const FirewireLinkOptions options_;
  std::optional<int> channel_;
  int bandwidth_ = 0;
  bool streaming_ = false;
  bool reset_seen_ = false;  // by an access: channel and bandwidth are to be taken again
  std::size_t packet_bytes_ = 0;
  std::size_t frame_bytes_ = 0;
  std::vector<std::byte> bytes_;  // of the frame that is coming
  std::vector<std::byte> spare_;
  std::string fault_;
  bool in_frame_ = false;
  bool headless_ = false;
  std::optional<std::uint32_t> last_cycle_;
  HostTime last_packet_;
  std::deque<StreamChunk> chunks_;
};

class FirewireFinder final : public LinkFinder {
 public:
  FirewireFinder(std::shared_ptr<firewire::Bus> bus, const FirewireLinkOptions& options)
      : bus_(std::move(bus)), options_(options) {}

  Result<std::vector<Candidate>> Find() override {
    OMNIHDR_ASSIGN(const std::vector<firewire::NodeInfo> nodes, bus_->List());
    std::vector<Candidate> found;
    for (const firewire::NodeInfo& info : nodes) {
      found.push_back({fmt::format("firewire {} ({:016x})", info.port, info.guid),
                       [bus = bus_, info, options = options_]() -> Result<std::unique_ptr<Link>> {
                         OMNIHDR_ASSIGN(auto node, bus->Open(info));
                         return MakeFirewireLink(std::move(node), options);
                       }});
    }
    return found;
  }

 private:
  const std::shared_ptr<firewire::Bus> bus_;
  const FirewireLinkOptions options_;
};

}  // namespace

int BandwidthUnits(std::size_t packet_bytes, int speed) {
  constexpr std::size_t kOverhead = 3;  // quadlets: header and two checksums
  const std::size_t quadlets = (packet_bytes + 3) / 4 + kOverhead;
  const std::size_t sixteenths = quadlets * 16;  // a quadlet at S100 is 16 units
  return static_cast<int>(std::max<std::size_t>(sixteenths >> speed, 1));
}

std::unique_ptr<Link> MakeFirewireLink(std::unique_ptr<firewire::Node> node,
                                       const FirewireLinkOptions& options) {
  return std::make_unique<FirewireLink>(std::move(node), options);
}

std::unique_ptr<LinkFinder> MakeFirewireFinder(std::shared_ptr<firewire::Bus> bus,
                                               const FirewireLinkOptions& options) {
  return std::make_unique<FirewireFinder>(std::move(bus), options);
}

}  // namespace omnihdr::iidc
