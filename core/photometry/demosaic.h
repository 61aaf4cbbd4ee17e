#pragma once

namespace omnihdr {

// How a panorama's colours are interpolated from the mosaics of a rig's sensors.
enum class Demosaic {
  // Every colour for itself, bilinear at its own (half) density. The fastest.
  kBilinear,
  // Green along edges, not across them; red and blue follow the green's detail (GreenGuide). About
  // a third less error at edges, more noise in even areas (core/photometry/README.md).
  kEdgeAware,
};

}  // namespace omnihdr
