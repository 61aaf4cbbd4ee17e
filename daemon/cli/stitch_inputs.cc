#include "daemon/cli/stitch_inputs.h"

#include <algorithm>
#include <optional>
#include <span>
#include <type_traits>
#include <utility>
#include <variant>

#include "core/session/response_json.h"
#include "core/session/rig_file.h"
#include "daemon/cli/exposed_image.h"
#include "daemon/cli/response_option.h"

namespace omnihdr {
namespace {

constexpr char kNoPicture[] = "-";

struct SensorPicture {
  std::string file;
  Exposure exposure;
  DecodedImage image;
};

Result<SensorPicture> ReadPicture(const std::string& text,
                                  const std::optional<ExposureTime>& otherwise) {
  SensorPicture picture;
  Result<ExposedImageName> exposed = ParseExposedImage(text);
  if (exposed) {
    picture.file = exposed->file;
    picture.exposure.time = exposed->time;
  } else if (otherwise) {
    picture.file = text;
    picture.exposure.time = *otherwise;
  } else {
    return Fail(ErrorKind::kUsage,
                "{}: how long was it exposed? Expected --seconds for all pictures, or "
                "IMAGE@SECONDS, as in a.png@1/60",
                text);
  }
  OMNIHDR_ASSIGN(picture.image, ReadImage(picture.file));
  return picture;
}

std::string KindOf(const DecodedImage& image) {
  return fmt::format("{} channel{} of {} bits", image.channels(), image.channels() == 1 ? "" : "s",
                     image.is_16_bit() ? 16 : 8);
}

// The pictures of one exposure, one below the other.
DecodedImage Stack(const std::vector<SensorPicture>& pictures) {
  int height = 0;
  for (const SensorPicture& picture : pictures) height += picture.image.height();
  return std::visit(
      [&](const auto& front) {
        using ImageType = std::decay_t<decltype(front)>;
        ImageType stacked = ImageType::Uninitialized(front.width(), height, front.channels());
        auto* to = stacked.data();
        for (const SensorPicture& picture : pictures) {
          const auto& pixels = std::get<ImageType>(picture.image.pixels);
          to = std::copy(pixels.values().begin(), pixels.values().end(), to);
        }
        return DecodedImage{std::move(stacked)};
      },
      pictures.front().image.pixels);
}

Result<std::vector<Response>> ResponsesOf(const StitchInputArguments& arguments, const Rig& rig) {
  std::vector<Response> responses;
  if (!arguments.response.empty()) {
    OMNIHDR_ASSIGN(Response response, ResponseOf(arguments.response));
    responses.push_back(std::move(response));
    return responses;
  }
  for (const RigSensor& sensor : rig.sensors) {
    if (sensor.response_json.empty()) {
      responses.push_back(*Response::Linear());
      continue;
    }
    OMNIHDR_ASSIGN(Response response,
                   ParseResponse(sensor.response_json, fmt::format("{}: sensor \"{}\": response",
                                                                   arguments.rig, sensor.name)));
    responses.push_back(std::move(response));
  }
  return responses;
}

// How the pictures named are spread over exposures and sensors.
struct Plan {
  bool is_stacked = false;
  int width = 0;  // of a stacked frame
  int height = 0;
};

Result<Plan> PlanOf(const StitchInputArguments& arguments, const Rig& rig,
                    const std::optional<ExposureTime>& seconds) {
  const auto first = std::find_if(arguments.pictures.begin(), arguments.pictures.end(),
                                  [](const std::string& picture) { return picture != kNoPicture; });
  if (first == arguments.pictures.end()) {
    return Fail(ErrorKind::kUsage, "no picture named: expected one at least that is not \"-\"");
  }
  Result<std::vector<int>> rows = StackedRows(rig);
  if (!rows) return Forward(std::move(rows).error(), arguments.rig);
  OMNIHDR_ASSIGN(const SensorPicture picture, ReadPicture(*first, seconds));
  Plan plan;
  plan.width = rig.sensors.front().lens.width();
  plan.height = rows->back();
  plan.is_stacked = rig.sensors.size() > 1 && picture.image.width() == plan.width &&
                    picture.image.height() == plan.height;
  if (!plan.is_stacked && arguments.pictures.size() % rig.sensors.size() != 0) {
    return Fail(ErrorKind::kUsage,
                "{} pictures, expected {}, one for each sensor of {} in its order (\"-\" for a "
                "sensor without one; as many again for each further exposure), or stacked frames "
                "of {}x{}",
                arguments.pictures.size(), rig.sensors.size(), arguments.rig, plan.width,
                plan.height);
  }
  return plan;
}

// One exposure: `texts` as on the command line, one a sensor.
Result<std::vector<SensorPicture>> ReadSensors(const StitchInputs& inputs,
                                               std::span<const std::string> texts,
                                               const std::optional<ExposureTime>& seconds) {
  std::vector<SensorPicture> pictures;
  for (std::size_t s = 0; s < texts.size(); ++s) {
    const RigSensor& sensor = inputs.whole_rig.sensors[s];
    const bool is_taken =
        std::find(inputs.taken.begin(), inputs.taken.end(), s) != inputs.taken.end();
    if ((texts[s] != kNoPicture) != is_taken) {
      return Fail(ErrorKind::kUsage,
                  "sensor \"{}\" has a picture of some exposures only, expected one of each or "
                  "\"-\" in all",
                  sensor.name);
    }
    if (!is_taken) continue;
    OMNIHDR_ASSIGN(SensorPicture picture, ReadPicture(texts[s], seconds));
    if (picture.image.width() != sensor.lens.width() ||
        picture.image.height() != sensor.lens.height()) {
      return Fail(ErrorKind::kData, "{}: {}x{} pixels, expected the size of sensor \"{}\", {}x{}",
                  picture.file, picture.image.width(), picture.image.height(), sensor.name,
                  sensor.lens.width(), sensor.lens.height());
    }
    if (!pictures.empty() && KindOf(picture.image) != KindOf(pictures.front().image)) {
      return Fail(ErrorKind::kData, "{}: {}, expected {} as {}", picture.file,
                  KindOf(picture.image), KindOf(pictures.front().image), pictures.front().file);
    }
    pictures.push_back(std::move(picture));
  }
  return pictures;
}

Status ReadExposures(const StitchInputArguments& arguments, const Plan& plan,
                     const std::optional<ExposureTime>& seconds, StitchInputs* inputs) {
  const std::span<const std::string> texts = arguments.pictures;
  const std::size_t step = plan.is_stacked ? 1 : inputs->whole_rig.sensors.size();
  for (std::size_t first = 0; first < texts.size(); first += step) {
    std::vector<SensorPicture> pictures;
    if (plan.is_stacked) {
      if (texts[first] == kNoPicture) {
        return Fail(ErrorKind::kUsage,
                    "\"-\" among stacked frames of {}x{}, expected it in the place of a sensor's "
                    "picture",
                    plan.width, plan.height);
      }
      OMNIHDR_ASSIGN(SensorPicture picture, ReadPicture(texts[first], seconds));
      if (picture.image.width() != plan.width || picture.image.height() != plan.height) {
        return Fail(ErrorKind::kData, "{}: {}x{} pixels, expected a stacked frame of {}x{}",
                    picture.file, picture.image.width(), picture.image.height(), plan.width,
                    plan.height);
      }
      pictures.push_back(std::move(picture));
    } else {
      OMNIHDR_ASSIGN(pictures, ReadSensors(*inputs, texts.subspan(first, step), seconds));
    }
    if (!inputs->images.empty() &&
        KindOf(inputs->images.front()) != KindOf(pictures.front().image)) {
      return Fail(ErrorKind::kData, "{}: {}, expected {} as the first picture",
                  pictures.front().file, KindOf(pictures.front().image),
                  KindOf(inputs->images.front()));
    }
    std::vector<Exposure> exposures;
    for (const SensorPicture& picture : pictures) exposures.push_back(picture.exposure);
    inputs->images.push_back(Stack(pictures));
    inputs->exposures.push_back(std::move(exposures));
  }
  return {};
}

}  // namespace

std::vector<RigFrame> StitchInputs::Frames() const {
  std::vector<RigFrame> frames;
  for (std::size_t k = 0; k < images.size(); ++k) frames.push_back({&images[k], exposures[k]});
  return frames;
}

Result<StitchInputs> ReadStitchInputs(const StitchInputArguments& arguments) {
  std::optional<ExposureTime> seconds;
  if (!arguments.seconds.empty()) {
    seconds = ParseSeconds(arguments.seconds);
    if (!seconds) {
      return Fail(ErrorKind::kUsage, "--seconds: {}, expected a number above 0, as in 0.5 or 1/60",
                  arguments.seconds);
    }
  }
  StitchInputs inputs;
  inputs.directory = std::filesystem::path(arguments.rig).parent_path();
  OMNIHDR_ASSIGN(inputs.whole_rig, ReadRig(arguments.rig));
  OMNIHDR_ASSIGN(const Plan plan, PlanOf(arguments, inputs.whole_rig, seconds));
  inputs.rig = inputs.whole_rig;
  inputs.rig.sensors.clear();
  for (std::size_t s = 0; s < inputs.whole_rig.sensors.size(); ++s) {
    if (!plan.is_stacked && arguments.pictures[s] == kNoPicture) continue;
    inputs.taken.push_back(s);
    inputs.rig.sensors.push_back(inputs.whole_rig.sensors[s]);
  }
  if (inputs.taken.empty()) {
    return Fail(ErrorKind::kUsage, "no sensor has a picture of the first exposure");
  }
  OMNIHDR_TRY(ReadExposures(arguments, plan, seconds, &inputs));
  if (inputs.images.front().channels() == 3) {
    for (RigSensor& sensor : inputs.rig.sensors) sensor.bayer = BayerOrder::kNone;
  }
  OMNIHDR_ASSIGN(inputs.responses, ResponsesOf(arguments, inputs.rig));
  return inputs;
}

Result<RigMasks> ReadStitchMasks(const StitchInputs& inputs, const std::string& mask_file,
                                 const SphereGrid& grid) {
  Image<std::uint8_t> mask;
  if (!mask_file.empty()) {
    OMNIHDR_ASSIGN(mask, ReadMask(mask_file));
  }
  Rig rig = inputs.whole_rig;
  for (std::size_t s = 0; s < rig.sensors.size(); ++s) {
    const bool is_taken =
        std::find(inputs.taken.begin(), inputs.taken.end(), s) != inputs.taken.end();
    if (!is_taken) rig.sensors[s].mask_file.clear();
  }
  OMNIHDR_ASSIGN(RigMasks masks, ReadRigMasks(rig, inputs.directory, grid, mask, mask_file));
  if (masks.sensors.empty() || inputs.taken.size() == rig.sensors.size()) return masks;
  OMNIHDR_ASSIGN(const std::vector<int> from, StackedRows(rig));
  OMNIHDR_ASSIGN(const std::vector<int> to, StackedRows(inputs.rig));
  Image<std::uint8_t> taken = Image<std::uint8_t>::Uninitialized(masks.sensors.width(), to.back());
  for (std::size_t k = 0; k < inputs.taken.size(); ++k) {
    for (int y = 0; y < to[k + 1] - to[k]; ++y) {
      std::copy_n(masks.sensors.row(from[inputs.taken[k]] + y), taken.width(),
                  taken.row(to[k] + y));
    }
  }
  masks.sensors = std::move(taken);
  return masks;
}

}  // namespace omnihdr
