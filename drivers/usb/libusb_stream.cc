#include "drivers/usb/libusb_stream.h"

#include <fmt/format.h>

#include <condition_variable>
#include <deque>
#include <mutex>
#include <thread>
#include <utility>

#include "core/base/realtime.h"
#include "core/base/stage.h"

namespace omnihdr::usb {
namespace {

constexpr Nanoseconds kCancelDeadline = std::chrono::seconds(5);
constexpr auto kAfterError = std::chrono::milliseconds(10);
constexpr int kMaxErrorsInARow = 64;
constexpr int kMaxRevivals = 3;

// What the callbacks touch. It outlives the stream object if a transfer cannot be had back from the
// kernel: memory the kernel may still write to must not be freed.
struct Ring {
  struct Slot {
    Ring* ring = nullptr;
    libusb_transfer* transfer = nullptr;
    std::vector<std::byte> buffer;
    bool in_flight = false;
  };

  Ring(LibusbContext context_in, LibusbHandle handle_in, const BulkStreamOptions& options_in)
      : context(std::move(context_in)), handle(std::move(handle_in)), options(options_in) {}
  ~Ring() {
    for (Slot& slot : slots) libusb_free_transfer(slot.transfer);
  }
  Ring(const Ring&) = delete;
  Ring& operator=(const Ring&) = delete;

  int Submit(Slot& slot) {  // with mutex
    libusb_fill_bulk_transfer(slot.transfer, handle.get(), options.endpoint,
                              reinterpret_cast<unsigned char*>(slot.buffer.data()),
                              static_cast<int>(slot.buffer.size()), &Ring::Completed, &slot, 0);
    const int code = libusb_submit_transfer(slot.transfer);
    if (code == LIBUSB_SUCCESS) {
      slot.in_flight = true;
      ++in_flight;
    }
    return code;
  }

  void Note(int submit_code) {  // with mutex
    if (submit_code == LIBUSB_SUCCESS) return;
    if (submit_code == LIBUSB_ERROR_NO_DEVICE) {
      gone = true;
    } else {
      halted = true;
    }
  }

  static void LIBUSB_CALL Completed(libusb_transfer* transfer) {
    auto* slot = static_cast<Slot*>(transfer->user_data);
    slot->ring->OnCompleted(*slot);
  }

  void OnCompleted(Slot& slot) {
    std::lock_guard lock(mutex);
    slot.in_flight = false;
    --in_flight;
    const libusb_transfer& transfer = *slot.transfer;
    const auto actual = static_cast<std::size_t>(transfer.actual_length);
    bool again = !stopping;
    std::string error;
    switch (transfer.status) {
      case LIBUSB_TRANSFER_COMPLETED:
        errors_in_a_row = 0;
        revivals = 0;
        break;
      case LIBUSB_TRANSFER_CANCELLED:
        again = false;
        break;
      case LIBUSB_TRANSFER_NO_DEVICE:
        gone = true;
        break;
      case LIBUSB_TRANSFER_STALL:
        halted = true;
        error = "the endpoint stalled";
        break;
      case LIBUSB_TRANSFER_OVERFLOW:
        error = "the device sent more than a packet holds";
        break;
      default:
        error = fmt::format("transfer failed (status {})", static_cast<int>(transfer.status));
        if (++errors_in_a_row > kMaxErrorsInARow) halted = true;
    }
    const bool tells = transfer.status != LIBUSB_TRANSFER_CANCELLED || actual > 0;
    if (tells && !gone && !cancelled) Hand(slot, actual, std::move(error));
    if (again && !gone && !halted) Note(Submit(slot));
    changed.notify_all();
  }

  // Passes the slot's bytes to the reader and gives the slot another buffer.
  void Hand(Slot& slot, std::size_t actual, std::string error) {
    last_arrival = clock.Now();
    if (spare.empty()) {
      gap = true;
      return;
    }
    BulkChunk chunk;
    chunk.ended_short = actual < slot.buffer.size();
    chunk.gap = std::exchange(gap, false);
    chunk.error = std::move(error);
    chunk.arrived = last_arrival;
    chunk.bytes = std::exchange(slot.buffer, std::move(spare.back()));
    chunk.bytes.resize(actual);
    spare.pop_back();
    ready.push_back(std::move(chunk));
  }

