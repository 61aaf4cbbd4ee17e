#include <linux/videodev2.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "drivers/v4l2/camera_setup.h"
#include "drivers/v4l2/kernel_call.h"
#include "drivers/v4l2/recording.h"

namespace {

using namespace omnihdr;

void Check(bool law) {
  if (!law) std::abort();
}

// A kernel that answers with what the input says: a byte that chooses between success, an error,
// and bytes of the input over what the caller gave.
class FuzzedDevice final : public v4l2::V4l2Device {
 public:
  FuzzedDevice(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}
  int Open(const std::string&) override { return 0; }
  void Close() override {}
  int Ioctl(unsigned long request, void* argument) override {
    const std::uint8_t choice = Next();
    if (at_ >= size_ || choice >= 0xF0) return -22;
    if (choice < 0x80) return 0;
    const std::size_t bytes = _IOC_SIZE(request);
    const bool pointers = request == VIDIOC_S_EXT_CTRLS || request == VIDIOC_G_EXT_CTRLS;
    auto* to = pointers ? reinterpret_cast<std::uint8_t*>(
                              &static_cast<v4l2_ext_controls*>(argument)->controls->value64)
                        : static_cast<std::uint8_t*>(argument);
    const std::size_t room = pointers ? sizeof(std::int64_t) : bytes;
    const std::size_t from = pointers || choice % 2 == 0 ? 0 : Next() % room;
    for (std::size_t i = from; i < room && i < from + 16; ++i) to[i] = Next();
    return 0;
  }
  Mapping Map(std::size_t, std::int64_t) override { return {nullptr, -12}; }
  void Unmap(std::byte*, std::size_t) override {}
  int WaitForFrame(Nanoseconds) override { return 0; }

 private:
  std::uint8_t Next() { return at_ < size_ ? data_[at_++] : std::uint8_t{0}; }
  const std::uint8_t* data_;
  std::size_t size_;
  std::size_t at_ = 0;
};

class FuzzedSystem final : public v4l2::V4l2System {
 public:
  FuzzedSystem(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}
  std::vector<v4l2::V4l2Node> List() override { return {{"/dev/video0", {}, {}}}; }
  std::unique_ptr<v4l2::V4l2Device> MakeDevice() override {
    return std::make_unique<FuzzedDevice>(data_, size_);
  }

