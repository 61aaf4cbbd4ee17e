#pragma once

#include <linux/videodev2.h>

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "drivers/v4l2/device.h"

namespace omnihdr::emulators {

struct V4l2ModelOptions {
  std::string path = "/dev/video2";
  std::string name = "usb-Emulated_Camera_0001-video-index0";
  std::string serial = "0001";
  std::string driver = "uvcvideo";
  std::vector<std::uint32_t> formats = {V4L2_PIX_FMT_YUYV, V4L2_PIX_FMT_GREY};
  int width = 32;
  int height = 24;
  double interval_s = 0.004;
  int latency_frames = 2;  // from a write to the first frame it acts on; 1 = the next one
  bool in_lines = false;   // V4L2_CID_EXPOSURE with PIXEL_RATE, HBLANK and VBLANK
  bool multi_planar = false;
  bool has_manual_mode = true;
  bool starts_automatic = true;
  double light = 100000.0;  // code values of 255 a second at unity gain, at the brightest pixel
  std::uint32_t first_sequence = 7;
  std::uint32_t stamp_flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
};

// A camera as its ioctls show it, in the clock's time: controls with ranges, exposure that acts
// some frames after it was written, and pixels whose brightness is scene × exposure × gain. Frames
// are made when there is a buffer for them; none is lost unless a fault says so. Thread-safe.
class V4l2CameraModel {
 public:
  static constexpr int kUnityGain = 16;
  // Of a model in lines.
  static constexpr std::int64_t kPixelRate = 2'400'000;
  static constexpr std::int64_t kHblank = 16;

  V4l2CameraModel(V4l2ModelOptions options, const Clock& clock);

  struct Faults {
    int damaged = 0;                // the next so many buffers have the driver's error flag
    int cut = 0;                    // ... have half of their bytes
    int stale = 0;                  // ... have a sequence and a time stamp of long ago
    int lost = 0;                   // frames skipped before the next one
    bool silent = false;            // no frames at all
    bool ignores_exposure = false;  // what is written is read back and does nothing
    bool dark = false;
    std::map<unsigned long, int> refuse;          // by request: -errno
    std::map<std::uint32_t, std::int64_t> stuck;  // controls that always read so
  };
  void SetFaults(Faults faults);
  void SetLatency(int frames);
  // From now on, by a factor of options().light.
  void SetLight(double factor) { light_ = factor; }
  void Unplug();
  void PlugIn();

  const V4l2ModelOptions& options() const { return options_; }
  std::int64_t ControlNow(std::uint32_t id) const;
  // Control writes in their order, groups as one entry.
  std::vector<std::vector<std::uint32_t>> writes() const;
  // What a sample of the frame's values would be: 0 to 1 before clipping.
  double Brightness(double seconds, double gain, int x, int y) const;

  // The device's side; `session` tells handles apart and ends with the plug.
  struct Session {
    std::uint64_t plugging = 0;
    std::vector<std::vector<std::byte>> buffers;  // mapped memory outlives the plug
  };
  int Open(const std::string& path, Session& session);
  void Close(Session& session);
  int Ioctl(Session& session, unsigned long request, void* argument);
  std::byte* Map(Session& session, std::size_t length, std::int64_t offset);
  int WaitForFrame(Session& session, Nanoseconds timeout);
  bool plugged_in() const;

 private:
  struct Setting {
    std::uint32_t from = 0;  // sequence
    double seconds = 0.0;
    double gain = 1.0;
  };
  // All with mutex_.
  bool IsGone(const Session& session) const {
    return !plugged_in_ || session.plugging != plugging_;
  }
  void PowerUp();
  void Advance(Session& session);
  void Fill(std::vector<std::byte>& buffer, const Setting& setting) const;
  std::size_t FrameBytes() const;
  int QueryControl(v4l2_query_ext_ctrl& query) const;
  int SetControls(v4l2_ext_controls& group);
  int GetControls(v4l2_ext_controls& group) const;
  int SetFormat(v4l2_format& format, bool set);
  int Buffers(Session& session, unsigned long request, void* argument);
  Setting SettingNow() const;
  double IntervalSeconds() const;

  const V4l2ModelOptions options_;
  const Clock& clock_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  Faults faults_;
  bool plugged_in_ = true;
  std::uint64_t plugging_ = 1;
  int latency_ = 1;
  std::atomic<double> light_ = 1.0;
  std::map<std::uint32_t, v4l2_query_ext_ctrl> controls_;
  std::map<std::uint32_t, std::int64_t> values_;
  std::vector<std::vector<std::uint32_t>> writes_;
  std::deque<Setting> settings_;
  std::uint32_t fourcc_ = 0;
  bool streaming_ = false;
  std::uint32_t sequence_ = 0;  // of the next frame
  HostTime next_;               // its end
  std::deque<std::uint32_t> queued_;
  std::deque<v4l2_buffer> filled_;
};

// A kernel with these cameras, each with a node of metadata behind it.
std::unique_ptr<v4l2::V4l2System> MakeEmulatedV4l2(
    std::vector<std::shared_ptr<V4l2CameraModel>> cameras);

}  // namespace omnihdr::emulators
