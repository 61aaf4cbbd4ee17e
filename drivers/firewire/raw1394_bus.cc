// The one file that knows libraw1394.

#include <fmt/format.h>
#include <libraw1394/csr.h>
#include <libraw1394/raw1394.h>
#include <netinet/in.h>
#include <poll.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <map>
#include <optional>
#include <utility>

#include "drivers/firewire/firewire.h"

namespace omnihdr::firewire {
namespace {

constexpr int kMaxPorts = 16;
constexpr int kMaxNodes = 63;
constexpr nodeid_t kLocalBus = 0xFFC0;
constexpr std::uint64_t kRomGuid = CSR_REGISTER_BASE + CSR_CONFIG_ROM + 0x0C;
constexpr Nanoseconds kRomTimeout = std::chrono::milliseconds(200);
constexpr int kMaxEvents = 1000;  // handled at once
// What stays outstanding after its deadline; more than that, and the node counts as dead.
constexpr std::size_t kMaxOutstanding = 64;

struct CloseHandle {
  void operator()(raw1394handle_t handle) const { raw1394_destroy_handle(handle); }
};
using Handle = std::unique_ptr<std::remove_pointer_t<raw1394handle_t>, CloseHandle>;

Result<Handle> OpenPort(int port) {
  Handle handle(raw1394_new_handle_on_port(port));
  if (!handle) {
    return FailErrno(
        errno == EACCES || errno == EPERM ? ErrorKind::kPermission : ErrorKind::kUnavailable,
        fmt::format("FireWire port {}", port), errno);
  }
  return handle;
}

// Of a transaction: a negative errno of the kernel's, or the acknowledgement and response codes.
Answer Meaning(raw1394_errcode_t code) {
  if (raw1394_internal_err(code)) {
    switch (-raw1394_get_internal(code)) {
      case 0:
        return Answer::kComplete;
      case EAGAIN:
      case EBUSY:
        return Answer::kBusy;
      case ESTALE:
        return Answer::kReset;
      case ETIMEDOUT:
        return Answer::kNoAnswer;
      case ENODEV:
        return Answer::kGone;
      default:
        return Answer::kFailed;
    }
  }
  constexpr int kAckBusyX = 0x4;
  constexpr int kAckBusyB = 0x6;
  const int ack = raw1394_get_ack(code);
  if (ack >= kAckBusyX && ack <= kAckBusyB) return Answer::kBusy;
  switch (raw1394_get_rcode(code)) {
    case RAW1394_RCODE_COMPLETE:
      return Answer::kComplete;
    case RAW1394_RCODE_CONFLICT_ERROR:
      return Answer::kConflict;
    case RAW1394_RCODE_TYPE_ERROR:
    case RAW1394_RCODE_ADDRESS_ERROR:
      return Answer::kRefused;
    default:
      return Answer::kFailed;
  }
}

// A handle for transactions with deadlines: requests are started, and their ends come as events.
// What is late ends into memory of its own.
class Transactions {
 public:
  static Result<std::unique_ptr<Transactions>> Open(int port) {
    OMNIHDR_ASSIGN(Handle handle, OpenPort(port));
    return std::unique_ptr<Transactions>(new Transactions(std::move(handle)));
  }

  raw1394handle_t raw() const { return handle_.get(); }
  bool was_reset() const { return was_reset_; }
  void ForgetReset() { was_reset_ = false; }

  Answer Read(nodeid_t node, std::uint64_t address, std::span<std::uint32_t> quadlets,
              Nanoseconds timeout) {
    return Run(
        quadlets.size(), timeout,
        [&](Request& request, unsigned long tag) {
          return raw1394_start_read(raw(), node, address, 4 * request.data.size(),
                                    request.data.data(), tag);
        },
        quadlets);
  }
  Answer Write(nodeid_t node, std::uint64_t address, std::uint32_t value, Nanoseconds timeout) {
    return Run(1, timeout,
               [&](Request& request, unsigned long tag) {
                 request.data[0] = htonl(value);
                 return raw1394_start_write(raw(), node, address, 4, request.data.data(), tag);
               },
               {});
  }

