#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "drivers/modbus/responder.h"

namespace {

using namespace omnihdr;          // NOLINT(google-build-using-namespace)
using namespace omnihdr::modbus;  // NOLINT(google-build-using-namespace)

class Appliance {
 public:
  Appliance() : responder_([this](ApplianceCommand command) { return Command(command); }) {
    ApplianceStatus status;
    status.armed = true;
    status.last_fault = "a fault of more than sixty-four characters, as faults with paths are";
    responder_.Show(status);
  }
  void Ask(std::span<const std::uint8_t> pdu) {
    const int before = commands_;
    std::array<std::uint8_t, kMaxPdu> answer{};
    const std::size_t length = responder_.Answer(pdu, answer);
    if (length < 2 || length > kMaxPdu || (answer[0] & 0x7F) != (pdu[0] & 0x7F)) std::abort();
    const bool refused = (answer[0] & 0x80) != (pdu[0] & 0x80) || pdu[0] >= 0x80;
    if (refused && length != 2) std::abort();
    if (refused && answer[1] <= 3 && commands_ != before) std::abort();
  }

 private:
  Status Command(ApplianceCommand command) {
    ++commands_;
    if (commands_ % 3 == 0) return Fail(ErrorKind::kTemporary, "busy");
    return command == ApplianceCommand::kTrigger ? Status(Fail(ErrorKind::kUnavailable, "disarmed"))
                                                 : Status();
  }
  int commands_ = 0;
  Responder responder_;
};

}  // namespace

// Laws: whatever comes over TCP or a serial line, every request that is recognised gets an answer
// of a legal length, and one that is refused for what it is gives no command. The first byte says
// how the rest is cut into pieces.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::size_t piece = std::size_t{data[0]} + 1;
  const std::span<const std::uint8_t> stream(data + 1, size - 1);

  Appliance tcp_appliance;
  TcpFramer tcp;
  bool broken = false;
  for (std::size_t at = 0; at < stream.size() && !broken;) {
    const std::span<std::uint8_t> room = tcp.Room();
    if (room.empty()) std::abort();
    const std::size_t count = std::min({piece, room.size(), stream.size() - at});
    std::copy_n(stream.begin() + static_cast<std::ptrdiff_t>(at), count, room.begin());
    tcp.Filled(count);
    at += count;
    TcpFramer::Frame frame;
    TcpFramer::State state = TcpFramer::State::kNeedMore;
    while ((state = tcp.Next(frame)) == TcpFramer::State::kFrame) tcp_appliance.Ask(frame.pdu);
    broken = state == TcpFramer::State::kBroken;
  }

  Appliance serial_appliance;
  RtuFramer rtu(1);
  for (std::size_t at = 0; at < stream.size(); at += piece) {
    const auto frame = rtu.Take(stream.subspan(at, std::min(piece, stream.size() - at)));
    if (frame) serial_appliance.Ask(frame->pdu);
  }
  if (!stream.empty()) serial_appliance.Ask(stream.first(std::min(stream.size(), kMaxPdu)));
  return 0;
}
