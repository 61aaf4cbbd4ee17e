#include "core/base/result.h"

#include <cstring>

namespace omnihdr {

int ExitCode(ErrorKind kind) {
  switch (kind) {
    case ErrorKind::kUsage:
      return 64;
    case ErrorKind::kData:
      return 65;
    case ErrorKind::kNoInput:
      return 66;
    case ErrorKind::kUnavailable:
      return 69;
    case ErrorKind::kSoftware:
      return 70;
    case ErrorKind::kSystem:
      return 71;
    case ErrorKind::kCannotCreate:
      return 73;
    case ErrorKind::kIo:
      return 74;
    case ErrorKind::kTemporary:
      return 75;
    case ErrorKind::kProtocol:
      return 76;
    case ErrorKind::kPermission:
      return 77;
    case ErrorKind::kConfig:
      return 78;
  }
  return 70;
}

tl::unexpected<Error> FailErrno(ErrorKind kind, std::string_view what, int error_number) {
  char buffer[256];
  // The GNU strerror_r returns the text, which need not be in the buffer.
  const char* text = strerror_r(error_number, buffer, sizeof(buffer));
  return Fail(kind, "{}: {}", what, text);
}

}  // namespace omnihdr
