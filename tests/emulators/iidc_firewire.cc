#include "tests/emulators/iidc_firewire.h"

#include <algorithm>
#include <thread>
#include <utility>

namespace omnihdr::emulators {

using firewire::Answer;

namespace {

constexpr std::uint32_t kIsoData = 0x60C;
constexpr int kBandwidthOfABus = 4915;

bool TakeOne(int& left) {
  if (left <= 0) return false;
  --left;
  return true;
}

}  // namespace

class EmulatedNode final : public firewire::Node {
 public:
  explicit EmulatedNode(IidcFirewire& bus) : bus_(bus), generation_(bus.generation_) {}

  firewire::NodeInfo info() const override { return {0, bus_.device_->options().guid}; }
  Answer Read(std::uint64_t address, std::span<std::uint32_t> quadlets,
              Nanoseconds timeout) override {
    return Do(timeout, [&] { return bus_.device_->Read(address, quadlets); });
  }
  Answer Write(std::uint64_t address, std::uint32_t value, Nanoseconds timeout) override {
    return Do(timeout, [&] { return bus_.device_->Write(address, value); });
  }
  bool WasReset() override {
    std::lock_guard lock(bus_.mutex_);
    return generation_ != bus_.generation_;
  }
  Answer Refresh(Nanoseconds /*timeout*/) override {
    std::lock_guard lock(bus_.mutex_);
    ++bus_.refreshes_;
    generation_ = bus_.generation_;
    return bus_.device_->plugged_in() ? Answer::kComplete : Answer::kGone;
  }
  int speed() const override { return 2; }

  Status AllocateChannel(int channel) override {
    std::lock_guard lock(bus_.mutex_);
    if (bus_.channels_.insert(channel).second) return {};
    return Fail(ErrorKind::kUnavailable, "channel {} is taken", channel);
  }
  Status AllocateBandwidth(int units) override {
    std::lock_guard lock(bus_.mutex_);
    if (bus_.bandwidth_ + units > kBandwidthOfABus) {
      return Fail(ErrorKind::kUnavailable, "bandwidth {}: {} of {} are taken", units,
                  bus_.bandwidth_, kBandwidthOfABus);
    }
    bus_.bandwidth_ += units;
    return {};
  }
  void ReleaseChannel(int channel) override {
    std::lock_guard lock(bus_.mutex_);
    bus_.channels_.erase(channel);
  }
  void ReleaseBandwidth(int units) override {
    std::lock_guard lock(bus_.mutex_);
    bus_.bandwidth_ = std::max(0, bus_.bandwidth_ - units);
  }

  Status StartReceive(const firewire::IsoOptions& options) override {
    iso_ = options;
    receiving_ = true;
    frame_.resize(IidcFirewire::kFrameEnds);
    return {};
  }
  Result<firewire::IsoBatch> Receive(Nanoseconds timeout) override {
    if (!receiving_) return Fail(ErrorKind::kUnavailable, "not receiving");
    const HostTime deadline = clock_.Now() + timeout;
    while (true) {
      const IidcDevice::Moved moved = bus_.device_->ReadStream(frame_);
      if (moved.answer == IidcDevice::Answer::kGone) {
        // What an unplugged camera does to a bus.
        bus_.Reset();
        return firewire::IsoBatch{};
      }
      const std::uint32_t iso_data = bus_.device_->Register(kIsoData);
      if (moved.bytes > 0 && iso_data >> 28 == static_cast<std::uint32_t>(iso_.channel)) {
        return Packets(moved.bytes);
      }
      if (WasReset()) return firewire::IsoBatch{};
      if (clock_.Now() >= deadline) return Fail(ErrorKind::kTemporary, "no packet");
      std::this_thread::sleep_for(std::chrono::microseconds(200));
    }
  }
  void StopReceive() override { receiving_ = false; }

