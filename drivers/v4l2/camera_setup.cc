#include "drivers/v4l2/camera_setup.h"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>

#include "core/photometry/mosaic.h"
#include "core/session/rig_file.h"
#include "core/session/session_rig.h"
#include "drivers/v4l2/find_camera.h"

namespace omnihdr::v4l2 {
namespace {

using Json = nlohmann::json;
using std::chrono::seconds;

constexpr int kMaxFormats = 64;
constexpr Nanoseconds kLongestMeasurement = seconds(30);

Nanoseconds FromSeconds(double value) {
  return Nanoseconds(static_cast<std::int64_t>(std::llround(value * 1e9)));
}

// What the layout asks of the pixels.
struct Asked {
  int width = 0;
  int height = 0;
  BayerOrder bayer = BayerOrder::kNone;
  Layout layout = Layout::kRig;
  bool Allows(const PixelFormat& format) const {
    // Layouts other than rigs hold finished colour.
    if (layout != Layout::kRig) return format.channels == 3;
    return format.bayer == bayer;
  }
};

// `which`: the one sensor that the camera is; -1 = all.
Result<Asked> AskedByRig(const std::string& content, const std::string& name, int which) {
  OMNIHDR_ASSIGN(const Rig rig, ParseRig(content, name));
  if (which >= static_cast<int>(rig.sensors.size())) {
    return Fail(ErrorKind::kConfig, "{}: {} sensors: expected one for each of camera.v4l2.devices",
                name, rig.sensors.size());
  }
  OMNIHDR_ASSIGN(const std::vector<int> rows, StackedRows(rig).Context(name));
  Asked asked;
  asked.bayer = rig.sensors.front().bayer;
  for (const RigSensor& sensor : rig.sensors) {
    if (sensor.bayer == asked.bayer) continue;
    return Fail(ErrorKind::kConfig,
                "{}: sensor \"{}\": bayer: \"{}\", expected \"{}\" as the "
                "first sensor's",
                name, sensor.name, ToString(sensor.bayer), ToString(asked.bayer));
  }
  asked.width = rig.sensors.front().lens.width();
  asked.height = rows.back();
  if (which >= 0) asked.height = rig.sensors[static_cast<std::size_t>(which)].lens.height();
  return asked;
}

Result<PixelFormat> ChooseFormat(V4l2Device& device, const Asked& asked, Coding coding) {
  std::vector<std::uint32_t> offered;
  std::string names;
  for (int i = 0; i < kMaxFormats; ++i) {
    v4l2_fmtdesc described{};
    described.index = static_cast<std::uint32_t>(i);
    described.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    if (device.Ioctl(VIDIOC_ENUM_FMT, &described) < 0) break;
    // Formats that a library would make of others are not the camera's own.
    if ((described.flags & V4L2_FMT_FLAG_EMULATED) != 0) continue;
    offered.push_back(described.pixelformat);
    names += fmt::format("{}{}", names.empty() ? "" : ", ", FourCcName(described.pixelformat));
  }
  for (const PixelFormat& format : PixelFormats()) {
    if (coding != Coding::kAuto && format.coding != coding) continue;
    if (!asked.Allows(format)) continue;
    if (std::find(offered.begin(), offered.end(), format.fourcc) != offered.end()) return format;
  }
  return Fail(ErrorKind::kConfig, "format: \"{}\": the camera has {}: expected one that is {}",
              ToString(coding), names.empty() ? "none" : names,
              asked.layout != Layout::kRig ? "colour (yuyv, mjpeg)"
              : asked.bayer != BayerOrder::kNone
                  ? fmt::format("a mosaic in the rig file's order {}", ToString(asked.bayer))
                  : std::string("grey or colour"));
}

Result<FrameLayout> SetFormat(V4l2Device& device, const Asked& asked, const PixelFormat& wanted) {
  v4l2_format format{};
  format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (const int called = device.Ioctl(VIDIOC_G_FMT, &format); called < 0) {
    return FailCall("VIDIOC_G_FMT", called);
  }
  v4l2_pix_format& pixels = format.fmt.pix;
  const auto width = asked.width > 0 ? static_cast<std::uint32_t>(asked.width) : pixels.width;
  const auto height = asked.height > 0 ? static_cast<std::uint32_t>(asked.height) : pixels.height;
  pixels = {};
  pixels.width = width;
  pixels.height = height;
  pixels.pixelformat = wanted.fourcc;
  pixels.field = V4L2_FIELD_NONE;
  const std::string what =
      fmt::format("VIDIOC_S_FMT {} {} x {}", FourCcName(wanted.fourcc), width, height);
  if (const int called = device.Ioctl(VIDIOC_S_FMT, &format); called < 0) {
    return FailCall(what, called);
  }
  if (pixels.pixelformat != wanted.fourcc || pixels.width != width || pixels.height != height) {
    return Fail(ErrorKind::kConfig, "{}: the camera makes {} {} x {} of it", what,
                FourCcName(pixels.pixelformat), pixels.width, pixels.height);
  }
  if (pixels.field != V4L2_FIELD_NONE) {
    return Fail(ErrorKind::kConfig, "{}: field order {}: expected whole frames", what,
                pixels.field);
  }
  FrameLayout layout;
  layout.format = wanted;
  layout.width = static_cast<int>(std::min<std::uint32_t>(width, kMaxSide + 1));
  layout.height = static_cast<int>(std::min<std::uint32_t>(height, kMaxSide + 1));
  layout.bytes_per_line = pixels.bytesperline;
  layout.image_bytes = pixels.sizeimage;
  layout.full_range = pixels.quantization == V4L2_QUANTIZATION_FULL_RANGE;
  OMNIHDR_TRY(CheckLayout(layout).Context(what));
  return layout;
}

// The interval between frames in seconds; 0 = the device does not say.
Result<double> SetFrameRate(V4l2Device& device, double wanted) {
  v4l2_streamparm parameters{};
  parameters.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (wanted > 0.0) {
    v4l2_fract& interval = parameters.parm.capture.timeperframe;
    interval.numerator = 10000;
    interval.denominator = static_cast<std::uint32_t>(std::lround(wanted * 10000.0));
    if (const int called = device.Ioctl(VIDIOC_S_PARM, &parameters); called < 0) {
      return FailCall(fmt::format("VIDIOC_S_PARM {} frames/s", wanted), called);
    }
  } else if (device.Ioctl(VIDIOC_G_PARM, &parameters) < 0) {
    return 0.0;
  }
  const v4l2_fract& interval = parameters.parm.capture.timeperframe;
  if (interval.numerator == 0 || interval.denominator == 0) return 0.0;
  const double got = static_cast<double>(interval.numerator) / interval.denominator;
  if (wanted > 0.0 && std::abs(got * wanted - 1.0) > 0.01) {
    return Fail(ErrorKind::kConfig, "frame_rate: {}: the camera makes {:.4g} frames/s of it",
                wanted, 1.0 / got);
  }
  return std::min(got, 100.0);
}

std::string ExtraJson(const ReadyCamera& camera, const FoundCamera& found,
                      const std::vector<FixedControl>& fixed) {
  Json controls = Json::object();
  for (const FixedControl& control : fixed) controls[control.name] = control.value;
  Json v4l2 = {{"driver", found.driver},
               {"card", found.card},
               {"bus", found.bus},
               {"format", FourCcName(camera.frame.format.fourcc)},
               {"exposure_unit_s", camera.exposure->unit_s()},
               {"exposure_in_lines", camera.exposure->in_lines()},
               {"latency_frames", camera.latency_frames},
               {"latency_measured", camera.latency_measured},
               {"least_latency_frames", camera.least_latency},
               {"controls", controls}};
  if (!camera.latency_note.empty()) v4l2["latency_note"] = camera.latency_note;
  return Json{{"v4l2", v4l2}}.dump();
}

Status CheckOption(const char* name, int value, int low, int high) {
  if (value >= low && value <= high) return {};
  return Fail(ErrorKind::kConfig, "{}: {}: expected {} to {}", name, value, low, high);
}

Status Measure(ReadyCamera& camera, const V4l2CameraOptions& options, const Clock& clock) {
  if (options.latency_frames > 0) {
    camera.latency_frames = options.latency_frames;
    camera.latency_note = "as configured";
    return {};
  }
  OMNIHDR_TRY(camera.stream->Start(camera.frame));
  Status noted = NoteLatency(camera, options, clock);
  camera.stream->Stop();
  return noted;
}

}  // namespace

Status CheckDevices(const V4l2CameraOptions& options) {
  const std::vector<std::string>& devices = options.devices;
  if (devices.empty()) return {};
  if (devices.size() < 2 || devices.size() > kMaxDevices) {
    return Fail(ErrorKind::kConfig, "devices: {}: expected 2 to {}, or none", devices.size(),
                kMaxDevices);
  }
  if (!options.device.empty() || !options.controls_device.empty()) {
    return Fail(ErrorKind::kConfig, "device, controls: \"{}\", \"{}\": expected \"\" with devices",
                options.device, options.controls_device);
  }
  if (options.layout != Layout::kRig) {
    return Fail(ErrorKind::kConfig, "layout: \"{}\": expected \"rig\" with devices",
                ToString(options.layout));
  }
  for (std::size_t i = 0; i < devices.size(); ++i) {
    if (devices[i].empty())
      return Fail(ErrorKind::kConfig, "devices[{}]: empty: expected a name", i);
    if (std::find(devices.begin(), devices.begin() + static_cast<std::ptrdiff_t>(i), devices[i]) !=
        devices.begin() + static_cast<std::ptrdiff_t>(i)) {
      return Fail(ErrorKind::kConfig, "devices[{}]: \"{}\": expected each camera once", i,
                  devices[i]);
    }
  }
  return {};
}

Status V4l2CameraOptions::Validate() const {
  if (layout == Layout::kRig && rig_file.empty()) {
    return Fail(ErrorKind::kConfig, "rig: empty: expected the rig file with layout = \"rig\"");
  }
  OMNIHDR_TRY(CheckDevices(*this));
  OMNIHDR_TRY(CheckOption("width", width, 0, kMaxSide));
  OMNIHDR_TRY(CheckOption("height", height, 0, kMaxSide));
  if ((width == 0) != (height == 0)) {
    return Fail(ErrorKind::kConfig, "width, height: {}, {}: expected both or neither", width,
                height);
  }
  if (frame_rate != 0.0 && !(frame_rate >= 0.1 && frame_rate <= 1000.0)) {
    return Fail(ErrorKind::kConfig, "frame_rate: {}: expected 0.1 to 1000, or 0", frame_rate);
  }
  OMNIHDR_TRY(CheckOption("latency_frames", latency_frames, 0, 16));
  OMNIHDR_TRY(CheckOption("gain", gain, -1, 1'000'000));
  OMNIHDR_TRY(CheckOption("gain_unity", gain_unity, 0, 1'000'000));
  if (white_balance != 0) OMNIHDR_TRY(CheckOption("white_balance", white_balance, 1000, 20000));
  if (!(frame_timeout_s >= 0.01 && frame_timeout_s <= 600.0)) {
    return Fail(ErrorKind::kConfig, "frame_timeout_s: {}: expected 0.01 to 600", frame_timeout_s);
  }
  return {};
}

Nanoseconds LongestWait(const ReadyCamera& camera, const V4l2CameraOptions& options) {
  return 3 * camera.interval + FromSeconds(options.frame_timeout_s);
}

Status NoteLatency(ReadyCamera& camera, const V4l2CameraOptions& options, const Clock& clock) {
  OMNIHDR_ASSIGN(const LatencyMeasurement measured,
                 MeasureLatency(*camera.stream, camera.frame, *camera.exposure, clock,
                                LongestWait(camera, options), clock.Now() + kLongestMeasurement));
  camera.latency_measured = measured.frames.has_value();
  camera.latency_frames = measured.frames.value_or(kMaxLatency);
  camera.least_latency = measured.frames ? measured.least : 1;
  camera.latency_note = measured.why_not;
  return {};
}

Result<std::unique_ptr<ReadyCamera>> OpenAndSetUp(V4l2System& system,
                                                  const V4l2CameraOptions& options,
                                                  const Clock& clock) {
  OMNIHDR_TRY(options.Validate());
  auto camera = std::make_unique<ReadyCamera>();
  Asked asked;
  if (options.layout == Layout::kRig) {
    OMNIHDR_ASSIGN(camera->info.files, ReadRigFilesOf(options.rig_file));
    OMNIHDR_ASSIGN(
        asked, AskedByRig(camera->info.files.front().content, options.rig_file, options.sensor));
  } else {
    asked.width = options.width;
    asked.height = options.height;
  }
  asked.layout = options.layout;

  OMNIHDR_ASSIGN(FoundCamera found, FindCamera(system, options.device));
  camera->node = found.node.path;
  camera->device = std::move(found.device);
  V4l2Device& device = *camera->device;
  const auto set_up = [&]() -> Status {
    OMNIHDR_ASSIGN(const PixelFormat format, ChooseFormat(device, asked, options.coding));
    OMNIHDR_ASSIGN(camera->frame, SetFormat(device, asked, format));
    OMNIHDR_ASSIGN(const double interval_s, SetFrameRate(device, options.frame_rate));
    camera->interval = FromSeconds(interval_s);
    if (!options.controls_device.empty()) {
      camera->controls_device = system.MakeDevice();
      const int opened = camera->controls_device->Open(options.controls_device);
      if (opened < 0) return FailCall(fmt::format("open {}", options.controls_device), opened);
    }
    const Controls controls(camera->controls_device ? *camera->controls_device : device);
    std::optional<int> white_balance;
    if (options.white_balance > 0) white_balance = options.white_balance;
    OMNIHDR_ASSIGN(const std::vector<FixedControl> fixed,
                   SwitchOffAutomatic(controls, white_balance));
    OMNIHDR_ASSIGN(camera->exposure,
                   ExposureControl::Open(controls, camera->frame.width, camera->frame.height,
                                         interval_s, {options.gain_unity, options.gain}));
    camera->stream = std::make_unique<Stream>(device, clock);
    camera->stamps_at_readout = found.driver == "uvcvideo";
    OMNIHDR_TRY(Measure(*camera, options, clock).Context("measure the latency"));
    camera->info.extra_json = ExtraJson(*camera, found, fixed);
    return {};
  };
  OMNIHDR_TRY(set_up().Context(found.node.path));

  CameraInfo& info = camera->info;
  info.description.model = found.card.empty() ? "V4L2 camera" : found.card;
  info.description.serial = found.node.serial;
  info.description.bits = camera->frame.format.bits;
  info.description.layout = options.layout;
  info.description.width = camera->frame.width;
  info.description.height = camera->frame.height;
  info.description.bayer = ToString(asked.bayer);
  info.shortest = camera->exposure->shortest();
  info.longest = camera->exposure->longest();
  info.exposure_quantum_s = camera->exposure->quantum_s();
  info.exposure_latency_frames = camera->latency_frames - 1;
  info.min_trigger_interval = (camera->latency_frames + 2) * camera->interval;
  info.proof = camera->latency_measured ? ExposureProof::kLatency : ExposureProof::kReadback;
  return camera;
}

}  // namespace omnihdr::v4l2
