#pragma once

#include <fmt/format.h>

#include <string>
#include <string_view>
#include <tl/expected.hpp>
#include <utility>

namespace omnihdr {

// What kind of failure this is; decides the process's exit code (sysexits.h).
enum class ErrorKind {
  kUsage,         // EX_USAGE 64: the command line is wrong
  kData,          // EX_DATAERR 65: a file's content is wrong
  kNoInput,       // EX_NOINPUT 66: an input file is missing or unreadable
  kUnavailable,   // EX_UNAVAILABLE 69: a device or service is not there
  kSoftware,      // EX_SOFTWARE 70: our own fault
  kSystem,        // EX_OSERR 71: the operating system refused
  kCannotCreate,  // EX_CANTCREAT 73: an output file cannot be created
  kIo,            // EX_IOERR 74: reading or writing failed half-way (disk full, ...)
  kTemporary,     // EX_TEMPFAIL 75: try again (deadline passed, busy)
  kProtocol,      // EX_PROTOCOL 76: the other side broke the protocol
  kPermission,    // EX_NOPERM 77
  kConfig,        // EX_CONFIG 78: a configuration file or key is wrong
};

// The sysexits.h code for a kind of failure.
int ExitCode(ErrorKind kind);

// A failure with the way it came: each layer puts what it was doing in front of the message.
struct Error {
  ErrorKind kind = ErrorKind::kSoftware;
  std::string message;
};

// A value or the reason why there is none. [[nodiscard]]: a failure cannot be dropped by accident.
template <typename T>
class [[nodiscard]] Result : public tl::expected<T, Error> {
 public:
  using Base = tl::expected<T, Error>;
  using Base::Base;
  Result(Base base) : Base(std::move(base)) {}  // NOLINT(google-explicit-constructor)

  // The same result, its error (if any) prefixed with what the caller was doing: "what: message".
  Result Context(std::string_view what) && {
    if (!this->has_value()) {
      this->error().message = fmt::format("{}: {}", what, this->error().message);
    }
    return std::move(*this);
  }
};

using Status = Result<void>;

template <typename... Args>
tl::unexpected<Error> Fail(ErrorKind kind, fmt::format_string<Args...> format, Args&&... args) {
  return tl::unexpected<Error>(Error{kind, fmt::format(format, std::forward<Args>(args)...)});
}

// Passes an error on with the caller's own activity in front of it.
inline tl::unexpected<Error> Forward(Error error, std::string_view what) {
  error.message = fmt::format("{}: {}", what, error.message);
  return tl::unexpected<Error>(std::move(error));
}
inline tl::unexpected<Error> Forward(Error error) {
  return tl::unexpected<Error>(std::move(error));
}

// errno as a Result error: "what: No space left on device".
tl::unexpected<Error> FailErrno(ErrorKind kind, std::string_view what, int error_number);

}  // namespace omnihdr

// Returns from the enclosing function with the error of a Status / Result expression.
#define OMNIHDR_TRY(expression)                                                     \
  do {                                                                              \
    if (auto omnihdr_status = (expression); !omnihdr_status) {                      \
      return ::tl::unexpected<::omnihdr::Error>(std::move(omnihdr_status).error()); \
    }                                                                               \
  } while (false)

// `OMNIHDR_ASSIGN(auto value, Function());` declares value or returns the error.
#define OMNIHDR_ASSIGN(declaration, expression) \
  OMNIHDR_ASSIGN_IMPL(OMNIHDR_CONCAT(omnihdr_result_, __LINE__), declaration, expression)
#define OMNIHDR_ASSIGN_IMPL(result, declaration, expression)              \
  auto result = (expression);                                             \
  if (!result) {                                                          \
    return ::tl::unexpected<::omnihdr::Error>(std::move(result).error()); \
  }                                                                       \
  declaration = std::move(*result)
#define OMNIHDR_CONCAT(a, b) OMNIHDR_CONCAT_IMPL(a, b)
#define OMNIHDR_CONCAT_IMPL(a, b) a##b
