#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <vector>

#include "core/ports/camera.h"
#include "drivers/recording/recording_file.h"
#include "drivers/v4l2/camera_setup.h"
#include "drivers/v4l2/device.h"
#include "drivers/v4l2/rig_camera.h"

namespace omnihdr::v4l2 {

// What a driver asked of the kernel and what came back, frames and errors included, as a file: made
// beside the real thing and played back later, on any 64-bit little-endian machine, without it.

// Hands everything on to `system` and writes it down. The file is made anew at once: kCannotCreate.
// One that cannot be written later ends the recording and nothing else. One camera at a time.
Result<std::unique_ptr<V4l2System>> MakeRecordingSystem(std::unique_ptr<V4l2System> system,
                                                        const recording::RecordingOptions& options);

// The same for a rig of `members` cameras, each with a file of its own, for they are used side by
// side: RecordingOfMember.
Result<V4l2RigCamera::MakeSystem> MakeRecordingSystems(V4l2RigCamera::MakeSystem make,
                                                       std::size_t members,
                                                       const recording::RecordingOptions& options);
// "FILE.0" for the first.
std::filesystem::path RecordingOfMember(const std::filesystem::path& file, std::size_t member);

// A camera that a recording plays, not yet open. Law: asked the same in the same order, it answers
// the same, frame by frame: each trigger is taken where the recorded one was, and time is the
// recording's, which waits for nothing else. Asked something else, or beyond its end, it is
// kUnavailable or kProtocol, and the message names what was recorded and what was asked. Prepare
// has no effect: the recording has its own. Untrusted bytes; kData when they are no recording, a
// cut one is played as far as it goes. A rig (options.devices) has one recording for each camera:
// each goes on with its own calls, and pictures meet by their triggers as they do otherwise.
Result<std::unique_ptr<Camera>> MakeReplayedCamera(const V4l2CameraOptions& options,
                                                   std::vector<std::byte> recording);
Result<std::unique_ptr<Camera>> MakeReplayedRig(const V4l2CameraOptions& options,
                                                std::vector<std::vector<std::byte>> recordings);
// `file`: as options.recording named it.
Result<std::unique_ptr<Camera>> MakeReplayedCamera(const V4l2CameraOptions& options,
                                                   const std::filesystem::path& file);

// The system below such a camera, for tests. `recording` as above.
Result<std::unique_ptr<V4l2System>> MakeReplayingSystem(std::vector<std::byte> recording);

}  // namespace omnihdr::v4l2
