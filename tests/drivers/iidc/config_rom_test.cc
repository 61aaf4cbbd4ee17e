#include "drivers/iidc/config_rom.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "tests/drivers/iidc/emulated.h"

namespace omnihdr::config_rom_test {
namespace {

using ::testing::HasSubstr;

std::vector<std::uint32_t> EmulatedRom() {
  testing::EmulatedRegisters camera;
  return iidc::ReadConfigRom(*camera.link, std::chrono::seconds(1)).value();
}

TEST(ConfigRom, TellsWhoTheCameraIsAndWhereItsRegistersAre) {
  const Result<iidc::ConfigRom> rom = iidc::ParseConfigRom(EmulatedRom());
  ASSERT_TRUE(rom) << rom.error().message;
  EXPECT_EQ(iidc::FormatGuid(rom->guid), "00b09d0100c0ffee");
  EXPECT_EQ(rom->vendor_id, 0x00B09DU);
  EXPECT_EQ(rom->unit_spec, 0x00A02DU);
  EXPECT_EQ(rom->unit_version, 0x102U);
  EXPECT_EQ(rom->command_base, 0xFFFF'F0F0'0000U);
  EXPECT_EQ(rom->vendor, "Omni Emulators");
  EXPECT_EQ(rom->model, "Six-Eyed Test Head");
}

TEST(ConfigRom, CutOffAnywhereIsAnErrorThatSaysWhere) {
  const std::vector<std::uint32_t> rom = EmulatedRom();
  for (std::size_t length = 0; length < rom.size(); ++length) {
    const Result<iidc::ConfigRom> parsed = iidc::ParseConfigRom(std::span(rom).first(length));
    ASSERT_FALSE(parsed) << length;
    EXPECT_EQ(parsed.error().kind, ErrorKind::kProtocol);
    EXPECT_THAT(parsed.error().message, HasSubstr("quadlet")) << length;
  }
}

TEST(ConfigRom, AnyQuadletsGiveAnAnswer) {
  const std::vector<std::uint32_t> good = EmulatedRom();
  std::mt19937 random(7);
  for (int round = 0; round < 20000; ++round) {
    std::vector<std::uint32_t> rom = good;
    for (int changes = 0; changes < 3; ++changes) {
      rom[random() % rom.size()] = round % 2 == 0 ? random() : (random() & 0xFF0000FF);
    }
    const Result<iidc::ConfigRom> parsed = iidc::ParseConfigRom(rom);
    ASSERT_TRUE(parsed || !parsed.error().message.empty());
  }
}

TEST(ConfigRom, ADirectoryThatLeadsBackToItselfIsRefused) {
  std::vector<std::uint32_t> rom = EmulatedRom();
  rom[11] = 0xD4000000 | ((8U - 11U) & 0xFFFFFF);  // a large way forward: outside
  EXPECT_FALSE(iidc::ParseConfigRom(rom));
  rom = EmulatedRom();
  rom[7] = 0xD1000000;  // the entry itself
  EXPECT_FALSE(iidc::ParseConfigRom(rom));
}

TEST(ConfigRom, AnotherKindOfDeviceIsRefusedByItsSpecifier) {
  std::vector<std::uint32_t> rom = EmulatedRom();
  rom[9] = 0x1200609E;  // a disk
  const Result<iidc::ConfigRom> parsed = iidc::ParseConfigRom(rom);
  ASSERT_FALSE(parsed);
  EXPECT_THAT(parsed.error().message, HasSubstr("0x00609e"));
}

TEST(ConfigRom, ACameraThatDoesNotAnswerEndsInATimeout) {
  testing::EmulatedRegisters camera;
  camera.emulated.device->Set({.nak_registers = 1'000'000});
  const Result<std::vector<std::uint32_t>> rom =
      iidc::ReadConfigRom(*camera.link, std::chrono::milliseconds(30));
  ASSERT_FALSE(rom);
  EXPECT_EQ(rom.error().kind, ErrorKind::kTemporary);
}

}  // namespace
}  // namespace omnihdr::config_rom_test
