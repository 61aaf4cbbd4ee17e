#include "tests/emulators/umockdev_usb.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/usbdevice_fs.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <umockdev.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>

#include "core/base/file.h"
#include "tests/emulators/iidc_usb_function.h"

namespace omnihdr::emulators {
namespace {

using Answer = IidcDevice::Answer;

constexpr std::size_t kSetupBytes = 8;
constexpr const char* kSysPath = "/sys/devices/pci0000:00/0000:00:14.0/usb1/1-2";

// A reference to one of umockdev's objects.
template <typename T>
class Ref {
 public:
  explicit Ref(T* object = nullptr) : object_(object) {}
  Ref(Ref&& other) noexcept : object_(std::exchange(other.object_, nullptr)) {}
  Ref& operator=(Ref&& other) noexcept {
    std::swap(object_, other.object_);
    return *this;
  }
  ~Ref() {
    if (object_ != nullptr) g_object_unref(object_);
  }
  Ref(const Ref&) = delete;
  Ref& operator=(const Ref&) = delete;
  T* get() const { return object_; }

 private:
  T* object_;
};
using Data = Ref<UMockdevIoctlData>;

struct Urb {
  Data data;    // usbdevfs_urb
  Data buffer;  // what it points at
  unsigned long address = 0;
  unsigned char type = 0;
  std::size_t filled = 0;
  bool done = false;
  usbdevfs_urb* get() const { return reinterpret_cast<usbdevfs_urb*>(data.get()->data); }
};

// Makes poll() on a device's node wait as usbfs does: ready for writing while a transfer has ended
// and has not been reaped. umockdev's nodes are plain files, always ready, on which libusb's event
// thread would spin and take a processor. The node becomes a pipe of one page instead, full while
// nothing is ready. Not thread-safe.
class PollableNode {
 public:
  PollableNode() = default;
  explicit PollableNode(const std::string& path) {
    ::unlink(path.c_str());
    if (::mkfifo(path.c_str(), 0666) != 0) return;
    pipe_ = Fd(::open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
    if (::fcntl(pipe_.get(), F_SETPIPE_SZ, 4096) < 0) std::abort();
    SetReady(false);
  }

  void SetReady(bool ready) {
    if (ready == ready_ || !pipe_.valid()) return;
    char byte = 0;
    const ssize_t moved = ready ? ::read(pipe_.get(), &byte, 1) : ::write(pipe_.get(), &byte, 1);
    if (moved == 1) ready_ = ready;
  }

 private:
  Fd pipe_;
  bool ready_ = true;
};

}  // namespace

struct UmockdevUsb::Impl {
  explicit Impl(std::shared_ptr<IidcDevice> device_in)
      : device(std::move(device_in)), testbed(umockdev_testbed_new()) {
    Add();
  }
  ~Impl() { Remove(); }

  void Add() {
    std::string hex;
    for (const std::uint8_t byte : IidcUsbFunction::Descriptors())
      hex += fmt::format("{:02X}", byte);
    node = fmt::format("/dev/bus/usb/001/{:03}", number);
    const std::string description = fmt::format(
        "P: /devices/pci0000:00/0000:00:14.0/usb1/1-2\nN: bus/usb/001/{0:03}\n"
        "E: DEVNAME={1}\nE: DEVTYPE=usb_device\nE: SUBSYSTEM=usb\nE: BUSNUM=001\n"
        "E: DEVNUM={0:03}\nA: busnum=1\\n\nA: devnum={0}\\n\nA: bConfigurationValue=1\\n\n"
        "A: idVendor=1e10\\n\nA: idProduct=2004\\n\nA: speed=480\\n\nH: descriptors={2}\n",
        number, node, hex);
    GError* error = nullptr;
    umockdev_testbed_add_from_string(testbed.get(), description.c_str(), &error);
    Check(error, "add the device");
    handler = Ref<UMockdevIoctlBase>(umockdev_ioctl_base_new());
    g_signal_connect(handler.get(), "handle-ioctl", G_CALLBACK(&Impl::OnIoctl), this);
    umockdev_testbed_attach_ioctl(testbed.get(), node.c_str(), handler.get(), &error);
    Check(error, "attach the ioctl handler");
    present = true;
    const std::lock_guard lock(mutex);
    const std::unique_ptr<gchar, decltype(&g_free)> root(
        umockdev_testbed_get_root_dir(testbed.get()), &g_free);
    pollable = PollableNode(root.get() + node);
  }

