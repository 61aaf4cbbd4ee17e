#include "drivers/iidc/config_rom.h"

#include <fmt/format.h>

#include <optional>

#include "drivers/iidc/registers.h"

namespace omnihdr::iidc {
namespace {

constexpr std::uint32_t kBusName = 0x31333934;  // "1394"
constexpr std::size_t kRootDirectory = 5;
constexpr std::uint32_t kIidcSpec = 0x00A02D;
constexpr std::uint32_t kPointGreySpec = 0x00B09D;
constexpr std::size_t kMaxTextBytes = 128;

// Keys of directory entries.
constexpr std::uint32_t kKeyVendor = 0x03;
constexpr std::uint32_t kKeyUnitSpec = 0x12;
constexpr std::uint32_t kKeyUnitVersion = 0x13;
constexpr std::uint32_t kKeyCommandBase = 0x40;
constexpr std::uint32_t kKeyVendorText = 0x81;
constexpr std::uint32_t kKeyModelText = 0x82;
constexpr std::uint32_t kKeyUnit = 0xD1;
constexpr std::uint32_t kKeyUnitDependent = 0xD4;

class RomReader {
 public:
  explicit RomReader(std::span<const std::uint32_t> quadlets) : quadlets_(quadlets) {}

  // The entries of the directory at a quadlet.
  Result<std::span<const std::uint32_t>> Block(std::size_t at, std::string_view what) const {
    if (at >= quadlets_.size()) {
      return Fail(ErrorKind::kProtocol, "{} at quadlet {}: the ROM has {}", what, at,
                  quadlets_.size());
    }
    const std::size_t length = quadlets_[at] >> 16;
    if (length > quadlets_.size() - at - 1) {
      return Fail(ErrorKind::kProtocol, "{} at quadlet {}: {} quadlets long, {} are left", what, at,
                  length, quadlets_.size() - at - 1);
    }
    return quadlets_.subspan(at + 1, length);
  }

  // Where the entry with this key points, or its value for immediate entries. Nothing when absent.
  struct Entry {
    std::uint32_t value = 0;
    std::size_t target = 0;
  };
  std::optional<Entry> Find(std::span<const std::uint32_t> directory, std::uint32_t key) const {
    for (std::size_t i = 0; i < directory.size(); ++i) {
      if (directory[i] >> 24 != key) continue;
      const std::uint32_t value = directory[i] & 0xFFFFFF;
      const auto place = static_cast<std::size_t>(&directory[i] - quadlets_.data());
      return Entry{value, place + value};
    }
    return std::nullopt;
  }

  // A minimal ASCII text leaf: two quadlets of header, then characters, zero-padded.
  Result<std::string> Text(std::size_t at, std::string_view what) const {
    OMNIHDR_ASSIGN(const auto leaf, Block(at, what));
    std::string text;
    for (std::size_t i = 2; i < leaf.size() && text.size() < kMaxTextBytes; ++i) {
      for (int shift = 24; shift >= 0; shift -= 8) {
        const char c = static_cast<char>((leaf[i] >> shift) & 0xFF);
        if (c == '\0') return text;
        text += c >= 0x20 && c < 0x7F ? c : '?';
      }
    }
    return text;
  }

