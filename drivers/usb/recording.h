#pragma once

#include <filesystem>
#include <memory>
#include <span>
#include <vector>

#include "drivers/recording/recording_file.h"
#include "drivers/usb/usb.h"

namespace omnihdr::usb {

// What a driver asked of a bus and what came back, errors included, as a file: made beside the real
// thing and played back later without it.

using recording::RecordingOptions;

// Hands everything on to `bus` and writes it down. The file is made anew by the first List, which
// fails with kCannotCreate when that cannot be done; a file that cannot be written later ends the
// recording and nothing else. One camera at a time.
std::unique_ptr<Bus> MakeRecordingBus(std::shared_ptr<Bus> bus, const RecordingOptions& options);

// Plays a recording back to a driver that asks the same. Law: a request that is not the recorded
// one is kProtocol, naming both; after the recording's end every call is kUnavailable. A chunk of a
// stream comes once all requests recorded before it have been made; waiting for one that is not due
// is kTemporary, as often as it is asked. Untrusted bytes; kData when they are no recording, a cut
// one is played as far as it goes.
Result<std::unique_ptr<Bus>> MakeReplayingBus(std::vector<std::byte> recording);
Result<std::unique_ptr<Bus>> MakeReplayingBus(const std::filesystem::path& file);

}  // namespace omnihdr::usb
