#include "daemon/cli/calibration_input.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <utility>

#include "core/image/image_io.h"
#include "core/session/response_json.h"
#include "core/session/rig_file.h"
#include "core/session/session_reader.h"
#include "daemon/cli/response_option.h"

namespace omnihdr {
namespace {

std::optional<double> Number(std::string_view text) {
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || !std::isfinite(value)) {
    return std::nullopt;
  }
  return value;
}

struct NamedImage {
  std::string sensor;  // empty: not said
  std::string file;
  std::optional<double> seconds;
};

Result<NamedImage> ParseImage(const std::string& text) {
  NamedImage image;
  std::string rest = text;
  const std::size_t equals = rest.find('=');
  std::error_code ignored;
  if (equals != std::string::npos && !std::filesystem::exists(rest, ignored)) {
    image.sensor = rest.substr(0, equals);
    rest = rest.substr(equals + 1);
    if (image.sensor.empty()) {
      return Fail(ErrorKind::kUsage, "{}: expected SENSOR=IMAGE@SECONDS", text);
    }
  }
  const std::size_t at = rest.rfind('@');
  if (at != std::string::npos) {
    const std::string_view seconds = std::string_view(rest).substr(at + 1);
    const std::size_t slash = seconds.find('/');
    const std::optional<double> numerator = Number(seconds.substr(0, slash));
    const std::optional<double> denominator =
        slash == std::string_view::npos ? 1.0 : Number(seconds.substr(slash + 1));
    const bool is_time = numerator && denominator && *numerator > 0.0 && *denominator > 0.0;
    // An @ may also be part of a file's name.
    if (!is_time && !std::filesystem::exists(rest, ignored)) {
      return Fail(ErrorKind::kUsage,
                  "{}: expected IMAGE@SECONDS with SECONDS > 0, as in a.png@0.5 or a.png@1/60",
                  text);
    }
    if (is_time) {
      image.seconds = *numerator / *denominator;
      rest = rest.substr(0, at);
    }
  }
  if (rest.empty()) return Fail(ErrorKind::kUsage, "{}: no image named", text);
  image.file = rest;
  return image;
}

Result<BayerOrder> ParseBayer(const std::string& name) {
  if (name.empty()) return BayerOrder::kNone;
  const std::optional<BayerOrder> order = BayerOrderFromString(name);
  if (!order) {
    return Fail(ErrorKind::kUsage, "--bayer: {}, expected RGGB, GRBG, GBRG or BGGR", name);
  }
  return *order;
}

using Visit = std::function<Status(const CalibrationInput&, CalibrationPicture)>;

class Reader {
 public:
  Reader(const CalibrationArguments& arguments, const Visit& visit)
      : arguments_(arguments), visit_(visit) {}

  Result<CalibrationInput> Read() {
    OMNIHDR_ASSIGN(bayer_, ParseBayer(arguments_.bayer));
    if (!arguments_.response.empty()) {
      OMNIHDR_ASSIGN(response_, ResponseOf(arguments_.response));
    }
    bits_ = arguments_.bits;
    std::optional<SessionContents> session;
    input_.rig_file = arguments_.rig;
    if (!arguments_.session.empty()) {
      OMNIHDR_ASSIGN(session, ReadSession(arguments_.session));
      OMNIHDR_TRY(TakeSession(session->info));
    }
    if (!input_.rig_file.empty()) OMNIHDR_TRY(TakeRig());
    std::vector<NamedImage> images;
    for (const std::string& text : arguments_.images) {
      OMNIHDR_ASSIGN(NamedImage image, ParseImage(text));
      images.push_back(std::move(image));
    }
    if (!input_.rig) OMNIHDR_TRY(NameSensors(images, session.has_value()));
    for (const NamedImage& image : images) OMNIHDR_TRY(VisitImage(image));
    if (session) {
      for (const FrameRecord& frame : session->journal.frames) OMNIHDR_TRY(VisitFrame(frame));
    }
    if (input_.pictures == 0) {
      if (session) return Fail(ErrorKind::kData, "{}: no frame with pixels", arguments_.session);
      return Fail(ErrorKind::kUsage, "no pictures given: name IMAGEs or --session");
    }
    return std::move(input_);
  }