 private:
  template <typename Once>
  Answer Do(Nanoseconds timeout, Once once) {
    {
      std::lock_guard lock(bus_.mutex_);
      if (generation_ != bus_.generation_) return Answer::kReset;
      if (TakeOne(bus_.faults_.busy)) return Answer::kBusy;
      if (TakeOne(bus_.faults_.conflicts)) return Answer::kConflict;
      if (TakeOne(bus_.faults_.unanswered)) return Answer::kNoAnswer;
    }
    switch (once()) {
      case IidcDevice::Answer::kOk:
        return Answer::kComplete;
      case IidcDevice::Answer::kStall:
        return Answer::kRefused;
      case IidcDevice::Answer::kNak:
        std::this_thread::sleep_for(timeout);
        return Answer::kNoAnswer;
      case IidcDevice::Answer::kGone:
        break;
    }
    return Answer::kGone;
  }

  firewire::IsoBatch Packets(std::size_t bytes) {
    std::lock_guard lock(bus_.mutex_);
    IidcFirewire::Faults& faults = bus_.faults_;
    const bool lose_first = TakeOne(faults.lose_first_packets);
    const bool lose_middle = TakeOne(faults.lose_middle_packets);
    const bool lose_last = TakeOne(faults.lose_last_packets);
    const bool drop = TakeOne(faults.drop_packets);
    firewire::IsoBatch batch;
    const std::size_t count = (bytes + iso_.packet_bytes - 1) / iso_.packet_bytes;
    for (std::size_t i = 0; i < count; ++i) {
      cycle_ = (cycle_ + 1) % 8000;
      const bool middle = i == count / 2;
      if ((lose_first && i == 0) || (lose_middle && middle) || (lose_last && i + 1 == count) ||
          (drop && middle)) {
        continue;
      }
      firewire::IsoPacket packet;
      packet.begin = batch.bytes.size();
      packet.length = std::min(iso_.packet_bytes, bytes - i * iso_.packet_bytes);
      packet.sync = i == 0;
      packet.cycle = cycle_;
      packet.dropped = drop && i == count / 2 + 1 ? 1 : 0;
      const auto from = frame_.begin() + static_cast<std::ptrdiff_t>(i * iso_.packet_bytes);
      batch.bytes.insert(batch.bytes.end(), from,
                         from + static_cast<std::ptrdiff_t>(packet.length));
      batch.packets.push_back(packet);
    }
    batch.arrived = clock_.Now();
    return batch;
  }

  const SystemClock clock_;
  IidcFirewire& bus_;
  std::uint64_t generation_;
  firewire::IsoOptions iso_;
  bool receiving_ = false;
  std::uint32_t cycle_ = 7990;  // wraps soon
  std::vector<std::byte> frame_;
};

namespace {

class EmulatedBus final : public firewire::Bus {
 public:
  EmulatedBus(IidcFirewire& bus, std::shared_ptr<IidcDevice> device)
      : bus_(bus), device_(std::move(device)) {}
  Result<std::vector<firewire::NodeInfo>> List() override {
    std::vector<firewire::NodeInfo> nodes;
    if (device_->plugged_in()) nodes.push_back({0, device_->options().guid});
    return nodes;
  }
  Result<std::unique_ptr<firewire::Node>> Open(const firewire::NodeInfo& /*info*/) override {
    return std::unique_ptr<firewire::Node>(std::make_unique<EmulatedNode>(bus_));
  }

 private:
  IidcFirewire& bus_;
  const std::shared_ptr<IidcDevice> device_;
};

}  // namespace

void IidcFirewire::Set(const Faults& faults) {
  std::lock_guard lock(mutex_);
  faults_ = faults;
}

void IidcFirewire::Reset() {
  std::lock_guard lock(mutex_);
  ++generation_;
  channels_.clear();
  bandwidth_ = 0;
}

void IidcFirewire::Take(int channel) {
  std::lock_guard lock(mutex_);
  channels_.insert(channel);
}

std::set<int> IidcFirewire::channels() const {
  std::lock_guard lock(mutex_);
  return channels_;
}

int IidcFirewire::bandwidth() const {
  std::lock_guard lock(mutex_);
  return bandwidth_;
}

int IidcFirewire::refreshes() const {
  std::lock_guard lock(mutex_);
  return refreshes_;
}

std::unique_ptr<firewire::Bus> IidcFirewire::MakeBus() {
  return std::make_unique<EmulatedBus>(*this, device_);
}

}  // namespace omnihdr::emulators
