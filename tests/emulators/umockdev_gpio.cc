#include "tests/emulators/umockdev_gpio.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/gpio.h>
#include <sys/ioctl.h>
#include <umockdev.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <mutex>

#include "core/base/file.h"

namespace omnihdr::emulators {
namespace {

constexpr const char* kLine = "trigger-in";
constexpr std::size_t kKernelKeeps = 16;
// The program's number of the descriptor: above whatever it opens before.
constexpr int kInherited = 400;

void PutText(char* to, std::size_t room, const char* from) {
  std::memset(to, 0, room);
  std::memcpy(to, from, std::min(std::strlen(from), room - 1));
}

}  // namespace

struct UmockdevGpio::Impl {
  explicit Impl(UMockdevTestbed* testbed) : handler(umockdev_ioctl_base_new()) {
    std::array<int, 2> ends{};
    if (::pipe2(ends.data(), 0) != 0 || ::dup2(ends[0], kInherited) != kInherited) {
      Stop("pipe");
    }
    ::close(ends[0]);
    edges = Fd(ends[1]);
    inherited = Fd(kInherited);
    ::fcntl(edges.get(), F_SETFD, FD_CLOEXEC);
    ::fcntl(edges.get(), F_SETFL, O_NONBLOCK);
    GError* error = nullptr;
    umockdev_testbed_add_from_string(testbed,
                                     "P: /devices/platform/emulated/gpiochip0\nN: gpiochip0\n"
                                     "E: DEVNAME=/dev/gpiochip0\nE: SUBSYSTEM=gpio\nE: MAJOR=254\n"
                                     "E: MINOR=0\nA: dev=254:0\\n\n",
                                     &error);
    if (error != nullptr) Stop(error->message);
    g_signal_connect(handler, "handle-ioctl", G_CALLBACK(&Impl::OnIoctl), this);
    umockdev_testbed_attach_ioctl(testbed, "/dev/gpiochip0", handler, &error);
    if (error != nullptr) Stop(error->message);
  }
  ~Impl() { g_object_unref(handler); }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  [[noreturn]] static void Stop(const char* what) {
    fmt::print(stderr, "emulated GPIO chip: {}\n", what);
    std::abort();
  }

  static gboolean OnIoctl(UMockdevIoctlBase*, UMockdevIoctlClient* client, gpointer self) {
    static_cast<Impl*>(self)->Handle(client);
    return TRUE;
  }

  template <typename T, typename Change>
  static void Exchange(UMockdevIoctlClient* client, const Change& change) {
    UMockdevIoctlData* arg =
        umockdev_ioctl_data_resolve(umockdev_ioctl_client_get_arg(client), 0, sizeof(T), nullptr);
    T value{};
    std::memcpy(&value, arg->data, sizeof value);
    const int error = change(value);
    std::array<guint8, sizeof(T)> bytes{};
    std::memcpy(bytes.data(), &value, sizeof value);
    umockdev_ioctl_data_update(arg, 0, bytes.data(), sizeof value);
    umockdev_ioctl_client_complete(client, error == 0 ? 0 : -1, error);
    g_object_unref(arg);
  }

  template <typename Event>
  bool Write(const Event& event) const {
    int waiting = 0;
    if (::ioctl(inherited.get(), FIONREAD, &waiting) != 0) return false;
    if (static_cast<std::size_t>(waiting) >= kKernelKeeps * sizeof event) return false;
    return ::write(edges.get(), &event, sizeof event) == sizeof event;
  }

  int Take(int* fd) {
    if (taken) return EBUSY;
    taken = true;
    *fd = kInherited;
    return 0;
  }

  void Handle(UMockdevIoctlClient* client) {
    std::lock_guard lock(mutex);
    switch (umockdev_ioctl_client_get_request(client)) {
      case GPIO_GET_CHIPINFO_IOCTL:
        return Exchange<gpiochip_info>(client, [](gpiochip_info& info) {
          PutText(info.name, sizeof info.name, "gpiochip0");
          PutText(info.label, sizeof info.label, "emulated");
          info.lines = 1;
          return 0;
        });
      case GPIO_GET_LINEINFO_IOCTL:
        return Exchange<gpioline_info>(client, [](gpioline_info& info) {
          if (info.line_offset != 0) return EINVAL;
          PutText(info.name, sizeof info.name, kLine);
          return 0;
        });
      case GPIO_V2_GET_LINEINFO_IOCTL:
        return Exchange<gpio_v2_line_info>(client, [](gpio_v2_line_info& info) {
          if (info.offset != 0) return EINVAL;
          PutText(info.name, sizeof info.name, kLine);
          return 0;
        });
      case GPIO_GET_LINEEVENT_IOCTL:
        return Exchange<gpioevent_request>(
            client, [this](gpioevent_request& request) { return Take(&request.fd); });
      case GPIO_V2_GET_LINE_IOCTL:
        return Exchange<gpio_v2_line_request>(client, [this](gpio_v2_line_request& request) {
          second_interface = true;
          return Take(&request.fd);
        });
      default:
        umockdev_ioctl_client_complete(client, -1, ENOTTY);
    }
  }

  UMockdevIoctlBase* handler;
  Fd edges;
  Fd inherited;
  std::mutex mutex;
  bool taken = false;
  bool second_interface = false;
  std::uint32_t number = 0;
};

UmockdevGpio::UmockdevGpio(void* testbed)
    : impl_(std::make_unique<Impl>(static_cast<UMockdevTestbed*>(testbed))) {}
UmockdevGpio::~UmockdevGpio() = default;

bool UmockdevGpio::Edge() {
  std::lock_guard lock(impl_->mutex);
  const auto now = static_cast<std::uint64_t>(SystemClock().Now().ns());
  ++impl_->number;
  if (impl_->second_interface) {
    gpio_v2_line_event event{};
    event.timestamp_ns = now;
    event.id = GPIO_V2_LINE_EVENT_RISING_EDGE;
    event.seqno = impl_->number;
    event.line_seqno = impl_->number;
    return impl_->Write(event);
  }
  gpioevent_data event{};
  event.timestamp = now;
  event.id = GPIOEVENT_EVENT_RISING_EDGE;
  return impl_->Write(event);
}

}  // namespace omnihdr::emulators
