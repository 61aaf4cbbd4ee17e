// The survey directory: who may write, where it lies, how much and how fast.
#include <fmt/format.h>
#include <sys/stat.h>

#include <algorithm>
#include <fstream>
#include <sstream>
#include <system_error>

#include "daemon/doctor/checks.h"

namespace omnihdr::doctor {
namespace {

namespace fs = std::filesystem;

constexpr double kFewMinutes = 60.0;
constexpr double kVeryFewMinutes = 10.0;
constexpr std::uint64_t kLittleSpace = std::uint64_t{1} << 30;
constexpr std::uint64_t kFewInodes = 10'000;
constexpr double kMargin = 1.25;  // of speed over need, for views are written, too
constexpr std::size_t kUnknownPicture = std::size_t{5} << 20;

struct Mount {
  std::string place;
  std::string type;
  bool read_only = false;
};

// The mount that a path lies on, by the longest place in front of it.
Mount MountOf(const Machine& machine, const fs::path& path) {
  Mount best;
  std::ifstream lines(machine.At("/proc/self/mounts"));
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string device;
    std::string place;
    std::string type;
    std::string options;
    words >> device >> place >> type >> options;
    const std::string below = place == "/" ? "/" : place + "/";
    if ((path.string() + "/").starts_with(below) && place.size() >= best.place.size()) {
      best = {place, type, ("," + options + ",").find(",ro,") != std::string::npos};
    }
  }
  return best;
}

std::string Gigabytes(std::uint64_t bytes) {
  return fmt::format("{:.1f} GB", static_cast<double>(bytes) / 1e9);
}

// The directory itself, or the nearest one above it that exists.
fs::path Existing(fs::path directory) {
  std::error_code error;
  while (!fs::exists(directory, error) && directory.has_parent_path() &&
         directory.parent_path() != directory) {
    directory = directory.parent_path();
  }
  return directory;
}

void CheckSpace(Examination& e, const fs::path& directory, const DiskSpace& space) {
  const std::size_t picture = PictureBytes(e.config).value_or(0);
  const std::optional<double> rate = PicturesPerSecond(e.options, e.config);
  std::string text =
      fmt::format("{} of {} free", Gigabytes(space.free_bytes), Gigabytes(space.total_bytes));
  std::optional<double> minutes;
  if (picture > 0 && rate && *rate > 0.0) {
    minutes = static_cast<double>(space.free_bytes) / (static_cast<double>(picture) * *rate) / 60.0;
    text += fmt::format(": {:.0f} minutes of {:.3g} pictures a second of up to {:.1f} MB", *minutes,
                        *rate, static_cast<double>(picture) / 1e6);
  } else if (picture > 0) {
    text += fmt::format(": {} pictures of up to {:.1f} MB", space.free_bytes / picture,
                        static_cast<double>(picture) / 1e6);
  }
  const std::string remedy = fmt::format(
      "du -sh {}/*   # copy finished sessions away (omnihdr verify the copy), then "
      "remove them",
      directory.string());
  if (space.free_bytes < kLittleSpace || (minutes && *minutes < kVeryFewMinutes)) {
    e.Problem("storage-space", text, remedy);
  } else if (minutes && *minutes < kFewMinutes) {
    e.Warning("storage-space", text, remedy);
  } else if (space.has_inodes && space.free_inodes < kFewInodes) {
    e.Problem("storage-space",
              fmt::format("{}, and room for {} files only", text, space.free_inodes), remedy);
  } else {
    e.Good("storage-space", text);
  }
}

void CheckVolume(Examination& e, const fs::path& directory, const DiskSpace& space) {
  const Mount mount = MountOf(e.machine, directory);
  if (mount.read_only) {
    e.Problem("storage-volume", fmt::format("{} is mounted read-only", mount.place),
              fmt::format("sudo dmesg | tail; sudo mount -o remount,rw {}   # a disk with errors "
                          "is mounted so: fsck it first",
                          mount.place));
    return;
  }
  const std::string own = "mount a volume of its own (ext4) there, or set session.directory to one";
  if (mount.type == "tmpfs" || mount.type == "ramfs") {
    e.Warning("storage-volume",
              fmt::format("{} lies in memory ({}): gone when the machine is switched off",
                          directory.string(), mount.type),
              own);
    return;
  }
  if (mount.type == "vfat" || mount.type == "exfat" || mount.type == "ntfs" ||
      mount.type == "fuseblk") {
    e.Warning("storage-volume",
              fmt::format("{} is {}: a power cut may cost whole folders", mount.place, mount.type),
              "copy the data away, then: sudo mkfs.ext4 on that device");
    return;
  }
  const Result<DiskSpace> root = e.machine.space(e.machine.root);
  if (root && root->device == space.device && !e.config.MayLieOnRoot()) {
    e.Problem("storage-volume",
              fmt::format("{} is on the root file system: omnihdrd refuses to begin a survey there",
                          directory.string()),
              own + ", or allow it: storage.allow_root = true");
    return;
  }
  if (root && root->device == space.device) {
    e.Warning("storage-volume",
              fmt::format("{} is on the root file system: a survey that fills it stops the "
                          "machine's other services",
                          directory.string()),
              own);
    return;
  }
  e.Good("storage-volume",
         fmt::format("{} ({})", mount.place.empty() ? "a volume of its own" : mount.place,
                     mount.type.empty() ? "type not known" : mount.type));
}

void CheckSpeed(Examination& e, const fs::path& directory) {
  if (!e.options.measure_disk) {
    e.Add("storage-speed", Verdict::kSkipped, "not measured (--no-disk-test)");
    return;
  }
  const std::optional<std::size_t> known = PictureBytes(e.config);
  const std::size_t picture = known.value_or(kUnknownPicture);
  const Result<DiskSpeed> speed = e.machine.measure_disk(directory, picture);
  if (!speed) {
    e.Add("storage-speed", Verdict::kSkipped, speed.error().message);
    return;
  }
  const double takes = speed->bytes_per_second / static_cast<double>(picture);
  std::string text = fmt::format(
      "{:.1f} MB/s durable: {:.3g} pictures a second of {:.1f} MB, the slowest of {} in {:.0f} ms",
      speed->bytes_per_second / 1e6, takes, static_cast<double>(picture) / 1e6, speed->pictures,
      1e3 * speed->worst_s);
  const std::optional<double> rate = PicturesPerSecond(e.options, e.config);
  if (!rate) {
    e.Good("storage-speed", text + "; how many are needed is not known (--rate)");
    return;
  }
  text += fmt::format("; {:.3g} are needed", *rate);
  const std::string remedy =
      "a faster disk (not a memory card), a larger trigger distance or interval, or a higher "
      "recorder.png_compression; sudo iotop shows who else writes";
  if (takes < *rate) {
    e.Problem("storage-speed", text, remedy);
  } else if (takes < kMargin * *rate) {
    e.Warning("storage-speed", text, remedy);
  } else {
    e.Good("storage-speed", text);
  }
}

}  // namespace

