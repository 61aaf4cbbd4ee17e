#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "core/pipeline/session_processor.h"
#include "tests/support/small_session.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::testing {

// Small grids: these tests are about what happens, not how well.
inline PipelineOptions QuickOptions() {
  PipelineOptions options;
  options.stereo_width = 128;
  options.labels = 24;
  options.preview_quality = 80;
  return options;
}

// What a processor said while it worked.
struct Said {
  std::vector<ViewDone> views;
  std::vector<std::string> warnings;

  bool Warned(const std::string& text) const {
    return std::any_of(warnings.begin(), warnings.end(),
                       [&text](const std::string& w) { return w.find(text) != std::string::npos; });
  }
  std::vector<std::int64_t> Positions() const {
    std::vector<std::int64_t> positions;
    for (const ViewDone& view : views) positions.push_back(Value(view.position));
    return positions;
  }
};

inline ProcessorCallbacks Into(Said* said) {
  ProcessorCallbacks callbacks;
  callbacks.view_done = [said](const ViewDone& view) { said->views.push_back(view); };
  callbacks.warning = [said](const std::string& message) { said->warnings.push_back(message); };
  return callbacks;
}

inline std::unique_ptr<SessionProcessor> OpenProcessor(
    const std::filesystem::path& session, Said* said, const std::filesystem::path& output = {},
    const PipelineOptions& options = QuickOptions()) {
  Result<std::unique_ptr<SessionProcessor>> processor =
      SessionProcessor::Open(session, output, options, Into(said));
  EXPECT_TRUE(processor) << processor.error().message;
  return processor ? std::move(*processor) : nullptr;
}

// The whole of a session in one go.
struct Processed {
  Said said;
  SessionProcessor::Counts counts;
};
inline Processed ProcessAll(const std::filesystem::path& session,
                            const std::filesystem::path& output = {},
                            const PipelineOptions& options = QuickOptions()) {
  Processed processed;
  const std::unique_ptr<SessionProcessor> processor =
      OpenProcessor(session, &processed.said, output, options);
  if (processor == nullptr) return processed;
  const Status finished = processor->Finish();
  EXPECT_TRUE(finished) << finished.error().message;
  processed.counts = processor->counts();
  return processed;
}

// Tells which files differ, instead of printing their bytes.
inline ::testing::AssertionResult SameBytes(const std::map<std::string, std::string>& a,
                                            const std::map<std::string, std::string>& b) {
  std::string difference;
  for (const auto& [name, bytes] : a) {
    const auto other = b.find(name);
    if (other == b.end()) {
      difference += name + " is missing; ";
    } else if (other->second != bytes) {
      difference += name + " differs; ";
    }
  }
  for (const auto& [name, bytes] : b) {
    if (!a.contains(name)) difference += name + " is extra; ";
  }
  if (difference.empty()) return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure() << difference;
}

}  // namespace omnihdr::testing
