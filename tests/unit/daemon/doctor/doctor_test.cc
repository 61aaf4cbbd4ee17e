// Every check on a made-up machine, and on this one what can be tried here.
#include "daemon/doctor/doctor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <map>
#include <string>
#include <thread>
#include <vector>

#include "core/base/file.h"
#include "core/base/tcp.h"
#include "daemon/api/server.h"
#include "daemon/doctor/machine.h"
#include "tests/drivers/modbus/slave.h"
#include "tests/support/small_session.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::doctor_test {
namespace {

namespace fs = std::filesystem;
using doctor::Diagnosis;
using doctor::Verdict;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr gid_t kPlugdev = 46;
constexpr gid_t kVideo = 44;

class Doctor : public ::testing::Test {
 protected:
  // A machine that is as it should be, with a user "omnihdr" who is in plugdev and not in video.
  void SetUp() override {
    machine_.root = path() / "root";
    Put("/etc/passwd", "root:x:0:0::/root:/bin/sh\nomnihdr:x:990:990::/:/bin/false\n");
    Put("/etc/group", "root:x:0:\nvideo:x:44:\nplugdev:x:46:somebody,omnihdr\nomnihdr:x:990:\n");
    Put("/proc/self/mounts",
        fmt::format("/dev/sda1 / ext4 rw 0 0\n/dev/sdb1 {} ext4 rw 0 0\n", path().string()));
    Put("/lib/udev/rules.d/60-omnihdr-cameras.rules", "");
    Put("/sys/module/usbcore/parameters/usbfs_memory_mb", "1000\n");
    machine_.node = [this](const fs::path& file) -> Result<doctor::FileNode> {
      const auto known = nodes_.find(file.string());
      if (known != nodes_.end()) return known->second;
      struct stat status {};
      if (::stat(file.c_str(), &status) != 0) return Fail(ErrorKind::kNoInput, "no such file");
      // This user's own files are the service's.
      return doctor::FileNode{990, 990, status.st_mode};
    };
    machine_.space = [this](const fs::path& place) -> Result<doctor::DiskSpace> {
      doctor::DiskSpace space = space_;
      if (place == machine_.root) space.device = root_device_;
      return space;
    };
    machine_.measure_disk = [this](const fs::path&, std::size_t) -> Result<doctor::DiskSpeed> {
      return speed_;
    };
    machine_.gpio_chips = [this]() -> Result<std::vector<doctor::GpioChipInfo>> { return chips_; };
    machine_.clock_is_synchronised = [this]() -> Result<bool> { return synchronised_; };
    machine_.utc = [this] { return utc_; };
    machine_.run = [this](const std::vector<std::string>&) -> Result<std::string> {
      return systemctl_;
    };
    fs::create_directories(path() / "sessions");
    options_.config = path() / "c.toml";
    options_.user = "omnihdr";
    options_.timeout = std::chrono::milliseconds(500);
    SetConfig("");
  }

  void SetConfig(const std::string& more) {
    testing::WriteText(
        options_.config,
        "[session]\ndirectory = \"sessions\"\n[api]\nsocket = \"api.sock\"\n" + more);
  }
  // A file below the made-up root.
  void Put(const std::string& file, const std::string& text) {
    const fs::path place = machine_.At(file);
    fs::create_directories(place.parent_path());
    testing::WriteText(place, text);
  }
  void PutNode(const std::string& file, uid_t uid, gid_t gid, mode_t mode) {
    Put(file, "");
    nodes_[machine_.At(file).string()] = {uid, gid, S_IFCHR | mode};
  }
  void PutCamera() {
    const std::string device = "/sys/bus/usb/devices/2-1/";
    Put(device + "idVendor", "1e10\n");
    Put(device + "idProduct", "3800\n");
    Put(device + "serial", "12345\n");
    Put(device + "busnum", "2\n");
    Put(device + "devnum", "4\n");
    Put(device + "speed", "5000\n");
    PutNode("/dev/bus/usb/002/004", 0, kPlugdev, 0660);
    SetConfig("[camera]\ndriver = \"iidc\"\n[camera.iidc]\nrig = \"" + Rig() + "\"\n");
  }
  void PutVideo(const std::string& more = "") {
    fs::create_directories(machine_.At("/sys/class/video4linux/video0"));
    PutNode("/dev/video0", 0, kVideo, 0666);
    SetConfig("[camera]\ndriver = \"v4l2\"\n[camera.v4l2]\nlayout = \"perspective\"\n" + more);
  }
  static std::string Rig() {
    return std::string(OMNIHDR_SOURCE_DIR) + "/config/rigs/ladybug2.toml";
  }
  // A process of the made-up machine that has a file open.
  void PutHolder(int pid, const std::string& name, const std::string& file) {
    Put(fmt::format("/proc/{}/comm", pid), name + "\n");
    fs::create_directories(machine_.At(fmt::format("/proc/{}/fd", pid)));
    fs::create_symlink(file, machine_.At(fmt::format("/proc/{}/fd/7", pid)));
  }