 private:
  const std::uint8_t* data_;
  std::size_t size_;
};

void CheckPixels(const std::uint8_t* data, std::size_t size) {
  if (size < 5) return;
  v4l2::FrameLayout layout;
  layout.format = v4l2::PixelFormats()[data[0] % v4l2::PixelFormats().size()];
  layout.width = data[1] + 1;
  layout.height = data[2] % 64 + 1;
  layout.bytes_per_line = static_cast<std::size_t>(data[3]) * 4;
  layout.image_bytes = layout.bytes_per_line * static_cast<std::size_t>(layout.height);
  layout.full_range = data[4] % 2 != 0;
  const std::span<const std::byte> bytes = std::as_bytes(std::span(data + 5, size - 5));
  const auto pixels = v4l2::ReadPixels(bytes, layout);
  const auto level = v4l2::MeasureLevel(bytes, layout);
  Check(pixels.has_value() == level.has_value());
  if (!pixels) {
    Check(!pixels.error().message.empty());
    return;
  }
  Check(level->mean >= 0.0 && level->mean <= 1.0 && level->clipped >= 0.0 && level->clipped <= 1.0);
  Check(pixels->index() == (layout.format.bits > 8 ? 1U : 0U));
  std::visit(
      [&](const auto& image) {
        Check(image.width() == layout.width && image.height() == layout.height &&
              image.channels() == layout.format.channels);
      },
      *pixels);
}

// The calls of a recording, behind its magic: what is taken for a call is written back as the same
// bytes, and a driver that plays it comes to an end.
void PlayRecording(std::span<const std::byte> bytes) {
  if (const auto call = v4l2::DecodeCall(bytes)) {
    const std::vector<std::byte> again = v4l2::EncodeCall(*call);
    const auto twice = v4l2::DecodeCall(again);
    Check(twice && v4l2::EncodeCall(*twice) == again && !call->Request().empty());
  }
  const auto magic = std::as_bytes(std::span(v4l2::kKernelCallMagic));
  std::vector<std::byte> recording(magic.begin(), magic.end());
  recording.insert(recording.end(), bytes.begin(), bytes.end());
  auto system = v4l2::MakeReplayingSystem(std::move(recording));
  Check(system.has_value());
  v4l2::V4l2CameraOptions options;
  options.layout = Layout::kPerspective;
  options.latency_frames = 4;
  const auto camera = v4l2::OpenAndSetUp(**system, options, (*system)->clock());
  if (!camera) {
    Check(!camera.error().message.empty());
    return;
  }
  if (!(*camera)->stream->Start((*camera)->frame)) return;
  for (int i = 0; i < 16; ++i) {
    const auto next = (*camera)->stream->Next(Nanoseconds(0));
    if (!next) break;
    if (!*next) continue;
    static_cast<void>(v4l2::ReadPixels((*next)->bytes, (*camera)->frame));
    if (!(*camera)->stream->Recycle(**next)) break;
  }
}

// A head of two sensors, in a file of this process.
const std::string& RigFile() {
  static const std::string path = [] {
    std::string name = (std::filesystem::temp_directory_path() / "v4l2_fuzz_XXXXXX").string();
    const int fd = ::mkstemp(name.data());
    Check(fd >= 0);
    ::close(fd);
    std::ofstream out(name);
    out << "format = \"omnihdr-rig\"\nversion = 1\nmodel = \"head\"\nserial = \"\"\n"
           "sphere_radius_m = 10.0\nblend_width_deg = 5.0\n";
    for (int i = 0; i < 2; ++i) {
      out << "\n[[sensor]]\nname = \"" << i
          << "\"\nsize = [32, 24]\nbayer = \"none\"\nlens = \"fisheye\"\n"
             "focal = [16, 16]\ncentre = [16, 12]\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n"
             "fov_deg = 130.0\nrotation = [1.0, 0.0, 0.0, 0.0]\ntranslation = [0.0, 0.0, 0.0]\n";
    }
    return name;
  }();
  return path;
}

// The calls of two cameras, each behind its magic; the first byte says where the second begins.
void PlayRig(std::span<const std::byte> bytes) {
  if (bytes.empty()) return;
  const std::size_t cut = std::to_integer<std::size_t>(bytes[0]) * (bytes.size() - 1) / 255;
  const auto magic = std::as_bytes(std::span(v4l2::kKernelCallMagic));
  std::vector<std::vector<std::byte>> recordings;
  for (const auto part : {bytes.subspan(1, cut), bytes.subspan(1 + cut)}) {
    std::vector<std::byte>& recording = recordings.emplace_back(magic.begin(), magic.end());
    recording.insert(recording.end(), part.begin(), part.end());
  }
  v4l2::V4l2CameraOptions options;
  options.rig_file = RigFile();
  options.coding = v4l2::Coding::kGrey;
  options.latency_frames = 4;
  options.devices = {"/dev/video0", "/dev/video2"};
  auto camera = v4l2::MakeReplayedRig(options, std::move(recordings));
  Check(camera.has_value());
  const auto info = (*camera)->Open();
  Check(info.has_value() || !info.error().message.empty());
}

}  // namespace

// Any bytes in a buffer give a picture of the size set or an error with a message; any answers of a
// kernel end in a camera that can be believed or in an error with a message; so does any recording,
// of one camera or of two as a rig.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  if (data[0] == 0xFE) {
    PlayRig(std::as_bytes(std::span(data + 1, size - 1)));
    return 0;
  }
  if (data[0] == 0xFF) {
    PlayRecording(std::as_bytes(std::span(data + 1, size - 1)));
    return 0;
  }
  if (data[0] % 2 == 0) {
    CheckPixels(data + 1, size - 1);
    return 0;
  }
  FuzzedSystem system(data + 1, size - 1);
  v4l2::V4l2CameraOptions options;
  options.layout = data[0] % 4 == 1 ? Layout::kPanorama : Layout::kPerspective;
  options.latency_frames = data[0] % 8 < 4 ? 2 : 0;
  const SystemClock clock;
  const auto camera = v4l2::OpenAndSetUp(system, options, clock);
  if (!camera) {
    Check(!camera.error().message.empty());
    return 0;
  }
  Check((*camera)->info.shortest < (*camera)->info.longest);
  Check((*camera)->info.description.width > 0 && (*camera)->info.description.height > 0);
  return 0;
}
