#include "tests/emulators/v4l2_camera_model.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <iterator>
#include <utility>

#include "drivers/v4l2/pixel_format.h"

namespace omnihdr::emulators {
namespace {

constexpr std::size_t kPage = 4096;
constexpr std::int64_t kExposureMargin = 4;  // lines of a frame that cannot be exposed

v4l2_query_ext_ctrl Describe(std::uint32_t id, const char* name, std::uint32_t type,
                             std::int64_t minimum, std::int64_t maximum, std::int64_t initial) {
  v4l2_query_ext_ctrl control{};
  control.id = id;
  control.type = type;
  std::strncpy(control.name, name, sizeof control.name - 1);
  control.minimum = minimum;
  control.maximum = maximum;
  control.step = 1;
  control.default_value = initial;
  return control;
}

}  // namespace

V4l2CameraModel::V4l2CameraModel(V4l2ModelOptions options, const Clock& clock)
    : options_(std::move(options)), clock_(clock), latency_(options_.latency_frames) {
  PowerUp();
}

void V4l2CameraModel::PowerUp() {
  controls_.clear();
  values_.clear();
  writes_.clear();
  const auto add = [this](const v4l2_query_ext_ctrl& control) {
    controls_[control.id] = control;
    values_[control.id] = control.default_value;
  };
  if (options_.in_lines) {
    add(Describe(V4L2_CID_EXPOSURE, "Exposure", V4L2_CTRL_TYPE_INTEGER, 1,
                 options_.height + 8 - kExposureMargin, 8));
    add(Describe(V4L2_CID_VBLANK, "Vertical Blanking", V4L2_CTRL_TYPE_INTEGER, 8, 1000, 8));
    add(Describe(V4L2_CID_HBLANK, "Horizontal Blanking", V4L2_CTRL_TYPE_INTEGER, kHblank, kHblank,
                 kHblank));
    add(Describe(V4L2_CID_PIXEL_RATE, "Pixel Rate", V4L2_CTRL_TYPE_INTEGER64, kPixelRate,
                 kPixelRate, kPixelRate));
    controls_[V4L2_CID_HBLANK].flags = V4L2_CTRL_FLAG_READ_ONLY;
    controls_[V4L2_CID_PIXEL_RATE].flags = V4L2_CTRL_FLAG_READ_ONLY;
    add(Describe(V4L2_CID_ANALOGUE_GAIN, "Analogue Gain", V4L2_CTRL_TYPE_INTEGER, 1, 255,
                 kUnityGain));
  } else {
    add(Describe(V4L2_CID_EXPOSURE_ABSOLUTE, "Exposure Time, Absolute", V4L2_CTRL_TYPE_INTEGER, 1,
                 5000, 10));
    add(Describe(
        V4L2_CID_EXPOSURE_AUTO, "Auto Exposure", V4L2_CTRL_TYPE_MENU, 0, 3,
        options_.starts_automatic ? V4L2_EXPOSURE_APERTURE_PRIORITY : V4L2_EXPOSURE_MANUAL));
    add(Describe(V4L2_CID_EXPOSURE_AUTO_PRIORITY, "Exposure, Dynamic Framerate",
                 V4L2_CTRL_TYPE_BOOLEAN, 0, 1, 1));
    add(Describe(V4L2_CID_AUTO_WHITE_BALANCE, "White Balance, Automatic", V4L2_CTRL_TYPE_BOOLEAN, 0,
                 1, 1));
    add(Describe(V4L2_CID_WHITE_BALANCE_TEMPERATURE, "White Balance Temperature",
                 V4L2_CTRL_TYPE_INTEGER, 2800, 6500, 4600));
    add(Describe(V4L2_CID_POWER_LINE_FREQUENCY, "Power Line Frequency", V4L2_CTRL_TYPE_MENU, 0, 2,
                 1));
    add(Describe(V4L2_CID_GAIN, "Gain", V4L2_CTRL_TYPE_INTEGER, 0, 255, kUnityGain));
  }
  fourcc_ = options_.formats.front();
  streaming_ = false;
  queued_.clear();
  filled_.clear();
  settings_ = {SettingNow()};
}

void V4l2CameraModel::SetFaults(Faults faults) {
  std::lock_guard lock(mutex_);
  faults_ = std::move(faults);
  changed_.notify_all();
}

void V4l2CameraModel::SetLatency(int frames) {
  std::lock_guard lock(mutex_);
  latency_ = frames;
}

void V4l2CameraModel::Unplug() {
  std::lock_guard lock(mutex_);
  plugged_in_ = false;
  changed_.notify_all();
}

void V4l2CameraModel::PlugIn() {
  std::lock_guard lock(mutex_);
  plugged_in_ = true;
  ++plugging_;
  PowerUp();
}

bool V4l2CameraModel::plugged_in() const {
  std::lock_guard lock(mutex_);
  return plugged_in_;
}

std::int64_t V4l2CameraModel::ControlNow(std::uint32_t id) const {
  std::lock_guard lock(mutex_);
  return values_.at(id);
}

std::vector<std::vector<std::uint32_t>> V4l2CameraModel::writes() const {
  std::lock_guard lock(mutex_);
  return writes_;
}

double V4l2CameraModel::Brightness(double seconds, double gain, int x, int y) const {
  const double scene = 0.25 + 0.75 * (x + y) / (options_.width + options_.height - 2.0);
  return seconds * gain * scene * light_ * options_.light / 255.0;
}

V4l2CameraModel::Setting V4l2CameraModel::SettingNow() const {
  Setting setting;
  if (options_.in_lines) {
    const double line = static_cast<double>(options_.width + kHblank) / kPixelRate;
    setting.seconds = static_cast<double>(values_.at(V4L2_CID_EXPOSURE)) * line;
    setting.gain = static_cast<double>(values_.at(V4L2_CID_ANALOGUE_GAIN)) / kUnityGain;
  } else {
    // In automatic mode it is what the scene needs, whatever was written.
    setting.seconds = values_.at(V4L2_CID_EXPOSURE_AUTO) == V4L2_EXPOSURE_MANUAL
                          ? static_cast<double>(values_.at(V4L2_CID_EXPOSURE_ABSOLUTE)) * 1e-4
                          : 100.0 / options_.light;
    setting.gain = static_cast<double>(values_.at(V4L2_CID_GAIN)) / kUnityGain;
  }
  return setting;
}

double V4l2CameraModel::IntervalSeconds() const {
  if (!options_.in_lines) return options_.interval_s;
  const double line = static_cast<double>(options_.width + kHblank) / kPixelRate;
  return line * static_cast<double>(options_.height + values_.at(V4L2_CID_VBLANK));
}

std::size_t V4l2CameraModel::FrameBytes() const {
  const auto format = v4l2::FindPixelFormat(fourcc_);
  const std::size_t pixels =
      static_cast<std::size_t>(options_.width) * static_cast<std::size_t>(options_.height);
  return format && (format->bits > 8 || format->coding == v4l2::Coding::kYuyv) ? 2 * pixels
                                                                               : pixels;
}

void V4l2CameraModel::Fill(std::vector<std::byte>& buffer, const Setting& setting) const {
  const auto format = v4l2::FindPixelFormat(fourcc_);
  const bool yuyv = format->coding == v4l2::Coding::kYuyv;
  for (int y = 0; y < options_.height; ++y) {
    for (int x = 0; x < options_.width; ++x) {
      const double share =
          faults_.dark ? 0.0 : std::min(Brightness(setting.seconds, setting.gain, x, y), 1.0);
      const std::size_t at =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(options_.width) +
          static_cast<std::size_t>(x);
      if (yuyv) {
        buffer[2 * at] = static_cast<std::byte>(std::lround(16 + 219 * share));
        buffer[2 * at + 1] = std::byte{128};
      } else if (format->bits > 8) {
        const auto value = static_cast<unsigned>(std::lround(share * ((1U << format->bits) - 1U)));
        buffer[2 * at] = static_cast<std::byte>(value & 0xFF);
        buffer[2 * at + 1] = static_cast<std::byte>(value >> 8);
      } else {
        buffer[at] = static_cast<std::byte>(std::lround(255 * share));
      }
    }
  }
}

// Makes the frames whose time has come.
void V4l2CameraModel::Advance(Session& session) {
  const HostTime now = clock_.Now();
  const auto interval = Nanoseconds(std::llround(IntervalSeconds() * 1e9));
  while (streaming_ && next_ <= now) {
    if (queued_.empty() || faults_.silent) {
      next_ = now + interval;
      return;
    }
    if (faults_.lost > 0) sequence_ += static_cast<std::uint32_t>(std::exchange(faults_.lost, 0));
    while (settings_.size() > 1 && static_cast<std::int32_t>(sequence_ - settings_[1].from) >= 0) {
      settings_.pop_front();
    }
    v4l2_buffer buffer{};
    buffer.index = queued_.front();
    queued_.pop_front();
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    buffer.memory = V4L2_MEMORY_MMAP;
    buffer.field = V4L2_FIELD_NONE;
    buffer.sequence = sequence_++;
    buffer.bytesused = static_cast<std::uint32_t>(FrameBytes());
    buffer.flags = options_.stamp_flags;
    Fill(session.buffers[buffer.index], settings_.front());
    std::int64_t stamp = next_.ns();
    if (faults_.damaged > 0) {
      --faults_.damaged;
      buffer.flags |= V4L2_BUF_FLAG_ERROR;
    }
    if (faults_.cut > 0) {
      --faults_.cut;
      buffer.bytesused /= 2;
    }
    if (faults_.stale > 0) {
      --faults_.stale;
      --sequence_;
      buffer.sequence = sequence_ - 20;
      stamp -= 20 * interval.count();
    }
    buffer.timestamp.tv_sec = stamp / 1'000'000'000;
    buffer.timestamp.tv_usec = stamp % 1'000'000'000 / 1000;
    filled_.push_back(buffer);
    next_ = next_ + interval;
  }
}

int V4l2CameraModel::Open(const std::string& path, Session& session) {
  std::lock_guard lock(mutex_);
  if (!plugged_in_ || path != options_.path) return -ENOENT;
  session.plugging = plugging_;
  return 0;
}

void V4l2CameraModel::Close(Session& session) {
  std::lock_guard lock(mutex_);
  if (!IsGone(session)) streaming_ = false;
  session.plugging = 0;
}

int V4l2CameraModel::WaitForFrame(Session& session, Nanoseconds timeout) {
  std::unique_lock lock(mutex_);
  const HostTime deadline = clock_.Now() + timeout;
  while (true) {
    if (IsGone(session)) return 1;  // POLLERR: the next call says why
    Advance(session);
    if (!filled_.empty()) return 1;
    const HostTime now = clock_.Now();
    if (now >= deadline) return 0;
    changed_.wait_for(lock, std::max(std::min(deadline, next_) - now, Nanoseconds(10'000)));
  }
}

int V4l2CameraModel::QueryControl(v4l2_query_ext_ctrl& query) const {
  const bool next = (query.id & V4L2_CTRL_FLAG_NEXT_CTRL) != 0;
  const auto found =
      next ? controls_.upper_bound(query.id & ~V4L2_CTRL_FLAG_NEXT_CTRL) : controls_.find(query.id);
  if (found == controls_.end()) return -EINVAL;
  query = found->second;
  return 0;
}

int V4l2CameraModel::GetControls(v4l2_ext_controls& group) const {
  for (std::uint32_t i = 0; i < group.count; ++i) {
    v4l2_ext_control& each = group.controls[i];
    const auto found = controls_.find(each.id);
    if (found == controls_.end()) return -EINVAL;
    const auto stuck = faults_.stuck.find(each.id);
    const std::int64_t value = stuck != faults_.stuck.end() ? stuck->second : values_.at(each.id);
    if (found->second.type == V4L2_CTRL_TYPE_INTEGER64) {
      each.value64 = value;
    } else {
      each.value = static_cast<std::int32_t>(value);
    }
  }
  return 0;
}

int V4l2CameraModel::SetControls(v4l2_ext_controls& group) {
  std::vector<std::uint32_t> ids;
  for (std::uint32_t i = 0; i < group.count; ++i) {
    const v4l2_ext_control& each = group.controls[i];
    const auto found = controls_.find(each.id);
    group.error_idx = i;
    if (found == controls_.end()) return -EINVAL;
    if ((found->second.flags & V4L2_CTRL_FLAG_READ_ONLY) != 0) return -EACCES;
    ids.push_back(each.id);
  }
  for (std::uint32_t i = 0; i < group.count; ++i) {
    const v4l2_ext_control& each = group.controls[i];
    const v4l2_query_ext_ctrl& control = controls_.at(each.id);
    values_[each.id] = std::clamp<std::int64_t>(each.value, control.minimum, control.maximum);
    if (each.id == V4L2_CID_VBLANK) {
      v4l2_query_ext_ctrl& exposure = controls_.at(V4L2_CID_EXPOSURE);
      exposure.maximum = options_.height + values_[each.id] - kExposureMargin;
      values_[V4L2_CID_EXPOSURE] =
          std::min(values_[V4L2_CID_EXPOSURE], std::int64_t{exposure.maximum});
    }
  }
  writes_.push_back(std::move(ids));
  if (faults_.ignores_exposure) return 0;
  Setting setting = SettingNow();
  setting.from = sequence_ + static_cast<std::uint32_t>(latency_ - 1);
  // Every setting of a stopped camera acts on its first frame.
  if (!streaming_) settings_.clear();
  settings_.push_back(setting);
  return 0;
}

int V4l2CameraModel::SetFormat(v4l2_format& format, bool set) {
  if (format.type != V4L2_BUF_TYPE_VIDEO_CAPTURE) return -EINVAL;
  v4l2_pix_format& pixels = format.fmt.pix;
  if (set) {
    if (streaming_) return -EBUSY;
    if (std::find(options_.formats.begin(), options_.formats.end(), pixels.pixelformat) !=
        options_.formats.end()) {
      fourcc_ = pixels.pixelformat;
    }
  }
  const bool words = FrameBytes() > static_cast<std::size_t>(options_.width * options_.height);
  pixels.width = static_cast<std::uint32_t>(options_.width);
  pixels.height = static_cast<std::uint32_t>(options_.height);
  pixels.pixelformat = fourcc_;
  pixels.field = V4L2_FIELD_NONE;
  pixels.bytesperline = pixels.width * (words ? 2 : 1);
  pixels.sizeimage = static_cast<std::uint32_t>(FrameBytes());
  return 0;
}

int V4l2CameraModel::Buffers(Session& session, unsigned long request, void* argument) {
  if (request == VIDIOC_REQBUFS) {
    auto& wanted = *static_cast<v4l2_requestbuffers*>(argument);
    if (streaming_) return -EBUSY;
    queued_.clear();
    filled_.clear();
    wanted.count = std::min<std::uint32_t>(wanted.count, 8);
    session.buffers.assign(wanted.count, std::vector<std::byte>(FrameBytes()));
    return 0;
  }
  if (request == VIDIOC_STREAMON) {
    streaming_ = true;
    sequence_ = options_.first_sequence;
    settings_ = {SettingNow()};
    next_ = clock_.Now() + Nanoseconds(std::llround(IntervalSeconds() * 1e9));
    return 0;
  }
  if (request == VIDIOC_STREAMOFF) {
    streaming_ = false;
    queued_.clear();
    filled_.clear();
    return 0;
  }
  auto& buffer = *static_cast<v4l2_buffer*>(argument);
  if (request == VIDIOC_DQBUF) {
    if (!streaming_) return -EINVAL;
    Advance(session);
    if (filled_.empty()) return -EAGAIN;
    buffer = filled_.front();
    filled_.pop_front();
    return 0;
  }
  if (buffer.index >= session.buffers.size()) return -EINVAL;
  if (request == VIDIOC_QUERYBUF) {
    buffer.length = static_cast<std::uint32_t>(session.buffers[buffer.index].size());
    buffer.m.offset = static_cast<std::uint32_t>(buffer.index * kPage);
    return 0;
  }
  queued_.push_back(buffer.index);  // VIDIOC_QBUF
  return 0;
}

std::byte* V4l2CameraModel::Map(Session& session, std::size_t length, std::int64_t offset) {
  std::lock_guard lock(mutex_);
  const auto index = static_cast<std::size_t>(offset) / kPage;
  if (IsGone(session) || index >= session.buffers.size() ||
      length > session.buffers[index].size()) {
    return nullptr;
  }
  return session.buffers[index].data();
}

int V4l2CameraModel::Ioctl(Session& session, unsigned long request, void* argument) {
  std::lock_guard lock(mutex_);
  if (IsGone(session)) return -ENODEV;
  const auto refused = faults_.refuse.find(request);
  if (refused != faults_.refuse.end()) return refused->second;
  switch (request) {
    case VIDIOC_QUERYCAP: {
      auto& told = *static_cast<v4l2_capability*>(argument);
      std::memcpy(told.driver, options_.driver.c_str(),
                  std::min(options_.driver.size(), sizeof told.driver - 1));
      std::memcpy(told.card, "Emulated Camera", 16);
      std::memcpy(told.bus_info, "usb-emulated-1", 15);
      told.capabilities = V4L2_CAP_DEVICE_CAPS;
      told.device_caps = V4L2_CAP_STREAMING | (options_.multi_planar ? V4L2_CAP_VIDEO_CAPTURE_MPLANE
                                                                     : V4L2_CAP_VIDEO_CAPTURE);
      return 0;
    }
    case VIDIOC_ENUM_FMT: {
      auto& described = *static_cast<v4l2_fmtdesc*>(argument);
      if (described.index >= options_.formats.size()) return -EINVAL;
      described.pixelformat = options_.formats[described.index];
      return 0;
    }
    case VIDIOC_G_FMT:
    case VIDIOC_S_FMT:
      return SetFormat(*static_cast<v4l2_format*>(argument), request == VIDIOC_S_FMT);
    case VIDIOC_G_PARM:
    case VIDIOC_S_PARM: {
      auto& interval = static_cast<v4l2_streamparm*>(argument)->parm.capture.timeperframe;
      interval.numerator = static_cast<std::uint32_t>(std::lround(IntervalSeconds() * 1e6));
      interval.denominator = 1'000'000;
      return 0;
    }
    case VIDIOC_QUERY_EXT_CTRL:
      return QueryControl(*static_cast<v4l2_query_ext_ctrl*>(argument));
    case VIDIOC_QUERYMENU: {
      auto& query = *static_cast<v4l2_querymenu*>(argument);
      if (query.id == V4L2_CID_POWER_LINE_FREQUENCY) {
        constexpr const char* kNames[] = {"Disabled", "50 Hz", "60 Hz"};
        if (query.index >= std::size(kNames)) return -EINVAL;
        std::strncpy(reinterpret_cast<char*>(query.name), kNames[query.index],
                     sizeof query.name - 1);
      }
      if (query.id != V4L2_CID_EXPOSURE_AUTO) return 0;
      std::strncpy(reinterpret_cast<char*>(query.name),
                   query.index == V4L2_EXPOSURE_MANUAL ? "Manual Mode" : "Aperture Priority Mode",
                   sizeof query.name - 1);
      // As many cameras have it: manual and aperture priority only.
      const bool offered = (query.index == V4L2_EXPOSURE_MANUAL && options_.has_manual_mode) ||
                           query.index == V4L2_EXPOSURE_APERTURE_PRIORITY;
      return offered ? 0 : -EINVAL;
    }
    case VIDIOC_S_EXT_CTRLS:
      return SetControls(*static_cast<v4l2_ext_controls*>(argument));
    case VIDIOC_G_EXT_CTRLS:
      return GetControls(*static_cast<v4l2_ext_controls*>(argument));
    case VIDIOC_REQBUFS:
    case VIDIOC_QUERYBUF:
    case VIDIOC_QBUF:
    case VIDIOC_DQBUF:
    case VIDIOC_STREAMON:
    case VIDIOC_STREAMOFF:
      return Buffers(session, request, argument);
    default:
      return -ENOTTY;
  }
}

namespace {

std::string MetadataPath(const V4l2CameraModel& camera) { return camera.options().path + "9"; }

class EmulatedDevice final : public v4l2::V4l2Device {
 public:
  explicit EmulatedDevice(std::vector<std::shared_ptr<V4l2CameraModel>> cameras)
      : cameras_(std::move(cameras)) {}
  ~EmulatedDevice() override { Close(); }
  EmulatedDevice(const EmulatedDevice&) = delete;
  EmulatedDevice& operator=(const EmulatedDevice&) = delete;

  int Open(const std::string& path) override {
    for (const auto& camera : cameras_) {
      metadata_ = path == MetadataPath(*camera) && camera->plugged_in();
      if (metadata_) return 0;
      if (const int opened = camera->Open(path, session_); opened == 0) {
        camera_ = camera;
        return 0;
      }
    }
    return -ENOENT;
  }
  void Close() override {
    if (camera_) camera_->Close(session_);
    camera_.reset();
  }
  int Ioctl(unsigned long request, void* argument) override {
    if (metadata_ && request == VIDIOC_QUERYCAP) {
      auto& told = *static_cast<v4l2_capability*>(argument);
      told.capabilities = V4L2_CAP_DEVICE_CAPS;
      told.device_caps = V4L2_CAP_META_CAPTURE | V4L2_CAP_STREAMING;
      return 0;
    }
    return camera_ ? camera_->Ioctl(session_, request, argument) : -ENODEV;
  }
  Mapping Map(std::size_t length, std::int64_t offset) override {
    std::byte* data = camera_ ? camera_->Map(session_, length, offset) : nullptr;
    return {data, data == nullptr ? -EINVAL : 0};
  }
  void Unmap(std::byte* /*data*/, std::size_t /*length*/) override {}
  int WaitForFrame(Nanoseconds timeout) override {
    return camera_ ? camera_->WaitForFrame(session_, timeout) : -ENODEV;
  }

 private:
  const std::vector<std::shared_ptr<V4l2CameraModel>> cameras_;
  std::shared_ptr<V4l2CameraModel> camera_;
  V4l2CameraModel::Session session_;
  bool metadata_ = false;
};

class EmulatedSystem final : public v4l2::V4l2System {
 public:
  explicit EmulatedSystem(std::vector<std::shared_ptr<V4l2CameraModel>> cameras)
      : cameras_(std::move(cameras)) {}
  std::vector<v4l2::V4l2Node> List() override {
    std::vector<v4l2::V4l2Node> nodes;
    for (const auto& camera : cameras_) {
      if (!camera->plugged_in()) continue;
      const V4l2ModelOptions& options = camera->options();
      nodes.push_back({options.path, {options.name}, options.serial});
      nodes.push_back({MetadataPath(*camera), {}, options.serial});
    }
    return nodes;
  }
  std::unique_ptr<v4l2::V4l2Device> MakeDevice() override {
    return std::make_unique<EmulatedDevice>(cameras_);
  }

 private:
  const std::vector<std::shared_ptr<V4l2CameraModel>> cameras_;
};

}  // namespace

std::unique_ptr<v4l2::V4l2System> MakeEmulatedV4l2(
    std::vector<std::shared_ptr<V4l2CameraModel>> cameras) {
  return std::make_unique<EmulatedSystem>(std::move(cameras));
}

}  // namespace omnihdr::emulators
