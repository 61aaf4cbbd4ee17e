// Cameras and GPIO lines: nodes, permissions, modules, memory, and who holds them.
#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <set>
#include <system_error>

#include "core/photometry/mosaic.h"
#include "core/session/rig_file.h"
#include "core/session/session_reader.h"
#include "daemon/doctor/checks.h"
#include "drivers/gpio/lines.h"
#include "drivers/iidc/model_table.h"
#include "drivers/iidc/usb_link.h"
#include "drivers/usb/usb.h"
#include "drivers/v4l2/kernel_device.h"

namespace omnihdr::doctor {
namespace {

namespace fs = std::filesystem;

constexpr const char* kCameraRule = "60-omnihdr-cameras.rules";

struct UsbCamera {
  std::string name;  // "Ladybug5 (1e10:3800, serial 123) on USB port 2-1"
  fs::path node;     // /dev/bus/usb/002/004
  int product = 0;
  double megabits = 0.0;
};

std::vector<std::string> DirectoryNames(const fs::path& directory) {
  std::vector<std::string> names;
  std::error_code error;
  for (fs::directory_iterator it(directory, error), end; !error && it != end; it.increment(error)) {
    names.push_back(it->path().filename().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

int Number(const std::string& text, int base = 10) {
  int value = 0;
  std::from_chars(text.data(), text.data() + text.size(), value, base);
  return value;
}

std::vector<UsbCamera> FindUsbCameras(const Machine& machine) {
  std::vector<UsbCamera> cameras;
  const fs::path devices = "/sys/bus/usb/devices";
  for (const std::string& port : DirectoryNames(machine.At(devices))) {
    const auto text = [&](const char* file) { return machine.Text(devices / port / file); };
    if (Number(text("idVendor"), 16) != iidc::kPointGreyVendor) continue;
    UsbCamera camera;
    camera.product = Number(text("idProduct"), 16);
    camera.node =
        fmt::format("/dev/bus/usb/{:03}/{:03}", Number(text("busnum")), Number(text("devnum")));
    camera.megabits = Number(text("speed"));
    const auto model = iidc::FindModel(static_cast<std::uint16_t>(camera.product));
    const std::string serial = text("serial");
    camera.name =
        fmt::format("{} ({:04x}:{:04x}{}) on USB port {}, {:g} Mbit/s",
                    model ? model->name : text("product"), iidc::kPointGreyVendor, camera.product,
                    serial.empty() ? "" : ", serial " + serial, port, camera.megabits);
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

// Where udev has our rule; "" when it has not.
std::string CameraRule(const Machine& machine) {
  for (const char* folder :
       {"/etc/udev/rules.d", "/run/udev/rules.d", "/usr/lib/udev/rules.d", "/lib/udev/rules.d"}) {
    std::error_code error;
    const fs::path file = fs::path(folder) / kCameraRule;
    if (fs::exists(machine.At(file), error)) return file.string();
  }
  return {};
}

void CheckUsbCameras(Examination& e) {
  const std::vector<UsbCamera> cameras = FindUsbCameras(e.machine);
  if (cameras.empty()) {
    e.Problem("camera",
              fmt::format("no camera of Point Grey or FLIR (vendor {:04x}) on USB",
                          iidc::kPointGreyVendor),
              fmt::format("check its power and cable, then: lsusb -d {:04x}:; sudo dmesg | tail",
                          iidc::kPointGreyVendor));
    return;
  }
  const std::string rule = CameraRule(e.machine);
  for (const UsbCamera& camera : cameras) {
    const Result<FileNode> node = e.machine.node(e.machine.At(camera.node));
    if (node && !MayOpen(e.account, *node) && rule.empty()) {
      e.Problem("camera",
                fmt::format("{}: {} is {}, and udev has no rule {}", camera.name,
                            camera.node.string(), DescribeNode(e.machine, *node), kCameraRule),
                fmt::format("sudo cp systemd/{} /etc/udev/rules.d/; sudo udevadm control --reload; "
                            "sudo udevadm trigger --subsystem-match=usb",
                            kCameraRule));
      continue;
    }
    if (node && !MayOpen(e.account, *node) && node->gid == 0) {
      e.Problem(
          "camera",
          fmt::format("{}: {} is {}: {} does not give it to a group (its product number is "
                      "not in the rule, or it was plugged in before)",
                      camera.name, camera.node.string(), DescribeNode(e.machine, *node), rule),
          fmt::format("sudo udevadm trigger --subsystem-match=usb; else add {:04x} to a copy "
                      "of the rule in /etc/udev/rules.d",
                      camera.product));
      continue;
    }
    if (CheckNode(e, "camera", camera.node, "plugdev", "unplug the camera and plug it in again")) {
      e.found.back().found = camera.name + ": " + e.found.back().found;
    }
    if (camera.megabits > 0.0 && camera.megabits < 480.0) {
      e.Warning("camera-speed", fmt::format("{}: too slow for pictures", camera.name),
                "another port or cable: USB 2 has 480 Mbit/s, USB 3 5000");
    }
  }
}

void CheckUsbMemory(Examination& e) {
  const std::optional<std::size_t> picture = PictureBytes(e.config);
  const std::size_t needed = iidc::UsbBytesInFlight(picture.value_or(std::size_t{1} << 24));
  const fs::path file = usb::kUsbfsMemoryFile;
  const std::string limit = e.machine.Text(file);
  if (limit.empty()) {
    e.Add("usb-memory", Verdict::kSkipped, fmt::format("{} is not there", file.string()));
    return;
  }
  const std::size_t needed_mib = (needed >> 20U) + 1;
  if (usb::CheckUsbfsMemory(needed, e.machine.At(file))) {
    e.Good("usb-memory", fmt::format("{} MiB for USB buffers, {} needed", limit, needed_mib));
    return;
  }
  const std::size_t wanted = std::max<std::size_t>(4 * needed_mib, 1000);
  e.Problem("usb-memory",
            fmt::format("the kernel allows {} MiB of USB buffers ({}), the camera needs {}", limit,
                        file.string(), needed_mib),
            fmt::format("echo {} | sudo tee {}; for good: options usbcore usbfs_memory_mb={} in "
                        "/etc/modprobe.d/omnihdr.conf, or on the kernel's command line "
                        "usbcore.usbfs_memory_mb={}",
                        wanted, file.string(), wanted, wanted));
}

// Nodes by what the kernel read from their configuration ROMs; the controller's own node is what
// isochronous reception opens.
void CheckFirewireCameras(Examination& e) {
  const fs::path devices = "/sys/bus/firewire/devices";
  std::vector<std::string> cameras;
  std::vector<std::string> controllers;
  for (const std::string& name : DirectoryNames(e.machine.At(devices))) {
    const std::string units = e.machine.Text(devices / name / "units");
    // IIDC: of the 1394 Trade Association, or of Point Grey's own number.
    const bool iidc = units.find("0x00a02d:0x00010") != std::string::npos ||
                      units.find("0x00b09d:0x00010") != std::string::npos;
    if (iidc) cameras.push_back(name);
    if (e.machine.Text(devices / name / "is_local") == "1") controllers.push_back(name);
  }
  if (controllers.empty()) {
    e.Problem("camera", "no FireWire controller",
              "sudo modprobe firewire_ohci; lspci | grep -i 1394; sudo dmesg | tail");
    return;
  }
  for (const std::string& name : controllers) {
    CheckNode(e, "camera-controller", "/dev/" + name, "video", "sudo modprobe firewire_ohci");
  }
  if (cameras.empty()) {
    e.Problem("camera", "no IIDC camera on FireWire",
              "check its power and cable, then: sudo dmesg | tail; ls /sys/bus/firewire/devices");
  }
  for (const std::string& name : cameras) {
    CheckNode(e, "camera", "/dev/" + name, "video", "unplug the camera and plug it in again");
  }
}

// A USB device that says it is a video camera, whether or not a driver has taken it.
bool HasUsbVideo(const Machine& machine) {
  const fs::path devices = "/sys/bus/usb/devices";
  const std::vector<std::string> names = DirectoryNames(machine.At(devices));
  return std::any_of(names.begin(), names.end(), [&](const std::string& name) {
    return machine.Text(devices / name / "bInterfaceClass") == "0e";
  });
}

// One camera by its node, its lasting name or its serial number.
void CheckVideoDevice(Examination& e, v4l2::V4l2System& system, const std::string& device) {
  if (device.front() == '/') {
    CheckNode(e, "camera", device, "video", "omnihdr camera list   # names that are there");
    return;
  }
  const std::vector<v4l2::V4l2Node> list = system.List();
  const auto it = std::find_if(list.begin(), list.end(), [&device](const v4l2::V4l2Node& node) {
    return node.serial == device ||
           std::find(node.names.begin(), node.names.end(), device) != node.names.end();
  });
  if (it == list.end()) {
    e.Problem("camera",
              fmt::format("no video device has the name or serial number \"{}\" "
                          "(camera.v4l2.device)",
                          device),
              "omnihdr camera list   # names that are there");
    return;
  }
  CheckNode(e, "camera", "/" + fs::path(it->path).lexically_relative(e.machine.root).string(),
            "video", "sudo modprobe uvcvideo; sudo dmesg | tail");
}

void CheckV4l2Camera(Examination& e) {
  const v4l2::V4l2CameraOptions& options = e.config.camera.v4l2;
  const auto system = v4l2::MakeKernelSystem({e.machine.At("/dev"), e.machine.At("/sys")});
  std::vector<std::string> nodes;
  for (const v4l2::V4l2Node& node : system->List()) {
    nodes.push_back("/" + fs::path(node.path).lexically_relative(e.machine.root).string());
  }
  const std::string module = "sudo modprobe uvcvideo; sudo dmesg | tail";
  if (nodes.empty()) {
    std::error_code error;
    const bool loaded = fs::exists(e.machine.At("/sys/module/uvcvideo"), error);
    if (HasUsbVideo(e.machine) && !loaded) {
      e.Problem("camera",
                "a USB video camera is there, and the kernel's module uvcvideo is not loaded",
                "sudo modprobe uvcvideo; for good: echo uvcvideo | sudo tee "
                "/etc/modules-load.d/uvcvideo.conf");
    } else {
      e.Problem("camera", "no video device (/dev/video*)",
                HasUsbVideo(e.machine)
                    ? module
                    : "check the camera's power and cable, then: ls /dev/v4l/by-id; lsusb");
    }
    return;
  }
  std::vector<std::string> wanted = options.devices;
  if (wanted.empty() && !options.device.empty()) wanted = {options.device};
  if (wanted.empty()) {
    if (nodes.size() > 1) {
      e.Problem("camera",
                fmt::format("{} video devices ({}), and camera.v4l2.device does not say which",
                            nodes.size(), fmt::join(nodes, ", ")),
                "omnihdr camera list   # then set camera.v4l2.device");
      return;
    }
    wanted = {nodes.front()};
  }
  for (const std::string& device : wanted) CheckVideoDevice(e, *system, device);
  if (!options.controls_device.empty()) {
    CheckNode(e, "camera-controls", options.controls_device, "video",
              "ls /dev/v4l-subdev*; sudo dmesg | tail");
  }
}

const std::string* RigFileOf(const DaemonConfig& config) {
  const CameraConfig& camera = config.camera;
  if (camera.driver == CameraDriver::kIidc) return &camera.iidc.rig;
  if (camera.driver == CameraDriver::kV4l2 && !camera.v4l2.rig_file.empty()) {
    return &camera.v4l2.rig_file;
  }
  if (camera.driver == CameraDriver::kSim && !camera.sim.rig.empty()) return &camera.sim.rig;
  return nullptr;
}

void CheckLine(Examination& e, const std::vector<GpioChipInfo>& chips, const std::string& check,
               const gpio::LineName& wanted) {
  if (!wanted.configured()) return;
  const auto is_chip = [&wanted](const GpioChipInfo& chip) {
    return wanted.chip == chip.path || wanted.chip == chip.name || wanted.chip == chip.label ||
           wanted.chip == fs::path(chip.path).filename();
  };
  const auto chip = std::find_if(chips.begin(), chips.end(), is_chip);
  const auto closed = std::find_if(chips.begin(), chips.end(),
                                   [](const GpioChipInfo& c) { return !c.problem.empty(); });
  if (chip == chips.end() && closed == chips.end()) {
    std::vector<std::string> names;
    for (const GpioChipInfo& c : chips) names.push_back(fmt::format("{} ({})", c.name, c.label));
    e.Problem(check,
              names.empty() ? fmt::format("no GPIO chip at all, expected \"{}\"", wanted.chip)
                            : fmt::format("no GPIO chip \"{}\"; there are {}", wanted.chip,
                                          fmt::join(names, ", ")),
              "gpiodetect   # names to put into the configuration");
    return;
  }
  if (chip == chips.end() || !chip->problem.empty()) {
    const GpioChipInfo& which = chip == chips.end() ? *closed : *chip;
    e.Problem(check, fmt::format("{} cannot be asked: {}", which.path, which.problem),
              fmt::format("sudo usermod -aG gpio {}; sudo udevadm trigger --subsystem-match=gpio",
                          e.account.name));
    return;
  }
  std::size_t offset = chip->lines.size();
  for (std::size_t k = 0; k < chip->lines.size(); ++k) {
    if (chip->lines[k].name == wanted.line) offset = k;
  }
  if (offset == chip->lines.size()) {
    const int number = gpio::OffsetFromText(wanted.line);
    if (number >= 0) offset = std::min(offset, static_cast<std::size_t>(number));
  }
  if (offset >= chip->lines.size()) {
    e.Problem(check,
              fmt::format("{} ({}) has no line \"{}\": {} lines", chip->path, chip->label,
                          wanted.line, chip->lines.size()),
              fmt::format("gpioinfo {}   # names and numbers of its lines", chip->name));
    return;
  }
  const GpioLineInfo& line = chip->lines[offset];
  const bool ours = e.daemon_answers && line.consumer == "omnihdrd";
  if (line.used && !ours) {
    e.Problem(
        check,
        fmt::format("{} line {} is in use by \"{}\"", chip->path, wanted.line,
                    line.consumer.empty() ? "the kernel" : line.consumer),
        fmt::format("gpioinfo {}   # end that program, or disable the kernel driver (overlay) "
                    "that has the line",
                    chip->name));
    return;
  }
  if (const Result<FileNode> node = e.machine.node(e.machine.At(chip->path));
      node && !MayOpen(e.account, *node)) {
    e.Problem(
        check,
        fmt::format("{} is {}: {} may not open it", chip->path, DescribeNode(e.machine, *node),
                    e.account.name),
        fmt::format("sudo usermod -aG {} {}; sudo udevadm trigger --subsystem-match=gpio",
                    node->gid == 0 ? "gpio" : e.machine.GroupName(node->gid), e.account.name));
    return;
  }
  e.Good(check, fmt::format("{} ({}) line {} {}", chip->path, chip->label, wanted.line,
                            ours ? "is the daemon's" : "is free"));
}

}  // namespace

bool CheckNode(Examination& e, const std::string& check, const fs::path& path,
               const std::string& group, const std::string& missing) {
  const Result<FileNode> node = e.machine.node(e.machine.At(path));
  if (!node) {
    e.Problem(check, fmt::format("{} is not there", path.string()), missing);
    return false;
  }
  const std::string described = DescribeNode(e.machine, *node);
  if (!MayOpen(e.account, *node)) {
    const std::string owner = node->gid == 0 ? group : e.machine.GroupName(node->gid);
    e.Problem(check,
              fmt::format("{} is {}: {} may not open it", path.string(), described, e.account.name),
              fmt::format("sudo usermod -aG {} {}   # then log in again, or restart the service",
                          owner, e.account.name));
    return false;
  }
  std::error_code error;
  const fs::path real = fs::canonical(e.machine.At(path), error);
  const std::vector<std::string> holders = e.machine.HoldersOf(
      error ? path : "/" / real.lexically_relative(fs::canonical(e.machine.root)));
  std::vector<std::string> others;
  for (const std::string& holder : holders) {
    if (!e.daemon_answers || holder.find("(omnihdrd)") == std::string::npos) {
      others.push_back(holder);
    }
  }
  if (!others.empty()) {
    e.Problem(check,
              fmt::format("{} is held by process {}", path.string(), fmt::join(others, ", ")),
              fmt::format("sudo kill {}   # or close that program",
                          others.front().substr(0, others.front().find(' '))));
    return false;
  }
  e.Good(check, fmt::format("{} is {}, open for {}{}", path.string(), described, e.account.name,
                            holders.empty() ? "" : ", held by the daemon"));
  return true;
}

void CheckCamera(Examination& e) {
  const CameraConfig& camera = e.config.camera;
  switch (camera.driver) {
    case CameraDriver::kSim:
      e.Good("camera", "the simulated vehicle: needs nothing");
      break;
    case CameraDriver::kReplay: {
      const Result<SessionContents> session = ReadSession(camera.replay.session);
      if (session) {
        e.Good("camera", fmt::format("{}: {} frames to replay", camera.replay.session,
                                     session->journal.frames.size()));
      } else {
        e.Problem("camera", session.error().message, "set camera.replay.session to a session");
      }
      break;
    }
    case CameraDriver::kIidc:
      if (camera.iidc.bus == IidcBus::kFirewire) {
        CheckFirewireCameras(e);
        break;
      }
      CheckUsbCameras(e);
      CheckUsbMemory(e);
      break;
    case CameraDriver::kV4l2:
      CheckV4l2Camera(e);
      break;
  }
  if (const std::string* file = RigFileOf(e.config)) {
    if (const Result<Rig> rig = ReadRig(*file); rig) {
      e.Good("camera-rig", fmt::format("{}: {} sensors", *file, rig->sensors.size()));
    } else {
      e.Problem("camera-rig", rig.error().message, fmt::format("omnihdr rig check {}", *file));
    }
  }
}

void CheckGpio(Examination& e) {
  const GpioConfig& gpio = e.config.gpio;
  const auto output = [&gpio](const std::string& line) {
    return gpio::LineName{gpio.outputs.chip, line};
  };
  if (!gpio.inputs.trigger.name.configured() && !gpio.inputs.wheel.name.configured() &&
      !gpio.outputs.configured() && !gpio.camera_trigger.configured()) {
    return;
  }
  const Result<std::vector<GpioChipInfo>> chips = e.machine.gpio_chips();
  if (!chips) {
    e.Problem("gpio", chips.error().message, "gpiodetect");
    return;
  }
  CheckLine(e, *chips, "gpio-trigger", gpio.inputs.trigger.name);
  CheckLine(e, *chips, "gpio-wheel", gpio.inputs.wheel.name);
  CheckLine(e, *chips, "gpio-ready", output(gpio.outputs.ready));
  CheckLine(e, *chips, "gpio-busy", output(gpio.outputs.busy));
  CheckLine(e, *chips, "gpio-fault", output(gpio.outputs.fault));
  CheckLine(e, *chips, "gpio-strobe", output(gpio.outputs.strobe));
  CheckLine(e, *chips, "gpio-camera-trigger", output(gpio.camera_trigger.name.line));
}

std::optional<std::size_t> PictureBytes(const DaemonConfig& config) {
  const CameraConfig& camera = config.camera;
  if (const std::string* file = RigFileOf(config)) {
    const Result<Rig> rig = ReadRig(*file);
    if (!rig) return std::nullopt;
    const Result<std::vector<int>> rows = StackedRows(*rig);
    if (!rows) return std::nullopt;
    const auto pixels = static_cast<std::size_t>(rig->sensors.front().lens.width()) *
                        static_cast<std::size_t>(rows->back());
    using v4l2::Coding;
    const Coding coding = camera.v4l2.coding;
    bool deep = camera.driver == CameraDriver::kV4l2 && coding != Coding::kGrey &&
                coding != Coding::kBayer8;
    if (camera.driver == CameraDriver::kIidc) {
      deep = camera.iidc.coding == IidcCoding::kRaw16 || camera.iidc.coding == IidcCoding::kMono16;
    }
    return deep ? 2 * pixels : pixels;
  }
  if (camera.driver == CameraDriver::kSim && camera.sim.layout == SimLayout::kPanorama) {
    const auto width = static_cast<std::size_t>(camera.sim.width);
    return width * (width / 2) * 3;
  }
  if (camera.driver == CameraDriver::kV4l2 && camera.v4l2.width > 0) {
    return std::size_t{3} * static_cast<std::size_t>(camera.v4l2.width) *
           static_cast<std::size_t>(camera.v4l2.height);
  }
  if (camera.driver == CameraDriver::kReplay) {
    const Result<SessionContents> session = ReadSession(camera.replay.session);
    if (!session) return std::nullopt;
    const CameraDescription& d = session->info.camera;
    const std::size_t channels = d.layout == Layout::kRig ? 1 : 3;
    return static_cast<std::size_t>(d.width) * static_cast<std::size_t>(d.height) * channels *
           (d.bits > 8 ? 2 : 1);
  }
  return std::nullopt;
}

}  // namespace omnihdr::doctor
