#pragma once

#include <gtest/gtest.h>
#include <stdlib.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include "core/session/session.h"
#include "core/session/view_writer.h"

namespace omnihdr::test {

// A directory that goes with the test.
class TemporaryDirectory {
 public:
  TemporaryDirectory() {
    // In memory where there is such a place: thousands of fsyncs then cost nothing.
    const std::filesystem::path memory = "/dev/shm";
    const bool in_memory = ::access(memory.c_str(), W_OK) == 0;
    std::string pattern =
        ((in_memory ? memory : std::filesystem::temp_directory_path()) / "omnihdr-session-XXXXXX")
            .string();
    if (::mkdtemp(pattern.data()) == nullptr) ADD_FAILURE() << "mkdtemp " << pattern;
    path_ = pattern;
  }
  ~TemporaryDirectory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TemporaryDirectory(const TemporaryDirectory&) = delete;
  TemporaryDirectory& operator=(const TemporaryDirectory&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

inline std::string Slurp(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

inline void Spill(const std::filesystem::path& path, const std::string& text) {
  std::filesystem::create_directories(path.parent_path());
  std::ofstream file(path, std::ios::binary);
  file << text;
  if (!file) ADD_FAILURE() << "write " << path;
}

inline SessionInfo SampleInfo() {
  SessionInfo info;
  info.created = "2026-01-01T00:00:00Z";
  info.camera.model = "test camera";
  info.camera.width = 1536;
  info.camera.height = 768;
  return info;
}

inline FrameRecord SampleRecord(std::uint64_t frame, std::int64_t position) {
  FrameRecord record;
  record.frame = FrameId{frame};
  record.position = PositionId{position};
  record.file = fmt::format("raw/{:06}.png", frame);
  record.exposure.time = ExposureTime::Seconds(0.004);
  record.trigger_time = HostTime::FromNanoseconds(5'000'000'000);
  record.timestamp = HostTime::FromNanoseconds(5'002'000'000);
  return record;
}

inline ViewRecord SampleView(std::int64_t position) {
  ViewRecord view;
  view.position = PositionId{position};
  view.frames = {0, 1, 2};
  view.reference = 1;
  view.mode = "spatiotemporal";
  view.radiance_max = 812.0;
  view.valid_fraction = 0.998;
  return view;
}

}  // namespace omnihdr::test