  std::vector<Diagnosis> Examine() const { return doctor::Examine(options_, machine_); }
  const fs::path& path() const { return directory_.path(); }

  testing::TemporaryDirectory directory_;
  doctor::Machine machine_;
  doctor::DoctorOptions options_;
  std::map<std::string, doctor::FileNode> nodes_;
  doctor::DiskSpace space_ = {2'000'000'000'000, 4'000'000'000'000, 1'000'000, true, 2};
  dev_t root_device_ = 1;
  doctor::DiskSpeed speed_ = {100e6, 0.05, 20};
  std::vector<doctor::GpioChipInfo> chips_;
  bool synchronised_ = true;
  UtcTime utc_ = UtcTime::FromNanoseconds(1'767'225'600'000'000'000);
  std::string systemctl_;
};

auto Found(Verdict verdict, const std::string& check, const std::string& found,
           const std::string& remedy = "") {
  return Contains(AllOf(Field(&Diagnosis::check, check), Field(&Diagnosis::verdict, verdict),
                        Field(&Diagnosis::found, HasSubstr(found)),
                        Field(&Diagnosis::remedy, HasSubstr(remedy))));
}
auto Problem(const std::string& check, const std::string& found, const std::string& remedy) {
  return Found(Verdict::kProblem, check, found, remedy);
}
auto Warning(const std::string& check, const std::string& found, const std::string& remedy) {
  return Found(Verdict::kWarning, check, found, remedy);
}
auto NoComplaint() {
  return Not(
      Contains(Field(&Diagnosis::verdict, ::testing::AnyOf(Verdict::kWarning, Verdict::kProblem))));
}

std::string Told(const std::vector<Diagnosis>& all) {
  std::string text;
  for (const Diagnosis& d : all) {
    text += fmt::format("{} {}: {} -> {}\n", ToString(d.verdict), d.check, d.found, d.remedy);
  }
  return text;
}

TEST_F(Doctor, AGoodMachineHasNothingToComplainOf) {
  PutCamera();
  const std::vector<Diagnosis> found = Examine();
  EXPECT_THAT(found, NoComplaint()) << Told(found);
  EXPECT_THAT(found, Found(Verdict::kGood, "camera", "Ladybug5"));
  EXPECT_THAT(found, Found(Verdict::kGood, "usb-memory", "1000 MiB"));
  EXPECT_THAT(found, Found(Verdict::kGood, "clock", "synchronised"));
}

TEST_F(Doctor, EveryComplaintHasARemedy) {
  PutCamera();
  nodes_[machine_.At("/dev/bus/usb/002/004").string()].mode = S_IFCHR | 0600;
  synchronised_ = false;
  space_ = {1000, 1000, 3, true, 1};
  speed_ = {1.0, 3.0, 3};
  for (const Diagnosis& d : Examine()) {
    if (d.verdict == Verdict::kWarning || d.verdict == Verdict::kProblem) {
      EXPECT_FALSE(d.remedy.empty()) << d.check << ": " << d.found;
    }
  }
}

TEST_F(Doctor, EveryWrongLineOfTheConfigurationIsAProblem) {
  SetConfig("[recorder]\nqueue_frames = 0\n[camera]\ndriver = \"box\"\n");
  const std::vector<Diagnosis> found = Examine();
  EXPECT_THAT(found, Problem("config", "recorder.queue_frames", "omnihdr config check"));
  EXPECT_THAT(found, Problem("config", "camera.driver", "edit"));
  options_.config = path() / "none.toml";
  EXPECT_THAT(Examine(), Problem("config", "none.toml", "omnihdr config show >"));
}

TEST_F(Doctor, AUserThatIsNotThereIsAProblem) {
  options_.user = "nobody-such";
  EXPECT_THAT(Examine(), Problem("user", "nobody-such", "systemd-sysusers"));
}

TEST_F(Doctor, ACameraThatIsNotThereIsAProblem) {
  PutCamera();
  fs::remove_all(machine_.At("/sys/bus/usb/devices/2-1"));
  EXPECT_THAT(Examine(), Problem("camera", "vendor 1e10", "lsusb -d 1e10:"));
}

TEST_F(Doctor, ACameraNodeWithoutTheUdevRuleNamesTheRule) {
  PutCamera();
  nodes_[machine_.At("/dev/bus/usb/002/004").string()] = {0, 0, S_IFCHR | 0664};
  fs::remove(machine_.At("/lib/udev/rules.d/60-omnihdr-cameras.rules"));
  EXPECT_THAT(Examine(), Problem("camera", "/dev/bus/usb/002/004 is crw-rw-r-- root:root",
                                 "/etc/udev/rules.d/; sudo udevadm control --reload"));
  Put("/etc/udev/rules.d/60-omnihdr-cameras.rules", "");
  EXPECT_THAT(Examine(), Problem("camera", "does not give it to a group", "udevadm trigger"));
}

TEST_F(Doctor, AUserOutsideTheCamerasGroupIsNamedWithTheGroup) {
  PutCamera();
  Put("/etc/group", "plugdev:x:46:\n");
  EXPECT_THAT(Examine(),
              Problem("camera", "omnihdr may not open it", "sudo usermod -aG plugdev omnihdr"));
}

TEST_F(Doctor, WhoHoldsTheCameraIsNamed) {
  PutCamera();
  PutHolder(321, "flycap2", "/dev/bus/usb/002/004");
  EXPECT_THAT(Examine(), Problem("camera", "held by process 321 (flycap2)", "sudo kill 321"));
}

TEST_F(Doctor, ASlowUsbPortIsAWarning) {
  PutCamera();
  Put("/sys/bus/usb/devices/2-1/speed", "12\n");
  EXPECT_THAT(Examine(), Warning("camera-speed", "12 Mbit/s", "another port"));
}

TEST_F(Doctor, UsbMemoryIsHeldAgainstWhatTheCameraNeeds) {
  PutCamera();
  Put("/sys/module/usbcore/parameters/usbfs_memory_mb", "4\n");
  EXPECT_THAT(Examine(), Problem("usb-memory", "allows 4 MiB",
                                 "| sudo tee /sys/module/usbcore/parameters/usbfs_memory_mb"));
}

TEST_F(Doctor, PicturesOfSixteenBitsAreTwiceAsLongAsThoseOfEight) {
  PutCamera();
  options_.pictures_per_second = 1.0;
  const auto with = [&](const std::string& coding) {
    SetConfig("[camera]\ndriver = \"iidc\"\n[camera.iidc]\nrig = \"" + Rig() + "\"\ncoding = \"" +
              coding + "\"\n");
  };
  with("raw8");
  // Six sensors of 768 x 1024, one picture a second, for 100 minutes.
  space_.free_bytes = std::uint64_t{6} * 768 * 1024 * 6000;
  EXPECT_THAT(Examine(), Found(Verdict::kGood, "storage-space", "100 minutes"));
  for (const char* coding : {"raw16", "mono16"}) {
    with(coding);
    EXPECT_THAT(Examine(), Found(Verdict::kWarning, "storage-space", "50 minutes")) << coding;
  }
}

TEST_F(Doctor, AFirewireCameraIsLookedForOnItsBusAndItsControllerMustBeOpenToo) {
  SetConfig("[camera]\ndriver = \"iidc\"\n[camera.iidc]\nbus = \"firewire\"\nrig = \"" + Rig() +
            "\"\n");
  EXPECT_THAT(Examine(), Problem("camera", "no FireWire controller", "modprobe firewire_ohci"));
  Put("/etc/group", "root:x:0:\nvideo:x:44:omnihdr\nplugdev:x:46:\nomnihdr:x:990:\n");
  Put("/sys/bus/firewire/devices/fw0/is_local", "1\n");
  PutNode("/dev/fw0", 0, 0, 0600);
  std::vector<Diagnosis> found = Examine();
  EXPECT_THAT(found, Problem("camera", "no IIDC camera on FireWire", "power and cable"));
  EXPECT_THAT(found, Problem("camera-controller", "/dev/fw0", "usermod -aG video"));
  PutNode("/dev/fw0", 0, kVideo, 0660);
  Put("/sys/bus/firewire/devices/fw1/is_local", "0\n");
  Put("/sys/bus/firewire/devices/fw1/units", "0x00b09d:0x000102\n");
  PutNode("/dev/fw1", 0, kVideo, 0660);
  found = Examine();
  EXPECT_THAT(found, NoComplaint()) << Told(found);
  EXPECT_THAT(found, Found(Verdict::kGood, "camera", "/dev/fw1"));
}

TEST_F(Doctor, ARigFileThatCannotBeReadIsAProblem) {
  PutCamera();
  SetConfig("[camera]\ndriver = \"iidc\"\n[camera.iidc]\nrig = \"none.toml\"\n");
  EXPECT_THAT(Examine(), Problem("camera-rig", "none.toml", "omnihdr rig check"));
}

TEST_F(Doctor, AVideoDeviceIsLookedAtAsAUsbCameraIs) {
  PutVideo();
  EXPECT_THAT(Examine(), NoComplaint()) << Told(Examine());
  nodes_[machine_.At("/dev/video0").string()].mode = S_IFCHR | 0660;
  EXPECT_THAT(Examine(), Problem("camera", "/dev/video0 is crw-rw---- root:video",
                                 "sudo usermod -aG video omnihdr"));
  nodes_[machine_.At("/dev/video0").string()].mode = S_IFCHR | 0666;
  PutHolder(99, "cheese", "/dev/video0");
  EXPECT_THAT(Examine(), Problem("camera", "held by process 99 (cheese)", "sudo kill 99"));
}

TEST_F(Doctor, AVideoDeviceOfAnotherNameIsAProblem) {
  PutVideo("device = \"/dev/video7\"\n");
  EXPECT_THAT(Examine(), Problem("camera", "/dev/video7 is not there", "omnihdr camera list"));
  PutVideo("device = \"SN-1\"\n");
  EXPECT_THAT(Examine(), Problem("camera", "SN-1", "omnihdr camera list"));
  PutVideo();
  fs::create_directories(machine_.At("/sys/class/video4linux/video1"));
  EXPECT_THAT(Examine(), Problem("camera", "2 video devices", "set camera.v4l2.device"));
}

TEST_F(Doctor, EveryCameraOfARigIsLookedAt) {
  PutVideo();
  fs::create_directories(machine_.At("/sys/class/video4linux/video2"));
  PutNode("/dev/video2", 0, kVideo, 0600);
  SetConfig(
      fmt::format("[camera]\ndriver = \"v4l2\"\n[camera.v4l2]\nrig = \"{}\"\ndevices = [{}]\n",
                  Rig(), R"("/dev/video0", "/dev/video2", "/dev/video5", "SN-1", "SN-2", "SN-3")"));
  const std::vector<Diagnosis> found = Examine();
  EXPECT_THAT(found, Found(Verdict::kGood, "camera", "/dev/video0")) << Told(found);
  EXPECT_THAT(found, Problem("camera", "/dev/video2 is crw-------", "usermod -aG video"));
  EXPECT_THAT(found, Problem("camera", "/dev/video5 is not there", "omnihdr camera list"));
}

TEST_F(Doctor, AKernelModuleThatIsNotLoadedIsNamed) {
  SetConfig("[camera]\ndriver = \"v4l2\"\n[camera.v4l2]\nlayout = \"perspective\"\n");
  EXPECT_THAT(Examine(), Problem("camera", "no video device", "lsusb"));
  Put("/sys/bus/usb/devices/1-2:1.0/bInterfaceClass", "0e\n");
  EXPECT_THAT(Examine(), Problem("camera", "uvcvideo is not loaded", "sudo modprobe uvcvideo"));
}

TEST_F(Doctor, ReplayNeedsASession) {
  SetConfig("[camera]\ndriver = \"replay\"\n[camera.replay]\nsession = \"none\"\n");
  EXPECT_THAT(Examine(), Problem("camera", "session.json", "camera.replay.session"));
}

TEST_F(Doctor, AGpioLineIsFreeOrWhoHasItIsNamed) {
  const std::string config =
      "[gpio.trigger]\nchip = \"pinctrl\"\nline = \"17\"\n[gpio.outputs]\nchip = \"pinctrl\"\n"
      "busy = \"LED\"\n";
  SetConfig(config);
  EXPECT_THAT(Examine(), Problem("gpio-trigger", "no GPIO chip at all", "gpiodetect"));
  doctor::GpioChipInfo chip{"/dev/gpiochip0", "gpiochip0", "pinctrl", {}, ""};
  chip.lines.resize(20);
  chips_ = {chip};
  EXPECT_THAT(Examine(), Problem("gpio-busy", "has no line \"LED\"", "gpioinfo gpiochip0"));
  chips_[0].lines[3].name = "LED";
  EXPECT_THAT(Examine(), NoComplaint()) << Told(Examine());
  EXPECT_THAT(Examine(), Found(Verdict::kGood, "gpio-trigger", "line 17 is free"));
  chips_[0].lines[17] = {"", true, "w1-gpio"};
  EXPECT_THAT(Examine(), Problem("gpio-trigger", "in use by \"w1-gpio\"", "gpioinfo gpiochip0"));
  chips_[0].lines[17] = {};
  PutNode("/dev/gpiochip0", 0, 0, 0600);
  EXPECT_THAT(Examine(),
              Problem("gpio-trigger", "crw------- root:root", "sudo usermod -aG gpio omnihdr"));
  chips_ = {{"/dev/gpiochip0", "", "", {}, "Permission denied"}};
  EXPECT_THAT(Examine(), Problem("gpio-trigger", "Permission denied", "usermod -aG gpio"));
  chips_ = {{"/dev/gpiochip0", "gpiochip0", "other", {}, ""}};
  EXPECT_THAT(Examine(), Problem("gpio-trigger", "there are gpiochip0 (other)", "gpiodetect"));
}

TEST_F(Doctor, TheSurveyDirectoryMustBeWritable) {
  nodes_[(path() / "sessions").string()] = {0, 0, S_IFDIR | 0755};
  EXPECT_THAT(Examine(), Problem("storage", "omnihdr may not write", "sudo install -d -o omnihdr"));
}

TEST_F(Doctor, TheVolumeIsOneOfItsOwnAndKeepsWhatItIsGiven) {
  EXPECT_THAT(Examine(), Found(Verdict::kGood, "storage-volume", "ext4"));
  root_device_ = 2;
  EXPECT_THAT(Examine(),
              Warning("storage-volume", "on the root file system", "mount a volume of its own"));
  PutVideo();  // a real camera
  EXPECT_THAT(Examine(),
              Problem("storage-volume", "refuses to begin", "storage.allow_root = true"));
  PutVideo("[storage]\nallow_root = true\n");
  EXPECT_THAT(Examine(),
              Warning("storage-volume", "on the root file system", "mount a volume of its own"));
  root_device_ = 1;
  const auto mount = [&](const std::string& type, const std::string& options) {
    Put("/proc/self/mounts", fmt::format("/dev/sda1 / ext4 rw 0 0\n/dev/sdb1 {} {} {} 0 0\n",
                                         path().string(), type, options));
  };
  mount("tmpfs", "rw");
  EXPECT_THAT(Examine(), Warning("storage-volume", "in memory (tmpfs)", "ext4"));
  mount("vfat", "rw");
  EXPECT_THAT(Examine(), Warning("storage-volume", "vfat: a power cut", "mkfs.ext4"));
  mount("ext4", "noatime,ro,errors=remount-ro");
  EXPECT_THAT(Examine(), Problem("storage-volume", "mounted read-only", "remount,rw"));
}

TEST_F(Doctor, SpaceIsToldInMinutesOfTheConfiguredRate) {
  // 1536 x 768 pixels of three colours, two a second: 7.1 MB/s.
  SetConfig("[trigger]\nsource = \"timer\"\ninterval_s = 0.5\n");
  space_.free_bytes = 42'467'328'000;  // 100 minutes of it
  EXPECT_THAT(Examine(), Found(Verdict::kGood, "storage-space", "100 minutes of 2 pictures"));
  space_.free_bytes /= 4;
  EXPECT_THAT(Examine(), Warning("storage-space", "25 minutes", "du -sh"));
  space_.free_bytes /= 5;
  EXPECT_THAT(Examine(), Problem("storage-space", "5 minutes", "du -sh"));
  space_.free_bytes = 42'467'328'000;
  space_.free_inodes = 100;
  EXPECT_THAT(Examine(), Problem("storage-space", "100 files only", "du -sh"));
  machine_.space = [](const fs::path&) -> Result<doctor::DiskSpace> {
    return Fail(ErrorKind::kIo, "input/output error");
  };
  EXPECT_THAT(Examine(), Problem("storage-space", "not known: input/output error", "df"));
}

TEST_F(Doctor, TheDisksSpeedIsHeldAgainstTheRate) {
  SetConfig("[trigger]\nsource = \"timer\"\ninterval_s = 0.1\n");  // 35.4 MB/s
  speed_.bytes_per_second = 100e6;
  EXPECT_THAT(Examine(), Found(Verdict::kGood, "storage-speed", "100.0 MB/s"));
  speed_.bytes_per_second = 40e6;
  EXPECT_THAT(Examine(), Warning("storage-speed", "10 are needed", "faster disk"));
  speed_.bytes_per_second = 20e6;
  EXPECT_THAT(Examine(), Problem("storage-speed", "20.0 MB/s", "faster disk"));
  options_.pictures_per_second = 1.0;
  EXPECT_THAT(Examine(), Found(Verdict::kGood, "storage-speed", "1 are needed"));
  options_.measure_disk = false;
  EXPECT_THAT(Examine(), Found(Verdict::kSkipped, "storage-speed", "not measured"));
}

TEST_F(Doctor, AClockThatNothingKeepsIsAWarningAndOneNeverSetAProblem) {
  synchronised_ = false;
  EXPECT_THAT(Examine(), Warning("clock", "nothing keeps the clock", "timedatectl set-ntp true"));
  utc_ = UtcTime::FromNanoseconds(0);
  EXPECT_THAT(Examine(), Problem("clock", "never set", "timedatectl"));
}

TEST_F(Doctor, TheServicesStateIsTold) {
  EXPECT_THAT(Examine(), Found(Verdict::kSkipped, "service", "systemd does not run"));
  fs::create_directories(machine_.At("/run/systemd/system"));
  systemctl_ = "LoadState=not-found\nActiveState=inactive\n";
  EXPECT_THAT(Examine(), Found(Verdict::kSkipped, "service", "not installed"));
  systemctl_ = "LoadState=loaded\nActiveState=failed\nResult=exit-code\nNRestarts=7\n";
  EXPECT_THAT(Examine(), Problem("service", "exit-code, restarted 7 times",
                                 "journalctl -u omnihdrd -b -n 50"));
  systemctl_ = "LoadState=loaded\nActiveState=inactive\nUnitFileState=disabled\n";
  EXPECT_THAT(Examine(), Warning("service", "disabled", "systemctl enable --now"));
  systemctl_ = "LoadState=loaded\nActiveState=inactive\nUnitFileState=enabled\n";
  EXPECT_THAT(Examine(), Warning("service", "inactive", "systemctl start"));
  systemctl_ = "LoadState=loaded\nActiveState=active\nSubState=running\nUnitFileState=enabled\n";
  EXPECT_THAT(Examine(), Found(Verdict::kGood, "service", "active (running)"));
}

// Somebody at a TCP port who says `greeting` to everybody and then `answer` to what they say.
class Talker {
 public:
  Talker(std::string greeting, std::string answer)
      : listener_(*ListenTcp("127.0.0.1", 0)), port_(LocalPort(listener_.get())) {
    thread_ = std::jthread([this, greeting, answer](const std::stop_token& stop) {
      while (!stop.stop_requested()) {
        const Fd peer(::accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC));
        if (!peer.valid()) {
          std::this_thread::sleep_for(std::chrono::milliseconds(2));
          continue;
        }
        ::send(peer.get(), greeting.data(), greeting.size(), MSG_NOSIGNAL);
        char heard[256];
        if (!answer.empty() && ::recv(peer.get(), heard, sizeof heard, 0) > 0) {
          ::send(peer.get(), answer.data(), answer.size(), MSG_NOSIGNAL);
        }
      }
    });
  }
  int port() const { return port_; }

