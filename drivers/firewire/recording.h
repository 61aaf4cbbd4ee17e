#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <vector>

#include "drivers/firewire/firewire.h"
#include "drivers/recording/recording_file.h"

namespace omnihdr::firewire {

// What a driver asked of a bus and what came back, packets, resets and errors included, as a file:
// made beside the real thing and played back later without it.

using recording::RecordingOptions;

// Hands everything on to `bus` and writes it down. The file is made anew by the first List, which
// fails with kCannotCreate when that cannot be done; a file that cannot be written later ends the
// recording and nothing else. One camera at a time.
std::unique_ptr<Bus> MakeRecordingBus(std::shared_ptr<Bus> bus, const RecordingOptions& options);

// Plays a recording back to a driver that asks the same. Law: accesses to registers are answered in
// their order, and what concerns the stream (node, resources, receiving) in its own; one that is
// not the recorded one is kFailed or kProtocol, and Node::detail or the message names both; after
// the end all is kGone or kUnavailable. Packets and resets come once all accesses recorded before
// them have been made; waiting for what is not due is kTemporary, as often as it is asked.
// Untrusted bytes; kData when they are no recording, a cut one is played as far as it goes.
Result<std::unique_ptr<Bus>> MakeReplayingBus(std::vector<std::byte> recording);
Result<std::unique_ptr<Bus>> MakeReplayingBus(const std::filesystem::path& file);

}  // namespace omnihdr::firewire
