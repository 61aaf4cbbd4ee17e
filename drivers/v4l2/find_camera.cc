#include "drivers/v4l2/find_camera.h"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <optional>
#include <string_view>
#include <utility>
#include <vector>

namespace omnihdr::v4l2 {
namespace {

template <std::size_t N>
std::string Text(const unsigned char (&text)[N]) {
  std::string made(reinterpret_cast<const char*>(text),
                   strnlen(reinterpret_cast<const char*>(text), N));
  for (char& c : made) {
    if (c < 0x20 || c > 0x7E) c = '?';
  }
  return made;
}

// Nothing for a node that is no camera, such as one of metadata.
Result<std::optional<FoundCamera>> Identify(V4l2System& system, const V4l2Node& node) {
  FoundCamera found;
  found.node = node;
  found.device = system.MakeDevice();
  if (const int opened = found.device->Open(node.path); opened < 0) return FailCall("open", opened);
  v4l2_capability told{};
  if (const int called = found.device->Ioctl(VIDIOC_QUERYCAP, &told); called < 0) {
    return FailCall("VIDIOC_QUERYCAP", called);
  }
  const std::uint32_t can =
      (told.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? told.device_caps : told.capabilities;
  if ((can & V4L2_CAP_VIDEO_CAPTURE_MPLANE) != 0) {
    return Fail(ErrorKind::kConfig, "a multi-planar device, expected a single-planar one");
  }
  constexpr std::uint32_t kNeeded = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
  if ((can & kNeeded) != kNeeded) return std::optional<FoundCamera>();
  found.driver = Text(told.driver);
  found.card = Text(told.card);
  found.bus = Text(told.bus_info);
  return std::optional<FoundCamera>(std::move(found));
}

// A name that udev gives may stand with its folder.
bool IsCalled(const V4l2Node& node, std::string_view name) {
  if (name == node.path || name == node.serial) return true;
  for (const std::string_view folder : {"/dev/v4l/by-id/", "/dev/v4l/by-path/"}) {
    if (name.starts_with(folder)) name.remove_prefix(folder.size());
  }
  return std::find(node.names.begin(), node.names.end(), name) != node.names.end();
}

}  // namespace

std::vector<ListedCamera> ListCameras(V4l2System& system) {
  std::vector<ListedCamera> cameras;
  for (const V4l2Node& node : system.List()) {
    Result<std::optional<FoundCamera>> found = Identify(system, node);
    if (!found) {
      cameras.push_back({node, {}, found.error().message});
    } else if (*found) {
      cameras.push_back({node, (*found)->card, {}});
    }
  }
  return cameras;
}

Result<FoundCamera> FindCamera(V4l2System& system, const std::string& name) {
  const std::vector<V4l2Node> nodes = system.List();
  if (nodes.empty()) return Fail(ErrorKind::kUnavailable, "no video device");
  std::optional<FoundCamera> chosen;
  std::optional<Error> failure;
  std::string seen;
  int matching = 0;
  for (const V4l2Node& node : nodes) {
    const bool called = name.empty() || IsCalled(node, name);
    if (!seen.empty()) seen += ", ";
    seen += node.path;
    if (!node.serial.empty()) seen += fmt::format(" (serial {})", node.serial);
    if (!called) continue;
    Result<std::optional<FoundCamera>> found = Identify(system, node).Context(node.path);
    if (!found) {
      if (!failure) failure = std::move(found).error();
      continue;
    }
    if (!*found) continue;
    ++matching;
    if (!chosen) chosen = std::move(**found);
  }
  if (matching == 1) return std::move(*chosen);
  if (matching > 1) {
    return Fail(ErrorKind::kUnavailable, "{} cameras and none chosen (camera.v4l2.device): {}",
                matching, seen);
  }
  if (failure) return Forward(std::move(*failure));
  return Fail(ErrorKind::kUnavailable, "no camera \"{}\" among: {}", name, seen);
}

}  // namespace omnihdr::v4l2
