#include "tests/emulators/iidc_link.h"

#include <fmt/format.h>

#include <thread>
#include <utility>

#include "core/session/rig_file.h"
#include "core/sphere/lens.h"

namespace omnihdr::emulators {
namespace {

using Answer = IidcDevice::Answer;

class EmulatedLink final : public iidc::Link {
 public:
  explicit EmulatedLink(std::shared_ptr<IidcDevice> device) : device_(std::move(device)) {}

  Result<std::uint32_t> ReadQuadlet(std::uint64_t address, Nanoseconds timeout) override {
    std::uint32_t value = 0;
    OMNIHDR_TRY(ReadBlock(address, {&value, 1}, timeout));
    return value;
  }
  Status WriteQuadlet(std::uint64_t address, std::uint32_t value, Nanoseconds timeout) override {
    return Say(device_->Write(address, value), address, timeout);
  }
  Status ReadBlock(std::uint64_t address, std::span<std::uint32_t> quadlets,
                   Nanoseconds timeout) override {
    return Say(device_->Read(address, quadlets), address, timeout);
  }
  std::string name() const override { return "emulated camera"; }
  std::uint16_t product() const override { return 0; }
  std::size_t packet_bytes() const override { return device_->options().link_packet_bytes; }
  Status StartStream(std::size_t frame_bytes) override {
    const std::size_t packet = packet_bytes();
    buffer_.resize((frame_bytes / packet + 1) * packet);
    streaming_ = true;
    return {};
  }
  Result<iidc::StreamChunk> ReadStream(Nanoseconds timeout) override {
    if (!streaming_) return Fail(ErrorKind::kUnavailable, "emulated stream: not started");
    const HostTime deadline = clock_.Now() + timeout;
    iidc::StreamChunk chunk;
    while (true) {
      const IidcDevice::Moved moved = device_->ReadStream(std::span(buffer_).subspan(filled_));
      filled_ += moved.bytes;
      if (moved.answer == Answer::kGone) {
        return Fail(ErrorKind::kUnavailable, "emulated stream: the device has gone");
      }
      if (moved.answer == Answer::kStall) chunk.error = "the endpoint stalled";
      if (moved.ended) {
        chunk.bytes.assign(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(filled_));
        chunk.ended_short = filled_ < buffer_.size();
        chunk.arrived = clock_.Now();
        filled_ = 0;
        return chunk;
      }
      if (clock_.Now() >= deadline) {
        return Fail(ErrorKind::kTemporary, "emulated stream: nothing within {} ms",
                    timeout.count() / 1'000'000);
      }
      std::this_thread::sleep_for(std::chrono::microseconds(200));
    }
  }
  void Recycle(iidc::StreamChunk) override {}
  void StopStream() override {
    streaming_ = false;
    filled_ = 0;
  }

 private:
  static Status Say(Answer answer, std::uint64_t address, Nanoseconds timeout) {
    switch (answer) {
      case Answer::kOk:
        return {};
      case Answer::kStall:
        return Fail(ErrorKind::kProtocol, "{:#014x}: refused (stall)", address);
      case Answer::kNak:
        std::this_thread::sleep_for(timeout);
        return Fail(ErrorKind::kTemporary, "{:#014x}: no answer in {} ms", address,
                    timeout.count() / 1'000'000);
      case Answer::kGone:
        break;
    }
    return Fail(ErrorKind::kUnavailable, "{:#014x}: the device has gone", address);
  }

  const SystemClock clock_;
  const std::shared_ptr<IidcDevice> device_;
  std::vector<std::byte> buffer_;
  std::size_t filled_ = 0;
  bool streaming_ = false;
};

class EmulatedFinder final : public iidc::LinkFinder {
 public:
  explicit EmulatedFinder(std::vector<std::shared_ptr<IidcDevice>> devices)
      : devices_(std::move(devices)) {}
  Result<std::vector<Candidate>> Find() override {
    std::vector<Candidate> found;
    for (const auto& device : devices_) {
      if (!device->plugged_in()) continue;
      found.push_back(
          {fmt::format("emulated {}", found.size()),
           [device]() -> Result<std::unique_ptr<iidc::Link>> { return MakeEmulatedLink(device); }});
    }
    return found;
  }

 private:
  const std::vector<std::shared_ptr<IidcDevice>> devices_;
};

}  // namespace

std::unique_ptr<iidc::Link> MakeEmulatedLink(std::shared_ptr<IidcDevice> device) {
  return std::make_unique<EmulatedLink>(std::move(device));
}

std::unique_ptr<iidc::LinkFinder> MakeEmulatedFinder(
    std::vector<std::shared_ptr<IidcDevice>> devices) {
  return std::make_unique<EmulatedFinder>(std::move(devices));
}

std::string EmulatedRig(int sensors, int width, int rows, BayerOrder bayer) {
  std::string text =
      "format = \"omnihdr-rig\"\nversion = 1\nmodel = \"emulated head\"\nserial = \"\"\n"
      "sphere_radius_m = 10.0\nblend_width_deg = 5.0\n";
  for (int i = 0; i < sensors; ++i) {
    const double half = M_PI * i / sensors;
    text += fmt::format(
        "\n[[sensor]]\nname = \"{}\"\nsize = [{}, {}]\nbayer = \"{}\"\nlens = \"fisheye\"\n"
        "focal = [{}, {}]\ncentre = [{}, {}]\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n"
        "fov_deg = 130.0\nrotation = [{:.12f}, 0.0, 0.0, {:.12f}]\ntranslation = [0.0, 0.0, 0.0]\n",
        i, width, rows, ToString(bayer), 0.5 * width, 0.5 * width, 0.5 * width, 0.5 * rows,
        std::cos(half), std::sin(half));
  }
  return text;
}

}  // namespace omnihdr::emulators