  // Handles what has come; waits up to `timeout` for the first. false: the handle is broken.
  bool Iterate(Nanoseconds timeout) {
    pollfd watched{raw1394_get_fd(raw()), POLLIN, 0};
    auto ms = static_cast<int>(std::clamp<std::int64_t>(timeout.count() / 1'000'000, 0, 60'000));
    for (int i = 0; i < kMaxEvents; ++i) {
      const int ready = ::poll(&watched, 1, ms);
      if (ready < 0) return errno == EINTR;
      if (ready == 0) return true;
      if (raw1394_loop_iterate(raw()) < 0 && errno != EAGAIN && errno != EINTR) return false;
      ms = 0;
    }
    return true;
  }

 private:
  struct Request {
    std::vector<quadlet_t> data;  // as on the bus
    std::optional<raw1394_errcode_t> code;
  };

  explicit Transactions(Handle handle) : handle_(std::move(handle)) {
    raw1394_set_userdata(raw(), this);
    raw1394_set_tag_handler(raw(), &Transactions::OnTag);
    raw1394_set_bus_reset_handler(raw(), &Transactions::OnReset);
  }

  static int OnTag(raw1394handle_t handle, unsigned long tag, raw1394_errcode_t code) {
    auto& self = *static_cast<Transactions*>(raw1394_get_userdata(handle));
    const auto found = self.requests_.find(tag);
    if (found != self.requests_.end()) found->second.code = code;
    return 0;
  }
  static int OnReset(raw1394handle_t handle, unsigned int generation) {
    auto& self = *static_cast<Transactions*>(raw1394_get_userdata(handle));
    raw1394_update_generation(handle, generation);
    self.was_reset_ = true;
    return 0;
  }

  template <typename StartIt>
  Answer Run(std::size_t quadlets, Nanoseconds timeout, StartIt start,
             std::span<std::uint32_t> result) {
    std::erase_if(requests_, [](const auto& each) { return each.second.code.has_value(); });
    if (requests_.size() >= kMaxOutstanding) return Answer::kFailed;
    // A reset that nobody has looked at: node numbers may be others.
    if (!Iterate(Nanoseconds(0))) return Answer::kFailed;
    if (was_reset_) return Answer::kReset;
    const unsigned long tag = ++last_tag_;
    Request& request = requests_[tag];
    request.data.resize(quadlets);
    const HostTime deadline = clock_.Now() + timeout;
    if (start(request, tag) < 0) {
      const int error = errno;
      requests_.erase(tag);
      return Meaning(-error);
    }
    while (!request.code) {
      const Nanoseconds left = deadline - clock_.Now();
      if (left <= Nanoseconds(0)) return Answer::kNoAnswer;
      if (!Iterate(std::min<Nanoseconds>(left, std::chrono::milliseconds(20))))
        return Answer::kFailed;
    }
    const Answer answer = Meaning(*request.code);
    for (std::size_t i = 0; i < result.size(); ++i) result[i] = ntohl(request.data[i]);
    requests_.erase(tag);
    return answer;
  }

  const SystemClock clock_;
  // What outstanding requests write into: lives longer than the handle.
  std::map<unsigned long, Request> requests_;
  unsigned long last_tag_ = 0;
  bool was_reset_ = false;
  Handle handle_;
};

Result<std::uint64_t> ReadGuid(Transactions& transactions, nodeid_t node) {
  std::array<std::uint32_t, 2> guid{};
  for (std::size_t i = 0; i < guid.size(); ++i) {
    const Answer answer =
        transactions.Read(node, kRomGuid + 4 * i, std::span(guid).subspan(i, 1), kRomTimeout);
    if (answer != Answer::kComplete) {
      return Fail(ErrorKind::kTemporary, "configuration ROM: {}", ToString(answer));
    }
  }
  return std::uint64_t{guid[0]} << 32 | guid[1];
}

// The other nodes of a port with their GUIDs; what does not answer is left out.
std::map<std::uint64_t, nodeid_t> NodesOf(Transactions& transactions) {
  std::map<std::uint64_t, nodeid_t> nodes;
  const int count = std::min(raw1394_get_nodecount(transactions.raw()), kMaxNodes);
  const nodeid_t own = raw1394_get_local_id(transactions.raw());
  for (int i = 0; i < count; ++i) {
    const auto node = static_cast<nodeid_t>(kLocalBus | i);
    if (node == own) continue;
    if (const Result<std::uint64_t> guid = ReadGuid(transactions, node)) nodes[*guid] = node;
  }
  return nodes;
}

class Raw1394Node final : public Node {
 public:
  Raw1394Node(NodeInfo info, std::unique_ptr<Transactions> transactions)
      : info_(info), transactions_(std::move(transactions)) {}
  ~Raw1394Node() override { StopReceive(); }
  Raw1394Node(const Raw1394Node&) = delete;
  Raw1394Node& operator=(const Raw1394Node&) = delete;

  NodeInfo info() const override { return info_; }
  Answer Read(std::uint64_t address, std::span<std::uint32_t> quadlets,
              Nanoseconds timeout) override {
    return transactions_->Read(node_, address, quadlets, timeout);
  }
  Answer Write(std::uint64_t address, std::uint32_t value, Nanoseconds timeout) override {
    return transactions_->Write(node_, address, value, timeout);
  }
  bool WasReset() override {
    transactions_->Iterate(Nanoseconds(0));
    return transactions_->was_reset();
  }
  Answer Refresh(Nanoseconds timeout) override {
    const HostTime deadline = clock_.Now() + timeout;
    // Nodes answer late after a reset, and it may be followed by another one.
    while (true) {
      transactions_->ForgetReset();
      const std::map<std::uint64_t, nodeid_t> nodes = NodesOf(*transactions_);
      const auto found = nodes.find(info_.guid);
      if (found != nodes.end() && !transactions_->was_reset()) {
        node_ = found->second;
        return Answer::kComplete;
      }
      if (clock_.Now() >= deadline) return Answer::kGone;
      if (!transactions_->Iterate(std::chrono::milliseconds(20))) return Answer::kGone;
    }
  }
  int speed() const override {
    const int speed = raw1394_get_speed(transactions_->raw(), node_);
    return std::clamp(speed, 0, 5);
  }

  Status AllocateChannel(int channel) override {
    if (raw1394_channel_modify(transactions_->raw(), static_cast<unsigned>(channel),
                               RAW1394_MODIFY_ALLOC) == 0) {
      return {};
    }
    return FailErrno(ErrorKind::kUnavailable, fmt::format("isochronous channel {}", channel),
                     errno);
  }
  Status AllocateBandwidth(int units) override {
    if (raw1394_bandwidth_modify(transactions_->raw(), static_cast<unsigned>(units),
                                 RAW1394_MODIFY_ALLOC) == 0) {
      return {};
    }
    return FailErrno(ErrorKind::kUnavailable, fmt::format("isochronous bandwidth {}", units),
                     errno);
  }
  void ReleaseChannel(int channel) override {
    raw1394_channel_modify(transactions_->raw(), static_cast<unsigned>(channel),
                           RAW1394_MODIFY_FREE);
  }
  void ReleaseBandwidth(int units) override {
    raw1394_bandwidth_modify(transactions_->raw(), static_cast<unsigned>(units),
                             RAW1394_MODIFY_FREE);
  }

  Status StartReceive(const IsoOptions& options) override {
    StopReceive();
    OMNIHDR_ASSIGN(Handle handle, OpenPort(info_.port));
    raw1394_set_userdata(handle.get(), this);
    raw1394_set_bus_reset_handler(handle.get(), &Raw1394Node::OnIsoReset);
    // An interrupt eight times a buffer, and at least every 16 packets (2 ms).
    const int interval = static_cast<int>(std::clamp<std::size_t>(options.packets / 8, 1, 16));
    if (raw1394_iso_recv_init(handle.get(), &Raw1394Node::OnPacket,
                              static_cast<unsigned>(options.packets),
                              static_cast<unsigned>(options.packet_bytes),
                              static_cast<unsigned char>(options.channel),
                              RAW1394_DMA_PACKET_PER_BUFFER, interval) < 0) {
      return FailErrno(ErrorKind::kIo, "isochronous reception", errno);
    }
    if (raw1394_iso_recv_start(handle.get(), -1, -1, -1) < 0) {
      const int error = errno;
      raw1394_iso_shutdown(handle.get());
      return FailErrno(ErrorKind::kIo, "start isochronous reception", error);
    }
    iso_ = std::move(handle);
    return {};
  }
  Result<IsoBatch> Receive(Nanoseconds timeout) override {
    if (!iso_) return Fail(ErrorKind::kUnavailable, "isochronous reception: not started");
    batch_ = {};
    pollfd watched{raw1394_get_fd(iso_.get()), POLLIN, 0};
    const auto ms =
        static_cast<int>(std::clamp<std::int64_t>(timeout.count() / 1'000'000, 0, 60'000));
    const int ready = ::poll(&watched, 1, ms);
    if (ready < 0 && errno != EINTR) {
      return FailErrno(ErrorKind::kIo, "isochronous reception", errno);
    }
    if (ready <= 0) return Fail(ErrorKind::kTemporary, "no packet within {} ms", ms);
    // One event: as many packets as an interrupt stands for.
    if (raw1394_loop_iterate(iso_.get()) < 0 && errno != EAGAIN && errno != EINTR) {
      return FailErrno(errno == ENODEV ? ErrorKind::kUnavailable : ErrorKind::kIo,
                       "isochronous reception", errno);
    }
    batch_.arrived = clock_.Now();
    return std::exchange(batch_, {});
  }
  void StopReceive() override {
    if (!iso_) return;
    raw1394_iso_stop(iso_.get());
    raw1394_iso_shutdown(iso_.get());
    iso_.reset();
  }

 private:
  static int OnIsoReset(raw1394handle_t handle, unsigned int generation) {
    raw1394_update_generation(handle, generation);
    return 0;
  }
  static raw1394_iso_disposition OnPacket(raw1394handle_t handle, unsigned char* data,
                                          unsigned int length, unsigned char /*channel*/,
                                          unsigned char /*tag*/, unsigned char sy,
                                          unsigned int cycle, unsigned int dropped) {
    auto& self = *static_cast<Raw1394Node*>(raw1394_get_userdata(handle));
    IsoPacket packet;
    packet.begin = self.batch_.bytes.size();
    packet.length = length;
    packet.sync = sy == 1;
    packet.cycle = cycle;
    packet.dropped = dropped;
    const auto* bytes = reinterpret_cast<const std::byte*>(data);
    self.batch_.bytes.insert(self.batch_.bytes.end(), bytes, bytes + length);
    self.batch_.packets.push_back(packet);
    return RAW1394_ISO_OK;
  }

  const SystemClock clock_;
  const NodeInfo info_;
  std::unique_ptr<Transactions> transactions_;
  nodeid_t node_ = 0;
  Handle iso_;
  IsoBatch batch_;
};

class Raw1394Bus final : public Bus {
 public:
  Result<std::vector<NodeInfo>> List() override {
    Handle handle(raw1394_new_handle());
    if (!handle) return FailErrno(ErrorKind::kUnavailable, "FireWire", errno);
    std::array<raw1394_portinfo, kMaxPorts> ports{};
    const int count = raw1394_get_port_info(handle.get(), ports.data(), kMaxPorts);
    if (count < 0) return FailErrno(ErrorKind::kUnavailable, "FireWire ports", errno);
    if (count == 0) return Fail(ErrorKind::kUnavailable, "no FireWire controller");
    std::vector<NodeInfo> found;
    for (int port = 0; port < std::min(count, kMaxPorts); ++port) {
      OMNIHDR_ASSIGN(const auto transactions, Transactions::Open(port));
      for (const auto& [guid, node] : NodesOf(*transactions)) found.push_back({port, guid});
    }
    return found;
  }
  Result<std::unique_ptr<Node>> Open(const NodeInfo& info) override {
    OMNIHDR_ASSIGN(auto transactions, Transactions::Open(info.port));
    auto node = std::make_unique<Raw1394Node>(info, std::move(transactions));
    if (node->Refresh(kRomTimeout) != Answer::kComplete) {
      return Fail(ErrorKind::kUnavailable, "FireWire port {}: {:016x} is not there", info.port,
                  info.guid);
    }
    return std::unique_ptr<Node>(std::move(node));
  }
};

}  // namespace

std::unique_ptr<Bus> MakeSystemBus() { return std::make_unique<Raw1394Bus>(); }

}  // namespace omnihdr::firewire
