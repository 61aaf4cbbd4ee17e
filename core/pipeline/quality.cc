#include "core/pipeline/quality.h"

#include <algorithm>
#include <array>
#include <cassert>

namespace omnihdr {
namespace {

constexpr int kLeastLabels = 16;  // as PipelineOptions::Validate
constexpr int kLeastWidth = 128;

int Share(int value, int numerator, int denominator, int least) {
  return std::max(std::min(value, least), value * numerator / denominator);
}

}  // namespace

std::string_view ToString(Overload value) {
  return value == Overload::kDegrade ? "degrade" : "backlog";
}

Status OverloadOptions::Validate() const {
  if (backlog_limit >= 2 && backlog_limit <= 10000) return {};
  return Fail(ErrorKind::kConfig, "pipeline.backlog_limit: {}, expected 2 to 10000", backlog_limit);
}

PipelineOptions AtQuality(const PipelineOptions& options, int level) {
  assert(level >= 0 && level <= kMaxQualityLevel);
  PipelineOptions reduced = options;
  if (level >= 1) reduced.labels = Share(options.labels, 2, 3, kLeastLabels);
  if (level >= 2) reduced.stereo_width = Share(options.stereo_width, 3, 4, kLeastWidth) / 2 * 2;
  if (level >= 3) reduced.neighbours = 1;
  if (level >= 4) {
    reduced.labels = Share(options.labels, 1, 2, kLeastLabels);
    reduced.stereo_width = Share(options.stereo_width, 1, 2, kLeastWidth) / 2 * 2;
  }
  return reduced;
}

std::string_view DescribeQuality(int level) {
  static constexpr std::array<std::string_view, kMaxQualityLevel + 1> kTexts = {
      "full", "labels x 2/3", "labels x 2/3, stereo width x 3/4",
      "labels x 2/3, stereo width x 3/4, 1 neighbour on each side",
      "labels x 1/2, stereo width x 1/2, 1 neighbour on each side"};
  assert(level >= 0 && level <= kMaxQualityLevel);
  return kTexts[static_cast<std::size_t>(level)];
}

int QualityGovernor::Next(int backlog) {
  if (options_.overload == Overload::kBacklog) return 0;
  if (since_change_ < kSettle) {
    ++since_change_;
    return level_;
  }
  const bool rises = backlog >= options_.backlog_limit && backlog >= backlog_at_change_ &&
                     level_ < kMaxQualityLevel;
  const bool falls = backlog <= options_.backlog_limit / 2 && level_ > 0;
  if (!rises && !falls) return level_;
  level_ += rises ? 1 : -1;
  since_change_ = 0;
  backlog_at_change_ = backlog;
  return level_;
}

}  // namespace omnihdr