 private:
  Status TakeSession(const SessionInfo& info) {
    if (!response_) response_of_session_ = info.response;
    bits_ = info.camera.bits;
    if (info.camera.layout != Layout::kRig) return {};
    if (input_.rig_file.empty()) {
      input_.rig_file = (std::filesystem::path(arguments_.session) / "rig.toml").string();
    }
    if (bayer_ == BayerOrder::kNone && !info.camera.bayer.empty()) {
      bayer_ = BayerOrderFromString(info.camera.bayer).value_or(BayerOrder::kNone);
    }
    return {};
  }

  Status TakeRig() {
    OMNIHDR_ASSIGN(input_.rig, ReadRig(input_.rig_file));
    for (const RigSensor& sensor : input_.rig->sensors) {
      input_.sensors.push_back(sensor.name);
      Response response =
          response_ ? *response_ : response_of_session_.value_or(*Response::Linear());
      if (!response_ && !sensor.response_json.empty()) {
        OMNIHDR_ASSIGN(response,
                       ParseResponse(sensor.response_json,
                                     fmt::format("{}: {}", input_.rig_file, sensor.name)));
      }
      input_.responses.push_back(std::move(response));
    }
    return {};
  }

  Status NameSensors(const std::vector<NamedImage>& images, bool has_session) {
    for (const NamedImage& image : images) {
      const std::string& name = image.sensor.empty() ? kUnnamed : image.sensor;
      if (std::find(input_.sensors.begin(), input_.sensors.end(), name) == input_.sensors.end()) {
        input_.sensors.push_back(name);
      }
    }
    if (has_session && input_.sensors.empty()) input_.sensors.push_back(kUnnamed);
    const Response response =
        response_ ? *response_ : response_of_session_.value_or(*Response::Linear());
    input_.responses.assign(input_.sensors.size(), response);
    return {};
  }

  Result<int> IndexOf(const std::string& name) const {
    const auto found = std::find(input_.sensors.begin(), input_.sensors.end(), name);
    if (found == input_.sensors.end()) {
      return Fail(ErrorKind::kUsage, "sensor {}: the rig {} has {}", name, input_.rig_file,
                  fmt::join(input_.sensors, ", "));
    }
    return static_cast<int>(found - input_.sensors.begin());
  }

  BayerOrder BayerOf(int sensor) const {
    if (bayer_ != BayerOrder::kNone || !input_.rig) return bayer_;
    return input_.rig->sensors[static_cast<std::size_t>(sensor)].bayer;
  }

  Status VisitOne(const DecodedImage& image, const std::string& name, int sensor, int stand,
                  int first_row, int height, std::optional<double> seconds,
                  const std::optional<Pose>& pose) {
    CalibrationPicture picture;
    picture.name = name;
    picture.sensor = sensor;
    picture.stand = stand;
    picture.seconds = seconds.value_or(1.0);
    picture.has_seconds = seconds.has_value();
    if (pose) picture.world_from_rig = pose->rotation.toRotationMatrix();
    Result<SensorPicture> made =
        MakeSensorPicture(image, bits_, BayerOf(sensor), first_row, height);
    if (!made) return Forward(made.error(), name);
    picture.picture = std::move(*made);
    ++input_.pictures;
    return visit_(input_, std::move(picture));
  }

  // All sensors of a frame, stacked top to bottom in the rig's order.
  Status VisitStacked(const DecodedImage& image, const std::string& file,
                      std::optional<double> seconds, const std::optional<Pose>& pose) {
    int row = 0;
    for (std::size_t s = 0; s < input_.rig->sensors.size(); ++s) {
      const Lens& lens = input_.rig->sensors[s].lens;
      OMNIHDR_TRY(VisitOne(image, fmt::format("{} ({})", file, input_.sensors[s]),
                           static_cast<int>(s), stands_, row, lens.height(), seconds, pose));
      row += lens.height();
    }
    ++stands_;
    return {};
  }

  bool IsStacked(const DecodedImage& image) const {
    if (!input_.rig || input_.rig->sensors.size() < 2) return false;
    int rows = 0;
    for (const RigSensor& sensor : input_.rig->sensors) {
      if (sensor.lens.width() != image.width()) return false;
      rows += sensor.lens.height();
    }
    return rows == image.height();
  }

