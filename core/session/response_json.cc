#include "core/session/response_json.h"

#include <array>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "core/session/limits.h"
#include "core/session/response_members.h"
#include "core/session/session_reader.h"

namespace omnihdr {
namespace json {

Result<Response> ReadResponse(const ObjectReader& json) {
  constexpr std::string_view kModels = "\"linear\", \"loglinear\" or \"table\"";
  OMNIHDR_ASSIGN(const std::string model, json.String("model", kModels));
  Result<Response> response = Response::Linear();
  if (model == "linear") {
    OMNIHDR_ASSIGN(const double black, json.NumberOr("black", 0.0, 0.0, std::nextafter(128.0, 0.0),
                                                     "8-bit code values in [0, 128)"));
    response = Response::Linear(black);
  } else if (model == "loglinear") {
    std::array<std::array<double, 2>, 3> a_b{};
    constexpr std::array<std::string_view, 3> kChannels = {"r", "g", "b"};
    constexpr std::string_view kPair = "[a, b] with a > 0, of ln X = a*Z + b";
    for (std::size_t c = 0; c < 3; ++c) {
      OMNIHDR_ASSIGN(const Json* pair, json.Array(kChannels[c], kPair));
      if (pair->size() != 2) return json.Wrong(kChannels[c], kPair);
      const std::optional<double> a = FiniteNumber((*pair)[0]);
      const std::optional<double> b = FiniteNumber((*pair)[1]);
      if (!a || !b || *a <= 0.0) return json.Wrong(kChannels[c], kPair);
      a_b[c] = {*a, *b};
    }
    response = Response::LogLinear(a_b);
  } else if (model == "table") {
    constexpr std::string_view kTable = "three arrays of 256 finite, non-decreasing numbers";
    OMNIHDR_ASSIGN(const Json* rows, json.Array("ln_exposure", kTable));
    if (rows->size() != 3) return json.Wrong("ln_exposure", kTable);
    std::array<std::vector<double>, 3> table;
    for (std::size_t c = 0; c < 3; ++c) {
      const Json& row = (*rows)[c];
      if (!row.is_array() || row.size() != 256) return json.Wrong("ln_exposure", kTable);
      for (const Json& value : row) {
        const std::optional<double> number = FiniteNumber(value);
        if (!number) return json.Wrong("ln_exposure", kTable);
        table[c].push_back(*number);
      }
    }
    response = Response::Table(table);
  } else {
    return json.Wrong("model", kModels);
  }
  if (!response) return json.Wrong("model", response.error().message);
  OMNIHDR_ASSIGN(const double white,
                 json.NumberOr("white", 255.0, 64.0, 255.0, "8-bit code values in [64, 255]"));
  return response->WithWhite(white);
}

ObjectWriter ResponseObject(const Response& response) {
  ObjectWriter json;
  switch (response.model()) {
    case ResponseModel::kLinear:
      json.Add("model", "linear");
      if (response.black() != 0.0) json.Add("black", response.black());
      break;
    case ResponseModel::kLogLinear:
      json.Add("model", "loglinear");
      json.Add("r", response.loglinear()[0]);
      json.Add("g", response.loglinear()[1]);
      json.Add("b", response.loglinear()[2]);
      break;
    case ResponseModel::kTable:
      json.Add("model", "table").Add("ln_exposure", response.table());
      break;
  }
  if (response.white() != 255.0) json.Add("white", response.white());
  return json;
}

}  // namespace json

namespace {

// Where the value of a member of the outermost object stands, the last one of that name as readers
// take it. `text` is valid JSON.
std::optional<std::pair<std::size_t, std::size_t>> ValueOfMember(std::string_view text,
                                                                 std::string_view key) {
  std::optional<std::pair<std::size_t, std::size_t>> found;
  int depth = 0;
  std::string_view last_string;
  std::size_t value_begin = std::string_view::npos;
  const auto close = [&](std::size_t end) {
    if (value_begin == std::string_view::npos) return;
    while (end > value_begin &&
           std::string_view(" \t\r\n").find(text[end - 1]) != std::string_view::npos) {
      --end;
    }
    found = {value_begin, end};
    value_begin = std::string_view::npos;
  };
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (c == '"') {
      const std::size_t begin = i + 1;
      for (++i; i < text.size() && text[i] != '"'; ++i) {
        if (text[i] == '\\') ++i;
      }
      if (depth == 1) last_string = text.substr(begin, i - begin);
    } else if (c == ':' && depth == 1 && last_string == key) {
      value_begin = text.find_first_not_of(" \t\r\n", i + 1);
    } else if (c == '{' || c == '[') {
      ++depth;
    } else if (c == '}' || c == ']') {
      if (depth == 1) close(i);
      --depth;
    } else if (c == ',' && depth == 1) {
      close(i);
      last_string = {};
    }
  }
  return found;
}

}  // namespace

Result<Response> ParseResponse(std::string_view text, const std::string& name) {
  if (text.size() > session_limits::kMaxInfoBytes) {
    return Fail(ErrorKind::kData, "{}: {} bytes, expected at most {}", name, text.size(),
                session_limits::kMaxInfoBytes);
  }
  const json::Source source{name, text, 0};
  OMNIHDR_ASSIGN(const json::Json value, json::Parse(source));
  OMNIHDR_ASSIGN(const json::ObjectReader reader, json::ObjectReader::Root(source, value));
  return json::ReadResponse(reader);
}

std::string FormatResponse(const Response& response) {
  return json::ResponseObject(response).Finish();
}

Result<std::string> ReplaceSessionResponse(std::string_view text, const std::string& name,
                                           const Response& response) {
  OMNIHDR_TRY(ParseSessionInfo(text, name));
  const auto place = ValueOfMember(text, "response");
  if (!place) {
    // Parsed, so it is there: its name is written with escapes.
    return Fail(ErrorKind::kData, "{}: response: expected its name in plain letters", name);
  }
  std::string replaced(text.substr(0, place->first));
  replaced += FormatResponse(response);
  replaced += text.substr(place->second);
  OMNIHDR_TRY(ParseSessionInfo(replaced, name).Context("with the new response"));
  return replaced;
}

}  // namespace omnihdr
