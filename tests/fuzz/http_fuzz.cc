#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "daemon/api/http.h"
#include "daemon/api/routes.h"

namespace {

using namespace omnihdr;  // NOLINT(google-build-using-namespace)

class CountingBackend final : public ApiBackend {
 public:
  Result<StatusReport> GetStatus() override { return StatusReport{}; }
  ApiReply Arm() override { return Command(); }
  ApiReply Disarm() override { return Command(); }
  ApiReply Trigger() override { return Command(); }
  ApiReply Finish() override { return Command(); }
  ApiReply Stop(bool) override { return Command(); }
  ApiReply Reload() override { return Command(); }
  int commands = 0;

 private:
  ApiReply Command() {
    ++commands;
    return {};
  }
};

HttpReader Read(std::string_view text, std::size_t piece) {
  HttpReader reader;
  for (std::size_t at = 0; at < text.size(); at += piece) reader.Take(text.substr(at, piece));
  return reader;
}

void Require(bool holds) {
  if (!holds) std::abort();
}

}  // namespace

// Laws: what a request becomes does not depend on how its bytes are cut; a complete one keeps every
// limit; a refused one has a status of an error and a reason; only a POST of a whole route changes
// anything, once. The first byte says how the rest is cut.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string_view text(reinterpret_cast<const char*>(data) + 1, size - 1);
  const HttpReader whole = Read(text, std::max<std::size_t>(text.size(), 1));
  const HttpReader cut = Read(text, std::size_t{data[0]} + 1);
  Require(whole.state() == cut.state() && whole.status() == cut.status());
  if (whole.state() == HttpReader::State::kRefused) {
    Require(whole.status() >= 400 && whole.status() < 600 && !whole.reason().empty());
    return 0;
  }
  if (whole.state() == HttpReader::State::kNeedMore) return 0;
  const HttpRequest& request = whole.request();
  Require(request.method == cut.request().method && request.target == cut.request().target &&
          request.body == cut.request().body &&
          request.authorization == cut.request().authorization);
  Require(!request.method.empty() && request.target.front() == '/' &&
          request.target.size() <= HttpReader::kMaxTargetBytes &&
          request.body.size() <= HttpReader::kMaxBodyBytes);
  CountingBackend backend;
  const HttpAnswer answer = AnswerRequest(request, backend);
  Require(answer.status >= 200 && answer.status < 600 && !answer.body.empty());
  Require(backend.commands <= 1);
  Require(backend.commands == 0 ||
          (request.method == "POST" && request.target.substr(0, 4) == "/v1/"));
  return 0;
}