  void Remove() {
    if (!present) return;
    present = false;
    umockdev_testbed_uevent(testbed.get(), kSysPath, "remove");
    umockdev_testbed_remove_device(testbed.get(), kSysPath);
    ++number;
  }

  static void Check(GError* error, const char* what) {
    if (error == nullptr) return;
    fmt::print(stderr, "umockdev: {}: {}\n", what, error->message);
    std::abort();
  }

  static gboolean OnIoctl(UMockdevIoctlBase*, UMockdevIoctlClient* client, gpointer self) {
    static_cast<Impl*>(self)->Handle(client);
    return TRUE;
  }

  void Handle(UMockdevIoctlClient* client) {
    std::lock_guard lock(mutex);
    Respond(client);
    TellPoll();
  }

  void TellPoll() {
    const bool waits = std::any_of(urbs.begin(), urbs.end(), [](const Urb& urb) {
      return urb.type == USBDEVFS_URB_TYPE_BULK && !urb.done;
    });
    pollable.SetReady(
        !device->plugged_in() || (waits && device->StreamIsReady()) ||
        std::any_of(urbs.begin(), urbs.end(), [](const Urb& urb) { return urb.done; }));
  }

  // The device's memory can be filled during one of the client's calls only, so pictures go there
  // when the client reaps; this looks whether it is worth its while.
  void LookForPictures(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      std::this_thread::sleep_for(std::chrono::microseconds(300));
      const std::lock_guard lock(mutex);
      TellPoll();
    }
  }

  void Respond(UMockdevIoctlClient* client) {
    const unsigned long request = umockdev_ioctl_client_get_request(client);
    const Data arg(umockdev_ioctl_client_get_arg(client));
    g_object_ref(arg.get());
    switch (request) {
      case USBDEVFS_SUBMITURB:
        return Submit(client, arg.get());
      case USBDEVFS_REAPURB:
      case USBDEVFS_REAPURBNDELAY:
        return Reap(client, arg.get());
      case USBDEVFS_DISCARDURB:
        return Discard(client, arg.get());
      case USBDEVFS_GET_CAPABILITIES: {
        const Data caps(umockdev_ioctl_data_resolve(arg.get(), 0, sizeof(__u32), nullptr));
        __u32 value = USBDEVFS_CAP_NO_PACKET_SIZE_LIM;
        umockdev_ioctl_data_update(caps.get(), 0, reinterpret_cast<guint8*>(&value), sizeof(value));
        return umockdev_ioctl_client_complete(client, 0, 0);
      }
      case USBDEVFS_CLEAR_HALT:
      case USBDEVFS_CLAIMINTERFACE:
      case USBDEVFS_RELEASEINTERFACE:
      case USBDEVFS_SETCONFIGURATION:
      case USBDEVFS_SETINTERFACE:
        if (!device->plugged_in()) return umockdev_ioctl_client_complete(client, -1, ENODEV);
        return umockdev_ioctl_client_complete(client, 0, 0);
      case USBDEVFS_GETDRIVER:
        return umockdev_ioctl_client_complete(client, -1, ENODATA);
      default:
        return umockdev_ioctl_client_complete(client, -1, ENOTTY);
    }
  }

  void Submit(UMockdevIoctlClient* client, UMockdevIoctlData* arg) {
    if (!device->plugged_in()) return umockdev_ioctl_client_complete(client, -1, ENODEV);
    Urb urb;
    urb.data = Data(umockdev_ioctl_data_resolve(arg, 0, sizeof(usbdevfs_urb), nullptr));
    const usbdevfs_urb* raw = urb.get();
    urb.address = urb.data.get()->client_addr;
    urb.type = raw->type;
    urb.buffer =
        Data(umockdev_ioctl_data_resolve(urb.data.get(), offsetof(usbdevfs_urb, buffer),
                                         static_cast<std::size_t>(raw->buffer_length), nullptr));
    if (urb.buffer.get() == nullptr) return umockdev_ioctl_client_complete(client, -1, EFAULT);
    if (urb.type == USBDEVFS_URB_TYPE_CONTROL) Control(urb);
    urbs.push_back(std::move(urb));
    umockdev_ioctl_client_complete(client, 0, 0);
  }

  static void Finish(Urb& urb, int status, std::size_t actual) {
    usbdevfs_urb raw = *urb.get();
    raw.status = status;
    raw.actual_length = static_cast<int>(actual);
    umockdev_ioctl_data_update(urb.data.get(), 0, reinterpret_cast<guint8*>(&raw), sizeof(raw));
    urb.done = true;
  }

