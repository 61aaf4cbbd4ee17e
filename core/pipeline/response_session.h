#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/image/image_io.h"
#include "core/photometry/response_samples.h"
#include "core/session/session_reader.h"
#include "core/sphere/rig.h"

namespace omnihdr {

struct SessionSamples {
  ResponseSamples samples;  // exposures that are equal within a percent are one
  bool moving = false;      // from neighbouring positions, not from brackets of one place
  int frames = 0;           // that took part
  int links = 0;            // moving: pairs of positions that were matched
  std::vector<std::string> warnings;
};

struct SessionSampleOptions {
  SampleOptions samples;
  int max_positions = 12;  // with brackets, spread over the session
  int max_frames = 40;     // of a moving session, from its start
  int reach = 2;           // moving: positions i and i + 1 … i + reach are compared
  Status Validate() const;
};

// What a response is recovered from, of a recorded session. Where frames of different exposure
// share a position: spots of those brackets (SamplesFromBracket). Where the camera moved between
// exposures (layout panorama): features found in both of two neighbouring positions' frames and
// agreeing with one motion of the camera (essential matrix), which things that moved by themselves
// do not; a feature is a blob, whose mean over its core changes least with where exactly it is put.
// Bayer mosaics of the layout rig are read at half size. `mask`: empty or of a frame's size, under
// 128 = do not use.
// Errors: as SamplesFromBracket; a moving session whose layout is not panorama or of which no two
// neighbours under different exposures could be matched.
Result<SessionSamples> SamplesFromSession(const std::filesystem::path& directory,
                                          const SessionContents& contents,
                                          ImageView<const std::uint8_t> mask,
                                          const SessionSampleOptions& options);

// A Bayer mosaic as colour at half size: each 2×2 tile one pixel, its green the mean of two.
// Requires one channel and an order. And a mask to go with it: what any of the four does not use.
DecodedImage HalfSizeColour(const DecodedImage& mosaic, BayerOrder order);
Image<std::uint8_t> HalfSizeMask(ImageView<const std::uint8_t> mask);

}  // namespace omnihdr
