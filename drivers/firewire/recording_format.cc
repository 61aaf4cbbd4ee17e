#include "drivers/firewire/recording_format.h"

#include <fmt/format.h>

#include <utility>

#include "drivers/recording/call_bytes.h"

namespace omnihdr::firewire {
namespace {

constexpr std::size_t kMostNodes = 1024;
constexpr std::size_t kMostQuadlets = 4096;
constexpr std::size_t kMostPackets = std::size_t{1} << 20;
constexpr std::int32_t kFastest = 15;

void Put(recording::CallWriter& out, const NodeInfo& node) {
  out.Put(static_cast<std::uint32_t>(node.port), 4);
  out.Put(node.guid, 8);
}

NodeInfo ReadNode(recording::CallReader& in) {
  NodeInfo node;
  node.port = static_cast<int>(in.Number(4) & 0x7FFFFFFF);
  node.guid = in.Number(8);
  return node;
}

// The bytes of packets, one after the other: gaps between them are not kept.
void Put(recording::CallWriter& out, const IsoBatch& batch) {
  out.Put(batch.packets.size(), 4);
  std::vector<std::byte> bytes;
  for (const IsoPacket& packet : batch.packets) {
    out.Put(packet.length, 4);
    out.Put(packet.sync ? 1U : 0U, 1);
    out.Put(packet.cycle, 4);
    out.Put(packet.dropped, 4);
    const auto begin = batch.bytes.begin() + static_cast<std::ptrdiff_t>(packet.begin);
    bytes.insert(bytes.end(), begin, begin + static_cast<std::ptrdiff_t>(packet.length));
  }
  out.Put(bytes);
}

IsoBatch ReadBatch(recording::CallReader& in) {
  IsoBatch batch;
  const std::size_t packets = in.Number(4);
  if (packets > kMostPackets) in.Refuse();
  std::size_t begin = 0;
  for (std::size_t i = 0; in.ok() && i < packets; ++i) {
    IsoPacket packet;
    packet.begin = begin;
    packet.length = in.Number(4);
    packet.sync = in.Number(1) != 0;
    packet.cycle = static_cast<std::uint32_t>(in.Number(4));
    packet.dropped = static_cast<std::uint32_t>(in.Number(4));
    begin += packet.length;
    batch.packets.push_back(packet);
  }
  batch.bytes = in.Bytes();
  if (batch.bytes.size() != begin) in.Refuse();
  return batch;
}

}  // namespace

std::string RecordedCall::Request() const {
  switch (kind) {
    case Kind::kList:
      return "list the devices";
    case Kind::kOpen:
      return fmt::format("open {} ({:016x})", node.port, node.guid);
    case Kind::kRead:
      return fmt::format("read {} quadlets at {:#014x}", number, address);
    case Kind::kWrite:
      return fmt::format("write {:#010x} at {:#014x}", number, address);
    case Kind::kRefresh:
      return "find the node again";
    case Kind::kAllocateChannel:
      return fmt::format("allocate channel {}", number);
    case Kind::kAllocateBandwidth:
      return fmt::format("allocate {} units of bandwidth", number);
    case Kind::kReleaseChannel:
      return fmt::format("release channel {}", number);
    case Kind::kReleaseBandwidth:
      return fmt::format("release {} units of bandwidth", number);
    case Kind::kStartReceive:
      return fmt::format("receive channel {} in packets of {} bytes", number, packet_bytes);
    case Kind::kStopReceive:
      return "stop receiving";
    case Kind::kBatch:
      return "wait for packets";
    case Kind::kReset:
      return "a reset of the bus";
  }
  return "?";
}

std::vector<std::byte> EncodeCall(const RecordedCall& call) {
  recording::CallWriter out;
  out.Put(static_cast<std::uint64_t>(call.kind), 1);
  Put(out, call.node);
  out.Put(call.address, 8);
  out.Put(call.number, 4);
  out.Put(call.packet_bytes, 4);
  out.Put(static_cast<std::uint64_t>(call.answer), 1);
  out.Put(call.error);
  out.Put(call.nodes.size(), 4);
  for (const NodeInfo& node : call.nodes) Put(out, node);
  out.Put(call.quadlets.size(), 4);
  for (const std::uint32_t quadlet : call.quadlets) out.Put(quadlet, 4);
  out.Put(static_cast<std::uint32_t>(call.speed), 4);
  Put(out, call.batch);
  return std::move(out).Take();
}

std::optional<RecordedCall> DecodeCall(std::span<const std::byte> bytes) {
  recording::CallReader in(bytes);
  RecordedCall call;
  const std::uint64_t kind = in.Number(1);
  if (kind < 1 || kind > static_cast<std::uint64_t>(RecordedCall::Kind::kReset)) {
    return std::nullopt;
  }
  call.kind = static_cast<RecordedCall::Kind>(kind);
  call.node = ReadNode(in);
  call.address = in.Number(8);
  call.number = static_cast<std::uint32_t>(in.Number(4));
  call.packet_bytes = static_cast<std::uint32_t>(in.Number(4));
  const std::uint64_t answer = in.Number(1);
  if (answer > static_cast<std::uint64_t>(Answer::kFailed)) return std::nullopt;
  call.answer = static_cast<Answer>(answer);
  call.error = in.OptionalError();
  const std::size_t nodes = in.Number(4);
  if (nodes > kMostNodes) return std::nullopt;
  for (std::size_t i = 0; in.ok() && i < nodes; ++i) call.nodes.push_back(ReadNode(in));
  const std::size_t quadlets = in.Number(4);
  if (quadlets > kMostQuadlets) return std::nullopt;
  for (std::size_t i = 0; in.ok() && i < quadlets; ++i) {
    call.quadlets.push_back(static_cast<std::uint32_t>(in.Number(4)));
  }
  call.speed = static_cast<std::int32_t>(in.Number(4));
  if (call.speed < 0 || call.speed > kFastest) return std::nullopt;
  call.batch = ReadBatch(in);
  if (!in.ok() || !in.at_end()) return std::nullopt;
  return call;
}

}  // namespace omnihdr::firewire