  static int StatusOf(Answer answer) {
    switch (answer) {
      case Answer::kOk:
        return 0;
      case Answer::kStall:
        return -EPIPE;
      case Answer::kNak:
        return -EINPROGRESS;
      case Answer::kGone:
        break;
    }
    return -ESHUTDOWN;
  }

  // The setup packet lies in front of the data.
  void Control(Urb& urb) {
    const guint8* bytes = urb.buffer.get()->data;
    const auto length = static_cast<std::size_t>(urb.buffer.get()->data_len);
    if (length < kSetupBytes) return Finish(urb, -EPIPE, 0);
    IidcUsbFunction::Setup setup;
    std::copy_n(bytes, kSetupBytes, setup.begin());
    const bool in = (setup[0] & 0x80) != 0;
    std::vector<std::uint8_t> data;
    if (!in) data.assign(bytes + kSetupBytes, bytes + length);
    const Answer answer = function.Control(setup, data);
    if (answer == Answer::kNak) return;  // never answered: the client gives up
    if (answer != Answer::kOk) return Finish(urb, StatusOf(answer), 0);
    if (in) {
      data.resize(std::min(data.size(), length - kSetupBytes));
      umockdev_ioctl_data_update(urb.buffer.get(), kSetupBytes, data.data(),
                                 static_cast<gint>(data.size()));
    }
    Finish(urb, 0, data.size());
  }

  // Gives the oldest bulk transfers what the device has.
  void PumpStream() {
    for (Urb& urb : urbs) {
      if (urb.type != USBDEVFS_URB_TYPE_BULK || urb.done) continue;
      const auto length = static_cast<std::size_t>(urb.buffer.get()->data_len);
      std::vector<std::byte> bytes(length - urb.filled);
      const IidcDevice::Moved moved = device->ReadStream(bytes);
      if (moved.bytes > 0) {
        umockdev_ioctl_data_update(urb.buffer.get(), urb.filled,
                                   reinterpret_cast<guint8*>(bytes.data()),
                                   static_cast<gint>(moved.bytes));
        urb.filled += moved.bytes;
      }
      if (!moved.ended) return;
      Finish(urb, moved.answer == Answer::kNak ? 0 : StatusOf(moved.answer), urb.filled);
    }
  }

  void Reap(UMockdevIoctlClient* client, UMockdevIoctlData* arg) {
    PumpStream();
    if (!device->plugged_in()) {
      for (Urb& urb : urbs) {
        if (!urb.done) Finish(urb, -ESHUTDOWN, urb.filled);
      }
    }
    const auto done =
        std::find_if(urbs.begin(), urbs.end(), [](const Urb& urb) { return urb.done; });
    if (done == urbs.end()) {
      return umockdev_ioctl_client_complete(client, -1, device->plugged_in() ? EAGAIN : ENODEV);
    }
    const Data pointer(umockdev_ioctl_data_resolve(arg, 0, sizeof(void*), nullptr));
    umockdev_ioctl_data_set_ptr(pointer.get(), 0, done->data.get());
    umockdev_ioctl_client_complete(client, 0, 0);
    urbs.erase(done);
  }

  void Discard(UMockdevIoctlClient* client, UMockdevIoctlData* arg) {
    unsigned long address = 0;
    std::memcpy(&address, arg->data, sizeof(address));
    for (Urb& urb : urbs) {
      if (urb.address != address || urb.done) continue;
      Finish(urb, -ENOENT, urb.filled);
      return umockdev_ioctl_client_complete(client, 0, 0);
    }
    umockdev_ioctl_client_complete(client, -1, EINVAL);
  }

  const std::shared_ptr<IidcDevice> device;
  IidcUsbFunction function{device};
  Ref<UMockdevTestbed> testbed;
  Ref<UMockdevIoctlBase> handler;
  std::string node;
  int number = 5;
  bool present = false;
  std::mutex mutex;
  std::deque<Urb> urbs;
  PollableNode pollable;
  std::jthread looker{[this](const std::stop_token& stop) { LookForPictures(stop); }};
};

UmockdevUsb::UmockdevUsb(std::shared_ptr<IidcDevice> device)
    : impl_(std::make_unique<Impl>(std::move(device))) {}
UmockdevUsb::~UmockdevUsb() = default;

void* UmockdevUsb::testbed() const { return impl_->testbed.get(); }

void UmockdevUsb::Unplug() {
  impl_->device->Unplug();
  impl_->Remove();
}

void UmockdevUsb::PlugIn() {
  impl_->device->PlugIn();
  impl_->Add();
}

}  // namespace omnihdr::emulators
