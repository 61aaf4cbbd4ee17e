#include "drivers/v4l2/kernel_device.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <fstream>
#include <limits>
#include <optional>
#include <utility>

namespace omnihdr::v4l2 {
namespace {

namespace fs = std::filesystem;

constexpr int kMaxInterruptions = 100;
constexpr int kMaxNodes = 256;

class KernelDevice final : public V4l2Device {
 public:
  KernelDevice() = default;
  ~KernelDevice() override { Close(); }
  KernelDevice(const KernelDevice&) = delete;
  KernelDevice& operator=(const KernelDevice&) = delete;

  int Open(const std::string& path) override {
    Close();
    fd_ = ::open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
    return fd_ < 0 ? -errno : 0;
  }
  void Close() override {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }
  int Ioctl(unsigned long request, void* argument) override {
    for (int i = 0; i < kMaxInterruptions; ++i) {
      if (::ioctl(fd_, request, argument) >= 0) return 0;
      if (errno != EINTR) return -errno;
    }
    return -EINTR;
  }
  Mapping Map(std::size_t length, std::int64_t offset) override {
    void* data = ::mmap(nullptr, length, PROT_READ | PROT_WRITE, MAP_SHARED, fd_, offset);
    if (data == MAP_FAILED) return {nullptr, -errno};
    return {static_cast<std::byte*>(data), 0};
  }
  void Unmap(std::byte* data, std::size_t length) override { ::munmap(data, length); }
  int WaitForFrame(Nanoseconds timeout) override {
    pollfd watched{fd_, POLLIN, 0};
    const auto ms = std::clamp<std::int64_t>(timeout.count() / 1'000'000, 0, 600'000);
    const int ready = ::poll(&watched, 1, static_cast<int>(ms));
    if (ready < 0) return errno == EINTR ? 0 : -errno;
    // With an error the reason is what the next VIDIOC_DQBUF says.
    return ready;
  }

 private:
  int fd_ = -1;
};

std::string FirstLine(const fs::path& file) {
  std::ifstream in(file);
  std::string line;
  std::getline(in, line);
  return line;
}

// The serial number of the USB device that the node's device is part of.
std::string UsbSerial(const fs::path& node) {
  std::error_code failed;
  fs::path at = fs::canonical(node / "device", failed);
  if (failed) return {};
  for (int i = 0; i < 4 && at.has_relative_path(); ++i, at = at.parent_path()) {
    if (fs::exists(at / "idVendor", failed)) return FirstLine(at / "serial");
  }
  return {};
}

std::optional<int> NumberOf(const std::string& name) {
  constexpr std::string_view kPrefix = "video";
  if (!name.starts_with(kPrefix)) return std::nullopt;
  int number = 0;
  const char* end = name.data() + name.size();
  const auto read = std::from_chars(name.data() + kPrefix.size(), end, number);
  if (read.ec != std::errc{} || read.ptr != end) return std::nullopt;
  return number;
}

class KernelSystem final : public V4l2System {
 public:
  explicit KernelSystem(KernelRoots roots) : roots_(std::move(roots)) {}

  std::vector<V4l2Node> List() override {
    std::vector<std::pair<int, V4l2Node>> found;
    std::error_code failed;
    fs::directory_iterator at(roots_.sys / "class" / "video4linux", failed);
    for (; !failed && at != fs::directory_iterator() && found.size() < kMaxNodes;
         at.increment(failed)) {
      const std::string name = at->path().filename().string();
      const std::optional<int> number = NumberOf(name);
      if (!number) continue;
      V4l2Node node;
      node.path = (roots_.dev / name).string();
      node.serial = UsbSerial(at->path());
      found.emplace_back(*number, std::move(node));
    }
    for (const char* folder : {"by-id", "by-path"}) AddNames(folder, found);
    std::sort(found.begin(), found.end(),
              [](const auto& a, const auto& b) { return a.first < b.first; });
    std::vector<V4l2Node> nodes;
    for (auto& [number, node] : found) {
      std::sort(node.names.begin(), node.names.end());
      nodes.push_back(std::move(node));
    }
    return nodes;
  }
  std::unique_ptr<V4l2Device> MakeDevice() override { return std::make_unique<KernelDevice>(); }

 private:
  void AddNames(const char* folder, std::vector<std::pair<int, V4l2Node>>& found) const {
    std::error_code failed;
    fs::directory_iterator at(roots_.dev / "v4l" / folder, failed);
    for (; !failed && at != fs::directory_iterator(); at.increment(failed)) {
      std::error_code unreadable;
      const fs::path target = fs::read_symlink(at->path(), unreadable).filename();
      if (unreadable) continue;
      for (auto& [number, node] : found) {
        if (fs::path(node.path).filename() == target) {
          node.names.push_back(at->path().filename().string());
        }
      }
    }
  }

  const KernelRoots roots_;
};

}  // namespace

std::unique_ptr<V4l2System> MakeKernelSystem(KernelRoots roots) {
  return std::make_unique<KernelSystem>(std::move(roots));
}

}  // namespace omnihdr::v4l2
