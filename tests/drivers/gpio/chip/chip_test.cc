#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/gpio.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <umockdev.h>
#include <unistd.h>

#include <array>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "drivers/gpio/camera_trigger.h"
#include "drivers/gpio/lines.h"
#include "tests/support/eventually.h"

namespace omnihdr::chip_test {
namespace {

using namespace omnihdr::gpio;  // NOLINT(google-build-using-namespace)
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr unsigned kLines = 4;
constexpr std::array<const char*, kLines> kNames = {"trigger-in", "wheel-in", "lamp-out", ""};

void CopyText(char* to, std::size_t room, const char* from) {
  std::memset(to, 0, room);
  std::memcpy(to, from, std::min(std::strlen(from), room - 1));
}

// A chip "gpiochip0" labelled "emulated" with four lines, answering both of the kernel's interfaces
// as the kernel does. A line that is requested is a pipe: edges are written into it as the kernel's
// event structures; what is set is kept.
class EmulatedChip {
 public:
  EmulatedChip() : testbed_(umockdev_testbed_new()), handler_(umockdev_ioctl_base_new()) {
    GError* error = nullptr;
    const char* description =
        "P: /devices/platform/emulated/gpiochip0\n"
        "N: gpiochip0\n"
        "E: DEVNAME=/dev/gpiochip0\n"
        "E: SUBSYSTEM=gpio\n"
        "E: MAJOR=254\n"
        "E: MINOR=0\n"
        "A: dev=254:0\\n\n";
    if (umockdev_testbed_add_from_string(testbed_, description, &error) == 0) {
      ADD_FAILURE() << error->message;
      return;
    }
    g_signal_connect_data(handler_, "handle-ioctl",
                          reinterpret_cast<GCallback>(&EmulatedChip::OnIoctl), this, nullptr,
                          GConnectFlags{});
    if (umockdev_testbed_attach_ioctl(testbed_, "/dev/gpiochip0", handler_, &error) == 0) {
      ADD_FAILURE() << error->message;
    }
    // What an output line's request gives: a descriptor that the emulation answers, opened before,
    // for the handler cannot wait for itself.
    if (umockdev_testbed_add_from_string(testbed_,
                                         "P: /devices/platform/emulated/gpioline0\n"
                                         "N: gpioline0\n"
                                         "E: DEVNAME=/dev/gpioline0\n"
                                         "E: SUBSYSTEM=gpio\n"
                                         "E: MAJOR=254\n"
                                         "E: MINOR=1\n"
                                         "A: dev=254:1\\n\n",
                                         &error) == 0 ||
        umockdev_testbed_attach_ioctl(testbed_, "/dev/gpioline0", handler_, &error) == 0) {
      ADD_FAILURE() << error->message;
      return;
    }
    output_ = open("/dev/gpioline0", O_RDWR | O_CLOEXEC);
    if (output_ < 0) ADD_FAILURE() << "open /dev/gpioline0";
  }
  ~EmulatedChip() {
    g_object_unref(handler_);
    g_object_unref(testbed_);
  }
  EmulatedChip(const EmulatedChip&) = delete;
  EmulatedChip& operator=(const EmulatedChip&) = delete;

  // An edge as the kernel reports it; `number` is that of the second interface.
  void Edge(unsigned line, std::int64_t monotonic_ns, bool rising, std::uint32_t number) {
    std::lock_guard lock(mutex_);
    if (second_interface_) {
      gpio_v2_line_event event{};
      event.timestamp_ns = static_cast<std::uint64_t>(monotonic_ns);
      event.id = rising ? GPIO_V2_LINE_EVENT_RISING_EDGE : GPIO_V2_LINE_EVENT_FALLING_EDGE;
      event.offset = line;
      event.seqno = number;
      event.line_seqno = number;
      ASSERT_EQ(write(lines_[line].get(), &event, sizeof event),
                static_cast<ssize_t>(sizeof event));
      return;
    }
    gpioevent_data event{};
    event.timestamp = static_cast<std::uint64_t>(monotonic_ns);
    event.id = rising ? GPIOEVENT_EVENT_RISING_EDGE : GPIOEVENT_EVENT_FALLING_EDGE;
    ASSERT_EQ(write(lines_[line].get(), &event, sizeof event), static_cast<ssize_t>(sizeof event));
  }
  bool second_interface() const { return second_interface_; }
  std::uint64_t flags(unsigned line) {
    std::lock_guard lock(mutex_);
    return flags_[line];
  }
  // Every value that was set at an output line, as the voltage is without active low.
  std::vector<bool> values() {
    std::lock_guard lock(mutex_);
    return values_;
  }
  std::uint32_t debounce_us = 0;
  bool refuse_busy = false;