 private:
  Fd listener_;
  const int port_;
  std::jthread thread_;
};

int ClosedPort() {
  const Fd listener = *ListenTcp("127.0.0.1", 0);
  return LocalPort(listener.get());
}

TEST_F(Doctor, GpsdIsAskedForItsReceivers) {
  const auto use = [&](int port) {
    SetConfig(fmt::format("[gnss]\nenabled = true\nport = {}\n", port));
  };
  use(ClosedPort());
  EXPECT_THAT(Examine(), Problem("gnss", "Connection refused", "gpsd.socket"));
  const std::string version = "{\"class\":\"VERSION\",\"release\":\"3.22\"}\n";
  const Talker good(version, "{\"class\":\"DEVICES\",\"devices\":[{\"path\":\"/dev/ttyACM0\"}]}\n");
  use(good.port());
  EXPECT_THAT(Examine(), Found(Verdict::kGood, "gnss", "has 1 receiver"));
  const Talker bare(version, "{\"class\":\"DEVICES\",\"devices\":[]}\n");
  use(bare.port());
  EXPECT_THAT(Examine(), Warning("gnss", "no receiver", "gpsdctl add"));
  const Talker other("220 mail\r\n", "");
  use(other.port());
  EXPECT_THAT(Examine(), Problem("gnss", "is no gpsd", "gnss.port"));
}

