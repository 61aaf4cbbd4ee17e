#pragma once

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <span>
#include <type_traits>
#include <utility>

#include "core/base/large_memory.h"

namespace omnihdr {

// A rectangle of pixels somebody else owns. Row 0 is the top; a pixel is `channels` adjacent values
// (interleaved); consecutive rows are `stride` values apart. Cheap to copy; T may be const.
template <typename T>
class ImageView {
 public:
  ImageView() = default;
  ImageView(T* data, int width, int height, int channels, std::ptrdiff_t stride)
      : data_(data), width_(width), height_(height), channels_(channels), stride_(stride) {}
  // A view of mutable pixels is a view of constant ones.
  operator ImageView<const T>() const  // NOLINT(google-explicit-constructor)
      requires(!std::is_const_v<T>) {
    return {data_, width_, height_, channels_, stride_};
  }

  int width() const { return width_; }
  int height() const { return height_; }
  int channels() const { return channels_; }
  std::ptrdiff_t stride() const { return stride_; }
  bool empty() const { return width_ == 0 || height_ == 0; }
  T* row(int y) const { return data_ + y * stride_; }
  T* pixel(int x, int y) const { return row(y) + static_cast<std::ptrdiff_t>(x) * channels_; }
  T& at(int x, int y, int c = 0) const {
    assert(x >= 0 && x < width_ && y >= 0 && y < height_ && c >= 0 && c < channels_);
    return pixel(x, y)[c];
  }
  ImageView Crop(int x, int y, int width, int height) const {
    return {pixel(x, y), width, height, channels_, stride_};
  }

 private:
  T* data_ = nullptr;
  int width_ = 0;
  int height_ = 0;
  int channels_ = 0;
  std::ptrdiff_t stride_ = 0;
};

// Owns a rectangle of pixels: interleaved channels, rows without gaps, 64-byte aligned start. Move
// only, so that a copy of megabytes is always written as Clone().
template <typename T>
class Image {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  Image() = default;
  // Pixels are value-initialised (zero).
  Image(int width, int height, int channels = 1) : Image(width, height, channels, T{}) {}
  Image(int width, int height, int channels, T value)
      : Image(Allocated{}, width, height, channels) {
    std::fill_n(data_.get(), size(), value);
  }
  // For a picture whose every value is then written: pixels hold anything, all bits set where
  // assertions are on (NaN, of floats), so that a test sees the one that was forgotten.
  static Image Uninitialized(int width, int height, int channels = 1) {
    Image image(Allocated{}, width, height, channels);
#ifndef NDEBUG
    std::memset(static_cast<void*>(image.data()), 0xFF, sizeof(T) * image.size());
#endif
    return image;
  }
  Image(Image&& other) noexcept { *this = std::move(other); }
  Image& operator=(Image&& other) noexcept {
    data_ = std::move(other.data_);
    width_ = std::exchange(other.width_, 0);
    height_ = std::exchange(other.height_, 0);
    channels_ = std::exchange(other.channels_, 0);
    return *this;
  }
  Image Clone() const {
    Image copy = Uninitialized(width_, height_, channels_);
    std::copy_n(data_.get(), size(), copy.data_.get());
    return copy;
  }

  int width() const { return width_; }
  int height() const { return height_; }
  int channels() const { return channels_; }
  bool empty() const { return width_ == 0 || height_ == 0; }
  // Number of values: width · height · channels.
  std::size_t size() const {
    return static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_) *
           static_cast<std::size_t>(channels_);
  }
  T* data() { return data_.get(); }
  const T* data() const { return data_.get(); }
  std::span<T> values() { return {data_.get(), size()}; }
  std::span<const T> values() const { return {data_.get(), size()}; }
  T* row(int y) { return data_.get() + y * stride(); }
  const T* row(int y) const { return data_.get() + y * stride(); }
  T* pixel(int x, int y) { return row(y) + static_cast<std::ptrdiff_t>(x) * channels_; }
  const T* pixel(int x, int y) const { return row(y) + static_cast<std::ptrdiff_t>(x) * channels_; }
  T& at(int x, int y, int c = 0) { return view().at(x, y, c); }
  const T& at(int x, int y, int c = 0) const { return view().at(x, y, c); }
  ImageView<T> view() { return {data_.get(), width_, height_, channels_, stride()}; }
  ImageView<const T> view() const { return {data_.get(), width_, height_, channels_, stride()}; }
  operator ImageView<const T>() const { return view(); }  // NOLINT(google-explicit-constructor)

 private:
  struct Allocated {};
  Image(Allocated /*unused*/, int width, int height, int channels)
      : width_(width), height_(height), channels_(channels) {
    assert(width >= 0 && height >= 0 && channels >= 0);
    data_.reset(static_cast<T*>(AllocateLarge(sizeof(T) * size())));
  }
  struct Free {
    void operator()(T* p) const { FreeLarge(p); }
  };
  std::ptrdiff_t stride() const { return static_cast<std::ptrdiff_t>(width_) * channels_; }

  std::unique_ptr<T, Free> data_;
  int width_ = 0;
  int height_ = 0;
  int channels_ = 0;
};

}  // namespace omnihdr