 private:
  static gboolean OnIoctl(UMockdevIoctlBase* /*base*/, UMockdevIoctlClient* client, gpointer self) {
    return static_cast<EmulatedChip*>(self)->Handle(client) ? TRUE : FALSE;
  }

  template <typename T, typename Change>
  static bool Exchange(UMockdevIoctlClient* client, const Change& change) {
    UMockdevIoctlData* arg =
        umockdev_ioctl_data_resolve(umockdev_ioctl_client_get_arg(client), 0, sizeof(T), nullptr);
    if (arg == nullptr) return false;
    T value{};
    std::memcpy(&value, arg->data, sizeof value);
    const int error = change(value);
    std::array<guint8, sizeof(T)> bytes{};
    std::memcpy(bytes.data(), &value, sizeof value);
    umockdev_ioctl_data_update(arg, 0, bytes.data(), sizeof value);
    umockdev_ioctl_client_complete(client, error == 0 ? 0 : -1, error);
    g_object_unref(arg);
    return true;
  }

  // A pipe for a line: the reading end is what the request gives.
  int Connect(unsigned line) {
    std::array<int, 2> ends{};
    if (pipe2(ends.data(), O_CLOEXEC) != 0) return -1;
    lines_[line] = Fd(ends[1]);
    return ends[0];
  }

  bool Handle(UMockdevIoctlClient* client) {
    std::lock_guard lock(mutex_);
    switch (umockdev_ioctl_client_get_request(client)) {
      case GPIO_GET_CHIPINFO_IOCTL:
        return Exchange<gpiochip_info>(client, [](gpiochip_info& info) {
          CopyText(info.name, sizeof info.name, "gpiochip0");
          CopyText(info.label, sizeof info.label, "emulated");
          info.lines = kLines;
          return 0;
        });
      case GPIO_GET_LINEINFO_IOCTL:
        return Exchange<gpioline_info>(client, [](gpioline_info& info) {
          if (info.line_offset >= kLines) return EINVAL;
          CopyText(info.name, sizeof info.name, kNames[info.line_offset]);
          return 0;
        });
      case GPIO_V2_GET_LINEINFO_IOCTL:
        return Exchange<gpio_v2_line_info>(client, [](gpio_v2_line_info& info) {
          if (info.offset >= kLines) return EINVAL;
          CopyText(info.name, sizeof info.name, kNames[info.offset]);
          return 0;
        });
      case GPIO_GET_LINEEVENT_IOCTL:
        return Exchange<gpioevent_request>(client, [this](gpioevent_request& request) {
          if (refuse_busy) return EBUSY;
          flags_[request.lineoffset] = request.eventflags | request.handleflags << 8;
          request.fd = Connect(request.lineoffset);
          return 0;
        });
      case GPIO_GET_LINEHANDLE_IOCTL:
        return Exchange<gpiohandle_request>(client, [this](gpiohandle_request& request) {
          if (refuse_busy) return EBUSY;
          flags_[request.lineoffsets[0]] = request.flags;
          request.fd = std::exchange(output_, -1);
          return request.fd < 0 ? EBUSY : 0;
        });
      case GPIOHANDLE_SET_LINE_VALUES_IOCTL:
        return Exchange<gpiohandle_data>(client, [this](gpiohandle_data& data) {
          values_.push_back(data.values[0] != 0);
          return 0;
        });
      case GPIO_V2_LINE_SET_VALUES_IOCTL:
        return Exchange<gpio_v2_line_values>(client, [this](gpio_v2_line_values& data) {
          values_.push_back((data.bits & 1U) != 0);
          return 0;
        });
      case GPIO_V2_GET_LINE_IOCTL:
        return Exchange<gpio_v2_line_request>(client, [this](gpio_v2_line_request& request) {
          if (refuse_busy) return EBUSY;
          second_interface_ = true;
          flags_[request.offsets[0]] = request.config.flags;
          for (unsigned i = 0; i < request.config.num_attrs; ++i) {
            const gpio_v2_line_attribute& attribute = request.config.attrs[i].attr;
            if (attribute.id == GPIO_V2_LINE_ATTR_ID_DEBOUNCE) {
              debounce_us = attribute.debounce_period_us;
            }
            if (attribute.id == GPIO_V2_LINE_ATTR_ID_FLAGS) {
              flags_[request.offsets[0]] = attribute.flags;
            }
          }
          const bool output = (flags_[request.offsets[0]] & GPIO_V2_LINE_FLAG_OUTPUT) != 0;
          request.fd = output ? std::exchange(output_, -1) : Connect(request.offsets[0]);
          return request.fd < 0 ? EBUSY : 0;
        });
      default:
        umockdev_ioctl_client_complete(client, -1, ENOTTY);
        return true;
    }
  }

