#pragma once

#include <cstddef>
#include <cstdint>

// Bounds of what a session may say. Wide enough for every camera and survey, narrow enough that
// nothing downstream overflows or allocates without limit. Private to core/session.
namespace omnihdr::session_limits {

inline constexpr std::int64_t kMinSide = 64;       // pixels
inline constexpr std::int64_t kMaxSide = 1 << 16;  // pixels
inline constexpr double kMinExposureSeconds = 1e-9;
inline constexpr double kMaxExposureSeconds = 1e5;
inline constexpr double kMaxGainDb = 200.0;
inline constexpr double kMaxCylinderZ = 1000.0;
inline constexpr std::int64_t kMaxFrame = 999'999'999'999;
inline constexpr std::int64_t kMaxPosition = 999'999'999;
inline constexpr std::int64_t kMaxFramesPerPosition = 1000;
inline constexpr std::size_t kMaxBracket = 1000;
inline constexpr std::size_t kMaxLineBytes = std::size_t{1} << 20;
inline constexpr std::size_t kMaxInfoBytes = std::size_t{1} << 22;  // session.json
inline constexpr std::size_t kMaxViewBytes = std::size_t{1} << 26;  // view.json
inline constexpr std::size_t kMaxJournalBytes = std::size_t{1} << 32;
inline constexpr std::size_t kMaxWarnings = 1000;  // kept; further ones are only counted

}  // namespace omnihdr::session_limits
