// The cameras of the build that take the suite without a kernel of their own.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "drivers/all_drivers.h"
#include "drivers/iidc/firewire_link.h"
#include "drivers/sim/simulation.h"
#include "drivers/sim/world.h"
#include "drivers/v4l2/rig_camera.h"
#include "tests/compliance/camera_suite.h"
#include "tests/emulators/iidc_firewire.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/pulsed_wire.h"
#include "tests/emulators/umockdev_usb.h"
#include "tests/emulators/v4l2_camera_model.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::compliance {
namespace rigs_test {
namespace {

constexpr int kWidth = 128;

std::shared_ptr<const sim::World> SharedWorld() {
  static const auto world = sim::World::Create(sim::SceneKind::kTunnel, 1);
  return world;
}

Rig MakeSimRig(Layout layout, bool pulsed = false) {
  sim::SimCameraOptions options;
  options.simulation.layout = layout;
  options.simulation.sensor_width = 64;
  options.simulation.scene = sim::SceneKind::kTunnel;
  options.simulation.width = kWidth;
  options.simulation.samples = 1;
  options.readout_s = 0.002;
  if (pulsed) options.release = std::make_shared<emulators::PulsedWire>([] {});
  auto camera = std::make_unique<sim::SimCamera>(options, SharedWorld());
  Rig rig;
  sim::SimCamera* raw = camera.get();
  rig.unplug = [raw] { raw->Unplug(); };
  rig.plug_in = [raw] { raw->PlugIn(); };
  rig.camera = std::move(camera);
  for (const double t : {0.0001, 0.001, 0.004, 0.016, 0.05}) {
    rig.ladder.push_back(ExposureTime::Seconds(t));
  }
  return rig;
}

// A recorded session, made once for the process and removed at its end.
class RecordedSession {
 public:
  static constexpr int kFrames = 120;
  static const RecordedSession& Get(Layout layout) {
    static const RecordedSession panoramas(Layout::kPanorama);
    static const RecordedSession stacks(Layout::kRig);
    return layout == Layout::kRig ? stacks : panoramas;
  }
  const std::filesystem::path& path() const { return path_; }
  ~RecordedSession() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  RecordedSession(const RecordedSession&) = delete;
  RecordedSession& operator=(const RecordedSession&) = delete;

 private:
  explicit RecordedSession(Layout layout)
      : path_(std::filesystem::temp_directory_path() /
              fmt::format("omnihdr-compliance-{}-{}", ToString(layout), getpid())) {
    sim::SimulateOptions options;
    options.simulation.layout = layout;
    options.simulation.sensor_width = 64;
    options.simulation.scene = sim::SceneKind::kTunnel;
    options.simulation.width = kWidth;
    options.simulation.samples = 1;
    options.positions = kFrames / 3;
    options.bracket.frames_per_position = 3;
    const Status made = sim::WriteSimulatedSession(path_, options, {});
    if (!made) ADD_FAILURE() << made.error().message;
  }
  std::filesystem::path path_;
};

Rig MakeReplayRig(Layout layout) {
  ReplayOptions options;
  options.session = RecordedSession::Get(layout).path();
  options.interval_s = 0.0;
  auto camera = std::make_unique<ReplayCamera>(options);
  const ReplayCamera* raw = camera.get();
  Rig rig;
  rig.camera = std::move(camera);
  rig.ladder = {ExposureTime::Seconds(0.0005), ExposureTime::Seconds(0.002)};
  rig.triggers = RecordedSession::kFrames;
  rig.fixed_exposure = [raw](std::uint64_t trigger) -> std::optional<Exposure> {
    const auto line = raw->Line(trigger);
    if (!line) return std::nullopt;
    return line->exposure;
  };
  return rig;
}

// An emulated IIDC camera: in this process, or as a USB device that the real libusb talks to.
enum class Carrier { kInProcess, kUsb, kFirewire };

struct EmulatedCamera {
  explicit EmulatedCamera(Carrier carrier)
      : device(std::make_shared<emulators::IidcDevice>(MakeOptions(carrier), clock)) {
    const emulators::IidcDeviceOptions& options = device->options();
    std::ofstream(rig()) << emulators::EmulatedRig(6, options.max_width, options.rows_per_sensor,
                                                   options.bayer);
  }
  static emulators::IidcDeviceOptions MakeOptions(Carrier carrier) {
    emulators::IidcDeviceOptions options;
    options.readout_s = 0.004;
    if (carrier == Carrier::kFirewire) {
      options.link_packet_bytes = emulators::IidcFirewire::kFrameEnds;
    }
    return options;
  }
  std::filesystem::path rig() const { return folder.path() / "head.toml"; }