TEST_F(Doctor, TheVehiclesRegistersAreRead) {
  const auto use = [&](int port, int address) {
    SetConfig(
        fmt::format("[modbus.client]\nconnection = \"tcp\"\nport = {}\n"
                    "[modbus.client.odometer]\nregister = {}\n",
                    port, address));
  };
  use(ClosedPort(), 3);
  EXPECT_THAT(Examine(), Problem("modbus-vehicle", "refused", "ping -c 3 127.0.0.1"));
  testing_modbus::Slave slave;
  slave.StartTcp();
  use(slave.port(), 3);
  EXPECT_THAT(Examine(), Found(Verdict::kGood, "modbus-vehicle", "1 numbers read"));
  use(slave.port(), 9000);
  EXPECT_THAT(Examine(), Problem("modbus-vehicle", "refuses odometer at register 9000",
                                 "modbus.client.odometer.register"));
}

TEST_F(Doctor, ASerialPortIsADeviceLikeOthers) {
  const std::string config =
      "[modbus.client]\nconnection = \"rtu\"\ndevice = \"/dev/ttyUSB0\"\n"
      "[modbus.client.odometer]\nregister = 3\n";
  SetConfig(config);
  EXPECT_THAT(Examine(), Problem("modbus-device", "/dev/ttyUSB0 is not there", "ftdi_sio"));
  PutNode("/dev/ttyUSB0", 0, 0, 0660);
  EXPECT_THAT(Examine(), Problem("modbus-device", "omnihdr may not open it",
                                 "sudo usermod -aG dialout omnihdr"));
}

