#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/units.h"
#include "core/session/session_check.h"

namespace omnihdr {

// Private to core/session: one view against its journal.

// What the journal says of frames, for views to be held against. Not a map: a survey has many.
class FrameIndex {
 public:
  struct Entry {
    std::uint64_t frame = 0;
    std::int64_t position = 0;
    bool has_pixels = false;  // its line says "ok"
  };
  explicit FrameIndex(std::vector<Entry> entries);
  const Entry* Find(std::uint64_t frame) const;  // null when no line has that number
  bool HasUsableFrame(std::int64_t position) const;
  // Positions with a usable frame, ascending.
  const std::vector<std::int64_t>& positions() const { return positions_; }

 private:
  std::vector<Entry> entries_;  // by frame
  std::vector<std::int64_t> positions_;
};

// What is wrong with the view in `directory` (VIEWS/000003). `name` stands for it in the findings.
std::vector<SessionFinding> CheckView(const std::filesystem::path& directory, PositionId position,
                                      const std::string& name, const FrameIndex& frames,
                                      bool quick);

// `message` without the "name: " or "name:" in front that our readers' errors begin with; takes a
// line number that follows into `line`, when it is not null.
std::string WithoutName(std::string message, std::string_view name, int* line = nullptr);

}  // namespace omnihdr