  const SystemClock clock;
  const testing::TemporaryDirectory folder;
  std::shared_ptr<emulators::IidcDevice> device;
  std::unique_ptr<emulators::UmockdevUsb> usb;
  emulators::IidcFirewire firewire{device};
};

Rig MakeIidcRig(Carrier carrier, iidc::PictureFormat format = iidc::PictureFormat::kRaw,
                bool pulsed = false) {
  auto emulated = std::make_shared<EmulatedCamera>(carrier);
  iidc::IidcCameraOptions options;
  options.rig_file = emulated->rig();
  options.format = format;
  if (format == iidc::PictureFormat::kJpeg) options.mode = 7;
  if (pulsed) {
    options.release =
        std::make_shared<emulators::PulsedWire>([device = emulated->device] { device->Pulse(); });
  }
  Rig rig;
  rig.surroundings = emulated;
  if (carrier == Carrier::kUsb) {
    emulated->usb = std::make_unique<emulators::UmockdevUsb>(emulated->device);
    rig.camera = MakeCamera(options).value();
    rig.unplug = [emulated] { emulated->usb->Unplug(); };
    rig.plug_in = [emulated] { emulated->usb->PlugIn(); };
  } else {
    rig.camera = std::make_unique<iidc::IidcCamera>(
        options, carrier == Carrier::kFirewire
                     ? iidc::MakeFirewireFinder(emulated->firewire.MakeBus())
                     : emulators::MakeEmulatedFinder({emulated->device}));
    rig.unplug = [emulated] { emulated->device->Unplug(); };
    rig.plug_in = [emulated] { emulated->device->PlugIn(); };
  }
  for (const double t : {0.0001, 0.001, 0.004, 0.016, 0.05}) {
    rig.ladder.push_back(ExposureTime::Seconds(t));
  }
  return rig;
}

// An emulated camera below the kernel's ioctls: of class UVC, or a raw sensor.
struct EmulatedV4l2Camera {
  EmulatedV4l2Camera(const emulators::V4l2ModelOptions& options, BayerOrder bayer)
      : model(std::make_shared<emulators::V4l2CameraModel>(options, clock)) {
    std::ofstream(rig()) << emulators::EmulatedRig(1, options.width, options.height, bayer);
  }
  std::filesystem::path rig() const { return folder.path() / "head.toml"; }

