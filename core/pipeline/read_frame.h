#pragma once

#include <filesystem>

#include "core/base/result.h"
#include "core/image/image_io.h"
#include "core/session/session.h"

namespace omnihdr {

// The pixels of a frame of a session. kData, naming the file, when they are not those journaled (by
// crc32c, where the line has one) or not of the camera's size.
Result<DecodedImage> ReadFrame(const std::filesystem::path& session,
                               const CameraDescription& camera, const FrameRecord& record);

}  // namespace omnihdr
