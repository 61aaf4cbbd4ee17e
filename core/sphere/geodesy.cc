#include "core/sphere/geodesy.h"

#include <cmath>
#include <numbers>

namespace omnihdr {
namespace {

constexpr double kRadius = 6378137.0;  // of the equator
constexpr double kEccentricitySquared = 6.69437999014e-3;
constexpr double kDegree = std::numbers::pi / 180.0;

// Of curvature across the meridian.
double PrimeRadius(double lat) {
  const double sine = std::sin(lat);
  return kRadius / std::sqrt(1.0 - kEccentricitySquared * sine * sine);
}

Eigen::Vector3d EarthCentred(const GeodeticPlace& place) {
  const double lat = place.lat_deg * kDegree;
  const double lon = place.lon_deg * kDegree;
  const double n = PrimeRadius(lat);
  return {(n + place.alt_m) * std::cos(lat) * std::cos(lon),
          (n + place.alt_m) * std::cos(lat) * std::sin(lon),
          (n * (1.0 - kEccentricitySquared) + place.alt_m) * std::sin(lat)};
}

}  // namespace

Eigen::Vector3d EastNorthUp(const GeodeticPlace& origin, const GeodeticPlace& place) {
  const double lat = origin.lat_deg * kDegree;
  const double lon = origin.lon_deg * kDegree;
  Eigen::Matrix3d enu_from_earth;
  enu_from_earth << -std::sin(lon), std::cos(lon), 0.0,                               //
      -std::sin(lat) * std::cos(lon), -std::sin(lat) * std::sin(lon), std::cos(lat),  //
      std::cos(lat) * std::cos(lon), std::cos(lat) * std::sin(lon), std::sin(lat);
  return enu_from_earth * (EarthCentred(place) - EarthCentred(origin));
}

GeodeticPlace PlaceAt(const GeodeticPlace& origin, const Eigen::Vector3d& enu) {
  GeodeticPlace place = origin;
  // Newton's method on the exact forward map, with the slope at the origin.
  const double lat = origin.lat_deg * kDegree;
  const double n = PrimeRadius(lat);
  const double sine = std::sin(lat);
  const double m = n * (1.0 - kEccentricitySquared) / (1.0 - kEccentricitySquared * sine * sine);
  for (int step = 0; step < 3; ++step) {
    const Eigen::Vector3d missing = enu - EastNorthUp(origin, place);
    place.lat_deg += missing.y() / (m + origin.alt_m) / kDegree;
    place.lon_deg += missing.x() / ((n + origin.alt_m) * std::cos(lat)) / kDegree;
    place.alt_m += missing.z();
  }
  return place;
}

}  // namespace omnihdr