void CheckStorage(Examination& e) {
  const fs::path directory = fs::absolute(e.config.session.directory).lexically_normal();
  const fs::path existing = Existing(directory);
  const Result<FileNode> node = e.machine.node(existing);
  if (!node || !S_ISDIR(node->mode)) {
    e.Problem("storage", fmt::format("{}: not a directory", existing.string()),
              fmt::format("sudo install -d -o {} {}", e.account.name, directory.string()));
    return;
  }
  const bool is_there = existing == directory;
  if (!MayOpen(e.account, *node)) {
    e.Problem("storage",
              fmt::format("{} is {}: {} may not write {}", existing.string(),
                          DescribeNode(e.machine, *node), e.account.name,
                          is_there ? "there" : "the survey directory into it"),
              fmt::format("sudo install -d -o {0} {1}", e.account.name, directory.string()));
  } else {
    e.Good("storage",
           fmt::format("{} {}", directory.string(), is_there ? "can be written" : "can be made"));
  }
  const Result<DiskSpace> space = e.machine.space(existing);
  if (!space) {
    e.Problem("storage-space", fmt::format("free space is not known: {}", space.error().message),
              fmt::format("df {}", existing.string()));
    return;
  }
  CheckVolume(e, existing, *space);
  CheckSpace(e, existing, *space);
  CheckSpeed(e, existing);
}

std::optional<double> PicturesPerSecond(const DoctorOptions& options, const DaemonConfig& config) {
  if (options.pictures_per_second > 0.0) return options.pictures_per_second;
  const double frames = config.bracket.frames_per_position;
  if (config.trigger.source == TriggerKind::kTimer) return frames / config.trigger.interval_s;
  if (config.trigger.source == TriggerKind::kDistance &&
      config.trigger.odometer == OdometerKind::kSim) {
    return frames * config.camera.sim.speed_m_s / config.trigger.distance_m;
  }
  return std::nullopt;
}

}  // namespace omnihdr::doctor
