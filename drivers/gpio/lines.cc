#include "drivers/gpio/lines.h"

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <system_error>

namespace omnihdr::gpio {

std::string_view ToString(Edge edge) {
  switch (edge) {
    case Edge::kRising:
      return "rising";
    case Edge::kFalling:
      return "falling";
    case Edge::kBoth:
      return "both";
  }
  return "?";
}

std::string_view ToString(Bias bias) {
  switch (bias) {
    case Bias::kAsIs:
      return "as-is";
    case Bias::kDisabled:
      return "disabled";
    case Bias::kPullUp:
      return "pull-up";
    case Bias::kPullDown:
      return "pull-down";
  }
  return "?";
}

std::vector<std::string> ChipPaths() {
  std::vector<std::string> paths;
  std::error_code error;
  for (std::filesystem::directory_iterator it("/dev", error), end; !error && it != end;
       it.increment(error)) {
    if (it->path().filename().string().starts_with("gpiochip")) {
      paths.push_back(it->path().string());
    }
  }
  std::sort(paths.begin(), paths.end());
  return paths;
}

int OffsetFromText(const std::string& text) {
  if (text.empty() || text.size() > 5 ||
      !std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; })) {
    return -1;
  }
  int offset = 0;
  for (const char c : text) offset = offset * 10 + (c - '0');
  return offset;
}

tl::unexpected<Error> FailLine(const std::string& what, int error_number) {
  switch (error_number) {
    case EBUSY:
      return Fail(ErrorKind::kUnavailable, "{}: it is in use by another program or the kernel",
                  what);
    case ENOENT:
    case ENODEV:
    case ENXIO:
    case ENOTTY:
      return Fail(ErrorKind::kUnavailable, "{}: there is no such chip or line", what);
    case EACCES:
    case EPERM:
      return FailErrno(ErrorKind::kPermission, what, error_number);
    default:
      return FailErrno(ErrorKind::kUnavailable, what, error_number);
  }
}

}  // namespace omnihdr::gpio
