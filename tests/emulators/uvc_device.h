#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/clock.h"
#include "core/image/image.h"
#include "tests/emulators/device_answer.h"

namespace omnihdr::emulators {

struct UvcDeviceOptions {
  std::string serial = "UVC-0001";
  int width = 64;
  int height = 48;
  double interval_s = 0.05;  // between frames; twice as much is offered, too
  // From the frame that is being exposed when a setting comes to the first one it acts on; 1 = the
  // next one.
  int latency_frames = 2;
  std::uint32_t shortest_units = 1;  // of 100 µs
  std::uint32_t longest_units = 10'000;
  std::uint32_t unity_gain = 16;
  // The camera makes multiples of this of an exposure, rounded down, and tells so.
  std::uint32_t coarse_units = 1;
  // Says of its controls that they may change by themselves, so that a host does not take what it
  // wrote for what there is.
  bool controls_autoupdate = true;
};

// A device model of a camera of USB's video class (UVC 1.1), free of any transport: the class's
// requests to its camera terminal, processing unit and stream, and a stream of payloads with frames
// of a scene at the exposure, gain and white balance in force. It runs freely, from commit to
// StopStream, in the clock's time. Frames nobody fetches are not made. Thread-safe.
class UvcDevice {
 public:
  // Numbers of the interfaces, of the units of interface kControl, and of the formats.
  static constexpr std::uint8_t kControlInterface = 0;
  static constexpr std::uint8_t kStreamInterface = 1;
  static constexpr std::uint8_t kCameraTerminal = 1;
  static constexpr std::uint8_t kProcessingUnit = 2;
  static constexpr std::uint8_t kOutputTerminal = 3;
  static constexpr std::uint8_t kGrey = 1;
  static constexpr std::uint8_t kYuyv = 2;
  static constexpr std::size_t kPayloadBytes = 16384;  // the largest, with its header
  static constexpr std::uint32_t kClockHz = 1'000'000;
  // Selectors of the class.
  enum CameraControl : std::uint8_t { kAutoMode = 2, kAutoPriority = 3, kExposure = 4 };
  enum ProcessingControl : std::uint8_t {
    kBacklight = 1,
    kGain = 4,
    kPowerLine = 5,
    kTemperature = 0x0A,
    kAutoTemperature = 0x0B,
  };

  UvcDevice(UvcDeviceOptions options, const Clock& clock);

  // A class-specific request: SET_CUR takes `data`, GET_... puts its answer there.
  struct Request {
    std::uint8_t code = 0;
    std::uint8_t selector = 0;
    std::uint8_t entity = 0;  // 0 = the interface itself
    std::uint8_t interface = 0;
  };
  DeviceAnswer Handle(const Request& request, std::vector<std::uint8_t>& data);
  // One payload, when there is one. The buffer should hold kPayloadBytes.
  DeviceMoved ReadStream(std::span<std::byte> buffer);
  void StopStream();

  // Faults; the counts are of the next frames or requests.
  struct Faults {
    int swallowed = 0;              // made and never sent
    int torn = 0;                   // end after half of their bytes
    int marked = 0;                 // say of themselves that they are damaged
    int unended = 0;                // lack the mark of their end
    int overlong = 0;               // have bytes beyond their end
    int stall_stream = 0;           // reads of the stream that are refused
    int stall_controls = 0;         // requests to a control that are refused
    bool silent = false;            // no frames at all
    bool ignores_exposure = false;  // takes every exposure and keeps the one it has
  };
  void Set(const Faults& faults);
  void SetLatency(int frames);
  // What it sees: linear RGB of its own width and height, or nothing = a ramp. 1.0 gives the value
  // 128 at 1 s and unity gain.
  void SetScene(Image<float> radiance);
  void Unplug();
  void PlugIn();
  bool plugged_in() const;

  // The value of a grey frame's pixel.
  std::uint8_t PixelAt(int x, int y, double seconds, double gain = 1.0) const;
  const UvcDeviceOptions& options() const { return options_; }
  // As it is: what was written last, or how the camera changed it.
  std::uint32_t ControlNow(std::uint8_t entity, std::uint8_t selector) const;
  // Controls written so far, as (entity, selector), since it was plugged in.
  std::vector<std::pair<std::uint8_t, std::uint8_t>> writes() const;
  bool streaming() const;

 private:
  using Key = std::pair<std::uint8_t, std::uint8_t>;
  struct Control {
    std::size_t bytes = 1;
    std::uint32_t least = 0;
    std::uint32_t most = 1;
    std::uint32_t step = 1;
    std::uint32_t initial = 0;
    std::uint32_t now = 0;
  };
  struct Setting {
    std::uint64_t from = 0;  // number of the first frame
    double seconds = 0.0;
    double gain = 1.0;
    double kelvin = 0.0;
    bool operator==(const Setting& other) const {
      return seconds == other.seconds && gain == other.gain && kelvin == other.kelvin;
    }
  };
  struct Sending {
    std::vector<std::byte> bytes;
    std::size_t sent = 0;
    bool odd = false;  // its frame identifier
    bool damaged = false;
    bool ended = true;
    std::uint32_t began = 0;  // device clock
  };
  // What a probe and a commit hold.
  struct Commit {
    std::uint8_t format = kGrey;
    std::uint32_t interval = 0;  // 100 ns
  };

  // All with mutex_.
  void PowerUp();
  DeviceAnswer Fail(std::uint8_t error);
  DeviceAnswer HandleStream(const Request& request, std::vector<std::uint8_t>& data);
  DeviceAnswer HandleControl(const Request& request, std::vector<std::uint8_t>& data);
  DeviceAnswer Write(const Key& key, Control& control, std::uint32_t value);
  std::uint32_t Value(std::uint8_t entity, std::uint8_t selector) const;
  Setting SettingNow() const;
  std::uint64_t FrameBeingExposed(HostTime now) const;
  void Advance(HostTime now);
  void Make(const Setting& setting);
  void Render(const Setting& setting);
  double Share(int x, int y, int channel, double effective_seconds) const;
  std::size_t FrameBytes() const;
  Nanoseconds Interval() const;
  std::uint32_t DeviceClock(HostTime at) const;

  const UvcDeviceOptions options_;
  const Clock& clock_;
  mutable std::mutex mutex_;
  Image<float> scene_;
  Faults faults_;
  int latency_ = 1;
  bool plugged_in_ = true;
  HostTime power_up_;
  std::map<Key, Control> controls_;
  std::vector<Key> writes_;
  std::uint8_t last_error_ = 0;
  Commit probe_;
  Commit commit_;
  bool streaming_ = false;
  HostTime begin_;           // of frame 0's exposure
  std::uint64_t frame_ = 0;  // the next one to be made
  bool odd_ = false;         // the identifier of the next one
  std::deque<Setting> settings_;
  std::deque<Sending> sending_;
  std::optional<Setting> rendered_setting_;
  std::vector<std::byte> rendered_;
};

}  // namespace omnihdr::emulators
