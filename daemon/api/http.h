#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace omnihdr {

// The part of HTTP/1.1 that the API speaks: one request a connection, with a small body of a stated
// length or none. What is more than that is refused, not interpreted: nothing is decoded, folded,
// or passed on.

struct HttpRequest {
  std::string method;
  std::string target;  // as it came: never decoded, never taken for a path of a file
  bool chunks = true;  // the client is of HTTP/1.1 and takes an answer in chunks
  std::string accept;  // of the headers those that mean something here
  std::string authorization;
  std::string body;
};

// Takes a request's bytes as they come. Laws: what comes out does not depend on how the bytes were
// cut; a request that is complete keeps every limit below; at most kMaxHeadBytes + kMaxBodyBytes
// are kept. Not thread-safe.
class HttpReader {
 public:
  static constexpr std::size_t kMaxHeadBytes = 8192;
  static constexpr std::size_t kMaxTargetBytes = 256;
  static constexpr std::size_t kMaxHeaders = 64;
  static constexpr std::size_t kMaxBodyBytes = 4096;

  enum class State { kNeedMore, kComplete, kRefused };
  State Take(std::string_view bytes);
  State state() const { return state_; }

  // Of a complete request.
  const HttpRequest& request() const { return request_; }
  // Of a refused one: the status of the answer, 400, 413, 414, 417, 431, 501 or 505, and why.
  int status() const { return status_; }
  const std::string& reason() const { return reason_; }

 private:
  void Refuse(int status, std::string reason);
  bool TakeRequestLine(std::string_view line);
  bool TakeHeader(std::string_view line);
  bool TakeLine(std::string_view line);

  State state_ = State::kNeedMore;
  bool in_body_ = false;
  bool first_line_ = true;
  bool has_length_ = false;
  std::size_t length_ = 0;
  std::size_t head_bytes_ = 0;
  std::size_t headers_ = 0;
  std::string line_;
  HttpRequest request_;
  int status_ = 0;
  std::string reason_;
};

// "Bad Request" for 400.
std::string_view HttpReason(int status);

}  // namespace omnihdr