TEST_F(Doctor, TheModbusServersPortMustBeFree) {
  const Fd listener = *ListenTcp("127.0.0.1", 0);
  SetConfig(
      fmt::format("[modbus.server]\nconnection = \"tcp\"\nport = {}\n", LocalPort(listener.get())));
  EXPECT_THAT(Examine(), Problem("modbus-server", "in use", "sudo ss -ltnp"));
}

TEST_F(Doctor, AnotherDaemonIsFoundByItsProcess) {
  EXPECT_THAT(Examine(), Found(Verdict::kSkipped, "daemon", "not running"));
  Put("/proc/4711/comm", "omnihdrd\n");
  EXPECT_THAT(Examine(),
              Problem("daemon", "an omnihdrd (process 4711) runs", "ps -o args= -p 4711"));
}

TEST_F(Doctor, WhoMayNotLookIntoTheSocketsFolderIsToldItsGroup) {
  Put("/etc/group", "omnihdr:x:4242:\n");
  const auto usual = machine_.node;
  machine_.node = [this, usual](const fs::path& place) -> Result<doctor::FileNode> {
    if (place == path() / "api.sock") return Fail(ErrorKind::kPermission, "not allowed");
    if (place == path()) return doctor::FileNode{4242, 4242, S_IFDIR | 0750};
    return usual(place);
  };
  EXPECT_THAT(Examine(), Problem("daemon", "may not look into it", "sudo usermod -aG omnihdr "));
}

