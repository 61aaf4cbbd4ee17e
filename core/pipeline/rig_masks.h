#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/photometry/stitch_table.h"
#include "core/sphere/rig.h"
#include "core/sphere/sphere_grid.h"

namespace omnihdr {

// A mask picture as W×H×1, white (of its first channel) = use. Errors name the file.
Result<Image<std::uint8_t>> ReadMask(const std::filesystem::path& file);

// The lens masks that a rig names as one picture of the stacked frame; empty when no sensor has
// one. `directory`: where the rig file lies. Errors name the mask's file: missing, another size
// than its sensor's.
Result<Image<std::uint8_t>> ReadLensMasks(const Rig& rig, const std::filesystem::path& directory);

// What of a rig's frames and of the panorama not to use; an empty picture = use all.
struct RigMasks {
  Image<std::uint8_t> sensors;   // the stacked frame's size
  Image<std::uint8_t> panorama;  // the grid's size
  StitchMasks views() const { return {sensors.view(), panorama.view()}; }
};

// The lens masks together with a person's mask (empty = none), which either has the size of the
// stacked frame, or is a lat-long picture of any size twice as wide as high (sky, vehicle): then
// the nearest of its pixels counts for each of the grid's. Error (kData): another size.
Result<RigMasks> ReadRigMasks(const Rig& rig, const std::filesystem::path& directory,
                              const SphereGrid& grid, ImageView<const std::uint8_t> mask,
                              const std::string& mask_name);

}  // namespace omnihdr
