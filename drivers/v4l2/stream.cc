#include "drivers/v4l2/stream.h"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>

namespace omnihdr::v4l2 {
namespace {

constexpr std::int64_t kMostSeconds = 1'000'000'000;  // of a machine's running

}  // namespace

Status Stream::Start(const FrameLayout& layout) {
  if (running_) return {};
  Status begun = Begin(layout);
  if (!begun) Stop();
  return begun;
}

Status Stream::Begin(const FrameLayout& layout) {
  OMNIHDR_TRY(CheckLayout(layout));
  v4l2_requestbuffers request{};
  request.count = kBuffers;
  request.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  request.memory = V4L2_MEMORY_MMAP;
  if (const int called = device_->Ioctl(VIDIOC_REQBUFS, &request); called < 0) {
    return FailCall("VIDIOC_REQBUFS", called);
  }
  if (request.count < 2 || request.count > kMaxBuffers) {
    return Fail(ErrorKind::kProtocol, "VIDIOC_REQBUFS: {} buffers: expected 2 to {}", request.count,
                kMaxBuffers);
  }
  for (std::uint32_t i = 0; i < request.count; ++i) {
    v4l2_buffer buffer{};
    buffer.index = i;
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    buffer.memory = V4L2_MEMORY_MMAP;
    if (const int called = device_->Ioctl(VIDIOC_QUERYBUF, &buffer); called < 0) {
      return FailCall("VIDIOC_QUERYBUF", called);
    }
    if (buffer.length < layout.image_bytes || buffer.length > 2 * kMaxImageBytes) {
      return Fail(ErrorKind::kProtocol, "VIDIOC_QUERYBUF: {} bytes: expected {} to {}",
                  buffer.length, layout.image_bytes, 2 * kMaxImageBytes);
    }
    const V4l2Device::Mapping mapping = device_->Map(buffer.length, buffer.m.offset);
    if (mapping.data == nullptr) return FailCall("map a buffer", mapping.error);
    buffers_.push_back({mapping, buffer.length});
    OMNIHDR_TRY(Queue(i));
  }
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (const int called = device_->Ioctl(VIDIOC_STREAMON, &type); called < 0) {
    return FailCall(called == -ENOSPC
                        ? "VIDIOC_STREAMON: not enough bandwidth on the USB bus (take "
                          "a smaller picture or another port)"
                        : "VIDIOC_STREAMON",
                    called);
  }
  running_ = true;
  return {};
}

void Stream::Stop() {
  if (buffers_.empty()) return;
  // A device that has gone refuses both, and has nothing left to stop.
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  device_->Ioctl(VIDIOC_STREAMOFF, &type);
  for (const Buffer& buffer : buffers_) device_->Unmap(buffer.mapping.data, buffer.length);
  buffers_.clear();
  v4l2_requestbuffers none{};
  none.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  none.memory = V4L2_MEMORY_MMAP;
  device_->Ioctl(VIDIOC_REQBUFS, &none);
  running_ = false;
}

Status Stream::Queue(std::uint32_t index) {
  v4l2_buffer buffer{};
  buffer.index = index;
  buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  buffer.memory = V4L2_MEMORY_MMAP;
  const int called = device_->Ioctl(VIDIOC_QBUF, &buffer);
  if (called < 0) return FailCall("VIDIOC_QBUF", called);
  return {};
}

Status Stream::Recycle(const Filled& filled) { return Queue(filled.index); }

Result<std::optional<Filled>> Stream::Next(Nanoseconds timeout) {
  if (!running_) return Fail(ErrorKind::kUnavailable, "not streaming");
  const int ready = device_->WaitForFrame(timeout);
  if (ready < 0) return FailCall("poll", ready);
  if (ready == 0) return std::optional<Filled>();
  v4l2_buffer buffer{};
  buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  buffer.memory = V4L2_MEMORY_MMAP;
  const int called = device_->Ioctl(VIDIOC_DQBUF, &buffer);
  if (called == -EAGAIN) return std::optional<Filled>();
  if (called < 0) return FailCall("VIDIOC_DQBUF", called);
  if (buffer.index >= buffers_.size()) {
    return Fail(ErrorKind::kProtocol, "VIDIOC_DQBUF: buffer {}: expected below {}", buffer.index,
                buffers_.size());
  }
  const Buffer& own = buffers_[buffer.index];
  Filled filled;
  filled.index = buffer.index;
  filled.bytes = {own.mapping.data, std::min<std::size_t>(buffer.bytesused, own.length)};
  filled.sequence = buffer.sequence;
  filled.damaged = (buffer.flags & V4L2_BUF_FLAG_ERROR) != 0;
  filled.taken_out = clock_->Now();
  filled.stamp = filled.taken_out;
  const std::int64_t seconds = buffer.timestamp.tv_sec;
  const std::int64_t microseconds = buffer.timestamp.tv_usec;
  if ((buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC &&
      seconds >= 0 && seconds < kMostSeconds && microseconds >= 0 && microseconds < 1'000'000) {
    filled.stamp = HostTime::FromNanoseconds(seconds * 1'000'000'000 + microseconds * 1000);
    filled.kind = (buffer.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE
                      ? StampKind::kStart
                      : StampKind::kEnd;
  }
  return std::optional<Filled>(filled);
}

}  // namespace omnihdr::v4l2
