#pragma once

#include <memory>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "drivers/v4l2/device.h"

namespace omnihdr::v4l2 {

// A camera's node, opened, and what it says of itself.
struct FoundCamera {
  V4l2Node node;
  std::unique_ptr<V4l2Device> device;
  std::string driver;
  std::string card;
  std::string bus;
};

// A camera there now, or a node that could not be asked whether it is one.
struct ListedCamera {
  V4l2Node node;
  std::string card;     // what the driver calls it
  std::string problem;  // why it could not be asked, or cannot be used; `card` is empty then
};
// By number. Nodes that are no camera, such as those of metadata, are left out.
std::vector<ListedCamera> ListCameras(V4l2System& system);

// The camera of that path (/dev/video0), name in /dev/v4l/by-id or by-path (with or without the
// folder) or serial number; "" = the only one there. kUnavailable: there is
// none, or more than one; the message names what is there.
Result<FoundCamera> FindCamera(V4l2System& system, const std::string& name);

}  // namespace omnihdr::v4l2
