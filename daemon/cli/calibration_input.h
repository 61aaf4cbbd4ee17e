#pragma once

#include <Eigen/Core>
#include <array>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/photometry/response.h"
#include "core/photometry/sensor_picture.h"
#include "core/sphere/rig.h"

namespace CLI {
class App;
}

namespace omnihdr {

// The pictures that `omnihdr calibrate white-balance|sensors|vignetting` work on, as the command
// line names them.
struct CalibrationArguments {
  // [SENSOR=]IMAGE[@SECONDS]; an IMAGE as tall as all the rig's sensors together is a stacked
  // frame.
  std::vector<std::string> images;
  std::string session;
  std::string rig;
  std::string response;  // empty: the session's or the sensor's own, or else linear
  std::string bayer;     // empty: the rig's or the session's
  int bits = 16;
};

struct CalibrationPicture {
  std::string name;  // for people: the file, and the sensor's part of it
  int sensor = 0;    // index into CalibrationInput::sensors
  int stand = 0;     // pictures of one stacked frame share it; of single files it counts per sensor
  double seconds = 1.0;
  bool has_seconds = false;
  std::optional<Eigen::Matrix3d> world_from_rig;  // when the session knows it
  SensorPicture picture;
};

struct CalibrationInput {
  std::vector<std::string> sensors;  // names
  std::vector<Response> responses;   // of each sensor
  std::optional<Rig> rig;
  std::string rig_file;
  int pictures = 0;
};

// Adds the options that the struct stands for.
void AddCalibrationOptions(CLI::App* command, CalibrationArguments* arguments);

// Reads rig and session and hands over one picture after the other (one is in memory at a time).
// Stops at the first error of a file or of `visit`.
Result<CalibrationInput> ReadCalibrationPictures(
    const CalibrationArguments& arguments,
    const std::function<Status(const CalibrationInput&, CalibrationPicture)>& visit);

// "x,y,x,y,x,y,x,y" as four points. Error: kUsage.
Result<std::array<Eigen::Vector2d, 4>> ParseCorners(const std::string& text);

}  // namespace omnihdr