  const LibusbContext context;
  const LibusbHandle handle;
  const BulkStreamOptions options;
  const SystemClock clock;
  std::mutex mutex;
  std::condition_variable changed;
  std::deque<Slot> slots;
  std::vector<std::vector<std::byte>> spare;
  std::deque<BulkChunk> ready;
  int in_flight = 0;
  int errors_in_a_row = 0;
  int revivals = 0;
  bool stopping = false;   // no transfer is submitted any more
  bool cancelled = false;  // what still comes is thrown away
  bool gone = false;
  bool halted = false;  // transfers run out; the endpoint's halt is to be cleared
  bool gap = false;
  HostTime last_arrival;
};

class LibusbStream final : public BulkStream {
 public:
  explicit LibusbStream(std::unique_ptr<Ring> ring)
      : ring_(std::move(ring)),
        events_("usb-events", [ring = ring_.get()](std::stop_token stop, Stage& stage) {
          const RealtimeThread realtime(RealtimePriority::kTransfers);
          while (!stop.stop_requested()) {
            stage.Progress();
            timeval wait{0, 100'000};
            const int code =
                libusb_handle_events_timeout_completed(ring->context.get(), &wait, nullptr);
            // An error that stays must not take the processor.
            if (code != LIBUSB_SUCCESS) std::this_thread::sleep_for(kAfterError);
          }
          return Status{};
        }) {}
  ~LibusbStream() override {
    Stop(Nanoseconds(0), Nanoseconds(0));
    events_.RequestStop();
    libusb_interrupt_event_handler(ring_->context.get());
    static_cast<void>(events_.Join());  // its body returns no error
    std::lock_guard lock(ring_->mutex);
    if (ring_->in_flight > 0) static_cast<void>(ring_.release());
  }
  LibusbStream(const LibusbStream&) = delete;
  LibusbStream& operator=(const LibusbStream&) = delete;

  Status Start() {
    std::lock_guard lock(ring_->mutex);
    for (Ring::Slot& slot : ring_->slots) {
      if (const int code = ring_->Submit(slot); code != LIBUSB_SUCCESS) {
        return LibusbFailure(code, fmt::format("stream: {} transfers of {} bytes",
                                               ring_->options.transfers, slot.buffer.size()));
      }
    }
    return {};
  }

  Result<BulkChunk> Next(Nanoseconds timeout) override {
    Ring& ring = *ring_;
    std::unique_lock lock(ring.mutex);
    const auto something = [&] {
      return !ring.ready.empty() || ring.gone || ring.stopping ||
             (ring.halted && ring.in_flight == 0);
    };
    ring.changed.wait_for(lock, timeout, something);
    if (!ring.ready.empty()) {
      BulkChunk chunk = std::move(ring.ready.front());
      ring.ready.pop_front();
      return chunk;
    }
    if (ring.gone) return Fail(ErrorKind::kUnavailable, "stream: the device has gone");
    if (ring.stopping) return Fail(ErrorKind::kUnavailable, "stream: stopped");
    if (ring.halted && ring.in_flight == 0) OMNIHDR_TRY(Revive(lock));
    return Fail(ErrorKind::kTemporary, "stream: nothing within {} ms", timeout.count() / 1'000'000);
  }

  void Recycle(BulkChunk chunk) override {
    std::lock_guard lock(ring_->mutex);
    chunk.bytes.resize(ring_->options.transfer_bytes);
    ring_->spare.push_back(std::move(chunk.bytes));
  }

  void Stop(Nanoseconds quiet, Nanoseconds limit) override {
    Ring& ring = *ring_;
    std::unique_lock lock(ring.mutex);
    if (ring.cancelled) return;
    const HostTime began = ring.clock.Now();
    while (!ring.gone && !ring.halted) {
      for (BulkChunk& chunk : ring.ready) {
        chunk.bytes.resize(ring.options.transfer_bytes);
        ring.spare.push_back(std::move(chunk.bytes));
      }
      ring.ready.clear();
      const HostTime now = ring.clock.Now();
      const HostTime since = std::max(began, ring.last_arrival);
      if (now - since >= quiet || now - began >= limit) break;
      ring.changed.wait_for(lock, std::min(quiet - (now - since), limit - (now - began)));
    }
    ring.stopping = true;
    ring.cancelled = true;
    ring.ready.clear();
    for (Ring::Slot& slot : ring.slots) {
      if (slot.in_flight) libusb_cancel_transfer(slot.transfer);
    }
    ring.changed.wait_for(lock, kCancelDeadline, [&] { return ring.in_flight == 0; });
  }

 private:
  // Clears the halt and submits all transfers again.
  Status Revive(std::unique_lock<std::mutex>& lock) {
    Ring& ring = *ring_;
    if (++ring.revivals > kMaxRevivals) {
      return Fail(ErrorKind::kIo, "stream: endpoint {:#04x} failed {} times in a row",
                  ring.options.endpoint, kMaxRevivals);
    }
    lock.unlock();
    const int code = libusb_clear_halt(ring.handle.get(), ring.options.endpoint);
    lock.lock();
    if (code != LIBUSB_SUCCESS) return LibusbFailure(code, "stream: clear the endpoint's halt");
    ring.halted = false;
    ring.errors_in_a_row = 0;
    for (Ring::Slot& slot : ring.slots) {
      if (const int submitted = ring.Submit(slot); submitted != LIBUSB_SUCCESS) {
        ring.Note(submitted);
        return LibusbFailure(submitted, "stream: submit again");
      }
    }
    return {};
  }

  std::unique_ptr<Ring> ring_;
  Stage events_;
};

}  // namespace

Result<std::unique_ptr<BulkStream>> StartLibusbStream(LibusbContext context, LibusbHandle handle,
                                                      const BulkStreamOptions& options) {
  auto ring = std::make_unique<Ring>(std::move(context), std::move(handle), options);
  for (int i = 0; i < options.transfers; ++i) {
    Ring::Slot& slot = ring->slots.emplace_back();
    slot.ring = ring.get();
    slot.buffer.resize(options.transfer_bytes);
    slot.transfer = libusb_alloc_transfer(0);
    if (slot.transfer == nullptr) return Fail(ErrorKind::kSystem, "stream: no memory");
  }
  for (int i = 0; i < options.spare; ++i) {
    ring->spare.emplace_back(options.transfer_bytes);
  }
  auto stream = std::make_unique<LibusbStream>(std::move(ring));
  OMNIHDR_TRY(stream->Start());
  return std::unique_ptr<BulkStream>(std::move(stream));
}

}  // namespace omnihdr::usb
