#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include "core/base/clock.h"
#include "core/base/file.h"
#include "core/base/result.h"
#include "daemon/api/http.h"

namespace omnihdr {

// One connection of a client: a socket that does not block, every wait of which has a deadline.
class HttpConnection {
 public:
  explicit HttpConnection(Fd fd) : fd_(std::move(fd)) {}
  int fd() const { return fd_.get(); }

  // Reads until the request is complete or refused; false when it is neither at the deadline, or
  // when the client has gone.
  bool Read(HttpReader& reader, HostTime deadline);
  // All of it, or false: the client does not take it in time, or has gone.
  bool Write(std::string_view bytes, HostTime deadline);
  // Says that nothing more comes, and throws away what the client still sends, up to a bound: an
  // answer must not be lost to it because of bytes that nobody has read.
  void Finish(HostTime deadline);

 private:
  Fd fd_;
};

}  // namespace omnihdr
