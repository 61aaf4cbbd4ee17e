#include "drivers/v4l2/kernel_call.h"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include "drivers/recording/call_bytes.h"

namespace omnihdr::v4l2 {
namespace {

using recording::CallReader;
using recording::CallWriter;

constexpr std::size_t kMaxNodes = 256;
constexpr std::size_t kMaxNames = 64;
constexpr std::int32_t kMostErrno = 4095;                // the kernel's own bound
constexpr std::int64_t kLatest = std::int64_t{1} << 61;  // nanoseconds of a machine's running
constexpr std::size_t kMaxControlBytes = 64 * sizeof(v4l2_ext_control);

struct Named {
  std::uint32_t request;
  const char* name;
};
constexpr Named kNames[] = {
    {VIDIOC_QUERYCAP, "VIDIOC_QUERYCAP"},
    {VIDIOC_ENUM_FMT, "VIDIOC_ENUM_FMT"},
    {VIDIOC_G_FMT, "VIDIOC_G_FMT"},
    {VIDIOC_S_FMT, "VIDIOC_S_FMT"},
    {VIDIOC_G_PARM, "VIDIOC_G_PARM"},
    {VIDIOC_S_PARM, "VIDIOC_S_PARM"},
    {VIDIOC_QUERY_EXT_CTRL, "VIDIOC_QUERY_EXT_CTRL"},
    {VIDIOC_QUERYMENU, "VIDIOC_QUERYMENU"},
    {VIDIOC_G_EXT_CTRLS, "VIDIOC_G_EXT_CTRLS"},
    {VIDIOC_S_EXT_CTRLS, "VIDIOC_S_EXT_CTRLS"},
    {VIDIOC_REQBUFS, "VIDIOC_REQBUFS"},
    {VIDIOC_QUERYBUF, "VIDIOC_QUERYBUF"},
    {VIDIOC_QBUF, "VIDIOC_QBUF"},
    {VIDIOC_DQBUF, "VIDIOC_DQBUF"},
    {VIDIOC_STREAMON, "VIDIOC_STREAMON"},
    {VIDIOC_STREAMOFF, "VIDIOC_STREAMOFF"},
};

template <typename T>
T As(std::span<const std::byte> bytes) {
  T value{};
  std::memcpy(&value, bytes.data(), std::min(bytes.size(), sizeof value));
  return value;
}

std::string Details(const KernelCall& call) {
  switch (call.request) {
    case VIDIOC_S_FMT: {
      const auto format = As<v4l2_format>(call.argument).fmt.pix;
      return fmt::format(" {} {} x {}", FourCcName(format.pixelformat), format.width,
                         format.height);
    }
    case VIDIOC_S_PARM: {
      const v4l2_fract interval = As<v4l2_streamparm>(call.argument).parm.capture.timeperframe;
      return fmt::format(" {}/{} s", interval.numerator, interval.denominator);
    }
    case VIDIOC_QUERY_EXT_CTRL:
      return fmt::format(" {:#010x}", As<v4l2_query_ext_ctrl>(call.argument).id);
    case VIDIOC_QUERYMENU: {
      const auto menu = As<v4l2_querymenu>(call.argument);
      const std::uint32_t id = menu.id;
      const std::uint32_t index = menu.index;
      return fmt::format(" {:#010x} {}", id, index);
    }
    case VIDIOC_REQBUFS:
      return fmt::format(" {}", As<v4l2_requestbuffers>(call.argument).count);
    case VIDIOC_QUERYBUF:
    case VIDIOC_QBUF:
      return fmt::format(" {}", As<v4l2_buffer>(call.argument).index);
    case VIDIOC_G_EXT_CTRLS:
    case VIDIOC_S_EXT_CTRLS: {
      std::string text;
      for (std::size_t at = 0; at + sizeof(v4l2_ext_control) <= call.controls.size();
           at += sizeof(v4l2_ext_control)) {
        const auto control = As<v4l2_ext_control>(std::span(call.controls).subspan(at));
        const std::uint32_t id = control.id;
        const std::int32_t value = control.value;
        text += fmt::format(" {:#010x}", id);
        if (call.request == VIDIOC_S_EXT_CTRLS) text += fmt::format("={}", value);
      }
      return text;
    }
    default:
      return {};
  }
}

void Put(CallWriter& out, HostTime time) { out.Put(static_cast<std::uint64_t>(time.ns()), 8); }

HostTime ReadTime(CallReader& in) {
  const auto ns = static_cast<std::int64_t>(in.Number(8));
  if (ns < 0 || ns > kLatest) in.Refuse();
  return HostTime::FromNanoseconds(in.ok() ? ns : 0);
}

void Put(CallWriter& out, double value) { out.Put(std::bit_cast<std::uint64_t>(value), 8); }

void Put(CallWriter& out, const std::vector<V4l2Node>& nodes) {
  out.Put(nodes.size(), 2);
  for (const V4l2Node& node : nodes) {
    out.Put(std::string_view(node.path));
    out.Put(std::string_view(node.serial));
    out.Put(node.names.size(), 2);
    for (const std::string& name : node.names) out.Put(std::string_view(name));
  }
}

std::vector<V4l2Node> ReadNodes(CallReader& in) {
  std::vector<V4l2Node> nodes;
  const std::uint64_t count = in.Number(2);
  if (count > kMaxNodes) in.Refuse();
  for (std::uint64_t i = 0; in.ok() && i < count; ++i) {
    V4l2Node node;
    node.path = in.Text();
    node.serial = in.Text();
    const std::uint64_t names = in.Number(2);
    if (names > kMaxNames) in.Refuse();
    for (std::uint64_t n = 0; in.ok() && n < names; ++n) node.names.push_back(in.Text());
    nodes.push_back(std::move(node));
  }
  return nodes;
}

bool FitsItsRequest(const KernelCall& call) {
  const std::size_t bytes = _IOC_SIZE(call.request);
  return call.argument.size() == bytes && call.argument_after.size() == bytes &&
         call.controls.size() == call.controls_after.size() &&
         call.controls.size() % sizeof(v4l2_ext_control) == 0 &&
         call.controls.size() <= kMaxControlBytes &&
         (call.controls.empty() || HasControls(call.request));
}

}  // namespace

bool HasControls(std::uint32_t request) {
  return request == VIDIOC_S_EXT_CTRLS || request == VIDIOC_G_EXT_CTRLS;
}

std::string KernelCall::Request() const {
  switch (kind) {
    case Kind::kList:
      return "list the devices";
    case Kind::kOpen:
      return fmt::format("open {}", path);
    case Kind::kIoctl: {
      for (const Named& each : kNames) {
        if (each.request == request) return each.name + Details(*this);
      }
      return fmt::format("ioctl {:#010x}", request);
    }
    case Kind::kMap:
      return fmt::format("map {} bytes at {}", length, offset);
    case Kind::kWait:
      return "wait for a frame";
    case Kind::kTrigger:
      return fmt::format("trigger with {:.6g} s, {:.4g} dB", exposure.time.seconds(),
                         exposure.gain.value);
    case Kind::kPrepare:
      return fmt::format("prepare {:.6g} s, {:.4g} dB", exposure.time.seconds(),
                         exposure.gain.value);
  }
  return "?";
}

bool KernelCall::AsksTheSame(const KernelCall& other) const {
  return kind == other.kind && device == other.device && path == other.path &&
         request == other.request && argument == other.argument && controls == other.controls &&
         length == other.length && offset == other.offset && exposure == other.exposure;
}

std::vector<std::byte> EncodeCall(const KernelCall& call) {
  using Kind = KernelCall::Kind;
  CallWriter out;
  out.Put(static_cast<std::uint64_t>(call.kind), 1);
  out.Put(call.device, 4);
  Put(out, call.at);
  out.Put(static_cast<std::uint32_t>(call.result), 4);
  switch (call.kind) {
    case Kind::kList:
      Put(out, call.nodes);
      break;
    case Kind::kOpen:
      out.Put(std::string_view(call.path));
      break;
    case Kind::kIoctl:
      out.Put(call.request, 4);
      out.Put(call.argument);
      out.Put(call.argument_after);
      out.Put(call.controls);
      out.Put(call.controls_after);
      out.Put(call.frame);
      break;
    case Kind::kMap:
      out.Put(call.length, 8);
      out.Put(static_cast<std::uint64_t>(call.offset), 8);
      break;
    case Kind::kWait:
      break;
    case Kind::kTrigger:
    case Kind::kPrepare:
      Put(out, call.exposure.time.seconds());
      Put(out, call.exposure.gain.value);
      Put(out, call.trigger_time);
      break;
  }
  return std::move(out).Take();
}

std::optional<KernelCall> DecodeCall(std::span<const std::byte> bytes) {
  using Kind = KernelCall::Kind;
  CallReader in(bytes);
  KernelCall call;
  const std::uint64_t kind = in.Number(1);
  if (kind < 1 || kind > static_cast<std::uint64_t>(Kind::kPrepare)) return std::nullopt;
  call.kind = static_cast<Kind>(kind);
  call.device = static_cast<std::uint32_t>(in.Number(4));
  call.at = ReadTime(in);
  call.result = static_cast<std::int32_t>(static_cast<std::uint32_t>(in.Number(4)));
  switch (call.kind) {
    case Kind::kList:
      call.nodes = ReadNodes(in);
      break;
    case Kind::kOpen:
      call.path = in.Text();
      break;
    case Kind::kIoctl:
      call.request = static_cast<std::uint32_t>(in.Number(4));
      call.argument = in.Bytes();
      call.argument_after = in.Bytes();
      call.controls = in.Bytes();
      call.controls_after = in.Bytes();
      call.frame = in.Bytes();
      if (!FitsItsRequest(call)) return std::nullopt;
      break;
    case Kind::kMap:
      call.length = in.Number(8);
      call.offset = static_cast<std::int64_t>(in.Number(8));
      break;
    case Kind::kWait:
      break;
    case Kind::kTrigger:
    case Kind::kPrepare:
      call.exposure.time = ExposureTime::Seconds(std::bit_cast<double>(in.Number(8)));
      call.exposure.gain = GainDb{std::bit_cast<double>(in.Number(8))};
      call.trigger_time = ReadTime(in);
      break;
  }
  if (!in.ok() || !in.at_end() || call.result < -kMostErrno) return std::nullopt;
  return call;
}

}  // namespace omnihdr::v4l2
