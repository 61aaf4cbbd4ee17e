#include "drivers/v4l2/device.h"

#include <cerrno>

namespace omnihdr::v4l2 {

const Clock& V4l2System::clock() const {
  static const SystemClock system;
  return system;
}

ErrorKind KindOf(int error) {
  switch (-error) {
    case ENODEV:
    case ENXIO:
    case ENOENT:
    case ENOSPC:
      return ErrorKind::kUnavailable;
    case EACCES:
    case EPERM:
      return ErrorKind::kPermission;
    case EBUSY:
    case EAGAIN:
    case ETIMEDOUT:
      return ErrorKind::kTemporary;
    default:
      return ErrorKind::kProtocol;
  }
}

tl::unexpected<Error> FailCall(std::string_view what, int error) {
  return FailErrno(KindOf(error), what, -error);
}

std::string FourCcName(std::uint32_t fourcc) {
  std::string name;
  for (int shift = 0; shift < 32; shift += 8) {
    const auto c = static_cast<char>(fourcc >> shift & 0x7F);
    name += c >= 0x20 && c < 0x7F ? c : '?';
  }
  while (!name.empty() && name.back() == ' ') name.pop_back();
  return name;
}

}  // namespace omnihdr::v4l2