  Status VisitImage(const NamedImage& named) {
    OMNIHDR_ASSIGN(const DecodedImage image, ReadImage(named.file));
    if (named.sensor.empty() && IsStacked(image)) {
      return VisitStacked(image, named.file, named.seconds, std::nullopt);
    }
    int sensor = 0;
    if (!named.sensor.empty()) {
      OMNIHDR_ASSIGN(sensor, IndexOf(named.sensor));
    } else if (input_.sensors.size() > 1) {
      return Fail(ErrorKind::kUsage,
                  "{}: {}x{}: of which sensor? Expected SENSOR=IMAGE with one of {}{}", named.file,
                  image.width(), image.height(), fmt::join(input_.sensors, ", "),
                  input_.rig ? ", or a frame of all of them stacked" : "");
    }
    if (input_.rig) {
      const Lens& lens = input_.rig->sensors[static_cast<std::size_t>(sensor)].lens;
      if (image.width() != lens.width() || image.height() != lens.height()) {
        return Fail(ErrorKind::kData, "{}: {}x{}, expected {}x{} as sensor {} of {}", named.file,
                    image.width(), image.height(), lens.width(), lens.height(),
                    input_.sensors[static_cast<std::size_t>(sensor)], input_.rig_file);
      }
    }
    // The n-th picture of every sensor belongs to the n-th stand.
    stand_of_.resize(input_.sensors.size(), 0);
    const int stand = stand_of_[static_cast<std::size_t>(sensor)]++;
    return VisitOne(image, named.file, sensor, stand, 0, image.height(), named.seconds,
                    std::nullopt);
  }

  Status VisitFrame(const FrameRecord& frame) {
    if (frame.status != FrameStatus::kOk || frame.file.empty()) return {};
    const std::filesystem::path file = std::filesystem::path(arguments_.session) / frame.file;
    OMNIHDR_ASSIGN(const DecodedImage image, ReadImage(file));
    const double seconds = frame.exposure.EffectiveSeconds();
    if (!input_.rig) {
      return VisitOne(image, frame.file, 0, stands_++, 0, image.height(), seconds, frame.pose);
    }
    if (!IsStacked(image) && input_.rig->sensors.size() > 1) {
      return Fail(ErrorKind::kData, "{}: {}x{}, expected all {} sensors of {} stacked",
                  file.string(), image.width(), image.height(), input_.rig->sensors.size(),
                  input_.rig_file);
    }
    return VisitStacked(image, frame.file, seconds, frame.pose);
  }

  const std::string kUnnamed = "camera";
  const CalibrationArguments& arguments_;
  const Visit& visit_;
  CalibrationInput input_;
  BayerOrder bayer_ = BayerOrder::kNone;
  std::optional<Response> response_;
  std::optional<Response> response_of_session_;
  int bits_ = 16;
  int stands_ = 0;
  std::vector<int> stand_of_;
};

}  // namespace

void AddCalibrationOptions(CLI::App* command, CalibrationArguments* arguments) {
  command->add_option("images", arguments->images,
                      "[SENSOR=]IMAGE[@SECONDS], as in left=a.png@1/60; with --rig also frames of "
                      "all sensors stacked");
  command->add_option("--session", arguments->session, "session directory whose frames to use");
  command->add_option("--rig", arguments->rig, "rig file [SESSION/rig.toml of a rig's session]");
  command->add_option("--response", arguments->response,
                      "linear, srgb, a session.json or a response file [the session's, the "
                      "sensor's, or linear]");
  command->add_option("--bayer", arguments->bayer,
                      "RGGB, GRBG, GBRG or BGGR of one-channel pictures [the rig's]");
  command->add_option("--bits", arguments->bits, "significant bits of 16-bit pictures")
      ->check(CLI::Range(8, 16))
      ->capture_default_str();
}

Result<CalibrationInput> ReadCalibrationPictures(const CalibrationArguments& arguments,
                                                 const Visit& visit) {
  return Reader(arguments, visit).Read();
}

Result<std::array<Eigen::Vector2d, 4>> ParseCorners(const std::string& text) {
  std::vector<double> numbers;
  std::string_view rest = text;
  while (!rest.empty()) {
    const std::size_t comma = rest.find(',');
    const std::optional<double> number = Number(rest.substr(0, comma));
    if (!number) break;
    numbers.push_back(*number);
    rest = comma == std::string_view::npos ? std::string_view() : rest.substr(comma + 1);
  }
  if (numbers.size() != 8 || !rest.empty()) {
    return Fail(ErrorKind::kUsage,
                "--corners: {}, expected x,y,x,y,x,y,x,y: the centres of dark skin, bluish green, "
                "black and white in pixels",
                text);
  }
  std::array<Eigen::Vector2d, 4> corners;
  for (std::size_t i = 0; i < 4; ++i) corners[i] = {numbers[2 * i], numbers[2 * i + 1]};
  return corners;
}

}  // namespace omnihdr
