#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

namespace omnihdr::iidc {

// What is known of a model's own exposure cycle (HDR_CONTROL, 0x1800).
enum class CycleKnowledge {
  kUnmeasured,  // nobody has tried it: used only when the configuration asks for it
  kWorks,       // somebody has, and it stepped from picture to picture
  kNone,        // the model has none, or not one that sets all of its sensors
};

// What is known about a model beyond what its registers say: facts are data. README.md has the
// sources.
struct CameraModel {
  std::uint16_t product = 0;  // USB
  std::string_view name;
  bool mono = false;
  // Pictures after which a new exposure is in force when triggered by software.
  int settle_frames = 0;
  bool deep = true;  // its 16-bit codings, when its registers offer them, are what picture.h reads
  CycleKnowledge cycle = CycleKnowledge::kUnmeasured;
  // The sensors of a head, stacked in one tall picture.
  int sensors = 1;
};

inline constexpr std::uint16_t kPointGreyVendor = 0x1E10;

std::span<const CameraModel> CameraModels();
// By USB product number; nothing for one that is not in the table (its registers are believed).
std::optional<CameraModel> FindModel(std::uint16_t product);

}  // namespace omnihdr::iidc