  const SystemClock clock;
  const testing::TemporaryDirectory folder;
  std::shared_ptr<emulators::V4l2CameraModel> model;
};

Rig MakeV4l2Rig(bool raw_sensor) {
  emulators::V4l2ModelOptions model;
  model.in_lines = raw_sensor;
  if (raw_sensor) {
    model.driver = "imx999";
    model.formats = {V4L2_PIX_FMT_SBGGR12};
  }
  auto emulated = std::make_shared<EmulatedV4l2Camera>(
      model, raw_sensor ? BayerOrder::kBggr : BayerOrder::kNone);
  v4l2::V4l2CameraOptions options;
  options.rig_file = emulated->rig();
  if (!raw_sensor) options.coding = v4l2::Coding::kGrey;
  Rig rig;
  rig.surroundings = emulated;
  rig.camera =
      std::make_unique<v4l2::V4l2Camera>(options, emulators::MakeEmulatedV4l2({emulated->model}));
  rig.unplug = [emulated] { emulated->model->Unplug(); };
  rig.plug_in = [emulated] { emulated->model->PlugIn(); };
  for (const double t : {0.0002, 0.0005, 0.001, 0.002, 0.0039}) {
    rig.ladder.push_back(ExposureTime::Seconds(t));
  }
  return rig;
}

// Three emulated cameras as one rig, each at its own pace.
struct EmulatedV4l2Head {
  EmulatedV4l2Head() {
    emulators::V4l2ModelOptions options;
    for (int i = 0; i < 3; ++i) {
      options.path = fmt::format("/dev/video{}", 2 * i);
      options.serial = fmt::format("S{}", i);
      options.interval_s = 0.004 + 0.001 * i;
      models.push_back(std::make_shared<emulators::V4l2CameraModel>(options, clock));
    }
    std::ofstream(rig()) << emulators::EmulatedRig(3, options.width, options.height,
                                                   BayerOrder::kNone);
  }
  std::filesystem::path rig() const { return folder.path() / "head.toml"; }

  const SystemClock clock;
  const testing::TemporaryDirectory folder;
  std::vector<std::shared_ptr<emulators::V4l2CameraModel>> models;
};

Rig MakeV4l2Head() {
  auto emulated = std::make_shared<EmulatedV4l2Head>();
  v4l2::V4l2CameraOptions options;
  options.rig_file = emulated->rig();
  options.coding = v4l2::Coding::kGrey;
  options.devices = {"S0", "S1", "S2"};
  Rig rig;
  rig.surroundings = emulated;
  rig.camera = std::make_unique<v4l2::V4l2RigCamera>(
      options, [emulated](std::size_t) { return emulators::MakeEmulatedV4l2(emulated->models); });
  rig.unplug = [emulated] {
    for (const auto& model : emulated->models) model->Unplug();
  };
  rig.plug_in = [emulated] {
    for (const auto& model : emulated->models) model->PlugIn();
  };
  for (const double t : {0.0002, 0.0005, 0.001, 0.002, 0.0039}) {
    rig.ladder.push_back(ExposureTime::Seconds(t));
  }
  return rig;
}

std::vector<RigFactory> EveryRig() {
  return {
      {"sim", [] { return MakeSimRig(Layout::kPanorama); }},
      {"sim_rig", [] { return MakeSimRig(Layout::kRig); }},
      {"sim_pulsed", [] { return MakeSimRig(Layout::kPanorama, true); }},
      {"replay", [] { return MakeReplayRig(Layout::kPanorama); }},
      {"replay_rig", [] { return MakeReplayRig(Layout::kRig); }},
      {"iidc", [] { return MakeIidcRig(Carrier::kUsb); }},
      {"iidc_in_process", [] { return MakeIidcRig(Carrier::kInProcess); }},
      {"iidc_firewire", [] { return MakeIidcRig(Carrier::kFirewire); }},
      {"iidc_jpeg", [] { return MakeIidcRig(Carrier::kInProcess, iidc::PictureFormat::kJpeg); }},
      {"iidc_pulsed",
       [] { return MakeIidcRig(Carrier::kInProcess, iidc::PictureFormat::kRaw, true); }},
      {"v4l2", [] { return MakeV4l2Rig(false); }},
      {"v4l2_raw_sensor", [] { return MakeV4l2Rig(true); }},
      {"v4l2_head", [] { return MakeV4l2Head(); }}};
}

TEST(CameraComplianceSuite, CoversEveryDriverOfTheBuild) {
  std::vector<std::string> covered;
  for (const RigFactory& rig : AllRigs()) covered.push_back(rig.name);
  for (const CameraDriverEntry& driver : CameraDrivers()) {
    EXPECT_THAT(covered, ::testing::Contains(driver.name));
  }
}

}  // namespace
}  // namespace rigs_test

std::vector<RigFactory> AllRigs() { return rigs_test::EveryRig(); }

}  // namespace omnihdr::compliance