  UMockdevTestbed* testbed_;
  UMockdevIoctlBase* handler_;
  std::mutex mutex_;
  std::map<unsigned, Fd> lines_;
  std::map<unsigned, std::uint64_t> flags_;
  bool second_interface_ = false;
  int output_ = -1;
  std::vector<bool> values_;
};

class GpioChip : public ::testing::Test {
 protected:
  EmulatedChip chip;
  const std::unique_ptr<Lines> lines = MakeLines();
  const SystemClock clock{};
};

TEST_F(GpioChip, ALineIsFoundByLabelOrNameOrPathAndByItsNameOrOffset) {
  for (const char* chip_name : {"emulated", "gpiochip0", "/dev/gpiochip0"}) {
    for (const char* line : {"trigger-in", "0", "3"}) {
      EdgeRequest request;
      request.name = {chip_name, line};
      const auto edges = lines->RequestEdges(request);
      EXPECT_TRUE(edges) << request.name.Text() << ": " << edges.error().message;
    }
  }
}

TEST_F(GpioChip, AChipOrLineThatIsNotThereIsNamed) {
  const auto problem = [&](const LineName& name) {
    EdgeRequest request;
    request.name = name;
    const auto edges = lines->RequestEdges(request);
    EXPECT_FALSE(edges);
    if (edges) return std::string();
    EXPECT_EQ(edges.error().kind, ErrorKind::kUnavailable) << edges.error().message;
    return edges.error().message;
  };
  EXPECT_THAT(problem({"another", "trigger-in"}), HasSubstr("GPIO chip another"));
  EXPECT_THAT(problem({"emulated", "button"}), HasSubstr("GPIO emulated line button"));
  EXPECT_THAT(problem({"emulated", "4"}), HasSubstr("the chip has lines 0 to 3"));
  chip.refuse_busy = true;
  EXPECT_THAT(problem({"emulated", "0"}), HasSubstr("in use by another program"));
}

TEST_F(GpioChip, EdgesComeWithTheKernelsTimeInOrder) {
  EdgeRequest request;
  request.name = {"emulated", "trigger-in"};
  request.edge = Edge::kBoth;
  request.bias = Bias::kPullUp;
  request.debounce = std::chrono::milliseconds(5);
  auto edges = lines->RequestEdges(request);
  ASSERT_TRUE(edges) << edges.error().message;
  pollfd ready{(*edges)->fd(), POLLIN, 0};
  EXPECT_EQ(poll(&ready, 1, 0), 0);
  const std::int64_t now = clock.Now().ns();
  chip.Edge(0, now - 2'000'000, true, 1);
  chip.Edge(0, now - 1'000'000, false, 2);
  ASSERT_EQ(poll(&ready, 1, 5000), 1);
  std::array<EdgeEvent, kMostEvents> events;
  const auto got = (*edges)->Read(events);
  ASSERT_TRUE(got) << got.error().message;
  ASSERT_EQ(*got, 2U);
  EXPECT_EQ(events[0].time.ns(), now - 2'000'000);
  EXPECT_TRUE(events[0].rising);
  EXPECT_EQ(events[1].time.ns(), now - 1'000'000);
  EXPECT_FALSE(events[1].rising);
  EXPECT_EQ(events[1].lost_before, 0U);
  EXPECT_EQ((*edges)->debounced(), chip.second_interface());
  if (chip.second_interface()) {
    EXPECT_EQ(chip.debounce_us, 5000U);
    EXPECT_EQ(chip.flags(0), GPIO_V2_LINE_FLAG_INPUT | GPIO_V2_LINE_FLAG_EDGE_RISING |
                                 GPIO_V2_LINE_FLAG_EDGE_FALLING | GPIO_V2_LINE_FLAG_BIAS_PULL_UP);
  } else {
    EXPECT_EQ(chip.flags(0) & 0xFF, static_cast<unsigned>(GPIOEVENT_REQUEST_BOTH_EDGES));
    EXPECT_NE(chip.flags(0) >> 8 & GPIOHANDLE_REQUEST_BIAS_PULL_UP, 0U);
  }
}

TEST_F(GpioChip, StampsOfKernelsThatUseTheWallClockAreBroughtToTheMonotonicOne) {
  EdgeRequest request;
  request.name = {"emulated", "trigger-in"};
  auto edges = lines->RequestEdges(request);
  ASSERT_TRUE(edges) << edges.error().message;
  if (chip.second_interface()) GTEST_SKIP() << "the second interface asks for the monotonic clock";
  const std::int64_t before = clock.Now().ns();
  chip.Edge(0, clock.NowUtc().ns(), true, 1);
  std::array<EdgeEvent, kMostEvents> events;
  ASSERT_TRUE((*edges)->Read(events));
  EXPECT_NEAR(static_cast<double>(events[0].time.ns() - before) * 1e-9, 0.0, 0.5);
}

TEST_F(GpioChip, WhatTheKernelLostIsToldAsFarAsItTells) {
  EdgeRequest request;
  request.name = {"emulated", "wheel-in"};
  auto edges = lines->RequestEdges(request);
  ASSERT_TRUE(edges) << edges.error().message;
  const std::int64_t now = clock.Now().ns();
  for (std::uint32_t i = 0; i < 16; ++i) chip.Edge(1, now + i, true, i + 1);
  chip.Edge(1, now + 100, true, 25);
  std::array<EdgeEvent, kMostEvents> events;
  std::size_t count = 0;
  while (count < 17) {
    const auto got = (*edges)->Read(std::span(events).subspan(count));
    ASSERT_TRUE(got) << got.error().message;
    count += *got;
  }
  if (chip.second_interface()) {
    EXPECT_EQ(events[16].lost_before, 8U);
    EXPECT_FALSE(events[15].buffer_was_full);
  } else {
    EXPECT_TRUE(events[15].buffer_was_full);
    EXPECT_FALSE(events[14].buffer_was_full);
    EXPECT_FALSE(events[16].buffer_was_full);
  }
}

TEST_F(GpioChip, AnOutputLineIsRequestedAsSuch) {
  auto output = lines->RequestOutput({{"emulated", "lamp-out"}, true});
  ASSERT_TRUE(output) << output.error().message;
  if (chip.second_interface()) {
    EXPECT_EQ(chip.flags(2), GPIO_V2_LINE_FLAG_OUTPUT | GPIO_V2_LINE_FLAG_ACTIVE_LOW);
  } else {
    EXPECT_EQ(chip.flags(2),
              static_cast<unsigned>(GPIOHANDLE_REQUEST_OUTPUT | GPIOHANDLE_REQUEST_ACTIVE_LOW));
  }
  for (const bool active : {true, false, true}) {
    const Status set = (*output)->Set(active);
    EXPECT_TRUE(set) << set.error().message;
  }
  EXPECT_THAT(chip.values(), ElementsAre(true, false, true));
}

TEST_F(GpioChip, APulseThatReleasesACameraIsSetAndTakenBackAtTheKernelsInterface) {
  CameraTriggerOptions options;
  options.name = {"emulated", "lamp-out"};
  options.pulse_s = 0.002;
  options.spacing_s = 0.01;
  CameraTrigger trigger(options, MakeLines(), clock);
  ASSERT_TRUE(trigger.Start());
  ASSERT_TRUE(testing::Eventually([&] { return trigger.report().up; })) << trigger.report().problem;
  for (int i = 0; i < 2; ++i) {
    const auto moment = trigger.Release(std::chrono::seconds(5));
    ASSERT_TRUE(moment) << moment.error().message;
  }
  ASSERT_TRUE(testing::Eventually([&] { return chip.values().size() == 4; }));
  EXPECT_THAT(chip.values(), ElementsAre(true, false, true, false));
}

}  // namespace
}  // namespace omnihdr::chip_test
