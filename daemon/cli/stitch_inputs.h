#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/base/units.h"
#include "core/image/image_io.h"
#include "core/photometry/mosaic.h"
#include "core/photometry/response.h"
#include "core/pipeline/rig_masks.h"
#include "core/sphere/rig.h"

namespace omnihdr {

// What `omnihdr stitch` works on, as the command line names it.
struct StitchInputArguments {
  // IMAGE[@SECONDS]: of each exposure one for each sensor in the rig's order ("-" = the sensor has
  // none), or one stacked frame.
  std::vector<std::string> pictures;
  std::string seconds;  // of pictures that do not say their own
  std::string rig;
  std::string response;  // as --response; empty: the sensors' own, or else linear
};

// Stacked frames of the sensors that have pictures.
struct StitchInputs {
  Rig whole_rig;  // as the file has it
  std::filesystem::path directory;
  std::vector<std::size_t> taken;  // which of its sensors have pictures, rising
  // The sensors that have pictures, with the colours that the pictures have: of developed pictures
  // the Bayer order does not count.
  Rig rig;
  std::vector<DecodedImage> images;  // one an exposure
  std::vector<std::vector<Exposure>> exposures;
  std::vector<Response> responses;  // one for all sensors, or one each

  std::vector<RigFrame> Frames() const;
};

// Reads rig and pictures. Errors name what is wrong and what was expected: the number of pictures,
// a picture's size, kind or exposure.
Result<StitchInputs> ReadStitchInputs(const StitchInputArguments& arguments);

// The lens masks of the sensors that take part, and the mask of --mask (empty = none): of the size
// of the whole rig's stacked frame, or a lat-long picture.
Result<RigMasks> ReadStitchMasks(const StitchInputs& inputs, const std::string& mask_file,
                                 const SphereGrid& grid);

}  // namespace omnihdr
