#pragma once

#include <Eigen/Core>

namespace omnihdr {

// A place on the WGS 84 ellipsoid.
struct GeodeticPlace {
  double lat_deg = 0.0;
  double lon_deg = 0.0;
  double alt_m = 0.0;  // above the ellipsoid, or any other level that all places share
};

// East, north and up in metres of `place` as seen from `origin`, in the plane that touches the
// ellipsoid there.
Eigen::Vector3d EastNorthUp(const GeodeticPlace& origin, const GeodeticPlace& place);

// The place that is `enu` from `origin`, to a millimetre within a hundred metres.
GeodeticPlace PlaceAt(const GeodeticPlace& origin, const Eigen::Vector3d& enu);

}  // namespace omnihdr
