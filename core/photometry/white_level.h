#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/image/image.h"
#include "core/image/image_io.h"

namespace omnihdr {

// The value that a sensor clips at where that is not the largest its samples could have: a full
// well, or an amplifier, short of the converter's end. Taken for usable, it makes highlights red or
// cyan, for the channels' gains differ.
struct WhiteLevel {
  double value = 255.0;  // 8-bit units; 98 of 100 clipped samples are not below it
  double share = 0.0;    // of the samples clipped, in the exposure with the most
  int exposures = 0;     // that show it
};

// Finds it in differently exposed pictures: samples heap up at the top of a picture that clips, and
// at the same value under every exposure; an evenly bright surface moves with the exposure. Not
// thread-safe.
class WhiteLevelFinder {
 public:
  // Rows [first_row, first_row + height) of a picture, every `step`th sample of every `step`th row.
  // `bits`: significant ones of 16-bit pictures. `mask`: empty or of the picture's size, under 128
  // = do not use.
  void Add(const DecodedImage& image, int bits, double seconds, int first_row, int height,
           ImageView<const std::uint8_t> mask = {}, int step = 1);

  // Nothing while not two exposures, at least half a stop apart, heap up at one value.
  std::optional<WhiteLevel> Find() const;

 private:
  struct Heap {
    double seconds;
    double value;
    double share;
  };
  std::vector<Heap> heaps_;
};

}  // namespace omnihdr
