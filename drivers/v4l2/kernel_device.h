#pragma once

#include <filesystem>
#include <memory>

#include "drivers/v4l2/device.h"

namespace omnihdr::v4l2 {

// The cameras of this machine's kernel. The roots are for tests.
struct KernelRoots {
  std::filesystem::path dev = "/dev";
  std::filesystem::path sys = "/sys";
};
std::unique_ptr<V4l2System> MakeKernelSystem(KernelRoots roots = {});

}  // namespace omnihdr::v4l2