 private:
  std::span<const std::uint32_t> quadlets_;
};

}  // namespace

Result<ConfigRom> ParseConfigRom(std::span<const std::uint32_t> quadlets) {
  if (quadlets.size() > kMaxRomQuadlets) {
    return Fail(ErrorKind::kProtocol, "configuration ROM of {} quadlets: expected at most {}",
                quadlets.size(), kMaxRomQuadlets);
  }
  if (quadlets.size() <= kRootDirectory) {
    return Fail(ErrorKind::kProtocol, "configuration ROM of {} quadlets: expected more than {}",
                quadlets.size(), kRootDirectory);
  }
  if (quadlets[0] >> 24 != 4 || quadlets[1] != kBusName) {
    return Fail(ErrorKind::kProtocol,
                "configuration ROM begins {:#010x} {:#010x}: expected 0x04...... {:#010x}",
                quadlets[0], quadlets[1], kBusName);
  }
  ConfigRom rom;
  rom.guid = std::uint64_t{quadlets[3]} << 32 | quadlets[4];
  const RomReader reader(quadlets);
  OMNIHDR_ASSIGN(const auto root, reader.Block(kRootDirectory, "root directory"));
  if (const auto vendor = reader.Find(root, kKeyVendor)) rom.vendor_id = vendor->value;
  const auto unit_entry = reader.Find(root, kKeyUnit);
  if (!unit_entry)
    return Fail(ErrorKind::kProtocol, "root directory: no unit directory (key 0xd1)");
  OMNIHDR_ASSIGN(const auto unit, reader.Block(unit_entry->target, "unit directory"));
  const auto spec = reader.Find(unit, kKeyUnitSpec);
  if (!spec || (spec->value != kIidcSpec && spec->value != kPointGreySpec)) {
    return Fail(ErrorKind::kProtocol,
                "unit directory: specifier {:#08x}: expected {:#08x} (IIDC) or {:#08x}",
                spec ? spec->value : 0, kIidcSpec, kPointGreySpec);
  }
  rom.unit_spec = spec->value;
  if (const auto version = reader.Find(unit, kKeyUnitVersion)) rom.unit_version = version->value;
  const auto dependent_entry = reader.Find(unit, kKeyUnitDependent);
  if (!dependent_entry) {
    return Fail(ErrorKind::kProtocol, "unit directory: no unit dependent directory (key 0xd4)");
  }
  if (dependent_entry->target == unit_entry->target) {
    return Fail(ErrorKind::kProtocol, "unit directory: leads back to itself at quadlet {}",
                unit_entry->target);
  }
  OMNIHDR_ASSIGN(const auto dependent,
                 reader.Block(dependent_entry->target, "unit dependent directory"));
  const auto base = reader.Find(dependent, kKeyCommandBase);
  if (!base) {
    return Fail(ErrorKind::kProtocol, "unit dependent directory: no command base (key 0x40)");
  }
  rom.command_base = kRegisterSpace + std::uint64_t{base->value} * 4;
  if (const auto vendor = reader.Find(dependent, kKeyVendorText)) {
    OMNIHDR_ASSIGN(rom.vendor, reader.Text(vendor->target, "vendor's name"));
  }
  if (const auto model = reader.Find(dependent, kKeyModelText)) {
    OMNIHDR_ASSIGN(rom.model, reader.Text(model->target, "model's name"));
  }
  return rom;
}

Result<std::vector<std::uint32_t>> ReadConfigRom(RegisterBus& bus, Nanoseconds timeout) {
  const SystemClock clock;
  const HostTime deadline = clock.Now() + timeout;
  std::vector<std::uint32_t> quadlets;
  while (quadlets.size() < kMaxRomQuadlets) {
    const Nanoseconds left = deadline - clock.Now();
    if (left <= Nanoseconds(0)) {
      return Fail(ErrorKind::kTemporary, "configuration ROM: {} quadlets in {} ms", quadlets.size(),
                  timeout.count() / 1'000'000);
    }
    const Result<std::uint32_t> quadlet = bus.ReadQuadlet(kConfigRom + 4 * quadlets.size(), left);
    if (!quadlet) {
      // The end of the ROM is where the camera refuses; anything else is a failure.
      if (quadlet.error().kind == ErrorKind::kProtocol && quadlets.size() > kRootDirectory) break;
      return Forward(quadlet.error(), "configuration ROM");
    }
    quadlets.push_back(*quadlet);
  }
  return quadlets;
}

std::string FormatGuid(std::uint64_t guid) { return fmt::format("{:016x}", guid); }

}  // namespace omnihdr::iidc
