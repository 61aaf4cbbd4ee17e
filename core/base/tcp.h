#pragma once

#include <string>

#include "core/base/clock.h"
#include "core/base/file.h"
#include "core/base/result.h"

namespace omnihdr {

// TCP by numeric IPv4 and IPv6 addresses only: looking up a name has no deadline.

bool IsNumericAddress(const std::string& address);
// A connected socket that does not block; kUnavailable or kTemporary within `timeout`.
Result<Fd> ConnectTcp(const std::string& address, int port, Nanoseconds timeout);
// A listening socket that does not block. Port 0 = any free one.
Result<Fd> ListenTcp(const std::string& address, int port);
// The port of a socket; 0 when it has none.
int LocalPort(int fd);

}  // namespace omnihdr
