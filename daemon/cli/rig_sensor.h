#pragma once

#include <string>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/sphere/rig.h"

namespace omnihdr {

// One sensor of a rig file, as --rig and --sensor name it.
struct RigSensorChoice {
  std::string rig_file;
  Rig rig;
  std::size_t index = 0;
  const RigSensor& sensor() const { return rig.sensors[index]; }
};

// `sensor`: a name, or else a number from 0 in the order of the file; empty for a rig of one.
// Errors: the rig file's; kUsage with the names there are.
Result<RigSensorChoice> ChooseRigSensor(const std::string& rig_file, const std::string& sensor);

// What of a frame is that sensor's: `mask` (empty or of the frame's size, under 128 = do not use)
// with everything else masked, and what the rig's own mask of the sensor leaves out. The frame is
// the sensor's alone, or all sensors' stacked; kData error for any other size. `frame` is for
// messages.
Result<Image<std::uint8_t>> MaskOfSensor(const RigSensorChoice& choice, const std::string& frame,
                                         int width, int height, ImageView<const std::uint8_t> mask);

}  // namespace omnihdr
