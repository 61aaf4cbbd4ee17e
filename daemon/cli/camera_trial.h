#pragma once

#include <functional>
#include <string>
#include <vector>

#include "core/ports/camera.h"

namespace omnihdr {

// What a camera is put to. A shortened form of the suite that every driver passes in the tests, for
// a real camera on the bench.
struct CameraTrialOptions {
  int starts = 50;                   // times its stream is started and stopped, 1 to 1000
  int exposures = 5;                 // of the ladder, shortest to longest, 2 to 20
  int triggers = 20;                 // given as fast as the camera takes them, 1 to 1000
  double longest_s = 0.1;            // of the ladder, unless the camera's own longest is shorter
  double exposure_tolerance = 0.02;  // relative, of asked for and proved
  Nanoseconds frame_timeout = std::chrono::seconds(2);
  // Asks whoever sits there to unplug the camera and to plug it in again; empty = not tried.
  std::function<void(const std::string& what_to_do)> ask;
  Nanoseconds return_timeout = std::chrono::seconds(60);
};

struct CameraTrialStep {
  std::string name;
  bool passed = false;
  std::string detail;  // what was seen, or what was wrong
};

// The open, stopped camera through the whole trial, which ends at the first step after which
// nothing else can work; `told` is called with each step as it ends. The camera is stopped after
// it.
std::vector<CameraTrialStep> RunCameraTrial(
    Camera& camera, const CameraInfo& info, const CameraTrialOptions& options,
    const std::function<void(const CameraTrialStep&)>& told);

// One picture: the trigger is given again while the camera is still busy, until the timeout.
Result<CameraFrame> TakeOnePicture(Camera& camera, const ExposureRequest& request,
                                   Nanoseconds timeout);

// Mean value of a picture's pixels, 0 to 1 of the largest code.
double MeanLevel(const CameraFrame& frame, int bits);

}  // namespace omnihdr
