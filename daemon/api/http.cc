#include "daemon/api/http.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <utility>

namespace omnihdr {
namespace {

constexpr char kBytesBehind[] =
    "there are bytes behind the request, expected one request a connection";

bool IsTokenCharacter(char c) {
  constexpr std::string_view kOthers = "!#$%&'*+-.^_`|~";
  return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
         kOthers.find(c) != std::string_view::npos;
}

bool IsToken(std::string_view text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), IsTokenCharacter);
}

bool IsVisible(char c) { return c > 0x20 && c < 0x7F; }

char Lower(char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; }

bool SameName(std::string_view a, std::string_view lower_case) {
  return a.size() == lower_case.size() && std::equal(a.begin(), a.end(), lower_case.begin(),
                                                     [](char x, char y) { return Lower(x) == y; });
}

std::string_view Trimmed(std::string_view text) {
  const auto space = [](char c) { return c == ' ' || c == '\t'; };
  while (!text.empty() && space(text.front())) text.remove_prefix(1);
  while (!text.empty() && space(text.back())) text.remove_suffix(1);
  return text;
}

}  // namespace

std::string_view HttpReason(int status) {
  switch (status) {
    case 200:
      return "OK";
    case 400:
      return "Bad Request";
    case 401:
      return "Unauthorized";
    case 404:
      return "Not Found";
    case 405:
      return "Method Not Allowed";
    case 408:
      return "Request Timeout";
    case 409:
      return "Conflict";
    case 413:
      return "Payload Too Large";
    case 414:
      return "URI Too Long";
    case 417:
      return "Expectation Failed";
    case 422:
      return "Unprocessable Entity";
    case 429:
      return "Too Many Requests";
    case 431:
      return "Request Header Fields Too Large";
    case 501:
      return "Not Implemented";
    case 503:
      return "Service Unavailable";
    case 505:
      return "HTTP Version Not Supported";
    default:
      return "Internal Server Error";
  }
}

void HttpReader::Refuse(int status, std::string reason) {
  state_ = State::kRefused;
  status_ = status;
  reason_ = std::move(reason);
}

bool HttpReader::TakeRequestLine(std::string_view line) {
  const std::size_t first = line.find(' ');
  const std::size_t second = first == std::string_view::npos ? first : line.find(' ', first + 1);
  if (second == std::string_view::npos) {
    Refuse(400, "the request line is not \"METHOD TARGET HTTP/1.1\"");
    return false;
  }
  const std::string_view method = line.substr(0, first);
  const std::string_view target = line.substr(first + 1, second - first - 1);
  const std::string_view version = line.substr(second + 1);
  if (!IsToken(method)) {
    Refuse(400, "the method is not a token");
  } else if (target.size() > kMaxTargetBytes) {
    Refuse(414, fmt::format("a target of {} bytes, expected at most {}", target.size(),
                            kMaxTargetBytes));
  } else if (target.empty() || target.front() != '/' ||
             !std::all_of(target.begin(), target.end(), IsVisible)) {
    Refuse(400, "the target is not a path of visible ASCII characters");
  } else if (version != "HTTP/1.1" && version != "HTTP/1.0") {
    Refuse(505, "expected HTTP/1.1 or HTTP/1.0");
  }
  if (state_ == State::kRefused) return false;
  request_.method = method;
  request_.target = target;
  request_.chunks = version == "HTTP/1.1";
  return true;
}

bool HttpReader::TakeHeader(std::string_view line) {
  if (++headers_ > kMaxHeaders) {
    Refuse(431, fmt::format("over {} headers, expected at most so many", kMaxHeaders));
    return false;
  }
  const std::size_t colon = line.find(':');
  if (colon == std::string_view::npos || !IsToken(line.substr(0, colon))) {
    Refuse(400, "a header is not \"Name: value\"");
    return false;
  }
  const std::string_view name = line.substr(0, colon);
  const std::string_view value = Trimmed(line.substr(colon + 1));
  const auto control = [](char c) {
    return (static_cast<unsigned char>(c) < 0x20 && c != '\t') || c == 0x7F;
  };
  if (std::any_of(value.begin(), value.end(), control)) {
    Refuse(400, "a header has control characters");
  } else if (SameName(name, "transfer-encoding")) {
    Refuse(501, "Transfer-Encoding: expected Content-Length");
  } else if (SameName(name, "expect")) {
    Refuse(417, "Expect: send the body with the request");
  } else if (SameName(name, "content-length")) {
    std::size_t length = 0;
    const char* const end = value.data() + value.size();
    const auto [stop, error] = std::from_chars(value.data(), end, length);
    const bool digits = !value.empty() && value.front() >= '0' && value.front() <= '9';
    if (has_length_ || !digits || stop != end || error == std::errc::invalid_argument) {
      Refuse(400, "Content-Length: expected one whole number");
    } else if (error != std::errc() || length > kMaxBodyBytes) {
      Refuse(413, fmt::format("the body is too large: expected at most {} bytes", kMaxBodyBytes));
    }
    has_length_ = true;
    length_ = length;
  } else if (SameName(name, "accept")) {
    request_.accept = value;
  } else if (SameName(name, "authorization")) {
    if (!request_.authorization.empty()) Refuse(400, "Authorization: expected it once");
    request_.authorization = value;
  }
  return state_ != State::kRefused;
}

// A line of the head, without its end; false = no more of the head is to be taken.
bool HttpReader::TakeLine(std::string_view line) {
  if (first_line_) {
    // Some clients send an empty line in front.
    if (line.empty()) return true;
    first_line_ = false;
    return TakeRequestLine(line);
  }
  if (!line.empty()) return TakeHeader(line);
  in_body_ = true;
  return false;
}

HttpReader::State HttpReader::Take(std::string_view bytes) {
  if (state_ == State::kComplete && !bytes.empty()) {
    Refuse(400, kBytesBehind);
    return state_;
  }
  while (state_ == State::kNeedMore && !in_body_ && !bytes.empty()) {
    const char c = bytes.front();
    bytes.remove_prefix(1);
    if (++head_bytes_ > kMaxHeadBytes) {
      Refuse(431,
             fmt::format("over {} bytes before the body, expected at most so many", kMaxHeadBytes));
      break;
    }
    if (c != '\n') {
      line_ += c;
      continue;
    }
    if (line_.empty() || line_.back() != '\r') {
      Refuse(400, "a line does not end in CR LF");
      break;
    }
    line_.pop_back();
    TakeLine(line_);
    line_.clear();
  }
  if (state_ != State::kNeedMore || !in_body_) return state_;
  if (request_.body.size() + bytes.size() > length_) {
    Refuse(400, kBytesBehind);
    return state_;
  }
  request_.body += bytes;
  if (request_.body.size() == length_) state_ = State::kComplete;
  return state_;
}

}  // namespace omnihdr
