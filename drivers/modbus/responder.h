#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <utility>

#include "core/capture/appliance.h"

namespace omnihdr::modbus {

// The appliance's registers and what a request does with them: the protocol without any transport.
// The map is documented in README.md; kMapVersion changes when a register changes its meaning.

inline constexpr std::uint16_t kMapVersion = 1;
inline constexpr std::size_t kMaxPdu = 253;
inline constexpr int kStatusRegisters = 64;
inline constexpr int kCommandRegister = 100;
inline constexpr int kTextRegisters = 128;  // from kRegReason on
inline constexpr int kCommandCoils = 2;     // 0 armed, 1 trigger
inline constexpr int kDiscreteInputs = 8;

// Names of the status registers, as addresses.
enum StatusRegister {
  kRegMapVersion = 0,
  kRegState = 1,
  kRegFlags = 2,  // bit n = discrete input n
  kRegUptime = 3,
  kRegTriggers = 4,  // this and those below: 32 bits, high word first
  kRegFramesRecorded = 6,
  kRegFramesLost = 8,
  kRegViewsFinished = 10,
  kRegViewsWaiting = 12,
  kRegMinutesLeft = 14,   // 16 bits; 65535 = not known
  kRegQualityLevel = 15,  // 16 bits
  kRegOdometer = 16,      // millimetres, signed; -2^31 = not known
  kRegCommandCount = 18,
  kRegCommandResult = 20,  // 16 bits
  kRegStorageLevel = 21,   // 16 bits; 0 enough, 1 warning, 2 stop, 3 unreadable
  kRegStorageFreeMb = 22,  // 2^32 - 1 = not known
  kRegLastFault = 32,      // 32 registers of two ASCII characters each, 0 = end
  kRegReason = 128,        // 64 registers of the same kind
  kRegRemedy = 192,        // likewise
};
enum DiscreteInput {
  kInputCameraReady = 0,
  kInputArmed = 1,
  kInputBusy = 2,
  kInputFault = 3,
  kInputSessionEnded = 4,
  kInputOdometer = 5,
  kInputGnss = 6,
  kInputControl = 7,
};
enum CommandResult : std::uint16_t { kNone = 0, kDone = 1, kRefused = 2 };

// Exception codes of the protocol that are used.
enum class Exception : std::uint8_t {
  kIllegalFunction = 1,
  kIllegalAddress = 2,
  kIllegalValue = 3,
  kServerFailure = 4,
  kServerBusy = 6,
  kGatewayTarget = 11,
};

struct ResponderCounts {
  std::uint64_t requests = 0;
  std::uint64_t exceptions = 0;
  std::uint64_t commands = 0;  // done
};

// Answers requests. Laws: every request of at least one byte gets an answer of 2 to kMaxPdu bytes;
// one that is refused for what it is (exceptions 1 to 3) has changed nothing. Not thread-safe.
class Responder {
 public:
  // `command` empty: nothing can be written.
  explicit Responder(CommandHandler command) : command_(std::move(command)) {}

  void Show(const ApplianceStatus& status);
  // The answer to a request PDU (function code and data); its length. 0 only for an empty request.
  std::size_t Answer(std::span<const std::uint8_t> request,
                     std::span<std::uint8_t, kMaxPdu> answer);
  const ResponderCounts& counts() const { return counts_; }

 private:
  using Outcome = std::optional<Exception>;  // nothing = done
  Outcome ReadBits(int address, int count, bool coils, std::uint8_t* to) const;
  std::optional<std::uint16_t> Register(int address) const;
  Outcome Command(ApplianceCommand command);
  Outcome WriteCoil(int address, bool on);
  Outcome WriteRegister(int address, std::uint16_t value);
  std::size_t Handle(std::span<const std::uint8_t> request, std::span<std::uint8_t> answer,
                     Outcome& failed);

  const CommandHandler command_;
  std::array<std::uint16_t, kStatusRegisters> registers_{};
  std::array<std::uint16_t, kTextRegisters> texts_{};
  std::array<bool, kDiscreteInputs> inputs_{};
  std::uint32_t command_count_ = 0;
  std::uint16_t last_command_ = 0;
  std::uint16_t last_result_ = kNone;
  ResponderCounts counts_;
};

// The length of a request PDU as far as its beginning tells; nothing yet when that is too short, 0
// when there is no such function here.
std::optional<std::size_t> RequestLength(std::span<const std::uint8_t> pdu);

// Cuts a TCP stream into requests.
class TcpFramer {
 public:
  struct Frame {
    std::uint16_t transaction = 0;
    std::uint8_t unit = 0;
    std::span<const std::uint8_t> pdu;  // until the next call
  };
  enum class State { kNeedMore, kFrame, kBroken };
  // Room for more bytes of the stream; Filled says how many came.
  std::span<std::uint8_t> Room();
  void Filled(std::size_t bytes) { size_ += bytes; }
  // kBroken: this is no Modbus, and where the next request would begin cannot be known.
  State Next(Frame& frame);
  bool empty() const { return size_ == consumed_; }

 private:
  std::array<std::uint8_t, 520> buffer_{};
  std::size_t size_ = 0;
  std::size_t consumed_ = 0;
};
inline constexpr std::size_t kTcpHeader = 7;

// Finds the requests to one unit in what comes over a serial line, among other units' requests and
// answers and noise.
class RtuFramer {
 public:
  struct Frame {
    std::uint8_t unit = 0;
    std::span<const std::uint8_t> pdu;  // until the next call
  };
  explicit RtuFramer(std::uint8_t unit) : unit_(unit) {}
  // More bytes; the request that ends with them, if one does: the newest bytes that make a whole
  // frame with this unit's address (or the broadcast's, 0), the length its function has, and the
  // right checksum.
  std::optional<Frame> Take(std::span<const std::uint8_t> bytes);
  // The line was silent: a frame that has begun will not go on.
  void Silence() { size_ = 0; }
  bool empty() const { return size_ == 0; }

 private:
  const std::uint8_t unit_;
  std::array<std::uint8_t, 512> buffer_{};
  std::size_t size_ = 0;
};

// CRC-16 of Modbus RTU; on the line its low byte comes first.
std::uint16_t Crc16(std::span<const std::uint8_t> bytes);

}  // namespace omnihdr::modbus
