#include "drivers/iidc/model_table.h"

namespace omnihdr::iidc {

std::span<const CameraModel> CameraModels() {
  static constexpr CameraModel kModels[] = {
      {.product = 0x2000, .name = "Firefly MV"},
      {.product = 0x2001, .name = "Firefly MV", .mono = true},
      {.product = 0x2002, .name = "Firefly MV, high resolution"},
      {.product = 0x2003, .name = "Firefly MV, high resolution", .mono = true},
      {.product = 0x2004, .name = "Chameleon"},
      {.product = 0x2005, .name = "Chameleon", .mono = true},
      {.product = 0x3000, .name = "Flea3"},
      {.product = 0x3005, .name = "Flea3 FL3-U3-13Y3M", .mono = true},
      {.product = 0x3006, .name = "Flea3 FL3-U3-13S2C"},
      {.product = 0x3008, .name = "Flea3 FL3-U3-88S2C"},
      {.product = 0x300A, .name = "Flea3 FL3-U3-13E4C"},
      {.product = 0x300B, .name = "Flea3 FL3-U3-13E4M", .mono = true},
      {.product = 0x3103, .name = "Grasshopper3 GS3-U3-23S6M", .mono = true},
      {.product = 0x3300, .name = "Flea3 FL3-U3-13E4M", .mono = true},
      // The exposure cycle is described for cameras of one sensor.
      {.product = 0x3800,
       .name = "Ladybug5 LD5-U3-51S5C-44",
       .deep = false,
       .cycle = CycleKnowledge::kNone,
       .sensors = 6},
  };
  return kModels;
}

std::optional<CameraModel> FindModel(std::uint16_t product) {
  for (const CameraModel& model : CameraModels()) {
    if (model.product == product) return model;
  }
  return std::nullopt;
}

}  // namespace omnihdr::iidc
