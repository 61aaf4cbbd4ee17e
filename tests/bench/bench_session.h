#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "core/pipeline/session_processor.h"
#include "core/session/view_writer.h"
#include "tests/bench/bench_drive.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr {

// A session on disk that grows position by position and is followed by our pipeline, with default
// options unless others are given: every step makes one view, all its files included.
class BenchSession {
 public:
  explicit BenchSession(const BenchDrive& drive, const PipelineOptions& options = {})
      : drive_(drive) {
    Result<SessionWriter> writer = SessionWriter::Create(directory_.path() / "s", drive.info);
    if (!writer) std::abort();
    writer_.emplace(std::move(*writer));
    Result<std::unique_ptr<SessionProcessor>> processor =
        SessionProcessor::Open(directory_.path() / "s", {}, options, {});
    if (!processor) std::abort();
    processor_ = std::move(*processor);
  }

  // The camera's work: a frame of the next position, durable.
  void Record() { drive_.Append(*writer_); }
  // The pipeline's: everything until the next view is on disk.
  void Process() {
    if (!processor_->Step()) std::abort();
    ++processed_;
  }
  void RecordAndProcess(int positions) {
    for (int k = 0; k < positions; ++k) {
      Record();
      Process();
    }
  }
  // Views and frames of the past are of no use to the pipeline; disks are small.
  void Forget() {
    const std::int64_t keep = 16;
    for (; forgotten_ < processed_ - keep; ++forgotten_) {
      std::filesystem::remove_all(directory_.path() / "s" / "views" /
                                  ViewDirectoryName(PositionId{forgotten_}));
    }
  }
  std::filesystem::path views() const { return directory_.path() / "s" / "views"; }

 private:
  const BenchDrive& drive_;
  testing::TemporaryDirectory directory_;
  std::optional<SessionWriter> writer_;
  std::unique_ptr<SessionProcessor> processor_;
  std::int64_t processed_ = 0;
  std::int64_t forgotten_ = 0;
};

}  // namespace omnihdr