TEST_F(Doctor, ASocketThatDoesNotAnswerIsAProblem) {
  const fs::path socket = path() / "api.sock";
  Fd listener(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  ASSERT_LT(socket.string().size(), sizeof address.sun_path);
  std::strncpy(address.sun_path, socket.c_str(), sizeof address.sun_path - 1);
  ASSERT_EQ(::bind(listener.get(), reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  ASSERT_EQ(::listen(listener.get(), 1), 0);
  EXPECT_THAT(Examine(), Contains(AllOf(Field(&Diagnosis::check, "daemon"),
                                        Field(&Diagnosis::verdict, Verdict::kProblem))))
      << Told(Examine());
  listener.Close();
  EXPECT_THAT(Examine(), Found(Verdict::kSkipped, "daemon", "left from an earlier run"));
}

// A daemon that says what a test puts in.
class SpokenStatus final : public ApiBackend {
 public:
  Result<StatusReport> GetStatus() override { return status; }
  ApiReply Arm() override { return {}; }
  ApiReply Disarm() override { return {}; }
  ApiReply Trigger() override { return {}; }
  ApiReply Finish() override { return {}; }
  ApiReply Stop(bool) override { return {}; }
  ApiReply Reload() override { return {}; }
  StatusReport status;
};

TEST_F(Doctor, ADaemonThatIsWellIsGoodAndOneThatIsNotSaysWhatToDo) {
  SpokenStatus daemon;
  EventHub hub(2, 4);
  ApiServerOptions options;
  options.socket = path() / "api.sock";
  const auto server = ApiServer::Listen(options, daemon, hub);
  ASSERT_TRUE(server) << server.error().message;
  daemon.status.state = {CaptureState::kArmed, "every trigger takes a picture", "nothing to do"};
  EXPECT_THAT(Examine(), Found(Verdict::kGood, "daemon", "armed"));
  EXPECT_THAT(Examine(), Not(Contains(Field(&Diagnosis::check, "orientation"))));
  daemon.status.state = {CaptureState::kDegraded, "the reason", "the remedy"};
  EXPECT_THAT(Examine(), Contains(AllOf(Field(&Diagnosis::check, "daemon"),
                                        Field(&Diagnosis::verdict, Verdict::kWarning),
                                        Field(&Diagnosis::remedy, "the remedy"))));
  daemon.status.orientation = {"contradicted", "they would agree upside down", 0.1, 3, 3};
  EXPECT_THAT(Examine(),
              Problem("orientation", "they would agree upside down", "omnihdr calibrate verify"));
  daemon.status.orientation.what = "agrees";
  EXPECT_THAT(Examine(), Found(Verdict::kGood, "orientation", "they would"));
}

TEST(DoctorMachine, TheDiskIsMeasuredAndLeftAsItWas) {
  const testing::TemporaryDirectory directory;
  const doctor::Machine machine = doctor::RealMachine();
  const Result<doctor::DiskSpeed> speed = machine.measure_disk(directory.path(), 100'000);
  ASSERT_TRUE(speed) << speed.error().message;
  EXPECT_GE(speed->pictures, 3);
  EXPECT_GT(speed->bytes_per_second, 0.0);
  EXPECT_GT(speed->worst_s, 0.0);
  EXPECT_TRUE(fs::is_empty(directory.path()));
  const Result<doctor::DiskSpace> space = machine.space(directory.path());
  ASSERT_TRUE(space) << space.error().message;
  EXPECT_GT(space->total_bytes, 0U);
}

TEST(DoctorMachine, AProgramIsRunAndEndedWhenItDoesNotEnd) {
  const doctor::Machine machine = doctor::RealMachine();
  EXPECT_EQ(machine.run({"echo", "a b"}).value_or(""), "a b\n");
  const Result<std::string> none = machine.run({"no-such-program-anywhere"});
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().kind, ErrorKind::kUnavailable);
  const auto begin = std::chrono::steady_clock::now();
  const Result<std::string> endless = machine.run({"sleep", "1000"});
  ASSERT_FALSE(endless);
  EXPECT_EQ(endless.error().kind, ErrorKind::kTemporary);
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(60));
}

TEST(DoctorMachine, WhoHasAFileOpenIsFoundOnThisMachine) {
  const testing::TemporaryDirectory directory;
  const fs::path file = fs::canonical(directory.path()) / "held";
  testing::WriteText(file, "");
  const doctor::Machine machine = doctor::RealMachine();
  EXPECT_THAT(machine.HoldersOf(file), ::testing::IsEmpty());
  std::FILE* held = std::fopen(file.c_str(), "r");
  EXPECT_THAT(machine.HoldersOf(file), Contains(HasSubstr(fmt::format("{} (", ::getpid()))));
  std::fclose(held);
}

TEST(DoctorMachine, ModesDecideAsTheKernelDoes) {
  const doctor::Account user{"u", 1000, {1000, 46}};
  const auto may = [&user](uid_t uid, gid_t gid, mode_t mode) {
    return doctor::MayOpen(user, {uid, gid, mode});
  };
  EXPECT_TRUE(may(1000, 0, 0600));
  EXPECT_FALSE(may(1000, 46, 0460)) << "the owner's bits alone count for the owner";
  EXPECT_TRUE(may(0, 46, 0060));
  EXPECT_FALSE(may(0, 46, 0640));
  EXPECT_FALSE(may(0, 0, 0660));
  EXPECT_TRUE(may(0, 0, 0666));
  EXPECT_TRUE(doctor::MayOpen({"root", 0, {0}}, {5, 5, 0}));
}

TEST(DoctorMachine, ThisMachineCanBeExamined) {
  const testing::TemporaryDirectory directory;
  testing::WriteText(directory.path() / "c.toml",
                     "[session]\ndirectory = \"s\"\n[api]\nsocket = \"api.sock\"\n");
  doctor::DoctorOptions options;
  options.config = directory.path() / "c.toml";
  const std::vector<Diagnosis> found = doctor::Examine(options, doctor::RealMachine());
  for (const char* check : {"config", "daemon", "service", "camera", "storage", "storage-space",
                            "storage-speed", "clock"}) {
    EXPECT_THAT(found, Contains(Field(&Diagnosis::check, check))) << Told(found);
  }
  EXPECT_TRUE(fs::exists(directory.path() / "c.toml"));
  EXPECT_FALSE(fs::exists(directory.path() / "s"));
}

}  // namespace
}  // namespace omnihdr::doctor_test
