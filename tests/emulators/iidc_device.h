#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <span>
#include <vector>

#include "core/base/clock.h"
#include "core/sphere/rig.h"
#include "tests/emulators/device_answer.h"
#include "tests/emulators/iidc_cycle.h"

namespace omnihdr::emulators {

struct IidcDeviceOptions {
  std::uint64_t guid = 0x00B09D0100C0FFEE;
  std::uint32_t serial = 12648430;
  int max_width = 64;
  int max_height = 288;  // six sensors of 48 rows
  int rows_per_sensor = 48;
  BayerOrder bayer = BayerOrder::kBggr;
  double shortest_s = 1e-5;
  double longest_s = 4.0;
  int exposure_latency = 0;  // pictures until a new shutter or gain is in force
  double readout_s = 0.003;
  std::uint32_t first_counter = 100;
  std::uint32_t first_cycle_s = 126;  // the cycle time wraps at 128 s
  std::size_t link_packet_bytes = 512;
  bool embedded_info = true;
  bool handshake_never_ends = false;
  bool coarse_words = false;    // sixteen shutter settings share a value of register and frame
  bool low_byte_first = false;  // in the codings of 16 bits
  bool keeps_gamma = false;     // a gamma that cannot be switched off by writing
  bool exposure_cycle = false;  // HDR_CONTROL, 0x1800
  CycleStart cycle_start = CycleStart::kContinues;
  bool series = true;  // trigger mode 15
  // Code values by which pixels differ from the smooth scene, the same in every picture: what makes
  // a file of them as long as a real one's.
  int grain = 0;
  // What a pixel of the whole sensor shows, as a code value at one second; empty = a smooth scene
  // of the device's own.
  std::function<double(int x, int y)> scene = {};
};

// A device model of an IIDC camera, free of any transport: registers, configuration ROM, Format7,
// features, software trigger (mode 15 with its series, too), the exposure cycle, embedded frame
// information, and Bayer pictures of a simple scene
// whose brightness follows shutter and gain. Adapters carry its registers and its stream over USB
// or in process. Time is the clock's. Thread-safe.
class IidcDevice {
 public:
  using Answer = DeviceAnswer;

  explicit IidcDevice(const IidcDeviceOptions& options, const Clock& clock);

  Answer Read(std::uint64_t address, std::span<std::uint32_t> quadlets);
  Answer Write(std::uint64_t address, std::uint32_t value);

  // Moves what is ready into `buffer`.
  using Moved = DeviceMoved;
  Moved ReadStream(std::span<std::byte> buffer);
  // Whether ReadStream would move anything, or has anything to tell.
  bool StreamIsReady();

  // Faults; the counts are of the next pictures or requests.
  struct Faults {
    int lose_frames = 0;   // taken and counted, never sent
    int short_frames = 0;  // ends early, with a short packet, after short_bytes
    std::size_t short_bytes = 700;
    int wrong_exposures = 0;  // taken and labelled with twice the shutter
    int late_frames = 0;      // sent late_s later
    double late_s = 0.0;
    int stall_registers = 0;
    int stall_after = -1;  // refuses one request, after this many have been answered
    int nak_registers = 0;
    int stall_stream = 0;
    int damaged_headers = 0;  // of compressed frames
    int unmarked_losses = 0;  // loses bytes in the middle, no short packet there
    int skipped_steps = 0;    // of the exposure cycle, before the next picture
    // Babble: sends two pictures more that nobody asked for, and bytes that are no picture.
    int babbling_frames = 0;
  };
  void Set(const Faults& faults);
  // A pulse on the camera's input 0: it exposes when its trigger is set to that.
  void Pulse();
  void Unplug();
  // Comes back as after power-up.
  void PlugIn();
  bool plugged_in() const;

  // Value of a scene point before the shutter: code value at one second and 0 dB.
  double RadianceAt(int x, int y) const;
  std::uint8_t PixelAt(int x, int y, double exposure_s, double gain_db) const;
  // In the codings of 16 bits: 12 bits, at the top.
  std::uint16_t DeepPixelAt(int x, int y, double exposure_s, double gain_db) const;
  const IidcDeviceOptions& options() const { return options_; }
  std::uint32_t Register(std::uint32_t offset) const;  // as it is, by offset from the command base
  int triggers_refused() const;                        // while the sensor was busy
  bool stall_pending() const;                          // Faults::stall_after has not come yet
  std::uint64_t requests() const;                      // of registers, answered or not
  // When the exposures began, the first 100,000 of them.
  std::vector<HostTime> trigger_times() const;

  // Shutter and gain as the value registers hold them.
  static double ShutterSeconds(std::uint32_t raw);
  static std::uint32_t ShutterRaw(double seconds);
  static double GainDecibels(std::uint32_t raw);
  static std::uint32_t GainRaw(double decibels);

  static constexpr std::uint64_t kBase = 0xFFFF'F0F0'0000;

 private:
  struct Sending {
    std::vector<std::byte> bytes;
    std::size_t sent = 0;
    HostTime ready;
  };
  struct Setting {
    std::uint32_t shutter = 0;
    std::uint32_t gain = 0;
  };

  // All with mutex_.
  void PowerUp();
  void ResetFeatures();
  std::uint8_t Value(int x, int y, double exposure) const;
  std::uint16_t DeepValue(int x, int y, double exposure) const;
  bool IsDeep();
  std::optional<Answer> Refuses();
  std::optional<std::uint32_t> ReadOne(std::uint64_t address) const;
  bool WriteOne(std::uint64_t address, std::uint32_t value);
  void WriteFeature(std::uint32_t offset, std::uint32_t value);
  void Trigger(std::uint32_t source);
  bool CycleIsOn() const;
  bool IsBusy(HostTime now) const;
  void TakeWhatIsDue();
  void Expose(HostTime start);
  void AbortSeries();
  std::uint32_t ShutterWord(std::uint32_t raw) const;
  std::vector<std::byte> TakePicture(const Setting& setting, HostTime start);
  std::uint32_t& Format7(std::uint32_t offset);  // of the mode selected
  std::vector<std::byte> Pixels(const Setting& setting);
  std::vector<std::byte> Compressed(double seconds, double decibels,
                                    std::span<const std::uint32_t> words);
  void UpdateTotals();

  const IidcDeviceOptions options_;
  const Clock& clock_;
  mutable std::mutex mutex_;
  std::vector<std::uint32_t> rom_;
  std::map<std::uint32_t, std::uint32_t> registers_;                         // by offset from kBase
  std::map<std::uint32_t, std::map<std::uint32_t, std::uint32_t>> format7_;  // by mode
  std::deque<Setting> settings_;  // the newest at the back
  std::deque<Sending> sending_;
  Faults faults_;
  bool plugged_in_ = true;
  HostTime power_up_;
  HostTime busy_until_;
  IidcCycle cycle_;
  std::uint32_t series_left_ = 0;  // pictures of a series that are still to be taken
  bool endless_series_ = false;
  std::uint32_t counter_ = 0;
  int triggers_refused_ = 0;
  std::uint64_t requests_ = 0;
  std::vector<HostTime> trigger_times_;
  // Pictures without their words, by what they depend on: a scene that stands still.
  std::map<std::array<std::uint32_t, 5>, std::vector<std::byte>> pictures_;
};

}  // namespace omnihdr::emulators
